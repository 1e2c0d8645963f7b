"""Points from the image points of calibrated stations: check points, and whatever else was seen but not adjusted."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from trackerd.calibrate.cell.model import Linear, linearise
from trackerd.calibrate.cell.observations import Observations
from trackerd.calibrate.cell.predict import chosen_columns
from trackerd.calibrate.cell.rays import nearest_point, rays
from trackerd.calibrate.cell.state import STATION_COLUMNS, Indices, State, inverse_2, state_of
from trackerd.calibrate.cell.targets import known_points
from trackerd.contract.errors import ConfigError, Degenerate
from trackerd.contract.model import Array
from trackerd.geometry.gimbal import Station

STEPS = 6
CLOSE_MM = 1e-9


@dataclass(frozen=True, slots=True)
class Measured:
    """Points in W, in the order of the targets; NaN where fewer than two stations saw one."""

    p_mm: Array  # (m, 3)
    random_mm2: Array  # (m, 3, 3)
    systematic_mm2: Array  # (m, 3, 3) calibration and angle-fixed encoders
    sensitivity: Array  # (m, 3, p) d point / d parameter

    @property
    def total_mm2(self) -> Array:
        return self.random_mm2 + self.systematic_mm2


def measure(
    observations: Observations, count: int, stations: Mapping[str, Station], parameters: Sequence[str], covariance: Array
) -> Measured:
    """Maximum-likelihood points from all views that show them; `count` is the number of targets.

    Views that show several points count as if their encoders were read for each: exact for single targets.
    """
    missing = [name for name in observations.gimbals if name not in stations]
    if missing:
        raise ConfigError(f"gimbal {', '.join(missing)} has views, but no calibrated station")
    cell = [stations[name] for name in observations.gimbals]
    rows, number, seen = _seen_twice(observations)
    p = np.full((count, 3), np.nan)
    random, systematic = np.full((count, 3, 3), np.nan), np.full((count, 3, 3), np.nan)
    sensitivity = np.full((count, 3, len(parameters)), np.nan)
    if len(seen):
        state = state_of(cell, known_points(np.zeros((len(seen), 3))))
        found = _adjusted(state, observations, rows, number, _first(state, observations, rows, number, len(seen)))
        p[seen] = found.p_mm
        by_parameter = chosen_columns(cell, parameters, _by_station(found, observations, rows, number, len(cell)))
        view = observations.view[rows]
        random[seen] = _random(found, observations.encoder_sigma_rad[view], observations.sigma_px[rows], number)
        fixed = _fixed(found, observations.encoder_fixed_rad[view], number, observations.gimbal[view])
        systematic[seen] = fixed + by_parameter @ covariance @ by_parameter.transpose(0, 2, 1)
        sensitivity[seen] = by_parameter
    return Measured(p, random, systematic, sensitivity)


@dataclass(frozen=True, slots=True)
class _Found:
    p_mm: Array  # (s, 3)
    linear: Linear  # of the rows
    gain: Array  # (r, 3, 2) d point / d image point


def _seen_twice(observations: Observations) -> tuple[Indices, Indices, Indices]:
    """Rows of points that two stations or more saw, the number of each row's point among them, and these points."""
    gimbal = observations.gimbal[observations.view]
    pairs = np.unique(np.column_stack([observations.point, gimbal]), axis=0)
    points, counts = np.unique(pairs[:, 0], return_counts=True)
    seen = points[counts > 1]
    rows = np.flatnonzero(np.isin(observations.point, seen))
    return rows, np.searchsorted(seen, observations.point[rows]), seen


def _first(state: State, observations: Observations, rows: Indices, number: Indices, count: int) -> Array:
    origins, directions = rays(state, observations, rows, in_world=True)
    return np.array([nearest_point(origins[number == i], directions[number == i]) for i in range(count)])


def _adjusted(state: State, observations: Observations, rows: Indices, number: Indices, p_mm: Array) -> _Found:
    o = observations
    view = o.view[rows]
    encoder_rad = np.hypot(o.encoder_sigma_rad, o.encoder_fixed_rad)[view]
    for _ in range(STEPS):
        linear = linearise(state, known_points(p_mm), o.gimbal, o.angles_rad, view, number)
        if np.isnan(linear.q_px).any():
            raise Degenerate("the lines of sight meet behind a camera")
        spread = (o.sigma_px[rows] ** 2)[:, None, None] * np.eye(2) + (encoder_rad**2)[:, None, None] * (
            linear.encoder @ linear.encoder.transpose(0, 2, 1)
        )
        weighted = linear.world.transpose(0, 2, 1) @ inverse_2(spread)
        information = np.zeros((len(p_mm), 3, 3))
        np.add.at(information, number, weighted @ linear.world)
        gain = np.linalg.inv(information)[number] @ weighted
        step = np.zeros_like(p_mm)
        np.add.at(step, number, (gain @ (o.q_px[rows] - linear.q_px)[:, :, None])[:, :, 0])
        p_mm = p_mm + step
        if np.abs(step).max() < CLOSE_MM:
            break
    return _Found(p_mm, linear, gain)


def _random(found: _Found, encoder_rad: Array, sigma_px: Array, number: Indices) -> Array:
    """Covariances of the points from what is independent from view to view."""
    moved = found.gain @ found.linear.encoder * encoder_rad[:, None, None]
    scaled = found.gain * sigma_px[:, None, None]
    sums = np.zeros((len(found.p_mm), 3, 3))
    np.add.at(sums, number, moved @ moved.transpose(0, 2, 1) + scaled @ scaled.transpose(0, 2, 1))
    return sums


def _fixed(found: _Found, encoder_rad: Array, number: Indices, gimbal: Indices) -> Array:
    """And from the angle-fixed part, which is the same in all views of a point by one station: they have nearly one angle."""
    moved = np.zeros((len(found.p_mm), int(gimbal.max()) + 1, 3, 2))
    np.add.at(moved, (number, gimbal), found.gain @ found.linear.encoder * encoder_rad[:, None, None])
    return np.asarray((moved @ moved.transpose(0, 1, 3, 2)).sum(axis=1))


def _by_station(found: _Found, observations: Observations, rows: Indices, number: Indices, count: int) -> Array:
    """d point / d parameter of all stations, (s, 3, 23 K)."""
    gimbal = observations.gimbal[observations.view[rows]]
    sums = np.zeros((len(found.p_mm), count, 3, STATION_COLUMNS))
    np.add.at(sums, (number, gimbal), -found.gain @ found.linear.station)
    return np.asarray(sums.transpose(0, 2, 1, 3).reshape(len(found.p_mm), 3, count * STATION_COLUMNS))
