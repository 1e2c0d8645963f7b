"""Where each gimbal looks while the probe stands still: five places in the image, on two radii, in one face or two."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import ceil, floor, pi, tau

import numpy as np

from trackerd.contract.errors import Degenerate
from trackerd.contract.model import Array
from trackerd.formats.looks import FACES, Face, Look
from trackerd.geometry.gimbal import Station

POSITIONS = 5
INNER = 0.5  # radius of every second place: one radius alone confuses the focal length with the distortion
GOLDEN = 0.381966  # of a turn, from probe point to probe point: all places together fill the image
EDGE_PX = 12.0  # that the outline keeps from the edge of the image


@dataclass(frozen=True, slots=True)
class Eye:
    """One gimbal as far as a plan needs it."""

    station: Station  # nominal
    travel_rad: tuple[tuple[float, float], tuple[float, float]]  # of the encoders: az, el
    origin_px: tuple[int, int]  # of the image on the sensor
    image_px: tuple[int, int]
    probe_radius_mm: float

    @property
    def name(self) -> str:
        return self.station.name

    def ball_px(self, p_mm: Array) -> float:
        """Its radius in the image."""
        range_mm = float(np.linalg.norm(p_mm - self.station.world_from_gimbal.translation_mm))
        return self.station.lens.fx_px * self.probe_radius_mm / range_mm


def places_px(eye: Eye, p_mm: Array, turn: int) -> Array:
    """(5, 2) sensor pixels, on an ellipse that the whole ball stays inside of and on one of half its size.

    `turn` counts the probe's points. Raises Degenerate where the ball does not fit the image.
    """
    size = np.array(eye.image_px, float)
    reach = (size - 1.0) / 2.0 - eye.ball_px(p_mm) - EDGE_PX
    if reach.min() <= 0.0:
        width, (columns, rows) = 2.0 * eye.ball_px(p_mm), eye.image_px
        raise Degenerate(f"the ball, {width:.0f} px wide, does not fit the image of {columns} x {rows} px")
    angle = tau * (np.arange(POSITIONS) * 2.0 / POSITIONS + turn * GOLDEN)
    radius = np.where(np.arange(POSITIONS) % 2, INNER, 1.0)
    middle = np.array(eye.origin_px) + (size - 1.0) / 2.0
    return np.asarray(middle + (radius * np.array((np.cos(angle), np.sin(angle)))).T * reach)


def looks_at(eye: Eye, p_mm: Array, turn: int, faces: Sequence[Face] = FACES) -> Iterator[Look]:
    """All looks at one place of the probe that are within travel: of a face all, or none. Degenerate where face 1 has none."""
    places = places_px(eye, p_mm, turn)
    for face in faces:
        found = [look(eye, p_mm, q_px, face, number) for number, q_px in enumerate(places)]
        missing = next((words for words in found if isinstance(words, str)), None)
        if missing is not None and face == 1:
            raise Degenerate(missing)
        if missing is None:
            yield from (one for one in found if not isinstance(one, str))


def look(eye: Eye, p_mm: Array, q_px: Array, face: Face, number: int = 0) -> Look | str:
    """Angles within the travel, or why there are none."""
    try:
        angles = eye.station.aim(p_mm, q_px, face)
    except Degenerate as error:
        return str(error)
    turned = []
    for axis, angle, (low, high) in zip(("az", "el"), angles, eye.travel_rad, strict=True):
        nearest = _within(angle, low, high)
        if nearest is None:
            degrees = np.degrees((angle, low, high))
            return f"gimbal {eye.name}: {axis} {degrees[0]:+.1f} deg is outside {degrees[1]:+.1f} to {degrees[2]:+.1f} deg"
        turned.append(nearest)
    return Look(number, face, q_px, turned[0], turned[1])


def _within(angle: float, low: float, high: float) -> float | None:
    """The angle with whole turns added, inside the travel.

    Of several the one nearest to a quarter turn beside its middle: second faces lie half a turn away, and would else be taken
    now on the one side and now on the other.
    """
    first, last = ceil((low - angle) / tau), floor((high - angle) / tau)
    wanted = (low + high) / 2.0 + pi / 2.0
    return min((angle + tau * turns for turns in range(first, last + 1)), key=lambda one: abs(one - wanted), default=None)
