"""The inverse of the normal matrix: the covariance of everything, or a refusal that names what is not determined."""

import numpy as np
import scipy.linalg

from trackerd.calibrate.cell.normal import FY, Normal
from trackerd.calibrate.cell.problem import Problem
from trackerd.calibrate.cell.state import (
    BODY_COLUMNS,
    FX,
    POSE,
    STATION_COLUMNS,
    STATION_NAMES,
    Indices,
    State,
    cross_matrices,
    points_in_world,
)
from trackerd.contract.errors import Undetermined
from trackerd.contract.model import Array

LEAST_EIGENVALUE = 1e-13  # of the normal matrix scaled to unit diagonal: below it, rounding decides
BODY_NAMES = (*POSE, "ball x_mm", "ball y_mm", "ball z_mm")


def covariance_of(problem: Problem, normal: Normal, free: Indices) -> Array:
    """(p, p) over all columns, 0 for what is not free; fy has its share. Raises Undetermined."""
    information = normal.information[np.ix_(free, free)]
    diagonal = np.diag(information)
    if not (np.isfinite(information).all() and diagonal.min(initial=1.0) > 0.0):
        worst = int(np.argmin(np.where(np.isfinite(diagonal), diagonal, -1.0)))
        raise Undetermined(f"nothing was seen that depends on {column_name(problem, int(free[worst]))}: hold it, or show more")
    scale = 1.0 / np.sqrt(diagonal)
    scaled = information * np.outer(scale, scale)
    try:
        inverse = scipy.linalg.cho_solve(scipy.linalg.cho_factor(scaled), np.eye(len(free)))
    except scipy.linalg.LinAlgError:
        inverse = None
    if inverse is None or np.diag(inverse).max(initial=1.0) > 1.0 / LEAST_EIGENVALUE:
        raise Undetermined(_what_is_loose(problem, scaled, free))
    inverse = (inverse + inverse.T) / 2.0 * np.outer(scale, scale)
    full = np.zeros_like(normal.information)
    full[np.ix_(free, free)] = inverse
    return _with_ties(full, problem)


def column_name(problem: Problem, column: int) -> str:
    layout, targets = problem.layout, problem.targets
    if column < layout.bodies_at:
        k = column // STATION_COLUMNS
        gimbals = problem.observations.gimbals
        return f"{gimbals[k] if k < len(gimbals) else f'station {k}'}.{STATION_NAMES[column % STATION_COLUMNS]}"
    if column < layout.points_at:
        body, at = divmod(column - layout.bodies_at, BODY_COLUMNS)
        return f"{targets.bodies[body].name}.{BODY_NAMES[at]}"
    point, at = divmod(column - layout.points_at, 3)
    return f"point {targets.names[int(np.flatnonzero(layout.slot == point)[0])]}.{'xyz'[at]}_mm"


def points_covariance(problem: Problem, state: State, covariance: Array) -> Array:
    """(m, 3, 3) of all targets in W; 0 for exact points of fixed bodies."""
    layout, targets = problem.layout, problem.targets
    points = np.arange(len(targets))
    _, turned = points_in_world(state, targets, points)
    rotation = state.r_world_from_body[targets.body]
    jacobian = np.concatenate(
        [-cross_matrices(turned), np.broadcast_to(np.eye(3), rotation.shape), rotation @ targets.flange, rotation], axis=2
    )
    body_at = layout.bodies_at + BODY_COLUMNS * targets.body[:, None] + np.arange(BODY_COLUMNS)
    own = layout.slot >= 0
    point_at = layout.points_at + 3 * np.where(own, layout.slot, 0)[:, None] + np.arange(3)
    if layout.columns == layout.points_at:
        jacobian, at = jacobian[:, :, :BODY_COLUMNS], body_at
    else:
        jacobian[~own, :, BODY_COLUMNS:] = 0.0
        at = np.concatenate([body_at, np.minimum(point_at, layout.columns - 1)], axis=1)
    blocks = covariance[at[:, :, None], at[:, None, :]]
    return np.asarray(jacobian @ blocks @ jacobian.transpose(0, 2, 1))


def _with_ties(full: Array, problem: Problem) -> Array:
    """Square pixels: what fx does, fy does in proportion."""
    if problem.square_pixels:
        for k, ratio in enumerate(problem.fy_per_fx):
            fx = STATION_COLUMNS * k + FX
            fy = fx - FX + FY
            full[fy] = ratio * full[fx]
            full[:, fy] = ratio * full[:, fx]
    return full


def _what_is_loose(problem: Problem, scaled: Array, free: Indices) -> str:
    _, vectors = np.linalg.eigh(scaled)
    worst = np.argsort(-np.abs(vectors[:, 0]))[:3]
    names = ", ".join(column_name(problem, int(free[i])) for i in worst)
    return (
        f"the data do not determine {names}: a prior, more points, more image positions or other angles would;"
        " without any point that is known in the world, hold one station's pose"
    )
