"""One gimbal of a capture in virtual time: the twin's controller, the renderer and the tracker; the seat asks for looks."""

import asyncio
from collections.abc import Coroutine
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
import pytest
from closed_loop import HOST_START_NS, NAME, SMALL, ClosedLoop, quick

from trackerd.calibrate.plan.looks import Eye, looks_at
from trackerd.contract.clock import HostNs, UnixNs
from trackerd.contract.errors import DeviceFault, DeviceTimeout
from trackerd.contract.model import Image
from trackerd.engine.pointing import Pointing
from trackerd.formats.looks import Look
from trackerd.service.seat import Seat

T = TypeVar("T")
SIZE = (SMALL["width_px"], SMALL["height_px"])
ORIGIN = (SMALL["offset_x_px"], SMALL["offset_y_px"])


@dataclass
class LoopClock:
    """The scene's time as the host has it."""

    loop: ClosedLoop

    def now(self) -> HostNs:
        return HostNs(HOST_START_NS + self.loop.now_ns)

    def unix(self, instant: HostNs) -> UnixNs:
        return UnixNs(instant)


class Bench:
    def __init__(self, *overrides: str) -> None:
        self.loop = quick("twin.encoder.white_arcsec=0.5", *overrides)
        self.pointing = Pointing(self.loop.settings.steering)
        self.loop.axes = self.pointing  # type: ignore[assignment]
        self.loop.connect()
        nominal = self.loop.scene.mounts[NAME].station
        self.probe_mm = self.loop.scene.truth(0)[0]
        travel = ((-1.0, 1.0), (-1.0, 1.0))
        self.looks = list(looks_at(Eye(nominal, travel, ORIGIN, SIZE, 4.0), self.probe_mm, 0, faces=(1,)))
        self.picture: tuple[Image, tuple[int, int]] | None = None
        size = float(SIZE[0]), float(SIZE[1])
        self.seat = Seat(NAME, self.pointing, LoopClock(self.loop), size, 1.0 / nominal.lens.fx_px, lambda _: self.picture)

    async def during(self, work: Coroutine[Any, Any, T], within_s: float = 40.0) -> T:
        """Moves the scene on until the work is done."""
        task = asyncio.ensure_future(work)
        until_ns = self.loop.now_ns + round(within_s * 1e9)
        while not task.done():
            assert self.loop.now_ns < until_ns
            told = len(self.loop.steps)
            self.loop.run(0.01)
            for step in self.loop.steps[told:]:
                self.seat.offer(step)
            await asyncio.sleep(0)
            await asyncio.sleep(0)
        return task.result()


async def test_each_look_shows_the_probe_at_its_place_with_the_encoders_of_these_frames() -> None:
    bench = Bench()
    bench.pointing.arm()
    await bench.during(bench.seat.ready(30.0))
    for look in bench.looks[:2]:
        view, _ = await bench.during(bench.seat.take(look, 6, 60.0))
        assert view.frames == 6
        np.testing.assert_allclose(view.q_px, look.q_px, atol=1.5)
        true = bench.loop.gimbal.station.pixel(bench.probe_mm, *bench.loop.gimbal.angles(bench.loop.now_ns))
        np.testing.assert_allclose(view.q_px, true, atol=0.05)
        assert (view.az_rad, view.el_rad) == pytest.approx(bench.loop.gimbal.angles(bench.loop.now_ns), abs=3e-6)
        assert 0.0 < np.sqrt(np.trace(view.cov_px2)) < 0.1


async def test_a_probe_beside_the_image_is_found_in_rings_and_what_the_geometry_is_off_by_is_learnt() -> None:
    off = "twin.error.left.stand_tilt_arcsec=[0.0,1700.0]"  # 250 px: out of the image of 320 px
    bench = Bench(off)
    bench.pointing.arm()
    assert await bench.during(bench.seat.find(bench.looks, 60.0))
    az, el = bench.seat.off_rad[1]
    assert max(abs(az), abs(el)) == pytest.approx(1700.0 / 206265.0, rel=0.1)
    for within_px in (12.0, 1.0):  # each look learns what the one before could not know
        view, _ = await bench.during(bench.seat.take(bench.looks[0], 5, 60.0))
        np.testing.assert_allclose(view.q_px, bench.looks[0].q_px, atol=within_px)


async def test_the_picture_that_is_kept_shows_the_ball() -> None:
    bench = Bench()
    bench.pointing.arm()
    bench.picture = np.arange(240 * 320, dtype=np.uint32).reshape(240, 320), ORIGIN
    view, crop = await bench.during(bench.seat.take(bench.looks[0], 4, 60.0))
    assert crop is not None
    row, column = divmod(int(crop[crop.shape[0] // 2, crop.shape[1] // 2]), 320)
    np.testing.assert_allclose((column + ORIGIN[0], row + ORIGIN[1]), view.q_px, atol=view.r_px)
    assert crop.shape[0] >= 2.0 * view.r_px


async def test_unarmed_axes_take_no_look() -> None:
    bench = Bench()
    with pytest.raises(DeviceFault, match="gimbal left: turn to the probe: not armed"):
        await bench.during(bench.seat.take(bench.looks[0], 4, 60.0))
    with pytest.raises(DeviceFault, match="gimbal left: begin: not armed"):
        await bench.during(bench.seat.ready(0.05))


async def test_a_hidden_probe_is_told_after_the_patience() -> None:
    bench = Bench()
    bench.pointing.arm()
    bench.loop.hidden = True
    with pytest.raises(DeviceTimeout, match="gimbal left: look at the probe: "):
        await bench.during(bench.seat.take(bench.looks[0], 4, 0.5))


async def test_a_look_beyond_the_travel_is_told_with_what_is_missing() -> None:
    bench = Bench("gimbal.left.steering.az_limits_deg=[-5,5]")
    bench.pointing.arm()
    far = Look(0, 1, bench.looks[0].q_px, 0.5, 0.0)
    with pytest.raises(DeviceTimeout, match=r"the axes did not get there: az -23\.\d+, el"):
        await bench.during(bench.seat.take(far, 4, 1.5))
