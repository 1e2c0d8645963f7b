"""The cell as one task group: a supervised bus and camera per station, the fusion, the status, the daemon's own health."""

import asyncio
import logging
from collections.abc import Callable, Coroutine
from contextlib import AbstractAsyncContextManager, aclosing
from dataclasses import dataclass

from trackerd.contract.errors import RecordingEnded
from trackerd.contract.ports import Camera, Gimbal
from trackerd.service.axes_link import AxesLink
from trackerd.service.fusion_task import FusionTask
from trackerd.service.outlet import Outlet
from trackerd.service.pacer import ticks
from trackerd.service.station_task import StationTask
from trackerd.service.supervisor import Device, keep
from trackerd.service.vital_signs import VitalSigns

log = logging.getLogger("trackerd.cell")
DRAIN_S = 0.3  # after the last recorded frame: what is still in the pipe is published


@dataclass(frozen=True, slots=True)
class StationParts:
    """One station, wired: how to open its devices, and the objects that outlive them."""

    name: str
    open_camera: Callable[[], AbstractAsyncContextManager[Camera]]
    open_gimbal: Callable[[], AbstractAsyncContextManager[Gimbal]]
    task: StationTask
    link: AxesLink
    camera: Device
    gimbal: Device


@dataclass(frozen=True, slots=True)
class CellService:
    """`run` returns when all recordings have been played to their end; a live cell runs until it is cancelled."""

    stations: dict[str, StationParts]
    fusion: FusionTask
    outlet: Outlet
    vitals: VitalSigns
    restart_s: tuple[float, float]
    status_hz: float

    async def run(self, ready: Callable[[], None]) -> None:
        cameras = [self._camera(part) for part in self.stations.values()]
        others = [self._gimbal(part) for part in self.stations.values()]
        async with asyncio.TaskGroup() as group:
            background = [group.create_task(part) for part in (*others, self.fusion.run(), self.vitals.run(), self._status())]
            streams = [group.create_task(stream) for stream in cameras]
            for part in self.stations.values():
                await part.camera.first.wait()
                await part.gimbal.first.wait()
            ready()
            await asyncio.wait(streams)
            await asyncio.sleep(DRAIN_S)
            for task in background:
                task.cancel()

    def _camera(self, part: StationParts) -> Coroutine[None, None, None]:
        async def once() -> None:
            async with part.open_camera() as camera:
                part.camera.running()
                try:
                    await part.task.run(camera)
                except RecordingEnded as end:
                    log.info("%s: %s", part.camera.name, end)
                    part.camera.ended(str(end))
                finally:
                    part.task.lost()
                    self.fusion.lost(part.name, f"{part.camera.name} gives no frames")

        return keep(part.camera, once, self.restart_s)

    def _gimbal(self, part: StationParts) -> Coroutine[None, None, None]:
        async def once() -> None:
            async with part.open_gimbal() as gimbal:
                part.gimbal.running()
                try:
                    await part.link.run(gimbal)
                finally:
                    self.fusion.lost(part.name, f"{part.gimbal.name} gives no angles")

        return keep(part.gimbal, once, self.restart_s)

    async def _status(self) -> None:
        async with aclosing(ticks(1.0 / self.status_hz)) as due:
            async for _ in due:
                self.outlet.status()
