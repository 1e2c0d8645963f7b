"""The capture without devices: what is taken, what is not taken again, and how a mover's own program is followed."""

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass, field
from math import radians
from typing import Any

import numpy as np
import pytest
from sim_cell import station

from trackerd.calibrate.plan.looks import Eye
from trackerd.calibrate.plan.make import Pace, errands, plan_stops
from trackerd.calibrate.plan.volume import Box
from trackerd.contract.errors import DeviceFault, DeviceTimeout
from trackerd.engine.still_look import StillView
from trackerd.formats.looks import Errand, Look
from trackerd.formats.mover import Stop
from trackerd.service import capture
from trackerd.service.capture import ByProgram, Capture, Told
from trackerd.service.seat import _spiral

capture.WATCH_S = 0.0
TRAVEL = ((radians(-60.0), radians(60.0)), (radians(-60.0), radians(60.0)))
EYES = [Eye(station(name, x), TRAVEL, (704, 528), (640, 480), 4.0) for name, x in (("left", -550.0), ("right", 550.0))]
BOX = Box.around(np.zeros(3), np.array((300.0, 300.0, 200.0)))


def planned(count: int = 6) -> list[Errand]:
    return errands(EYES, plan_stops(EYES, BOX, count, 0, Pace(5, 55.0)))


@dataclass
class Machine:
    """The probe is at `place`; a program moves on by itself, one stop each time somebody looks for it."""

    stops: Sequence[Stop]
    by_program: bool = False
    place: int = -1
    went: list[str] = field(default_factory=list)

    async def go(self, stop: Stop) -> bool:
        if self.by_program:
            return False
        self.place = [one.name for one in self.stops].index(stop.name)
        self.went.append(stop.name)
        return True

    def move_on(self, looker: str) -> None:
        if looker == "left":  # of two that look, one is enough
            self.place = min(self.place + 1, len(self.stops) - 1)


@dataclass
class MadeSeat:
    """Sees the probe where it is, through a geometry that is off by so much; `fails` at a look."""

    eye: Eye
    machine: Machine
    off: tuple[float, float] = (0.002, -0.003)
    fails: str = ""
    off_rad: dict[int, tuple[float, float]] = field(default_factory=dict)
    turned: list[Look] = field(default_factory=list)

    async def ready(self, patience_s: float) -> None:
        pass

    async def find(self, looks: Sequence[Look], patience_s: float) -> bool:
        await asyncio.sleep(0)
        if self.machine.place < 0:
            self.machine.move_on(self.eye.name)
        return True

    async def turn(self, look: Look) -> None:
        self.turned.append(look)
        self.machine.move_on(self.eye.name)
        await asyncio.sleep(0)

    def direction(self) -> tuple[float, float] | None:
        if self.machine.place < 0:
            return None
        az, el = self.eye.station.aim(self.machine.stops[self.machine.place].p_mm)
        return az + self.off[0], el + self.off[1]

    async def take(self, look: Look, frames: int, patience_s: float) -> tuple[StillView, Any]:
        await asyncio.sleep(0)
        if self.fails:
            raise DeviceFault("gimbal left", "turn to the probe", self.fails)
        self.off_rad[look.face] = self.off
        here = self.machine.stops[self.machine.place].name
        return StillView(look.q_px, 60.0, np.eye(2), look.az_rad, look.el_rad, np.eye(2), frames, 0), here


@dataclass
class Bench:
    machine: Machine
    capture: Capture
    stored: list[tuple[str, str, str]] = field(default_factory=list)  # view, gimbal, the stop that the probe was at
    told: list[Told] = field(default_factory=list)


def bench(work: list[Errand], taken: set[tuple[str, str]] | None = None, by_program: bool = False, fails: str = "") -> Bench:
    machine = Machine([errand.stop for errand in work], by_program)
    seats: Any = {eye.name: MadeSeat(eye, machine, fails=fails) for eye in EYES}
    mover: Any = machine if not by_program else ByProgram()

    async def store(errand: Errand, gimbal: str, look: Look, view: StillView, image: Any) -> None:
        made.stored.append((errand.view(look), gimbal, image))

    made_told: list[Told] = []
    made = Bench(machine, Capture(work, seats, mover, store, taken or set(), made_told.append, 5), told=made_told)
    return made


async def test_every_gimbal_takes_every_look_at_every_stop() -> None:
    work = planned()
    made = bench(work)
    await made.capture.run()
    assert len(made.stored) == made.capture.total == 6 * 2 * 5
    assert all(view.startswith(at) for view, _, at in made.stored)
    assert made.told[-1] == Told(work[-1].stop.name, 60, 60)


async def test_what_was_taken_before_an_interruption_is_not_taken_again() -> None:
    work = planned()
    first = {(work[0].view(look), gimbal) for gimbal, looks in work[0].looks.items() for look in looks}
    made = bench(work, first | {(work[1].view(work[1].looks["left"][0]), "left")})
    await made.capture.run()
    assert len(made.stored) == 60 - 10 - 1
    assert work[0].stop.name not in made.machine.went


async def test_a_machines_own_program_is_followed_by_where_the_probe_is_seen() -> None:
    made = bench(planned(), by_program=True)
    await made.capture.run()
    assert len(made.stored) == 60
    assert all(view.startswith(at) for view, _, at in made.stored)


async def test_a_program_that_does_not_come_is_told_by_the_stop() -> None:
    work = planned()
    made = bench(work, by_program=True)
    made.capture.program_s = 0.05
    made.machine.stops = made.machine.stops[1:]  # it never comes to the first one
    with pytest.raises(DeviceTimeout, match=f"the mover: come to {work[0].stop.name}: the probe was not seen there"):
        await made.capture.run()


async def test_a_gimbal_that_may_not_move_ends_the_capture_in_words() -> None:
    made = bench(planned(), fails="the axes are not referenced")
    with pytest.raises(ExceptionGroup) as raised:
        await made.capture.run()
    assert all(isinstance(error, DeviceFault) for error in raised.value.exceptions)
    assert not made.stored


def test_a_search_goes_outwards_and_nowhere_twice() -> None:
    places = list(_spiral())
    assert places[0] == (0.0, 0.0)
    assert len(set(places)) == len(places) == 25
    rings = [max(map(abs, place)) for place in places]
    assert rings == sorted(rings)
