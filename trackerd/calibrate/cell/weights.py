"""How far off each image point and each view is, and what weight it has.

Every one is judged without itself: an image point against the encoders' corrections that the rest of its view asks for, a
view's encoders against the corrections that its image points ask for. With one point in a view both are the same question.
"""

from dataclasses import dataclass
from enum import Enum, auto

import numpy as np
import numpy.typing as npt

from trackerd.calibrate.cell.model import Linear
from trackerd.calibrate.cell.normal import Weights
from trackerd.calibrate.cell.problem import Problem
from trackerd.calibrate.cell.state import inverse_2
from trackerd.contract.model import Array

MEDIAN_2 = 1.386  # of a chi-square with two degrees of freedom
SOFT_SIGMAS = 3.0  # where a fine weight has fallen to a quarter
NEAR_SIGMAS = 1.5  # where a coarse weight begins to fall
Flags = npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Offsets:
    """Squares of whitened offsets with two degrees of freedom each; inf behind a camera."""

    point: Array  # (n,)
    view: Array  # (v,) 0 for a view with less than two points that count


def everyone(problem: Problem) -> Weights:
    return Weights(np.ones(problem.n), np.ones(problem.v))


def offsets(problem: Problem, linear: Linear, weights: Weights) -> Offsets:
    o, v = problem.observations, problem.v
    sigma = o.sigma_px
    r = (linear.q_px - o.q_px) / sigma[:, None]
    seen = np.isfinite(r[:, 0])
    r = np.where(seen[:, None], r, 0.0)
    e = np.where(seen[:, None, None], linear.encoder / sigma[:, None, None], 0.0)
    own = weights.point[:, None, None] * (e.transpose(0, 2, 1) @ e)
    pull = weights.point[:, None] * np.einsum("nai,na->ni", e, r)
    sums, pulls = _per_view(own, o.view, v), _per_view(pull, o.view, v)
    free = 1.0 / problem.encoder_sigma_rad**2
    others = (sums + (weights.view * free)[:, None, None] * np.eye(2))[o.view] - own
    others += (1e-9 * free)[o.view][:, None, None] * np.eye(2)  # a view without encoders and with one point alone knows nothing
    cov = inverse_2(others)
    off = r - np.einsum("nai,nij,nj->na", e, cov, pulls[o.view] - pull)
    spread = np.eye(2) + e @ cov @ e.transpose(0, 2, 1)
    point = np.where(seen, np.einsum("na,nab,nb->n", off, inverse_2(spread), off), np.inf)
    return Offsets(point, _view_offsets(problem, e, r, seen, weights))


def _view_offsets(problem: Problem, e: Array, r: Array, seen: Flags, weights: Weights) -> Array:
    """A view that is left out is judged by all of its points: it may come back."""
    view_of, v = problem.observations.view, problem.v
    out = (np.bincount(view_of, weights.point, v) == 0.0)[view_of]
    weight = np.where(out, seen.astype(float), weights.point)
    sums = _per_view(weight[:, None, None] * (e.transpose(0, 2, 1) @ e), view_of, v)
    pulls = _per_view(weight[:, None] * np.einsum("nai,na->ni", e, r), view_of, v)
    several = np.bincount(view_of, weight > 0.0, v) > 1
    variance = problem.encoder_sigma_rad[several] ** 2
    asked = inverse_2(sums[several] + (1e-9 / variance)[:, None, None] * np.eye(2))
    correction = np.einsum("vij,vj->vi", asked, pulls[several])
    width = inverse_2(asked + variance[:, None, None] * np.eye(2))
    view = np.zeros(v)
    view[several] = np.einsum("vi,vij,vj->v", correction, width, correction)
    return view


class Loss(Enum):
    """EQUAL: all alike. COARSE: far ones pull no more than near ones, no valley is false. FINE: far ones do not pull at all."""

    EQUAL = auto()
    COARSE = auto()
    FINE = auto()


def soft(found: Offsets, loss: Loss) -> Weights:
    """The scale is the median's while the model is still coarse, and 1 in the end."""
    view = np.ones(len(found.view))
    several = found.view > 0.0
    if several.any():
        view[several] = _fall(found.view[several], loss)
    return Weights(_fall(found.point, loss), view)


def hard(found: Offsets, sigmas: float, problem: Problem) -> tuple[Weights, Flags]:
    """1 or 0, and which views are left out whole."""
    bad_view = found.view > sigmas**2
    good = (found.point <= sigmas**2) & ~bad_view[problem.observations.view]
    return Weights(good.astype(float), np.ones(problem.v)), bad_view


def _fall(squares: Array, loss: Loss) -> Array:
    median = float(np.median(squares))
    scale = max(1.0, median / MEDIAN_2) if np.isfinite(median) else 1e12
    if loss is Loss.COARSE:
        return np.asarray(1.0 / np.sqrt(1.0 + squares / (NEAR_SIGMAS**2 * scale)))  # of the absolute value, rounded
    return np.asarray(1.0 / (1.0 + squares / (SOFT_SIGMAS**2 * scale)) ** 2)  # Geman and McClure's


def _per_view(values: Array, view: npt.NDArray[np.intp], count: int) -> Array:
    flat = values.reshape(len(values), -1)
    sums = np.array([np.bincount(view, column, count) for column in flat.T], float)
    return sums.T.reshape(count, *values.shape[1:])
