"""The sectors' own grey levels in NumPy's kernel: their start, what they have in common, and how they are eliminated."""

from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from trackerd.contract.model import Array
from trackerd.vision.convergence import RULES

Ties: TypeAlias = list[tuple[float, Array]]  # of the levels outside, and inside: 1 / variance of their gradient, and that


def plain_levels(level: Array, weight: Array, edge: Array) -> Array:
    """B and D of each sector, (S, 2), by least squares with equal weights."""
    w, we = weight, weight * edge
    n, e, ee = w.sum(1), we.sum(1), (we * edge).sum(1)
    y, ye = (w * level).sum(1), (we * level).sum(1)
    det = n * ee - e * e
    contrast = np.where(det > RULES.blind * n * ee, (n * ye - e * y) / np.maximum(det, 1e-3), 0.0)
    return np.column_stack(((y - contrast * e) / np.maximum(n, 1.0), contrast))


def eliminate_levels(normal: Array, levels: Array, saturated_dn: float) -> tuple[Array, Array, Array]:
    """Schur complement (S, c - 2, c - 2) over (e, sig, G, residual), the levels at the best fit with the circle as it is, and
    minus their change with (e, sig, G), (S, 2, c - 3)."""
    damping = 1.0 / saturated_dn**2  # a level that saturates may be anything: it is not sent to infinity
    a, b, d = normal[:, 0, 0] + damping, normal[:, 0, 1], normal[:, 1, 1] + damping
    det = a * d - b * b
    blind = det <= RULES.blind * a * d
    det = np.where(blind, 1.0, det)
    c = np.where(blind[:, None, None], 0.0, normal[:, :2, 2:])
    solved = np.empty_like(c)
    solved[:, 0] = (d[:, None] * c[:, 0] - b[:, None] * c[:, 1]) / det[:, None]
    solved[:, 1] = (a[:, None] * c[:, 1] - b[:, None] * c[:, 0]) / det[:, None]
    reduced = np.where(blind[:, None, None], 0.0, normal[:, 2:, 2:] - c.transpose(0, 2, 1) @ solved)
    return reduced, levels + solved[:, :, -1], solved[:, :, :-1]


def tie(normal: Array, levels: Array, middle: Array, ambient_spread_dn: float | None) -> Ties:
    """Ties the levels outside, and those inside, to what the sectors have in common: as firmly as they are found to agree.

    Free levels cost a sixth of the precision; equal ones assumed would bias the centre by any gradient of the light. So the
    spread of the levels is taken from the sectors (empirical Bayes); those that stand out are left free. In `normal`, in place.
    """
    a, b, d = normal[:, 0, 0].copy(), normal[:, 0, 1].copy(), normal[:, 1, 1].copy()
    det = a * d - b * b
    seeing = det > RULES.blind * a * d
    det = np.where(seeing, det, 1.0)
    base = levels[:, 0] + (d * normal[:, 0, -1] - b * normal[:, 1, -1]) / det
    inside = base + levels[:, 1] + (a * normal[:, 1, -1] - b * normal[:, 0, -1]) / det
    return [
        _tie_end(normal, base, np.where(seeing, d / det, 1.0), seeing, levels[:, 0], (1.0, 0.0), -3, middle, None),
        _tie_end(
            normal,
            inside,
            np.where(seeing, np.maximum((a - 2.0 * b + d) / det, 1e-12), 1.0),
            seeing,
            levels.sum(axis=1),
            (1.0, 1.0),
            -2,
            middle,
            ambient_spread_dn,
        ),
    ]


def _tie_end(
    normal: Array,
    value: Array,
    variance: Array,
    seeing: npt.NDArray[np.bool_],
    taken_at: Array,
    towards: tuple[float, float],
    common: int,
    middle: Array,
    spread_dn: float | None,
) -> tuple[float, Array]:
    """One of the two; 1 / variance of the gradient that the sectors show, and that gradient."""
    if not seeing.any():
        return 0.0, np.zeros(2)
    centre = np.full(len(value), np.median(value[seeing]))
    if spread_dn is None:
        weight, firmness, common_part = _firmness(value - centre, variance, seeing, middle)
        centre += common_part[0] + middle @ common_part[1:]
        gradient = common_part[1:]
    else:
        weight = seeing / (spread_dn**2 * (1.0 + ((value - centre) / (RULES.doubted * spread_dn)) ** 2))
        firmness, gradient = RULES.firmest, np.zeros(2)
    row = np.zeros(normal.shape[:2])
    row[:, :2], row[:, common], row[:, -1] = towards, -1.0, centre - taken_at
    normal += weight[:, None, None] * row[:, :, None] * row[:, None, :]
    return firmness, gradient


def _firmness(deviation: Array, variance: Array, seeing: npt.NDArray[np.bool_], middle: Array) -> tuple[Array, float, Array]:
    """1 / variance of the levels about their common gradient, (S,), and of that gradient; mean and gradient."""
    own = float(np.median(variance[seeing]))
    size = np.abs(deviation)
    wide = RULES.stands_out * (1.4826 * float(np.median(size[seeing])) + np.sqrt(variance))
    share = (seeing & (size < wide)) / variance
    design = np.column_stack((np.ones(len(middle)), middle))
    covariance = np.linalg.inv((design * share[:, None]).T @ design + 1e-9 * np.eye(3))
    gradient = covariance @ (design.T @ (share * deviation))
    noise = 0.5 * (covariance[1, 1] + covariance[2, 2])
    strength = 0.5 * float(gradient[1] ** 2 + gradient[2] ** 2)
    firmness = 1.0 / (max(strength - RULES.gradient_noise * noise, 0.0) + 1.0 / RULES.firmest)
    rest = np.abs(deviation - design @ gradient)
    found = (1.4826 * float(np.median(rest[seeing]))) ** 2
    spread2 = max(found - own, 0.0) + RULES.least_spread_dn**2
    near = seeing & (rest < RULES.stands_out * np.sqrt(spread2 + variance))
    return np.asarray(near / spread2), firmness, gradient
