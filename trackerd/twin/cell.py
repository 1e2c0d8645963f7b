"""The simulated cell: scene, controllers and cameras put together."""

import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from trackerd.formats.cell import CellConfig
from trackerd.formats.twin import DeviceClockSettings, TwinSettings
from trackerd.geometry.gimbal import Station
from trackerd.sim.noise import key
from trackerd.sim.render import Renderer
from trackerd.sim.scene import Mount, Scene, View
from trackerd.twin.alarm import Alarm
from trackerd.twin.axes import GimbalAxes
from trackerd.twin.camera import CameraModel, TwinCamera
from trackerd.twin.clock import DeviceClock, SceneTime
from trackerd.twin.controller import Controller
from trackerd.twin.exposure import ExposureLine
from trackerd.twin.modbus import ModbusServer
from trackerd.twin.registers import GimbalRegisters

FIRST_SERIAL = 1001


@dataclass(frozen=True, slots=True)
class TwinGimbal:
    """One gimbal on the wire, with the camera that it carries."""

    name: str
    controller: Controller
    server: ModbusServer
    camera: TwinCamera


class TwinCell:
    """Everything that happens in the twin's process but its truth and its control socket. Made in a running event loop."""

    def __init__(self, scene: Scene, folder: Path) -> None:
        self.scene = scene
        self._renderers = {name: _warm_renderer(scene, name) for name in scene.mounts}  # slow: time begins after it
        self.times = SceneTime(time.monotonic_ns())
        self.alarm = Alarm()
        self.gimbals = {name: self._gimbal(name, FIRST_SERIAL + n, folder) for n, name in enumerate(scene.mounts)}

    @property
    def cameras(self) -> dict[str, TwinCamera]:
        return {gimbal.camera.model.name: gimbal.camera for gimbal in self.gimbals.values()}

    def advance(self) -> None:
        """Work off what was due by now, also where nobody asks."""
        now = self.times.now()
        for gimbal in self.gimbals.values():
            gimbal.controller.advance(now)

    async def close(self) -> None:
        for gimbal in self.gimbals.values():
            await gimbal.server.close()
            gimbal.camera.close()
        self.alarm.close()

    def _gimbal(self, name: str, serial: int, folder: Path) -> TwinGimbal:
        scene, settings = self.scene, self.scene.settings
        line = ExposureLine(scene.trigger(name))
        axes = GimbalAxes(scene.gimbals[name], settings.encoder)
        controller = Controller(serial, axes, _clock(settings.gimbal_clock(name)), line)

        def look(rising_ns: int, falling_ns: int) -> View:
            controller.advance(falling_ns)
            return scene.view(name, rising_ns, falling_ns)

        model = _camera_model(scene, name)
        camera = TwinCamera(
            model,
            line=line,
            look=look,
            renderer=self._renderers[name],
            times=self.times,
            alarm=self.alarm,
            path=folder / f"{model.name}.camera",
        )
        return TwinGimbal(name, controller, ModbusServer(GimbalRegisters(controller), self.times.now), camera)


def scene_of(cell: CellConfig, stations: Mapping[str, Station]) -> Scene:
    """The cell's gimbals, where the calibration has them. Without a table [twin] its defaults hold."""
    mounts = {
        name: Mount(stations[name], gimbal.camera, cell.cameras[gimbal.camera], gimbal.steering.aim_px)
        for name, gimbal in cell.gimbals.items()
    }
    return Scene(cell.twin or TwinSettings(), mounts, cell.probe.radius_mm)


def _warm_renderer(scene: Scene, gimbal: str) -> Renderer:
    """The first image takes many times as long as the others, so it is nobody's."""
    renderer, view = scene.renderer(gimbal), scene.view(gimbal, 0, 1)
    renderer.render(view.poses, view.probes_mm, 0)
    return renderer


def _camera_model(scene: Scene, gimbal: str) -> CameraModel:
    mount, settings = scene.mounts[gimbal], scene.settings
    return CameraModel(
        name=mount.camera_name,
        settings=mount.camera,
        sensor_px=mount.station.lens.sensor_px,
        transfer_ns=round(settings.camera.transfer_us * 1000.0),
        clock=_clock(settings.camera_clock(mount.camera_name)),
        drop_probability=settings.camera.drop_probability,
        drop_stream=key(settings.seed, mount.camera_name, "drop"),
    )


def _clock(settings: DeviceClockSettings) -> DeviceClock:
    return DeviceClock(round(settings.offset_s * 1e9), settings.drift_ppm)
