"""One gimbal of a capture: turned to a look, it gives one measurement of the target that stands still there."""

import asyncio
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from trackerd.contract.clock import Clock, HostNs
from trackerd.contract.errors import Degenerate, DeviceFault, DeviceTimeout
from trackerd.contract.model import Found, Image
from trackerd.engine.pointing import Pointing
from trackerd.engine.still_look import StillLook, StillView
from trackerd.engine.track import Step
from trackerd.formats.looks import Face, Look
from trackerd.steering.follow import angle_from_offset

CROP_RADII = 1.6  # of the picture that is kept, to either side of the ball's middle
OLD_S = 1.0  # of a frame: the camera has stopped
SETTLE_NS = 120_000_000  # after the encoders are there within 100": the last wobble of a servo of 20 Hz is below 1" by then
SEARCHED_FRAMES = 8  # of each place of a search; a ball is found and confirmed by then
SEARCH_STEP = 0.5  # of the image, from place to place of a search
SEARCH_RINGS = 2

Pair = tuple[float, float]


@dataclass(slots=True)
class Seat:
    """`offer` it every step of its station. What the nominal geometry is off by is learnt on the way, in encoder angles."""

    name: str
    pointing: Pointing
    clock: Clock
    image_px: Pair  # width, height
    rad_per_px: float
    image_of: Callable[[int], tuple[Image, tuple[int, int]] | None]  # a frame's image and its origin, while it is kept
    off_rad: dict[Face, Pair] = field(default_factory=dict)
    last: Step | None = None
    _news: asyncio.Event = field(default_factory=asyncio.Event)

    def offer(self, step: Step) -> None:
        self.last = step
        self._news.set()
        self._news = asyncio.Event()

    async def take(self, look: Look, frames: int, patience_s: float) -> tuple[StillView, Image | None]:
        """Raises DeviceTimeout where the axes do not get there, or nothing stands still in sight; DeviceFault where they may
        not move."""
        still = StillLook(frames, self.clock.now())
        try:
            async with asyncio.timeout(patience_s):
                await self.turn(look)
                still = StillLook(frames, HostNs(self.clock.now() + SETTLE_NS))
                while (view := still.add(await self._step())) is None:
                    pass
        except TimeoutError:
            raise DeviceTimeout(f"gimbal {self.name}", "look at the probe", self._trouble() or still.reason) from None
        self._learn(view, look)
        return view, self._crop(view)

    async def ready(self, patience_s: float) -> None:
        """Until nothing keeps the axes from moving. Raises DeviceFault, and says what does."""
        try:
            async with asyncio.timeout(patience_s):
                while self.pointing.missing():
                    await self._step()
        except TimeoutError:
            raise DeviceFault(f"gimbal {self.name}", "begin", self.pointing.missing() or "no frames") from None

    async def find(self, looks: Sequence[Look], patience_s: float) -> bool:
        """Turns to where the target of these looks should be in the middle, then round it, until it is seen; learns what the
        nominal geometry is off by there. False: it is nowhere there."""
        middle = middle_of(looks)
        for x, y in _spiral():
            width, height = self.image_px
            turned = SEARCH_STEP * y * height * self.rad_per_px, SEARCH_STEP * x * width * self.rad_per_px
            try:
                async with asyncio.timeout(patience_s):
                    await self.turn(middle, turned)
                    since = self.clock.now()
                    for _ in range(SEARCHED_FRAMES):
                        step = await self._step()
                        if step.instant > since and (seen := self.direction(step)) is not None:
                            self.off_rad[middle.face] = seen[0] - middle.az_rad, seen[1] - middle.el_rad
                            return True
            except TimeoutError:
                words = self._trouble() or f"too few frames in {patience_s:g} s"
                raise DeviceTimeout(f"gimbal {self.name}", "look for the probe", words) from None
        return False

    def direction(self, step: Step | None = None) -> Pair | None:
        """Encoder angles that would show the target, as it was seen last, in the middle; None: it is not seen."""
        step = self.last if step is None else step
        if step is None or step.angles is None or step.jacobian is None or step.offset_px is None:
            return None
        if not isinstance(step.outline, Found):
            return None
        try:
            az, el = angle_from_offset(step.jacobian, step.offset_px)
        except Degenerate:
            return None
        return step.angles.az_rad + az, step.angles.el_rad + el

    async def turn(self, look: Look, by_rad: Pair = (0.0, 0.0)) -> None:
        """To the look, corrected by what has been learnt, and by so much. Raises DeviceFault where the axes may not move."""
        off = self.off_rad.get(look.face, (0.0, 0.0))
        self.pointing.go(look.az_rad + off[0] + by_rad[0], look.el_rad + off[1] + by_rad[1])
        while not self.pointing.arrived:
            if missing := self.pointing.missing():
                raise DeviceFault(f"gimbal {self.name}", "turn to the probe", missing)
            await self._step()

    def _trouble(self) -> str:
        """What the axes or the camera do not do, in words; empty: nothing."""
        if not self.pointing.arrived:
            return self.pointing.missing() or f"the axes did not get there: {self.pointing.off_words}"
        age_s = 0.0 if self.last is None else (self.clock.now() - self.last.instant) * 1e-9
        return f"no frame for {age_s:.1f} s" if self.last is None or age_s > OLD_S else ""

    def _learn(self, view: StillView, look: Look) -> None:
        miss = (float(view.q_px[0] - look.q_px[0]), float(view.q_px[1] - look.q_px[1]))
        az, el = angle_from_offset(view.jacobian, miss)
        self.off_rad[look.face] = (view.az_rad + az - look.az_rad, view.el_rad + el - look.el_rad)

    def _crop(self, view: StillView) -> Image | None:
        kept = self.image_of(view.last_frame)
        if kept is None:
            return None
        image, origin = kept
        x, y = view.q_px - np.array(origin)
        reach = CROP_RADII * view.r_px
        rows, columns = slice(max(0, int(y - reach)), int(y + reach) + 2), slice(max(0, int(x - reach)), int(x + reach) + 2)
        return np.ascontiguousarray(image[rows, columns])

    async def _step(self) -> Step:
        await self._news.wait()
        assert self.last is not None
        return self.last


def middle_of(looks: Sequence[Look]) -> Look:
    """Between looks of one face: their places lie round the middle of the image."""
    az, el = np.mean([(look.az_rad, look.el_rad) for look in looks], axis=0).tolist()
    return Look(-1, looks[0].face, np.mean([look.q_px for look in looks], axis=0), az, el)


def _spiral() -> Iterator[Pair]:
    """Steps of a search: the middle, then ring after ring."""
    yield 0.0, 0.0
    for ring in range(1, SEARCH_RINGS + 1):
        for x in range(-ring, ring + 1):
            for y in range(-ring, ring + 1):
                if max(abs(x), abs(y)) == ring:
                    yield float(x), float(y)
