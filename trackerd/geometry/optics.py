"""What intrinsics say of the lens in the words of its maker: focal length in mm, angle of view, field of view."""

from dataclasses import dataclass
from math import acos, hypot

import numpy as np

from trackerd.contract.model import Array
from trackerd.geometry.lens import Lens


@dataclass(frozen=True, slots=True)
class AngleOfView:
    """Between the directions of opposite edges of the sensor, in rad; of the corners for the diagonal."""

    horizontal_rad: float
    vertical_rad: float
    diagonal_rad: float


@dataclass(frozen=True, slots=True)
class FieldOfView:
    """What the whole sensor sees on the plane across the optical axis at a distance from the entrance pupil."""

    distance_mm: float
    width_mm: float  # along the row of the image's middle
    height_mm: float  # along its column
    diagonal_mm: float
    x_mm_per_px: float  # on the optical axis
    y_mm_per_px: float


def focal_length_mm(lens: Lens, pitch_um: tuple[float, float]) -> tuple[float, float]:
    """Along x and y, by Eq 4.1 of the source thesis: f_mm = f_px x pixel pitch (width, height of a pixel in um).

    Two numbers, because they are a check: the pixels of most sensors are square, and a lens has one focal length.
    """
    return lens.fx_px * pitch_um[0] * 1e-3, lens.fy_px * pitch_um[1] * 1e-3


def angle_of_view(lens: Lens) -> AngleOfView:
    """With the distortion, from outer edge to outer edge of the outermost pixels."""
    left, right, top, bottom, first, last = (lens.unproject(q_px) for q_px in _rim(lens))
    return AngleOfView(_between(left, right), _between(top, bottom), _between(first, last))


def field_of_view(lens: Lens, distance_mm: float) -> FieldOfView:
    """With the distortion, as Table 4.11 of the source thesis lists it (which has it without)."""
    left, right, top, bottom, first, last = (np.array(lens.normalise(q_px)) * distance_mm for q_px in _rim(lens))
    return FieldOfView(
        distance_mm,
        width_mm=hypot(*(right - left)),
        height_mm=hypot(*(bottom - top)),
        diagonal_mm=hypot(*(last - first)),
        x_mm_per_px=distance_mm / lens.fx_px,
        y_mm_per_px=distance_mm / lens.fy_px,
    )


def _rim(lens: Lens) -> tuple[Array, ...]:
    """Middles of the left, right, upper and lower edge, first and last corner, in px."""
    width, height = lens.sensor_px
    x, y = (width - 1) / 2.0, (height - 1) / 2.0
    right, bottom = width - 0.5, height - 0.5
    places = (-0.5, y), (right, y), (x, -0.5), (x, bottom), (-0.5, -0.5), (right, bottom)
    return tuple(np.array(place) for place in places)


def _between(a: Array, b: Array) -> float:
    return acos(min(1.0, float(a @ b)))
