"""What a new calibration changes where it is used: how far the same pixels and angles come to lie from where they lay."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import sqrt

import numpy as np

from trackerd.contract.clock import HostNs
from trackerd.contract.errors import Degenerate
from trackerd.contract.model import Array, Sightline
from trackerd.geometry.gimbal import Station
from trackerd.geometry.triangulate import triangulate

ACROSS_RAD = 1e-5  # sigma of every line alike: it only shares the shift out between lines that no longer meet


@dataclass(frozen=True, slots=True)
class Shift:
    """Of points p_mm (n, 3) of the old calibration: the new one has them at p_mm + shift_mm."""

    p_mm: Array
    shift_mm: Array  # (n, 3)
    out_of_reach: int  # points that some station cannot be aimed at, by either calibration; they are not among p_mm

    @property
    def rms_mm(self) -> float:
        return sqrt(float((self.shift_mm**2).sum(axis=1).mean()))

    @property
    def max_mm(self) -> float:
        return float(np.linalg.norm(self.shift_mm, axis=1).max())

    @property
    def mean_mm(self) -> Array:
        """What is common to the volume, (3,)."""
        return np.asarray(self.shift_mm.mean(axis=0))

    @property
    def worst_mm(self) -> Array:
        """The point (3,) that is shifted farthest."""
        return np.asarray(self.p_mm[int(np.argmax(np.linalg.norm(self.shift_mm, axis=1)))])


def grid(min_mm: tuple[float, float, float], max_mm: tuple[float, float, float], steps: int = 5) -> Array:
    """Points that fill a box, its corners among them, (steps^3, 3)."""
    axes = (np.linspace(low, high, steps) for low, high in zip(min_mm, max_mm, strict=True))
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def shift_between(old: Mapping[str, Station], new: Mapping[str, Station], p_mm: Array) -> Shift:
    """Each station of both looks at a point with its old principal point; what it then says is read with the new calibration.

    p_mm (m, 3) in W. Raises Degenerate below two stations in common, or where none of the points can be looked at.
    """
    names = [name for name in old if name in new]
    if len(names) < 2:
        raise Degenerate(f"two calibrations are compared by two stations or more that both have, here {len(names)}")
    kept, shifts = [], []
    for point in p_mm:
        try:
            lines = [_line(old[name], new[name], point) for name in names]
            shifts.append(triangulate(lines).p_mm - point)
        except Degenerate:
            continue
        kept.append(point)
    if not kept:
        raise Degenerate("no point of the volume can be looked at by two stations")
    return Shift(np.array(kept), np.array(shifts), len(p_mm) - len(kept))


def _line(old: Station, new: Station, point_mm: Array) -> Sightline:
    q_px = np.array((old.lens.cx_px, old.lens.cy_px))
    az_rad, el_rad = old.aim(point_mm, q_px)
    world_from_camera = new.world_from_camera(az_rad, el_rad)
    direction = world_from_camera.rotate(new.lens.unproject(q_px))
    range_mm = float(np.linalg.norm(point_mm - world_from_camera.translation_mm))
    across = (np.eye(3) - np.outer(direction, direction)) * ACROSS_RAD**2
    return Sightline(
        station=old.name,
        instant=HostNs(0),
        instant_sigma_ns=0.0,
        origin_mm=world_from_camera.translation_mm,
        direction=direction,
        cov_rad2=across,
        fixed_cov_rad2=np.zeros((3, 3)),
        range_mm=range_mm,
        range_sigma_mm=range_mm,
        received=HostNs(0),
    )
