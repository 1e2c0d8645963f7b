"""The outline of a sphere as a lens draws it, in polar coordinates about its centre: radius over the angle, sector by sector.

A circle of radius r bulges nowhere. Off the optical axis the outline is an ellipse (a - b = 0.05 px in the corner of a long
lens, 16 px for one of 8 mm), and distortion bends that: the fit measures distances from the true curve, so that x, y and r are
what `geometry.sphere.centre_and_range` turns into the sphere's centre.
"""

from dataclasses import dataclass
from functools import cache
from math import asin, pi

import numpy as np

from trackerd.contract.model import Array
from trackerd.geometry.lens import Lens
from trackerd.geometry.sphere import centre_and_range

NUDGE_PX = 0.5  # of the central differences by x, y and r
ROUNDS = 30  # of the search for the points at given angles: each gains a digit or more
EXACT_RAD = 1e-10
STALE_PX = 5e-4  # a curve is reused near where it was made, until it would be wrong by this


@dataclass(frozen=True, slots=True)
class Curve:
    """At the middle of each of S sectors. Its place is not part of it: neither x, y nor r, except as noted."""

    bulge: Array  # (S, 4): px by which the radius exceeds r; its first two derivatives by the angle; cosine normal to ray
    design: Array  # (S, 3): d (outline, along its normal) / d (x, y, r)
    round: bool  # a circle: no bulge

    @property
    def reach_px(self) -> float:
        """How far it is from a circle."""
        return float(np.abs(self.bulge[:, 0]).max())


@cache
def circle(sectors: int) -> Curve:
    middle = angles(sectors)
    bulge = np.zeros((sectors, 4))
    bulge[:, 3] = 1.0
    return Curve(bulge, np.column_stack((np.cos(middle), np.sin(middle), np.ones(sectors))), round=True)


@cache
def angles(sectors: int) -> Array:
    """The middles of the sectors, from x towards y."""
    return np.asarray((np.arange(sectors) + 0.5) * (2.0 * pi / sectors))


@dataclass(frozen=True, slots=True)
class _Made:
    """A curve, where it was made (x, y, r), and how far from there it is good enough, in px."""

    curve: Curve
    place: Array
    reach_px: float

    def holds(self, place: Array) -> bool:
        return float(np.abs(place - self.place).sum()) <= self.reach_px


class View:
    """Where an image is on the sensor behind a lens. It remembers its latest curves: for one tracker, one thread."""

    def __init__(self, lens: Lens, origin_px: tuple[int, int] = (0, 0)) -> None:
        self.lens = lens
        self.origin_px = origin_px
        self._made: dict[int, _Made] = {}  # by the number of sectors

    def curve(self, x_px: float, y_px: float, r_px: float, sectors: int) -> Curve:
        """Of the sphere whose outline has this centre and r = sqrt(a b), in the image's coordinates.

        Raises ValueError where the lens shows no such outline.
        """
        place = np.array((x_px, y_px, r_px))
        made = self._made.get(sectors)
        if made is None or not made.holds(place):
            curve, reach_px = _curve(self.lens, place + np.array((*self.origin_px, 0.0)), sectors)
            made = self._made[sectors] = _Made(curve, place, reach_px)
        return made.curve

    def holds(self, x_px: float, y_px: float, r_px: float, curve: Curve) -> bool:
        """Whether the latest curve, if this is it, is good enough there."""
        made = self._made.get(len(curve.bulge))
        return made is not None and made.curve is curve and made.holds(np.array((x_px, y_px, r_px)))


def _curve(lens: Lens, place: Array, sectors: int) -> tuple[Curve, float]:
    """The curve at (x, y, r) in sensor coordinates, and how far from there it may be used."""
    nudges = NUDGE_PX * np.vstack((np.zeros(3), np.eye(3), -np.eye(3)))
    radius = _radius(lens, place + nudges, angles(sectors))
    bulge = radius[0] - place[2]
    first, second = _derivatives(radius[0])
    length = np.hypot(radius[0], first)
    slant = radius[0] / length
    change = (radius[1:4] - radius[4:7]).T / (2.0 * NUDGE_PX)  # (S, 3), r's own 1 included
    middle = angles(sectors)
    normal_x = (np.cos(middle) * radius[0] + np.sin(middle) * first) / length
    normal_y = (np.sin(middle) * radius[0] - np.cos(middle) * first) / length
    design = np.ascontiguousarray(slant[:, None] * change)  # as the compiled kernel takes it
    design[:, 0] += normal_x
    design[:, 1] += normal_y
    change[:, 2] -= 1.0
    reach_px = STALE_PX / max(float(np.abs(change).max()), 1e-9)
    return Curve(np.column_stack((bulge, first, second, slant)), design, round=False), reach_px


def _radius(lens: Lens, places: Array, polar_rad: Array) -> Array:
    """Distance (m, S) of the outline from its centre, at the polar angles (S,), for each place (m, 3)."""
    cones = [_cone(lens, place) for place in places]
    centre, across, down = (np.array([cone[k] for cone in cones])[:, :, None] for k in range(3))
    turn = np.broadcast_to(polar_rad, (len(places), len(polar_rad))).copy()
    for _ in range(ROUNDS):
        rays = centre + across * np.cos(turn)[:, None, :] + down * np.sin(turn)[:, None, :]
        if not float(rays[:, 2].min()) > 0.0:
            raise ValueError("the outline reaches beside the lens")
        points = lens.project(rays.transpose(1, 0, 2)) - places.T[:2, :, None]
        missing = np.arctan2(points[1], points[0]) - polar_rad
        missing -= 2.0 * pi * np.round(missing / (2.0 * pi))
        if float(np.abs(missing).max()) < EXACT_RAD:
            return np.asarray(np.hypot(points[0], points[1]))
        turn -= missing
    raise ValueError("the lens shows no outline there")


def _cone(lens: Lens, place: Array) -> tuple[Array, Array, Array]:
    """Of the rays that touch the sphere: its axis, and what to add to it towards the image's x and y."""
    direction, range_per_radius = centre_and_range(place[:2], float(place[2]), 1.0, lens)
    if not range_per_radius > 1.0:
        raise ValueError("no sphere has such an outline")
    x_axis = np.array((1.0, 0.0, 0.0)) - direction[0] * direction
    x_axis /= np.linalg.norm(x_axis)
    tangent = np.tan(asin(1.0 / range_per_radius))
    return direction, tangent * x_axis, tangent * np.cross(direction, x_axis)


def _derivatives(values: Array) -> tuple[Array, Array]:
    """First two derivatives of a smooth periodic function, from its values at equal steps."""
    spectrum = np.fft.rfft(values)
    order = np.arange(len(spectrum))
    first, second = (np.fft.irfft(spectrum * (1j * order) ** n, len(values)) for n in (1, 2))
    return first, second
