"""The whole simulated cell at any instant: the probe, the gimbals, what their encoders read and what their cameras see.

Time is nanoseconds since the scene's start. A scene is a function of its settings, the instant and the commands so far; the
axes remember one second.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from math import ceil

import numpy as np

from trackerd.contract.model import Array
from trackerd.formats.settings import CameraSettings, Pixel
from trackerd.formats.twin import TwinSettings
from trackerd.geometry.gimbal import Station
from trackerd.geometry.rigid import Rigid
from trackerd.sim.gimbal import SimGimbal
from trackerd.sim.path import ProbePath, State
from trackerd.sim.render import SHARP_PX, Renderer
from trackerd.sim.sweep import beside
from trackerd.sim.trigger import Trigger, trigger_of

PART_PX = 1.5  # smear from part to part, below two sigmas of the blur: an edge is within 1 DN of a smooth smear's
MOST_PARTS = 12


@dataclass(frozen=True, slots=True)
class Mount:
    """One gimbal of the cell: its calibrated station, the camera that it carries, the sensor pixel the probe is kept at."""

    station: Station
    camera_name: str
    camera: CameraSettings
    aim_px: Pixel | None = None  # default: the middle of the region

    @property
    def kept_at_px(self) -> Pixel:
        if self.aim_px is not None:
            return self.aim_px
        camera = self.camera
        return camera.offset_x_px + (camera.width_px - 1) / 2.0, camera.offset_y_px + (camera.height_px - 1) / 2.0


@dataclass(frozen=True, slots=True)
class View:
    """What a renderer needs of one exposure: the middles of its equal parts."""

    poses: tuple[Rigid, ...]  # world_from_camera
    probes_mm: tuple[Array, ...]  # (3,) in W


class Scene:
    """`mounts` by the gimbal's name. The axes stand, the probe `start_offset_px` from where it is to be kept."""

    def __init__(self, settings: TwinSettings, mounts: Mapping[str, Mount], radius_mm: float) -> None:
        self.settings = settings
        self.mounts = dict(mounts)
        self.radius_mm = radius_mm
        self.path = ProbePath(settings.path, settings.seed)
        self.gimbals = {name: SimGimbal(name, settings, mount.station) for name, mount in mounts.items()}
        for name, gimbal in self.gimbals.items():
            gimbal.place(*self.start_angles(name))

    def start_angles(self, gimbal: str) -> tuple[float, float]:
        x_px, y_px = self.mounts[gimbal].kept_at_px
        dx_px, dy_px = self.settings.start_offset_px
        return self.gimbals[gimbal].aim(self.truth(0)[0], (x_px + dx_px, y_px + dy_px))

    def truth(self, t_ns: int) -> State:
        """The probe's position (mm), velocity (mm/s) and acceleration (mm/s^2), each (3,) in W."""
        return self.path.at(t_ns)

    def true_pose(self, gimbal: str, t_ns: int) -> Rigid:
        return self.gimbals[gimbal].pose(t_ns)

    def encoder(self, gimbal: str, t_ns: int) -> tuple[float, float]:
        """What the controller reads at an instant, (az, el) in rad."""
        return self.gimbals[gimbal].encoder(t_ns)

    def latched(self, gimbal: str, begin_ns: int, end_ns: int) -> tuple[float, float]:
        """What the latch says of one exposure, as a controller's are read: the mean of both edges, (az, el) in rad."""
        edges = [self.gimbals[gimbal].latched(t_ns, begin_ns) for t_ns in (begin_ns, end_ns)]
        return (edges[0][0] + edges[1][0]) / 2.0, (edges[0][1] + edges[1][1]) / 2.0

    def trigger(self, gimbal: str) -> Trigger:
        """When the camera on this gimbal exposes."""
        mount = self.mounts[gimbal]
        return trigger_of(self.settings, mount.camera_name, mount.camera)

    def renderer(self, gimbal: str) -> Renderer:
        """A renderer for one thread. It knows nothing of the scene afterwards: hand it `view`s."""
        mount = self.mounts[gimbal]
        station = self.gimbals[gimbal].station
        return Renderer(station, mount.camera, self.settings.camera, self.radius_mm, self.settings.seed)

    def view(self, gimbal: str, begin_ns: int, end_ns: int) -> View:
        """One exposure, in as many parts as its blur needs. The axes are advanced to its end."""
        travel_px = float(np.linalg.norm(self._pixel(gimbal, end_ns) - self._pixel(gimbal, begin_ns)))
        parts = 1 if travel_px < SHARP_PX else min(MOST_PARTS, 1 + ceil(travel_px / PART_PX))
        middles = [begin_ns + (2 * part + 1) * (end_ns - begin_ns) // (2 * parts) for part in range(parts)]
        return View(tuple(self.true_pose(gimbal, t) for t in middles), tuple(self.truth(t)[0] for t in middles))

    def place(self) -> None:
        """Every gimbal aimed at the probe, at rest."""
        for name, gimbal in self.gimbals.items():
            gimbal.place(*gimbal.aim(self.truth(0)[0], self.mounts[name].kept_at_px))

    def follow(self, t_ns: int, until_ns: int) -> None:
        """Aim every gimbal at the true probe, or where it sweeps beside it, at the speed that meets it at `until_ns`."""
        for name, gimbal in self.gimbals.items():
            now_az, now_el = self._wanted(name, t_ns)
            az, el = self._wanted(name, until_ns)
            duration_s = (until_ns - t_ns) * 1e-9
            gimbal.az.follow(t_ns, now_az, (az - now_az) / duration_s)
            gimbal.el.follow(t_ns, now_el, (el - now_el) / duration_s)

    def _wanted(self, gimbal: str, t_ns: int) -> tuple[float, float]:
        az, el = self.gimbals[gimbal].aim(self.truth(t_ns)[0], self.mounts[gimbal].kept_at_px)
        beside_az, beside_el = beside(self.settings.sweep, t_ns)
        return az + beside_az, el + beside_el

    def _pixel(self, gimbal: str, t_ns: int) -> Array:
        """Where the probe's centre is on the sensor."""
        p_camera = self.true_pose(gimbal, t_ns).inverse().move(self.truth(t_ns)[0])
        return self.gimbals[gimbal].station.lens.project(p_camera)
