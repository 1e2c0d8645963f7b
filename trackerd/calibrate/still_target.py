"""Where a still target is in the frames of a gimbal that moves: the angles tell where to look for it in each."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from trackerd.contract.model import Array, Found, Image, Outline
from trackerd.geometry.gimbal import Station
from trackerd.vision.rays import Circle

Locate: TypeAlias = Callable[[Image, Circle | None], Outline]  # near a guess (x, y, r), or anywhere
Angles: TypeAlias = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Shown:
    """One frame, and the target in it or why it is not seen; coordinates are the sensor's."""

    frame: int
    angles: Angles
    outline: Outline


def follow_still_target(
    frames: Iterable[tuple[int, Image, Angles]],
    station: Station,
    locate: Locate,
    origin_px: tuple[int, int],
    range_mm: float,
) -> list[Shown]:
    """What each frame (number, image, encoder az and el) shows; `origin_px` is an image's first pixel on the sensor.

    A fast gimbal moves the target by more than its diameter from frame to frame; where it is expected it is looked for first.
    """
    origin, shown = np.array(origin_px, float), list[Shown]()
    place: tuple[Array, float] | None = None  # in W, with the radius in px
    for number, image, angles in frames:
        outline = locate(image, None if place is None else _guess(station, place, angles, origin))
        if isinstance(outline, Found):
            q_px = np.array((outline.x_px, outline.y_px)) + origin
            place = station.point_at(q_px, *angles, range_mm), outline.r_px
            outline = replace(outline, x_px=float(q_px[0]), y_px=float(q_px[1]))
        shown.append(Shown(number, angles, outline))
    return shown


def _guess(station: Station, place: tuple[Array, float], angles: Angles, origin: Array) -> Circle:
    x, y = (station.pixel(place[0], *angles) - origin).tolist()
    return x, y, place[1]
