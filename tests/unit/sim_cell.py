"""A small simulated cell for the tests: two eccentric gimbals, 2 m range, 1.1 m baseline."""

from math import atan2
from typing import Any

import numpy as np

from trackerd.formats.settings import CameraSettings
from trackerd.formats.twin import TwinSettings
from trackerd.geometry.gimbal import Station
from trackerd.geometry.lens import Lens
from trackerd.geometry.rigid import Rigid, rotation_about_x, rotation_about_y
from trackerd.sim.scene import Mount, Scene

RADIUS_MM = 4.0
PLAIN: dict[str, Any] = {"texture_dn": 0.0, "stem_width": 0.0}


def station(name: str, x_mm: float) -> Station:
    base = Rigid(rotation_about_y(atan2(-x_mm, 1920.0)), np.array((x_mm, 0.0, -1920.0)))
    camera = Rigid(rotation_about_x(0.002) @ rotation_about_y(0.003), np.array((0.0, -124.5, 40.0)))
    lens = Lens((2048, 1536), 31000.0, 31000.0, 1025.0, 765.0, (-0.05, 0.0, 0.0, 0.0, 0.0))
    return Station(name, base, camera, lens, eps_rad=3e-4, d_mm=0.05)


def camera(width_px: int = 320, height_px: int = 240) -> CameraSettings:
    return CameraSettings(
        driver="synthetic",
        width_px=width_px,
        height_px=height_px,
        offset_x_px=(2048 - width_px) // 2,
        offset_y_px=(1536 - height_px) // 2,
    )


def scene(**twin: Any) -> Scene:
    mounts = {name: Mount(station(name, x), f"{name}-camera", camera()) for name, x in (("left", -550.0), ("right", 550.0))}
    return Scene(TwinSettings(**twin), mounts, RADIUS_MM)
