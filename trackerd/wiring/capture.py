"""Objects for a plan and its capture, from the configuration: what each gimbal can see, who carries the probe, the parts."""

import asyncio
import socket
from collections.abc import Callable, Sequence
from contextlib import AbstractAsyncContextManager, AsyncExitStack
from dataclasses import dataclass
from functools import partial
from typing import Any

from trackerd.calibrate.plan.looks import Eye
from trackerd.contract.clock import Clock, SystemClock
from trackerd.contract.errors import DeviceFault
from trackerd.contract.model import Image
from trackerd.contract.ports import Camera, Gimbal
from trackerd.engine.latched import RecordingTime
from trackerd.engine.pointing import Pointing
from trackerd.engine.still_look import StillView
from trackerd.engine.track import Tracker
from trackerd.formats.calibration import load_calibration
from trackerd.formats.config import CellConfig
from trackerd.formats.dataset_file import DatasetFile, NewView
from trackerd.formats.framelink import pack_message, unpack_message
from trackerd.formats.looks import Errand, Look
from trackerd.formats.mover import Stop
from trackerd.geometry.gimbal import Station
from trackerd.geometry.sphere import centre_and_range
from trackerd.service.axes_link import AxesLink
from trackerd.service.capture import ByProgram, Capture, Mover, Told
from trackerd.service.capture_cell import CaptureParts, KeptFrames, run_capture
from trackerd.service.seat import Seat
from trackerd.service.station_task import StationTask
from trackerd.service.twin_process import announcement, start_twin
from trackerd.vision.kernels import warm_up
from trackerd.wiring.build import settle_threads
from trackerd.wiring.cell import driver
from trackerd.wiring.daemon import with_twin

REST_S = 0.05  # a machine's own settling after its interpolator has stopped


@dataclass(frozen=True, slots=True)
class CaptureRequest:
    cell: CellConfig
    overrides: Sequence[str]
    errands: Sequence[Errand]
    dataset: DatasetFile
    frames: int
    deg_s: float  # the axes turn no faster than this
    told: Callable[[Told], None]


def eyes_of(cell: CellConfig) -> list[Eye]:
    """What each gimbal of the cell can see by the calibration that it has: the nominal one is good enough."""
    stations = load_calibration(cell.calibration).stations
    return [_eye(cell, name, stations[name]) for name in cell.gimbals]


def _eye(cell: CellConfig, name: str, station: Station) -> Eye:
    steering, camera = cell.gimbals[name].steering, cell.cameras[cell.gimbals[name].camera]
    travels = [(steering.az_limits_rad, steering.el_limits_rad)]
    if cell.twin is not None:
        travels.append((cell.twin.axes.az_limits_rad, cell.twin.axes.el_limits_rad))
    az, el = ((max(low for low, _ in axis), min(high for _, high in axis)) for axis in zip(*travels, strict=True))
    origin, size = (camera.offset_x_px, camera.offset_y_px), (camera.width_px, camera.height_px)
    return Eye(station, (az, el), origin, size, cell.probe.radius_mm)


async def capture(request: CaptureRequest) -> None:
    """Takes every view that the dataset does not have yet. THE AXES MOVE. Raises DeviceError where that fails."""
    settle_threads()
    await asyncio.to_thread(warm_up)  # before a device is opened: nothing that runs waits for it
    async with AsyncExitStack() as stack:
        cell = request.cell
        mover: Mover = ByProgram()
        if cell.twin is not None:
            process = await stack.enter_async_context(start_twin(cell.path, request.overrides))
            told = await announcement(process)
            cell = with_twin(cell, told)
            if cell.twin is not None and cell.twin.path.kind == "external":
                mover = TwinMover(told["control"])
        await _run(cell, request, mover)


async def _run(cell: CellConfig, request: CaptureRequest, mover: Mover) -> None:
    clock, recording = SystemClock(), RecordingTime()
    stations = load_calibration(cell.calibration).stations
    seats: dict[str, Seat] = {}
    parts = []
    for name in cell.gimbals:
        part, seats[name] = _parts(cell, name, stations[name], request.deg_s, clock, recording)
        parts.append(part)
    store = partial(_store, request.dataset, cell, stations)
    capture = Capture(request.errands, seats, mover, store, request.dataset.taken, request.told, request.frames)
    await run_capture(capture, parts, cell.service.restart_s)


def _parts(
    cell: CellConfig, name: str, station: Station, deg_s: float, clock: Clock, recording: RecordingTime
) -> tuple[CaptureParts, Seat]:
    gimbal = cell.gimbals[name]
    camera = cell.cameras[gimbal.camera]
    slow = gimbal.steering.model_copy(update={"max_deg_s": min(deg_s, gimbal.steering.max_deg_s)})
    pointing, kept = Pointing(slow), KeptFrames()
    pointing.arm()
    link = AxesLink(name, pointing, gimbal, recording, clock)
    tracker = Tracker(station, cell.probe.radius_mm, camera, gimbal.steering, gimbal.tracking)
    size = float(camera.width_px), float(camera.height_px)
    seat = Seat(name, pointing, clock, size, 1.0 / station.lens.fx_px, kept.of)

    def open_camera() -> AbstractAsyncContextManager[Camera]:
        opened: AbstractAsyncContextManager[Camera] = driver("camera", camera.driver).open_camera(gimbal.camera, camera, clock)
        return opened

    def open_gimbal() -> AbstractAsyncContextManager[Gimbal]:
        opened: AbstractAsyncContextManager[Gimbal] = driver("gimbal", gimbal.driver).open_gimbal(name, gimbal, clock)
        return opened

    task = StationTask(name, tracker, link, recording, clock, lambda _, step: seat.offer(step))
    return CaptureParts(name, open_camera, open_gimbal, task, link, kept), seat


async def _store(
    dataset: DatasetFile,
    cell: CellConfig,
    stations: dict[str, Station],
    errand: Errand,
    gimbal: str,
    look: Look,
    view: StillView,
    image: Image | None,
) -> None:
    """Off the event loop: the heartbeat does not wait for the disk."""
    lens = stations[gimbal].lens
    direction, _ = centre_and_range(view.q_px, view.r_px, cell.probe.radius_mm, lens)  # of the ball, not of its outline
    new = NewView(
        view=errand.view(look),
        gimbal=gimbal,
        face=look.face,
        az_rad=view.az_rad,
        el_rad=view.el_rad,
        target=errand.stop.name,
        q_px=lens.project(direction),
        cov_px2=view.cov_px2,
        frames=view.frames,
        image=image,
    )
    await asyncio.to_thread(dataset.append, new)


@dataclass(frozen=True, slots=True)
class TwinMover:
    """The twin's probe, moved over its control socket: the stand-in for a machine."""

    control: str

    async def go(self, stop: Stop) -> bool:
        answer = await asyncio.to_thread(self._ask, {"do": "move_probe", "position_mm": stop.p_mm.tolist()})
        if "error" in answer:
            raise DeviceFault("the twin", f"move the probe to {stop.name}", str(answer["error"]))
        await asyncio.sleep(max(0.0, (answer["there_host_ns"] - SystemClock().now()) * 1e-9) + REST_S)
        return True

    def _ask(self, request: dict[str, Any]) -> dict[str, Any]:
        with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as client:
            client.settimeout(5.0)
            client.connect(self.control)
            client.send(pack_message(**request))
            return unpack_message(client.recv(1 << 16))
