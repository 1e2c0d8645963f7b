"""Where the probe truly is: tool paths in closed form, so that position, velocity and acceleration belong to any instant."""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from math import ceil, cos, pi, sin, sqrt
from typing import TypeAlias

import numpy as np

from trackerd.contract.model import Array
from trackerd.formats.twin import PathSettings
from trackerd.geometry.rigid import cross
from trackerd.sim.ramp import Motion, Ramp, Stroke

State: TypeAlias = tuple[Array, Array, Array]  # position mm, velocity mm/s, acceleration mm/s^2; each (3,) in W

WAVES = 5  # sines for each axis of a random path
START_SHARE = 0.25  # of a random path's acceleration that its start may use


class ProbePath:
    """The path of the settings; `at` takes nanoseconds of the scene's time."""

    def __init__(self, settings: PathSettings, seed: int = 1) -> None:
        self.settings = settings
        self._centre_mm = np.array(settings.centre_mm)
        self._ordered = Ordered(settings) if settings.kind == "external" else None
        self._motion = self._ordered.at if self._ordered is not None else _motion(settings, seed)
        self._dwell_s = settings.dwell_s if self._ordered is None else 0.0

    def at(self, t_ns: int) -> State:
        """Position (mm), velocity (mm/s) and acceleration (mm/s^2), each (3,) in W."""
        p, v, a = self._motion(max(0.0, t_ns * 1e-9 - self._dwell_s))
        return self._centre_mm + p, v, a

    def go(self, t_ns: int, p_mm: Array) -> int:
        """Sets off to a point of W at an instant, or when it has arrived where it is going; when it will be there, ns.

        Raises ValueError for a path that is not external.
        """
        if self._ordered is None:
            raise ValueError(f'twin.path.kind = "{self.settings.kind}": only an external path is moved by requests')
        return ceil(self._ordered.go(t_ns * 1e-9, p_mm - self._centre_mm) * 1e9)


def _motion(settings: PathSettings, seed: int) -> Callable[[float], State]:
    match settings.kind:
        case "still" | "external":
            return _still
        case "circle":
            return Circle(settings).at
        case "raster":
            return Raster(settings).at
        case "random":
            return Wander(settings, seed).at


def _still(_: float) -> State:
    return np.zeros(3), np.zeros(3), np.zeros(3)


def plane(normal: tuple[float, float, float]) -> tuple[Array, Array]:
    """Two unit directions that span the plane, right-handed with its normal; for z they are x and y."""
    n = np.array(normal) / np.linalg.norm(normal)
    guide = np.array((1.0, 0.0, 0.0)) if abs(n[0]) < 0.9 else np.array((0.0, 1.0, 0.0))
    u = guide - (guide @ n) * n
    u /= np.linalg.norm(u)
    return u, cross(n, u)


class Circle:
    """From rest on the circle to a constant speed along it."""

    def __init__(self, settings: PathSettings) -> None:
        self._radius_mm = settings.radius_mm
        self._u, self._v = plane(settings.normal)
        self._ramp = Ramp(settings.speed_mm_s, settings.acceleration_mm_s2, settings.jerk_mm_s3)

    def at(self, t_s: float) -> State:
        way, speed, acceleration = self._ramp.at(t_s)
        angle = way / self._radius_mm
        outward = cos(angle) * self._u + sin(angle) * self._v
        along = cos(angle) * self._v - sin(angle) * self._u
        inward = speed * speed / self._radius_mm
        return self._radius_mm * outward, speed * along, acceleration * along - inward * outward


@dataclass(frozen=True, slots=True)
class Leg:
    begin_s: float
    start_mm: Array
    direction: Array
    stroke: Stroke


class Raster:
    """Rows to and fro, a step after each, and the same way back: from rest to rest at every corner, for ever."""

    def __init__(self, settings: PathSettings) -> None:
        u, v = plane(settings.normal)
        corners = _raster_corners(u * settings.radius_mm, v * settings.row_mm, settings.rows)
        fastest = Ramp(settings.speed_mm_s, settings.acceleration_mm_s2, settings.jerk_mm_s3)
        self._legs: list[Leg] = []
        self._period_s = 0.0
        round_trip = [*corners, *corners[-2::-1]]
        for start, end in pairwise(round_trip):
            length = float(np.linalg.norm(end - start))
            leg = Leg(self._period_s, start, (end - start) / length, Stroke.over(length, fastest))
            self._legs.append(leg)
            self._period_s += leg.stroke.duration_s

    def at(self, t_s: float) -> State:
        t_s %= self._period_s
        leg = next(leg for leg in reversed(self._legs) if leg.begin_s <= t_s)
        way, speed, acceleration = leg.stroke.at(t_s - leg.begin_s)
        return leg.start_mm + way * leg.direction, speed * leg.direction, acceleration * leg.direction


def _raster_corners(half_row_mm: Array, step_mm: Array, rows: int) -> list[Array]:
    corners = []
    for row in range(rows):
        middle = step_mm * (row - (rows - 1) / 2.0)
        side = 1.0 if row % 2 else -1.0
        corners += [middle + side * half_row_mm, middle - side * half_row_mm]
    return corners


class Ordered:
    """At rest until told where to go, then straight there, from rest to rest."""

    def __init__(self, settings: PathSettings) -> None:
        self._fastest = Ramp(settings.speed_mm_s, settings.acceleration_mm_s2, settings.jerk_mm_s3)
        self._legs: list[Leg] = []
        self._there_s, self._there_mm = 0.0, np.zeros(3)  # when and where the last leg ends

    def go(self, t_s: float, p_mm: Array) -> float:
        """When it will be there, s."""
        way = p_mm - self._there_mm
        length = float(np.linalg.norm(way))
        if length > 0.0:
            leg = Leg(max(t_s, self._there_s), self._there_mm, way / length, Stroke.over(length, self._fastest))
            self._legs.append(leg)
            self._there_s, self._there_mm = leg.begin_s + leg.stroke.duration_s, p_mm
        return max(t_s, self._there_s)

    def at(self, t_s: float) -> State:
        leg = next((leg for leg in reversed(self._legs) if leg.begin_s <= t_s), None)
        if leg is None:
            return _still(t_s)
        way, speed, acceleration = leg.stroke.at(min(t_s - leg.begin_s, leg.stroke.duration_s))
        return leg.start_mm + way * leg.direction, speed * leg.direction, acceleration * leg.direction


class Wander:
    """Seeded sines on each axis, scaled so that reach, speed and acceleration stay within bounds, whatever the phases."""

    def __init__(self, settings: PathSettings, seed: int) -> None:
        rng = np.random.default_rng((seed, 0x70617468))
        self._pace = rng.uniform(0.25, 1.0, (3, WAVES))  # rad per unit of the path's parameter
        self._phase = rng.uniform(0.0, 2.0 * pi, (3, WAVES))
        self._size_mm = rng.uniform(0.5, 1.0, (3, WAVES))
        self._size_mm *= settings.radius_mm / self._bound(0)
        self._clock = self._start(settings)

    def at(self, t_s: float) -> State:
        s, rate, rate_change = self._clock(t_s)
        angle = self._pace * s + self._phase
        first = self._size_mm * self._pace * np.cos(angle)
        sines = self._size_mm * np.sin(angle)
        tangent = first.sum(axis=1)
        bend = -(sines * self._pace**2).sum(axis=1)
        return sines.sum(axis=1), tangent * rate, bend * rate**2 + tangent * rate_change

    def _bound(self, derivative: int) -> float:
        """No derivative of this order by the parameter is longer: all sines at their crest on all axes."""
        return float(np.linalg.norm((self._size_mm * self._pace**derivative).sum(axis=1)))

    def _start(self, settings: PathSettings) -> Callable[[float], Motion]:
        """The parameter over time: a smooth start, then the fastest rate within the bounds."""
        rate = min(
            settings.speed_mm_s / self._bound(1),
            sqrt((1.0 - START_SHARE) * settings.acceleration_mm_s2 / self._bound(2)),
            (settings.jerk_mm_s3 / self._bound(3)) ** (1.0 / 3.0),
        )
        change = START_SHARE * settings.acceleration_mm_s2 / self._bound(1)
        return Ramp(rate, change, START_SHARE * settings.jerk_mm_s3 / self._bound(1)).at
