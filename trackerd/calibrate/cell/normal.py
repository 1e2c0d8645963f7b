"""Normal equations of a cell. Two encoder corrections of each view, shared by all of its points, are eliminated.

With the image points' rows J and the view's encoder columns E (both divided by sigma), a view adds
J^T J - J^T E (E^T E + 1 / sigma_e^2)^-1 E^T J: the Schur complement, which equals whitening by px^2 I + E sigma_e^2 E^T.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from trackerd.calibrate.cell.model import Linear, linearise
from trackerd.calibrate.cell.problem import Bucket, Problem
from trackerd.calibrate.cell.state import (
    BODY_COLUMNS,
    FX,
    STATION_COLUMNS,
    Indices,
    State,
    cross_matrices,
    difference,
    inverse_2,
    points_in_world,
)
from trackerd.contract.model import Array

FY = FX + 1


@dataclass(frozen=True, slots=True)
class Weights:
    """Between 0 (left out) and 1."""

    point: Array  # (n,)
    view: Array  # (v,) of the encoders' own information


@dataclass(frozen=True, slots=True)
class Normal:
    """At a state, over all columns. The cost is chi-square, with the encoders' corrections at their best."""

    information: Array  # (p, p)
    gradient: Array  # (p,) half of the cost's
    cost: float
    encoder_information: Array  # (v, 2, 2)
    encoder_gradient: Array  # (v, 2)


@dataclass(frozen=True, slots=True)
class Columns:
    """Those that a stage frees, of all columns, and what of them a station and a body have."""

    free: Indices
    station: Indices  # of 23
    body: Indices  # of 9


def columns_of(free: Indices, problem: Problem) -> Columns:
    layout = problem.layout
    stations, bodies = free[free < layout.bodies_at], free[(free >= layout.bodies_at) & (free < layout.points_at)]
    return Columns(free, np.unique(stations % STATION_COLUMNS), np.unique((bodies - layout.bodies_at) % BODY_COLUMNS))


def evaluate(problem: Problem, state: State) -> Linear:
    """Model and derivatives; of square pixels, fy goes with fx."""
    o = problem.observations
    linear = linearise(state, problem.targets, o.gimbal, o.angles_rad, o.view, o.point)
    if problem.square_pixels:
        linear.station[:, :, FX] += problem.fy_per_fx[o.gimbal[o.view]][:, None] * linear.station[:, :, FY]
        linear.station[:, :, FY] = 0.0
    return linear


def assemble(problem: Problem, state: State, linear: Linear, weights: Weights, columns: Columns) -> Normal:
    """The cost is infinite where a point that counts is behind its camera."""
    p, v = problem.layout.columns, problem.v
    scale = np.sqrt(weights.point) / problem.observations.sigma_px
    residual = linear.q_px - problem.observations.q_px
    unseen = np.isnan(residual[:, 0])
    if (unseen & (weights.point > 0.0)).any():
        return Normal(np.zeros((p, p)), np.zeros(p), np.inf, np.zeros((v, 2, 2)), np.zeros((v, 2)))
    rows = _rows(linear, residual, scale, unseen, columns)
    products = [_product(bucket, rows) for bucket in problem.buckets]
    encoders = (weights.view / problem.encoder_sigma_rad**2)[:, None, None] * np.eye(2)
    gradients = np.zeros((v, 2))
    for bucket, product in zip(problem.buckets, products, strict=True):
        np.add.at(encoders, bucket.view, product[:, -3:-1, -3:-1])
        np.add.at(gradients, bucket.view, product[:, -3:-1, -1])
    inverse = inverse_2(encoders)
    best = (inverse @ gradients[:, :, None])[:, :, 0]
    information, gradient = np.zeros((p, p)), np.zeros(p)
    cost = float(sum(product[:, -1, -1].sum() for product in products) - (gradients * best).sum())
    _add_alone(problem, zip(problem.buckets, products, strict=True), (inverse, best), columns, (information, gradient))
    if not all(bucket.alone for bucket in problem.buckets):
        _add_coupled(problem, products, rows, (inverse, best), columns, (information, gradient))
    cost += _add_priors(problem, state, information, gradient) + _add_bars(problem, state, information, gradient)
    return Normal(information, gradient, cost, encoders, gradients)


def _rows(linear: Linear, residual: Array, scale: Array, unseen: npt.NDArray[np.bool_], columns: Columns) -> Array:
    """(n + 1, 2, 3 + c): point, station, body, encoders, residual, divided by sigma; the last row is 0, for padding."""
    n, body_at = len(scale), 3 + len(columns.station)
    rows = np.zeros((n + 1, 2, body_at + len(columns.body) + 3))
    s = scale[:, None, None]
    np.multiply(linear.point, s, out=rows[:n, :, :3])
    np.multiply(linear.station[:, :, columns.station], s, out=rows[:n, :, 3:body_at])
    np.multiply(linear.body[:, :, columns.body], s, out=rows[:n, :, body_at:-3])
    np.multiply(linear.encoder, s, out=rows[:n, :, -3:-1])
    np.multiply(residual, scale[:, None], out=rows[:n, :, -1])
    rows[:n][unseen] = 0.0
    return rows


def _product(bucket: Bucket, rows: Array) -> Array:
    """Of all pairs of columns, (S, c, c), summed over each segment's image points."""
    segments, k = bucket.rows.shape
    block = (rows if bucket.own else rows[:, :, 3:])[bucket.rows].reshape(segments, 2 * k, -1)
    return np.asarray(block.transpose(0, 2, 1) @ block)


def _add_alone(
    problem: Problem,
    buckets: Iterable[tuple[Bucket, Array]],
    encoders: tuple[Array, Array],
    columns: Columns,
    out: tuple[Array, Array],
) -> None:
    """Segments that are all of their view: the encoders go within each, then like ones are summed."""
    information, gradient = out
    inverse, best = encoders
    for bucket, product in buckets:
        if not bucket.alone:
            continue
        coupling = product[:, :-3, -3:-1]
        reduced = product[:, :-3, :-3] - coupling @ inverse[bucket.view] @ coupling.transpose(0, 2, 1)
        slope = product[:, :-3, -1] - (coupling @ best[bucket.view][:, :, None])[:, :, 0]
        first = 3 if bucket.own else 0
        sums = np.add.reduceat(reduced[:, first:, first:], bucket.groups, axis=0)
        slopes = np.add.reduceat(slope[:, first:], bucket.groups, axis=0)
        at = _global(problem, columns, bucket.station, bucket.body)
        for group, square, line in zip(bucket.groups, sums, slopes, strict=True):
            information[np.ix_(at[group], at[group])] += square
            gradient[at[group]] += line
        if bucket.own:
            point_at = _point_columns(problem, bucket.rows[:, 0])
            _add_cross(information, point_at, at, reduced[:, :3, 3:])
            np.add.at(information, (point_at[:, :, None], point_at[:, None, :]), reduced[:, :3, :3])
            np.add.at(gradient, point_at, slope[:, :3])


def _add_coupled(
    problem: Problem,
    products: Sequence[Array],
    rows: Array,
    encoders: tuple[Array, Array],
    columns: Columns,
    out: tuple[Array, Array],
) -> None:
    """Views of several bodies, or of several points that are not exact: their encoders couple all that they show."""
    information, gradient = out
    inverse, best = encoders
    buckets = [(bucket, product) for bucket, product in zip(problem.buckets, products, strict=True) if not bucket.alone]
    views = np.unique(np.concatenate([bucket.view for bucket, _ in buckets]))
    number = np.zeros(problem.v, np.intp)
    number[views] = np.arange(len(views))
    coupling = np.zeros((len(views), problem.layout.columns, 2))
    for bucket, product in buckets:
        at = _global(problem, columns, bucket.station, bucket.body)
        first = 3 if bucket.own else 0
        np.add.at(information, (at[:, :, None], at[:, None, :]), product[:, first:-3, first:-3])
        np.add.at(gradient, at, product[:, first:-3, -1])
        np.add.at(coupling, (number[bucket.view][:, None], at), product[:, first:-3, -3:-1])
        mine = bucket.rows[bucket.rows < problem.n]
        mine = mine[problem.layout.slot[problem.observations.point[mine]] >= 0]
        if len(mine):
            _add_points(problem, rows[mine], mine, columns, out)
            point_at = _point_columns(problem, mine)
            with_encoders = rows[mine][:, :, :3].transpose(0, 2, 1) @ rows[mine][:, :, -3:-1]
            np.add.at(coupling, (number[problem.observations.view[mine]][:, None], point_at), with_encoders)
    factor = (coupling @ np.linalg.cholesky(inverse[views])).transpose(1, 0, 2).reshape(problem.layout.columns, -1)
    information -= factor @ factor.T
    gradient -= (coupling @ best[views][:, :, None])[:, :, 0].sum(axis=0)


def _add_points(problem: Problem, rows: Array, mine: Indices, columns: Columns, out: tuple[Array, Array]) -> None:
    """Each image point couples its point with its station and its body."""
    information, gradient = out
    o = problem.observations
    at = _global(problem, columns, o.gimbal[o.view[mine]], problem.targets.body[o.point[mine]])
    point_at = _point_columns(problem, mine)
    product = rows[:, :, :3].transpose(0, 2, 1) @ rows
    _add_cross(information, point_at, at, product[:, :, 3:-3])
    np.add.at(information, (point_at[:, :, None], point_at[:, None, :]), product[:, :, :3])
    np.add.at(gradient, point_at, product[:, :, -1])


def _add_cross(information: Array, point_at: Indices, at: Indices, values: Array) -> None:
    """Points (r, 3) with others (r, c), on both sides of the diagonal."""
    np.add.at(information, (point_at[:, :, None], at[:, None, :]), values)
    np.add.at(information, (at[:, :, None], point_at[:, None, :]), values.transpose(0, 2, 1))


def _point_columns(problem: Problem, rows: Indices) -> Indices:
    slot = problem.layout.slot[problem.observations.point[rows]]
    return np.asarray(problem.layout.points_at + 3 * slot[:, None] + np.arange(3))


def _global(problem: Problem, columns: Columns, station: Indices, body: Indices) -> Indices:
    """The columns (S, c) of segments."""
    stations = STATION_COLUMNS * station[:, None] + columns.station
    bodies = problem.layout.bodies_at + BODY_COLUMNS * body[:, None] + columns.body
    return np.concatenate([stations, bodies], axis=1)


def _add_priors(problem: Problem, state: State, information: Array, gradient: Array) -> float:
    known, layout = problem.known, problem.layout
    from_centre = difference(state, known.centre)
    slope = _slope(from_centre)
    error = from_centre.ravel()
    weighted = known.station @ error
    end = layout.bodies_at
    information[:end, :end] += slope.T @ known.station @ slope
    gradient[:end] += slope.T @ weighted
    cost = float(error @ weighted)
    balls = layout.bodies_at + BODY_COLUMNS * np.arange(layout.bodies)[:, None] + np.arange(6, 9)
    off_mm = state.ball_mm - known.centre.ball_mm
    information[balls, balls] += known.ball[:, None]
    gradient[balls] += known.ball[:, None] * off_mm
    cost += float((known.ball[:, None] * off_mm**2).sum())
    points = layout.points_at + np.arange(layout.columns - layout.points_at).reshape(-1, 3)
    delta = state.delta_mm[layout.slot >= 0]
    pulled = np.einsum("nij,nj->ni", problem.point_information, delta)
    information[points[:, :, None], points[:, None, :]] += problem.point_information
    gradient[points] += pulled
    return cost + float((pulled * delta).sum())


def _slope(from_centre: Array) -> Array:
    """d difference / d step, (23 K, 23 K): 1, but for rotations the inverse of the left Jacobian."""
    slope = np.eye(from_centre.size)
    for k, row in enumerate(from_centre):
        for at in (0, 8):
            vector = row[at : at + 3]
            angle = float(np.sqrt(vector @ vector))
            cross = cross_matrices(vector)
            bend = 1.0 / 12.0 if angle < 1e-3 else (1.0 - 0.5 * angle / np.tan(0.5 * angle)) / angle**2
            place = slice(STATION_COLUMNS * k + at, STATION_COLUMNS * k + at + 3)
            slope[place, place] = np.eye(3) - 0.5 * cross + bend * cross @ cross
    return slope


def _add_bars(problem: Problem, state: State, information: Array, gradient: Array) -> float:
    t, layout = problem.targets, problem.layout
    if not len(t.bar_mm):
        return 0.0
    rows = np.zeros((len(t.bar_mm), layout.columns))
    ends = [points_in_world(state, t, t.bar_points[:, end]) for end in (0, 1)]
    apart = ends[1][0] - ends[0][0]
    length = np.maximum(np.sqrt((apart**2).sum(axis=1)), 1e-9)
    along = apart / length[:, None]
    for end, sign in ((0, -1.0), (1, 1.0)):
        _add_end(problem, state, rows, t.bar_points[:, end], sign * along, ends[end][1])
    rows /= t.bar_sigma_mm[:, None]
    off = (length - t.bar_mm) / t.bar_sigma_mm
    information += rows.T @ rows
    gradient += rows.T @ off
    return float(off @ off)


def _add_end(problem: Problem, state: State, rows: Array, point: Indices, along: Array, turned: Array) -> None:
    """Derivatives of bars' lengths by one end each: `along` (b, 3) is that by its place in W."""
    t, layout = problem.targets, problem.layout
    bars = np.arange(len(point))[:, None]
    body = t.body[point]
    at = layout.bodies_at + BODY_COLUMNS * body[:, None]
    in_body = np.einsum("bi,bij->bj", along, state.r_world_from_body[body])
    rows[bars, at + np.arange(3)] += np.cross(turned, along)
    rows[bars, at + np.arange(3, 6)] += along
    rows[bars, at + np.arange(6, 9)] += np.einsum("bi,bij->bj", in_body, t.flange[point])
    own = layout.slot[point] >= 0
    columns = layout.points_at + 3 * layout.slot[point][own][:, None] + np.arange(3)
    rows[bars[own], columns] += in_body[own]
