"""One station and the cell around it: counts, numbering anew, and the devices that come and go, on devices in memory."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from made_devices import CAMERA, EXPOSURE_NS, GIMBAL, MemoryCamera, MemoryGimbal
from sim_cell import station
from vision_pictures import Ball

from trackerd.contract.clock import CameraNs, ClockKind, HostNs, ManualClock
from trackerd.contract.errors import DeviceTimeout, RecordingEnded
from trackerd.contract.model import AxisAngles, CameraInfo, CameraStatistics, Frame, NoAngle, TrackState
from trackerd.engine.axes import Axes
from trackerd.engine.fuse import Fuser
from trackerd.engine.latched import RecordingTime
from trackerd.engine.track import Step, Tracker
from trackerd.formats.settings import CameraSettings, FusionSettings, GimbalSettings
from trackerd.service.axes_link import AxesLink
from trackerd.service.cell_service import CellService, StationParts
from trackerd.service.fusion_task import INBOX, FusionTask
from trackerd.service.notify import Notifier
from trackerd.service.station_task import ARRIVAL_SIGMA_NS, CameraTimes, StationTask
from trackerd.service.supervisor import Device
from trackerd.service.vital_signs import VitalSigns

SETTINGS = GimbalSettings(driver="memory", camera="left", cycle_ms=1.0, stale_ms=20.0)
IMAGE = CameraSettings(driver="memory", width_px=64, height_px=48)
PATIENCE_S = 10.0
LOST = DeviceTimeout("camera left", "wait for a frame", "none for 0.5 s")


class Bench:
    """A station on a gimbal and a camera in memory."""

    def __init__(self, info: CameraInfo = CAMERA, picture: CameraSettings = IMAGE) -> None:
        self.clock = ManualClock(HostNs(10**9))
        self.gimbal = MemoryGimbal(self.clock, GIMBAL)
        self.camera = MemoryCamera(self.clock, info)
        self.link = AxesLink("left", Axes(SETTINGS.steering, False), SETTINGS, RecordingTime(), self.clock)
        tracker = Tracker(station("left", -550.0), 4.0, picture, SETTINGS.steering, SETTINGS.tracking)
        self.steps: asyncio.Queue[Step] = asyncio.Queue()
        self.task = StationTask("left", tracker, self.link, RecordingTime(), self.clock, self._out)
        self.tasks: list[asyncio.Task[None]] = []

    def _out(self, name: str, step: Step) -> None:
        assert name == "left"
        self.steps.put_nowait(step)

    async def step(self) -> Step:
        return await asyncio.wait_for(self.steps.get(), PATIENCE_S)

    def exposed(self, frame_id: int, image: np.ndarray | None = None, **fields: Any) -> None:
        """A frame and its latch."""
        frame = self.camera.expose(frame_id, image, **fields)
        assert frame.mid_exposure is not None
        self.gimbal.expose(frame_id, frame.mid_exposure)


@asynccontextmanager
async def running(with_link: bool = True, **bench: Any) -> AsyncIterator[Bench]:
    """The station's camera, and its link once that knows the controller's clock."""
    made = Bench(**bench)
    if with_link:
        made.tasks.append(asyncio.create_task(made.link.run(made.gimbal)))
        await made.gimbal.exchanged(10)
    made.tasks.append(asyncio.create_task(made.task.run(made.camera)))
    yield made
    for task in made.tasks:
        task.cancel()
    await asyncio.wait(made.tasks)


async def started(bench: Bench, times: int) -> None:
    async with asyncio.timeout(PATIENCE_S):
        while bench.camera.calls.count("start") < times:
            await bench.gimbal.exchanged(1)


# ---- the station -----------------------------------------------------------------------------------------------------


async def test_the_camera_is_stopped_and_the_latches_zeroed_before_the_stream_begins() -> None:
    async with running() as bench:
        zeroed_at_start: list[bool] = []
        bench.camera.on_start = lambda: zeroed_at_start.append(any(c.latch_zero for c in bench.gimbal.commands))
        await started(bench, 1)
        assert bench.camera.calls == ["stop", "start"]
        assert zeroed_at_start == [True]


async def test_a_probe_in_the_picture_becomes_a_line_of_sight() -> None:
    picture = CameraSettings(driver="memory", width_px=640, height_px=480, offset_x_px=704, offset_y_px=528)
    async with running(picture=picture) as bench:
        await started(bench, 1)
        for n in range(2):
            bench.exposed(n, Ball().noisy(n), origin_px=(704, 528))
            step = await bench.step()
        assert step.state is TrackState.LOCKED
        assert step.sightline is not None
        assert step.sightline.received - step.sightline.instant == pytest.approx(EXPOSURE_NS, abs=1e6)
        assert bench.task.state is TrackState.LOCKED
        assert (bench.task.counts.processed, bench.task.counts.missed) == (2, 1)


async def test_every_frame_is_accounted_for() -> None:
    async with running() as bench:
        await started(bench, 1)
        bench.exposed(0)
        bench.exposed(4)
        bench.camera.counts = CameraStatistics(delivered=3, skipped=2, dropped=1)
        for _ in range(2):
            await bench.step()
        await bench.gimbal.exchanged(2)
        bench.camera.expose(5)  # without a latch
        await bench.step()
        counts = bench.task.counts
        assert (counts.processed, counts.skipped, counts.dropped, counts.no_angle, counts.missed) == (3, 2, 1, 1, 3)
        assert counts.last_no_angle == "its latch did not come within 2 bus cycles"
        assert counts.last_missed
        stages = bench.task.stages.percentiles()
        assert [stages[name].n for name in ("angles", "work", "tracked")] == [3, 3, 3]


async def test_what_a_camera_lost_before_it_was_opened_again_is_not_forgotten() -> None:
    async with running() as bench:
        bench.camera.counts = CameraStatistics(skipped=2, dropped=1)
        bench.exposed(0)
        await bench.step()
        again = MemoryCamera(bench.clock, counts=CameraStatistics(skipped=1))
        bench.tasks.append(asyncio.create_task(bench.task.run(again)))
        again.expose(0)
        await bench.step()
        assert (bench.task.counts.skipped, bench.task.counts.dropped) == (3, 1)


async def test_frames_go_on_without_a_controller_and_say_why_there_are_no_angles() -> None:
    async with running(with_link=False) as bench:
        bench.camera.expose(0)
        step = await bench.step()
        assert step.angles is None
        assert bench.task.counts.last_no_angle == "no link to the controller"


async def test_a_controller_that_restarts_makes_stream_and_latches_begin_anew() -> None:
    async with running() as bench:
        await started(bench, 1)
        bench.exposed(0)
        await bench.step()
        bench.gimbal.restart()
        await bench.gimbal.exchanged(2)
        bench.camera.expose(1)
        await bench.step()
        await started(bench, 2)
        assert bench.camera.calls == ["stop", "start"] * 2
        await bench.gimbal.exchanged(10)  # its clock is known again
        bench.exposed(0)
        assert (await bench.step()).angles is not None


async def test_a_link_that_comes_up_later_makes_the_stream_begin_anew() -> None:
    async with running(with_link=False) as bench:
        bench.camera.expose(0)
        await bench.step()
        bench.tasks.append(asyncio.create_task(bench.link.run(bench.gimbal)))
        await bench.gimbal.exchanged(10)
        bench.camera.expose(1)
        await bench.step()
        await started(bench, 2)
        bench.exposed(0)
        assert (await bench.step()).angles is not None


async def test_a_camera_that_is_lost_leaves_the_heartbeat_going_and_no_thread() -> None:
    async with running() as bench:
        await started(bench, 1)
        bench.exposed(0)
        await bench.step()
        bench.camera.out.put_nowait(LOST)
        stream = bench.tasks[-1]
        await asyncio.wait([stream], timeout=PATIENCE_S)
        assert stream.exception() is LOST
        done = len(bench.gimbal.commands)
        await bench.gimbal.exchanged(5)
        assert len(bench.gimbal.commands) - done == 5
        bench.task.lost()
        assert bench.task.state is TrackState.SEARCHING


# ---- when a frame was exposed ----------------------------------------------------------------------------------------

ARRIVED = HostNs(5_000_000_000)


def frame(mid_ns: int | None) -> Frame:
    return Frame(np.zeros((4, 4), np.uint8), 0, None if mid_ns is None else CameraNs(mid_ns), ARRIVED, EXPOSURE_NS)


def times(clock: ClockKind, recording: RecordingTime | None = None) -> CameraTimes:
    camera = MemoryCamera(ManualClock(), replace(CAMERA, clock=clock, transfer_ns=8_000_000))
    return CameraTimes(camera, recording or RecordingTime())


NO_ANGLE = NoAngle("no link to the controller")
BY_ARRIVAL = (ARRIVED - 9_000_000, ARRIVAL_SIGMA_NS)


def test_the_instant_of_the_latch_rules() -> None:
    angles = AxisAngles(0.0, 0.0, 1e-5, 0.0, HostNs(4_991_000_000), 5e3, "latch")
    found = times(ClockKind.HOST).instants(frame(1), angles)
    assert (found.exposed, found.exposed_sigma_ns, found.received) == (4_991_000_000, 5e3, ARRIVED)


@pytest.mark.parametrize(
    ("clock", "mid_ns", "expected"),
    [
        (ClockKind.HOST, 4_992_000_000, (4_992_000_000, 0.0)),
        (ClockKind.NONE, None, BY_ARRIVAL),
        (ClockKind.DEVICE, None, BY_ARRIVAL),
        (ClockKind.RECORDING, 17, (5_000_000_000 + 17 - 10, 0.0)),
    ],
)
def test_without_it_the_cameras_own_clock_rules_else_the_arrival(
    clock: ClockKind, mid_ns: int | None, expected: tuple[int, float]
) -> None:
    found = times(clock, RecordingTime(5_000_000_000 - 10)).instants(frame(mid_ns), NO_ANGLE)
    assert (found.exposed, found.exposed_sigma_ns) == expected


def test_a_cameras_own_counter_is_fitted_once_enough_frames_have_come() -> None:
    made = times(ClockKind.DEVICE)
    assert made.instants(frame(1_000), NO_ANGLE).exposed == BY_ARRIVAL[0]
    for n in range(40):
        arrived = HostNs(ARRIVED + n * 18_000_000)
        found = made.instants(replace(frame(1_000 + n * 18_000_000), arrived=arrived), NO_ANGLE)
    assert found.exposed == pytest.approx(arrived - 9_000_000, abs=20_000)
    assert found.exposed_sigma_ns < ARRIVAL_SIGMA_NS


# ---- the fusion ------------------------------------------------------------------------------------------------------


def fusion(published: list[Any]) -> FusionTask:
    fuser = Fuser(("left", "right"), FusionSettings(), 4.0, 0.05, 18_181_818)
    return FusionTask(fuser, ManualClock(HostNs(10**9)), published.append, 1e-3)


def blind() -> Step:
    return Step(0, HostNs(0), TrackState.SEARCHING, None, None, None, None, None, None, "itself", "no ball")  # type: ignore[arg-type]


async def test_the_fusions_queue_never_grows_and_what_it_drops_is_counted() -> None:
    task = fusion([])
    for _ in range(INBOX + 3):
        task.offer("left", blind())
    assert task.dropped == 3


async def test_the_fusion_ticks_when_nothing_comes() -> None:
    task = fusion([])
    running = asyncio.create_task(task.run())
    async with asyncio.timeout(PATIENCE_S):
        while task.ticks < 3:  # noqa: ASYNC110 - a count has no event
            await asyncio.sleep(0)
    running.cancel()
    await asyncio.wait([running])


# ---- the cell --------------------------------------------------------------------------------------------------------


class Quiet:
    """Nobody listens."""

    def status(self) -> None:
        pass


class Cell:
    """A cell of one station whose devices are opened in memory."""

    def __init__(self, restart_s: tuple[float, float] = (1e-3, 1e-3)) -> None:
        self.bench = Bench()
        self.ready = asyncio.Event()
        self.opened: list[str] = []
        self.missing = False
        parts = StationParts(
            "left",
            self._open_camera,
            self._open_gimbal,
            self.bench.task,
            self.bench.link,
            Device("camera left"),
            Device("gimbal left"),
        )
        self.parts = parts
        task = fusion([])
        vitals = VitalSigns(Notifier(None), lambda: task.ticks)
        self.service = CellService({"left": parts}, task, Quiet(), vitals, restart_s, 10.0)  # type: ignore[arg-type]

    @asynccontextmanager
    async def _open_camera(self) -> AsyncIterator[MemoryCamera]:
        self.opened.append("camera")
        yield self.bench.camera

    @asynccontextmanager
    async def _open_gimbal(self) -> AsyncIterator[MemoryGimbal]:
        self.opened.append("gimbal")
        if self.missing:
            raise DeviceTimeout("gimbal left", "connect", "no reply")
        yield self.bench.gimbal

    async def until(self, count: int, name: str) -> None:
        async with asyncio.timeout(PATIENCE_S):
            while self.opened.count(name) < count:  # noqa: ASYNC110 - a list has no event
                await asyncio.sleep(0)


async def test_a_cell_is_ready_once_every_device_ran_or_was_found_missing() -> None:
    cell = Cell()
    cell.missing = True
    running = asyncio.create_task(cell.service.run(cell.ready.set))
    await asyncio.wait_for(cell.ready.wait(), PATIENCE_S)
    assert (cell.parts.camera.state, cell.parts.gimbal.state) == ("running", "lost")
    assert cell.parts.gimbal.reason == "gimbal left: connect: no reply"
    cell.missing = False
    await cell.bench.gimbal.exchanged(2)
    assert cell.parts.gimbal.state == "running"
    running.cancel()
    await asyncio.wait([running])
    assert cell.bench.gimbal.commands[-1].mode == 0


async def test_a_camera_that_dies_is_opened_again_and_nothing_else_is() -> None:
    cell = Cell()
    running = asyncio.create_task(cell.service.run(cell.ready.set))
    await asyncio.wait_for(cell.ready.wait(), PATIENCE_S)
    cell.bench.camera.out.put_nowait(LOST)
    await cell.until(2, "camera")
    assert cell.opened.count("gimbal") == 1
    assert (cell.parts.camera.state, cell.parts.camera.restarts) == ("running", 1)
    running.cancel()
    await asyncio.wait([running])


async def test_a_cell_of_recordings_ends_with_the_last_of_them() -> None:
    cell = Cell()
    cell.bench.camera.out.put_nowait(RecordingEnded("all 5 frames were played"))
    async with asyncio.timeout(PATIENCE_S):
        await cell.service.run(cell.ready.set)
    assert (cell.parts.camera.state, cell.parts.camera.reason) == ("ended", "all 5 frames were played")
    assert cell.ready.is_set()


async def test_a_defect_in_one_task_ends_the_cell_with_the_axes_told_to_hold() -> None:
    cell = Cell()
    running = asyncio.create_task(cell.service.run(cell.ready.set))
    await asyncio.wait_for(cell.ready.wait(), PATIENCE_S)
    done = len(cell.bench.gimbal.commands)
    cell.bench.camera.out.put_nowait("no frame")  # type: ignore[arg-type]
    await asyncio.wait([running], timeout=PATIENCE_S)
    assert isinstance(running.exception(), ExceptionGroup)
    assert len(cell.bench.gimbal.commands) - done >= 3
    assert all(command.mode == 0 for command in cell.bench.gimbal.commands[done:])
