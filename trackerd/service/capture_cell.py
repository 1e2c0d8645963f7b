"""A capture as one task group: bus and camera of every gimbal, supervised, and the capture that asks them."""

import asyncio
from collections import OrderedDict
from collections.abc import AsyncIterator, Callable, Coroutine, Sequence
from contextlib import AbstractAsyncContextManager
from dataclasses import dataclass, field

from trackerd.contract.model import CameraInfo, CameraStatistics, Frame, Image
from trackerd.contract.ports import Camera, Gimbal
from trackerd.service.axes_link import AxesLink
from trackerd.service.capture import Capture
from trackerd.service.station_task import StationTask
from trackerd.service.supervisor import Device, keep

KEPT = 4  # frames: a step is told before as many more have come


@dataclass(slots=True)
class KeptFrames:
    """The last few images of a camera, by frame."""

    _images: OrderedDict[int, tuple[Image, tuple[int, int]]] = field(default_factory=OrderedDict)

    def keep(self, frame: Frame) -> None:
        self._images[frame.frame_id] = frame.image.copy(), frame.origin_px
        while len(self._images) > KEPT:
            self._images.popitem(last=False)

    def of(self, frame_id: int) -> tuple[Image, tuple[int, int]] | None:
        return self._images.get(frame_id)


@dataclass(frozen=True, slots=True)
class KeepingCamera:
    """A camera whose last frames are kept."""

    camera: Camera
    kept: KeptFrames

    @property
    def info(self) -> CameraInfo:
        return self.camera.info

    async def start(self) -> None:
        await self.camera.start()

    async def stop(self) -> None:
        await self.camera.stop()

    async def frames(self) -> AsyncIterator[Frame]:
        async for frame in self.camera.frames():
            self.kept.keep(frame)
            yield frame

    def statistics(self) -> CameraStatistics:
        return self.camera.statistics()


@dataclass(frozen=True, slots=True)
class CaptureParts:
    """One gimbal and its camera, wired."""

    name: str
    open_camera: Callable[[], AbstractAsyncContextManager[Camera]]
    open_gimbal: Callable[[], AbstractAsyncContextManager[Gimbal]]
    task: StationTask
    link: AxesLink
    kept: KeptFrames


async def run_capture(capture: Capture, parts: Sequence[CaptureParts], restart_s: tuple[float, float]) -> None:
    """Until the capture is done, or fails; the axes are told to hold on every way out."""
    devices = [(Device(f"camera of {part.name}"), Device(f"gimbal {part.name}"), part) for part in parts]
    async with asyncio.TaskGroup() as group:
        background = []
        for camera, gimbal, part in devices:
            background.append(group.create_task(keep(gimbal, _gimbal(gimbal, part), restart_s)))
            background.append(group.create_task(keep(camera, _camera(camera, part), restart_s)))
        for camera, gimbal, _ in devices:
            await camera.first.wait()
            await gimbal.first.wait()
        await capture.run()
        for task in background:
            task.cancel()


def _camera(device: Device, part: CaptureParts) -> Callable[[], Coroutine[None, None, None]]:
    async def once() -> None:
        async with part.open_camera() as camera:
            device.running()
            try:
                await part.task.run(KeepingCamera(camera, part.kept))
            finally:
                part.task.lost()

    return once


def _gimbal(device: Device, part: CaptureParts) -> Callable[[], Coroutine[None, None, None]]:
    async def once() -> None:
        async with part.open_gimbal() as gimbal:
            device.running()
            await part.link.run(gimbal)

    return once
