"""Levenberg and Marquardt's method on the normal equations, columns scaled to unit diagonal."""

from dataclasses import dataclass

import numpy as np
import scipy.linalg

from trackerd.calibrate.cell.model import Linear
from trackerd.calibrate.cell.normal import FY, Columns, Normal, Weights, assemble, columns_of, evaluate
from trackerd.calibrate.cell.problem import Problem
from trackerd.calibrate.cell.state import FX, STATION_COLUMNS, Indices, State, moved
from trackerd.calibrate.cell.weights import Loss, offsets, soft
from trackerd.contract.model import Array

FIRST_DAMPING, LEAST_DAMPING, MOST_DAMPING = 1e-4, 1e-15, 1e6


@dataclass(frozen=True, slots=True)
class Adjusted:
    state: State
    linear: Linear
    weights: Weights
    normal: Normal
    columns: Columns
    iterations: int


def adjust(
    problem: Problem,
    state: State,
    free: Indices,
    weights: Weights,
    *,
    loss: Loss,
    steps: int,
    tolerance: float,
    relative: float = 0.0,
    damping: float = FIRST_DAMPING,
) -> Adjusted:
    """Until a step changes chi-square by less than `tolerance`, or that share of it. Robust losses weigh anew every step."""
    columns = columns_of(free, problem)
    linear = evaluate(problem, state)
    if loss is not Loss.EQUAL:
        weights = soft(offsets(problem, linear, weights), loss)
    normal = assemble(problem, state, linear, weights, columns)
    taken = 0
    while taken < steps and damping < MOST_DAMPING and np.isfinite(normal.cost):
        step = _step(normal, columns, damping)
        change = float(-(normal.gradient @ step))
        if change < max(tolerance, relative * normal.cost):
            break
        taken += 1
        there = moved(state, _with_ties(step, problem), problem.layout)
        linear_there = evaluate(problem, there)
        normal_there = assemble(problem, there, linear_there, weights, columns)
        if not (_plausible(there, problem) and normal_there.cost <= normal.cost * (1.0 + 1e-12)):
            damping *= 10.0
            continue
        damping = max(damping * 0.1, LEAST_DAMPING)
        state, linear, normal = there, linear_there, normal_there
        if loss is not Loss.EQUAL:
            weights = soft(offsets(problem, linear, weights), loss)
            normal = assemble(problem, state, linear, weights, columns)
    return Adjusted(state, linear, weights, normal, columns, taken)


def _plausible(state: State, problem: Problem) -> bool:
    """Focal lengths between half and twice the nominal ones: beyond, a step has left the valley."""
    ratio = state.lens[:, :2] / problem.known.centre.lens[:, :2]
    return bool(((ratio > 0.5) & (ratio < 2.0)).all())


def _step(normal: Normal, columns: Columns, damping: float) -> Array:
    free = columns.free
    information = normal.information[np.ix_(free, free)]
    diagonal = np.diag(information)
    scale = np.where(diagonal > 0.0, 1.0 / np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0)), 1.0)
    scaled = information * np.outer(scale, scale)
    np.fill_diagonal(scaled, 1.0 + damping)
    solution = _solve(scaled, -scale * normal.gradient[free])
    step = np.zeros(len(normal.gradient))
    step[free] = scale * solution
    return step


def _solve(matrix: Array, right: Array) -> Array:
    """Of a symmetric matrix, which rounding may have made indefinite in a direction that only the damping holds."""
    try:
        return np.asarray(scipy.linalg.cho_solve(scipy.linalg.cho_factor(matrix, check_finite=False), right))
    except scipy.linalg.LinAlgError:
        values, vectors = np.linalg.eigh(matrix)
        return np.asarray(vectors @ (vectors.T @ right / np.maximum(values, 1e-15)))


def _with_ties(step: Array, problem: Problem) -> Array:
    if problem.square_pixels:
        step = step.copy()
        fx = STATION_COLUMNS * np.arange(problem.layout.stations) + FX
        step[fx - FX + FY] = problem.fy_per_fx * step[fx]
    return step
