"""Where a sphere of known radius is, from one image: direction and range, exact for any field of view and distortion."""

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from trackerd.contract.model import Array, Found, Image, Missed
from trackerd.geometry.lens import Lens
from trackerd.geometry.sphere import centre_and_range
from trackerd.vision.curve import View
from trackerd.vision.limb import LimbChoice
from trackerd.vision.locate import locate
from trackerd.vision.noise import NoiseModel
from trackerd.vision.rays import REACH_PX, Circle

NUDGE_PX = 1e-3  # of the differences that carry the covariance over


@dataclass(frozen=True, slots=True)
class SphereFound:
    """The sphere's centre in C, and the outline (image coordinates) that says so."""

    outline: Found
    direction: Array  # (3,), unit
    range_mm: float
    cov_mm2: Array  # (3, 3) of the centre direction * range_mm
    direction_cov_rad2: Array  # (3, 3) of rank 2
    range_sigma_mm: float

    @property
    def centre_mm(self) -> Array:
        return self.direction * self.range_mm


Sphere: TypeAlias = SphereFound | Missed


def locate_sphere(
    image: Image,
    guess: Circle | None,
    lens: Lens,
    radius_mm: float,
    origin_px: tuple[int, int] = (0, 0),
    noise: NoiseModel = NoiseModel(),  # noqa: B008
    reach_px: float = REACH_PX,
    limb: LimbChoice | None = None,
) -> Sphere:
    """As `locate`; `origin_px` is the sensor pixel (x, y) of the image's first one. Covariances to first order."""
    found = locate(image, guess, noise, reach_px, View(lens, origin_px), limb)
    return found if isinstance(found, Missed) else sphere_of(found, lens, radius_mm, origin_px)


def sphere_of(found: Found, lens: Lens, radius_mm: float, origin_px: tuple[int, int] = (0, 0)) -> SphereFound:
    """What an outline that was found with the lens in view says of the sphere."""
    place = np.array((found.x_px + origin_px[0], found.y_px + origin_px[1], found.r_px))
    direction, range_mm = centre_and_range(place[:2], found.r_px, radius_mm, lens)
    towards = np.empty((4, 3))  # of the direction and the range
    for n in range(3):
        nudge = NUDGE_PX * np.eye(3)[n]
        (d1, r1), (d0, r0) = (centre_and_range(p[:2], float(p[2]), radius_mm, lens) for p in (place + nudge, place - nudge))
        towards[:3, n], towards[3, n] = (d1 - d0) / (2.0 * NUDGE_PX), (r1 - r0) / (2.0 * NUDGE_PX)
    both = towards @ found.cov_px2 @ towards.T
    to_mm = np.column_stack((range_mm * np.eye(3), direction))
    return SphereFound(found, direction, range_mm, to_mm @ both @ to_mm.T, both[:3, :3], float(np.sqrt(both[3, 3])))
