"""The running cell: objects from the configuration, and the daemon's life from start to stop."""

import asyncio
import gc
import logging
import signal
import sys
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import AbstractAsyncContextManager, AsyncExitStack, asynccontextmanager, suppress
from dataclasses import replace
from typing import Any

import cv2

from trackerd import __version__
from trackerd.contract.clock import Clock, SystemClock
from trackerd.contract.model import Source
from trackerd.contract.ports import Camera, Gimbal
from trackerd.engine.axes import Axes
from trackerd.engine.fuse import Fuser
from trackerd.engine.latched import RecordingTime
from trackerd.engine.track import Tracker
from trackerd.formats.calibration import Calibration, load_calibration
from trackerd.formats.config import CellConfig
from trackerd.service.axes_link import AxesLink
from trackerd.service.cell_service import CellService, StationParts
from trackerd.service.commands import Commands
from trackerd.service.fusion_task import FusionTask
from trackerd.service.notify import Notifier
from trackerd.service.outlet import Outlet
from trackerd.service.station_task import StationTask
from trackerd.service.status import CellStatus
from trackerd.service.supervisor import Device
from trackerd.service.twin_process import announcement, start_twin
from trackerd.service.vital_signs import VitalSigns
from trackerd.service.zenoh_link import ZenohLink, open_link
from trackerd.wiring.cell import driver, source_of

log = logging.getLogger("trackerd")
SWITCH_S = (
    0.0005  # the loop waits no longer than this for a worker that holds the interpreter; 5 ms, the default, is a bus cycle
)


async def serve(cell: CellConfig, overrides: Sequence[str], duration_s: float | None) -> None:
    """Runs the cell until SIGTERM, SIGINT, the end of a recording, or for `duration_s` after READY."""
    sys.setswitchinterval(SWITCH_S)
    cv2.setNumThreads(1)  # one worker a station is the parallelism; OpenCV's own threads only fight over two cores
    told = None
    async with AsyncExitStack() as stack:
        if cell.twin is not None:
            twin = await stack.enter_async_context(start_twin(cell.path, overrides))
            source = source_of(cell)
            link = stack.enter_context(open_link(cell.zenoh, source))
            told = await announcement(twin)
            cell = with_twin(cell, told)
        else:
            source = source_of(cell)
            link = stack.enter_context(open_link(cell.zenoh, source))
        await _run(build(cell, source, link, SystemClock(), told), Notifier.from_environment(), duration_s)


def with_twin(cell: CellConfig, told: dict[str, Any]) -> CellConfig:
    """The cell with the addresses that the twin picked."""
    gimbals = {
        name: gimbal.model_copy(update=told["gimbals"][name]) if name in told["gimbals"] else gimbal
        for name, gimbal in cell.gimbals.items()
    }
    cameras = {
        name: camera.model_copy(update=told["cameras"][name]) if name in told["cameras"] else camera
        for name, camera in cell.cameras.items()
    }
    return replace(cell, gimbals=gimbals, cameras=cameras)


def build(cell: CellConfig, source: Source, link: ZenohLink, clock: Clock, told: dict[str, Any] | None = None) -> CellService:
    """`told`: what the twin announced, where the cell has one."""
    calibration = load_calibration(cell.calibration)
    period_s = 1.0 / min(camera.frame_rate_hz for camera in cell.cameras.values())
    fuser = Fuser(tuple(cell.gimbals), cell.fusion, cell.probe.radius_mm, cell.probe.radius_tolerance, round(period_s * 1e9))
    status = CellStatus(cell.name, __version__, calibration, told)
    outlet = Outlet(link, clock, source, calibration.id, round(cell.fusion.valid_periods * period_s * 1e9), status.gather)
    fusion = FusionTask(fuser, clock, outlet.fix, period_s)
    recording = RecordingTime()
    stations = {
        name: _station(name, cell, calibration, recording, clock, fusion, source is Source.TWIN) for name in cell.gimbals
    }
    vitals = VitalSigns(Notifier.from_environment(), lambda: fusion.ticks)
    status.watch(stations, fusion, fuser, outlet, vitals)
    Commands(stations, outlet).serve(link)
    return CellService(stations, fusion, outlet, vitals, cell.service.restart_s, cell.service.status_hz)


def _station(
    name: str,
    cell: CellConfig,
    calibration: Calibration,
    recording: RecordingTime,
    clock: Clock,
    fusion: FusionTask,
    twin: bool,
) -> StationParts:
    gimbal = cell.gimbals[name]
    camera = cell.cameras[gimbal.camera]
    rearm = gimbal.steering.rearm or ("automatic" if twin else "operator")
    link = AxesLink(name, Axes(gimbal.steering, rearm == "automatic"), gimbal, recording, clock)
    tracker = Tracker(calibration.stations[name], cell.probe.radius_mm, camera, gimbal.steering, gimbal.tracking)

    def open_camera() -> AbstractAsyncContextManager[Camera]:
        opened: AbstractAsyncContextManager[Camera] = driver("camera", camera.driver).open_camera(gimbal.camera, camera, clock)
        return opened

    def open_gimbal() -> AbstractAsyncContextManager[Gimbal]:
        opened: AbstractAsyncContextManager[Gimbal] = driver("gimbal", gimbal.driver).open_gimbal(name, gimbal, clock)
        return opened

    task = StationTask(name, tracker, link, recording, clock, fusion.offer)
    return StationParts(name, open_camera, open_gimbal, task, link, Device(f"camera {gimbal.camera}"), Device(f"gimbal {name}"))


async def _run(service: CellService, notifier: Notifier, duration_s: float | None) -> None:
    """Until it ends by itself, is told to stop, or its time is over; a stop is no error."""
    loop = asyncio.get_running_loop()
    stop = asyncio.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, stop.set)

    def ready() -> None:
        _settle_memory()
        notifier.ready("measuring")
        log.info("READY")
        if duration_s is not None:
            loop.call_later(duration_s, stop.set)

    async with _finished(service.run(ready)) as (running, stopping):
        await asyncio.wait((running, asyncio.ensure_future(stop.wait())), return_when=asyncio.FIRST_COMPLETED)
        notifier.stopping()
        stopping()
        with suppress(asyncio.CancelledError):
            await running
    gc.unfreeze()
    log.info("stopped")


@asynccontextmanager
async def _finished(work: Any) -> AsyncIterator[tuple["asyncio.Task[None]", Callable[[], object]]]:
    task = asyncio.ensure_future(work)
    try:
        yield task, task.cancel
    finally:
        task.cancel()


def _settle_memory() -> None:
    """What lives now lives for good: the collector need not look at it again (a full pass takes 10-50 ms)."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(50_000, 20, 50)
