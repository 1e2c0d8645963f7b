"""The capture of a calibration's dataset: stop after stop, each gimbal takes its looks and every view is stored at once."""

import asyncio
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from trackerd.contract.errors import DeviceTimeout
from trackerd.contract.model import Image
from trackerd.engine.still_look import StillView
from trackerd.formats.looks import Errand, Face, Look
from trackerd.formats.mover import Stop
from trackerd.service.seat import Seat, middle_of

READY_S = 5.0  # from the links being up to a referenced controller without a fault
WATCH_S = 0.1  # between two looks at whether the mover has come

Store = Callable[[Errand, str, Look, StillView, Image | None], Awaitable[None]]


class Mover(Protocol):
    """Who carries the probe."""

    async def go(self, stop: Stop) -> bool:
        """Carries it there and returns True once it stands; False: it goes by its own program, and has to be waited for."""
        ...


class ByProgram:
    """A machine that runs the planned program."""

    async def go(self, _: Stop) -> bool:
        return False


@dataclass(frozen=True, slots=True)
class Told:
    """How far it is."""

    stop: str
    done: int  # views, of all gimbals
    of: int


@dataclass(slots=True)
class Capture:
    """`taken` are the views (view, gimbal) of an earlier run; they are not taken again."""

    errands: Sequence[Errand]
    seats: Mapping[str, Seat]
    mover: Mover
    store: Store
    taken: set[tuple[str, str]]
    told: Callable[[Told], None]
    frames: int
    look_s: float = 20.0  # patience with one look
    program_s: float = 600.0  # patience with the mover's program, from stop to stop

    async def run(self) -> None:
        """Raises DeviceError where a look fails; what was taken before is stored."""
        for seat in self.seats.values():
            await seat.ready(READY_S)
        found = False
        for errand in self.errands:
            left = {name: self._left(errand, name) for name in self.seats}
            if not any(left.values()):
                continue
            if not await self.mover.go(errand.stop):
                await self._wait_for(errand, found)
            found = True
            async with asyncio.TaskGroup() as group:
                for name, looks in left.items():
                    group.create_task(self._looks(errand, name, looks))

    def _left(self, errand: Errand, gimbal: str) -> list[Look]:
        return [look for look in errand.looks[gimbal] if (errand.view(look), gimbal) not in self.taken]

    async def _looks(self, errand: Errand, gimbal: str, looks: Sequence[Look]) -> None:
        seat = self.seats[gimbal]
        for look in looks:
            if look.face not in seat.off_rad and not await seat.find(_of_face(errand, gimbal, look.face), self.look_s):
                raise DeviceTimeout(f"gimbal {gimbal}", f"find the probe at {errand.stop.name}", "it is nowhere near there")
            view, image = await seat.take(look, self.frames, self.look_s)
            await self.store(errand, gimbal, look, view, image)
            self.taken.add((errand.view(look), gimbal))
            self.told(Told(errand.stop.name, len(self.taken), self.total))

    @property
    def total(self) -> int:
        return sum(len(looks) for errand in self.errands for looks in errand.looks.values())

    async def _wait_for(self, errand: Errand, found: bool) -> None:
        """Until the gimbals that look there see the probe, and no other stop of the plan is nearer to where they see it."""
        try:
            async with asyncio.timeout(self.program_s):
                while True:
                    for name, seat in self.seats.items():
                        await self._look_out(seat, _of_face(errand, name, 1), found)
                    seen = {name: direction for name, seat in self.seats.items() if (direction := seat.direction()) is not None}
                    if len(seen) == len(self.seats) and self.nearest(seen) == errand.stop.name:
                        return
                    await asyncio.sleep(WATCH_S)
        except TimeoutError:
            raise DeviceTimeout(
                "the mover", f"come to {errand.stop.name}", f"the probe was not seen there in {self.program_s:g} s"
            ) from None

    async def _look_out(self, seat: Seat, looks: Sequence[Look], found: bool) -> None:
        """Where the probe will come; all round, as long as nobody knows what the nominal geometry is off by."""
        if found:
            await seat.turn(middle_of(looks))
        elif seat.direction() is None:
            await seat.find(looks, self.look_s)

    def nearest(self, seen_rad: Mapping[str, tuple[float, float]]) -> str:
        """The stop whose nominal directions are nearest to those of a probe in the middle of the images, less what they are off
        by."""

        def distance(errand: Errand) -> float:
            total = 0.0
            for name, (az, el) in seen_rad.items():
                az_off, el_off = self.seats[name].off_rad.get(1, (0.0, 0.0))
                middle = middle_of(_of_face(errand, name, 1))
                total += (az - az_off - middle.az_rad) ** 2 + (el - el_off - middle.el_rad) ** 2
            return total

        return min(self.errands, key=distance).stop.name


def _of_face(errand: Errand, gimbal: str, face: Face) -> list[Look]:
    return [look for look in errand.looks[gimbal] if look.face == face]
