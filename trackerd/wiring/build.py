"""Objects from the configuration: everything that a running cell is made of. Heavy: engines, OpenCV, SciPy."""

import logging
import sys
from contextlib import AbstractAsyncContextManager
from typing import Any

import cv2

from trackerd import __version__
from trackerd.contract.clock import Clock
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
from trackerd.service.status import CellStatus, Watched
from trackerd.service.supervisor import Device
from trackerd.service.vital_signs import VitalSigns
from trackerd.service.zenoh_link import ZenohLink
from trackerd.wiring.cell import driver

log = logging.getLogger("trackerd")

SWITCH_S = 0.0005  # the loop waits no longer for a worker that holds the interpreter; the default of 5 ms is a bus cycle


def settle_threads() -> None:
    """One worker a station is the parallelism; OpenCV's own threads only fight over the cores with it."""
    sys.setswitchinterval(SWITCH_S)
    cv2.setNumThreads(1)


def build(cell: CellConfig, source: Source, link: ZenohLink, clock: Clock, told: dict[str, Any] | None = None) -> CellService:
    """`told`: what the twin announced, where the cell has one."""
    calibration = load_calibration(cell.calibration)
    for note in calibration.standing(clock.unix(clock.now())).notes:
        log.warning("calibration %s: %s", calibration.id, note)
    period_s = 1.0 / min(camera.frame_rate_hz for camera in cell.cameras.values())
    fuser = Fuser(tuple(cell.gimbals), cell.fusion, cell.probe.radius_mm, cell.probe.radius_tolerance, round(period_s * 1e9))
    status = CellStatus(cell.name, __version__, calibration, told)
    outlet = Outlet(link, clock, source, calibration, round(cell.fusion.valid_periods * period_s * 1e9), status.gather)
    fusion = FusionTask(fuser, clock, outlet.fix, period_s)
    recording = RecordingTime()
    stations = {
        name: _station(name, cell, calibration, recording, clock, fusion, source is Source.TWIN) for name in cell.gimbals
    }
    vitals = VitalSigns(Notifier.from_environment(), lambda: fusion.ticks)
    status.watch(Watched(stations, fusion, fuser, outlet, vitals, recording))
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
