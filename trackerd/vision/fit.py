"""Subpixel circle: Gauss-Newton on the raw pixels of a ring, an edge model per sector, one circle and one blur for all.

Sector j: I = B_j + D_j E(t), E = erfc(t / sqrt 2) / 2, t = s / sig + sig / (2 r), s = distance - r. The last term is the
curvature of the edge; without it r is low by sig^2 / (2 r). B_j and D_j are eliminated (Schur), which leaves the offset e_j of
the edge in each sector with its information w_j; Tukey's weights on e_j sqrt(w_j) make the circle robust. Pixels weigh by the
noise of the *model's* level: weights by the observed one would bias r.
"""

from dataclasses import dataclass
from math import erfc, exp, pi, sqrt

import numpy as np

from trackerd.contract.model import Array, Image
from trackerd.vision.annulus import Floats, Gathered, Ring, gather, ring_for
from trackerd.vision.noise import NoiseModel
from trackerd.vision.rays import Circle

STEPS = 10
SETTLED_PX = 0.01  # each step is a tenth of the one before or less: the rest is far below the noise
SIGMA_START_PX = 0.95  # optics and pixel of a sharp picture
SIGMA_RANGE_PX = (0.3, 6.0)
TUKEY = 4.685  # 95 % efficient for normal errors
POOR_CHI2 = 3.0  # a sector that fits worse than this is played down
TABLE_END, TABLE_STEPS = 8.0, 1024  # of the edge profile, in units of the blur; rounding to a step costs 2e-4 of the contrast

_T = np.arange(-TABLE_END, TABLE_END, 1.0 / TABLE_STEPS) + 0.5 / TABLE_STEPS
_EDGE = np.array([0.5 * erfc(t / sqrt(2.0)) for t in _T], np.float32)
_BELL = np.array([exp(-0.5 * t * t) / sqrt(2.0 * pi) for t in _T], np.float32)


@dataclass(frozen=True, slots=True)
class Sectors:
    """What each sector says, (S,)."""

    contrast_dn: Array  # D_j
    level_dn: Array  # of the middle of the edge
    offset_px: Array  # e_j, from the circle
    information: Array  # 1 / variance of e_j, px^-2
    chi2: Array  # per degree of freedom


@dataclass(frozen=True, slots=True)
class CircleFit:
    x_px: float
    y_px: float
    r_px: float
    sigma_px: float  # blur of the edge
    cov_px2: Array  # (3, 3) of x, y, r
    sectors: Sectors
    weight: Array  # (S,) Tukey's, of the last step
    clipped: float
    settled: bool


@dataclass(slots=True)
class _Shape:
    """The shared unknowns; x and y from the ring's whole-numbered centre."""

    x: float
    y: float
    r: float
    sigma: float


def fit_circle(image: Image, start: Circle, noise: NoiseModel) -> CircleFit | None:
    """Fit from a start that is good to about 1.5 px. None: it ran away, or the image does not determine a circle."""
    fit = _fit(image, start, SIGMA_START_PX, noise, SIGMA_START_PX)
    if fit is not None and fit.sigma_px > 1.2:  # the ring for a sharp edge is too narrow for this one
        fit = _fit(image, (fit.x_px, fit.y_px, fit.r_px), fit.sigma_px, noise, min(fit.sigma_px * 1.3, SIGMA_RANGE_PX[1]))
    return fit


def _fit(image: Image, start: Circle, sigma_px: float, noise: NoiseModel, widest_px: float) -> CircleFit | None:
    pixels = ring_for(start[2], widest_px)
    column, row = round(start[0]), round(start[1])
    seen = gather(image, pixels, column, row)
    saturated_dn = noise.saturation_of(int(np.iinfo(image.dtype).max))
    clipped = _clipped_share(seen, saturated_dn)
    shape = _Shape(start[0] - column, start[1] - row, start[2], sigma_px)
    levels: Floats | None = None
    settled = False
    for _ in range(STEPS):
        normal, levels = _normal_matrices(pixels, seen, shape, levels, noise, saturated_dn if clipped > 0.0 else None)
        reduced, levels = _eliminate_levels(normal, levels)
        sectors = _sectors(reduced, levels, seen)
        step, hessian, weight, scale = _robust_step(reduced, sectors, pixels.design)
        if step is None:
            return None
        _move(shape, step)
        if abs(shape.x) + abs(shape.y) > 6.0 or abs(shape.r - start[2]) > 5.0:
            return None
        settled = float(np.abs(step[:3]).max()) < SETTLED_PX
        if settled:
            break
    cov = np.asarray(np.linalg.inv(hessian)[:3, :3] * scale**2, np.float64)
    return CircleFit(column + shape.x, row + shape.y, shape.r, shape.sigma, cov, sectors, weight, clipped, settled)


def _clipped_share(seen: Gathered, saturated_dn: float) -> float:
    clipped = (seen.level >= saturated_dn) * seen.weight
    return float(clipped.sum() / max(float(seen.weight.sum()), 1.0))


def _normal_matrices(
    pixels: Ring, seen: Gathered, shape: _Shape, levels: Floats | None, noise: NoiseModel, saturated_dn: float | None
) -> tuple[Array, Floats]:
    """Normal matrices (S, 5, 5) over the columns (B, D, e, sig, residual), and the levels (S, 2) they are taken at."""
    dx, dy = pixels.dx - np.float32(shape.x), pixels.dy - np.float32(shape.y)
    s = np.sqrt(dx * dx + dy * dy) - np.float32(shape.r)
    t = s * np.float32(1.0 / shape.sigma) + np.float32(shape.sigma / (2.0 * shape.r))
    index = ((t + np.float32(TABLE_END)) * np.float32(TABLE_STEPS)).astype(np.intp)
    edge, bell = _EDGE.take(index, mode="clip"), _BELL.take(index, mode="clip")
    if levels is None:
        levels = _plain_levels(seen, edge)
    base, contrast = levels[:, 0, None], levels[:, 1, None]
    model = base + contrast * edge
    weight = seen.weight / (np.maximum(model, 0.0) * np.float32(1.0 / noise.gain_e_per_dn) + np.float32(noise.floor_dn2))
    if saturated_dn is not None:  # by observation alone would select the brighter half of the noise
        weight = weight * ~((seen.level >= saturated_dn) & (model >= saturated_dn))
    columns = np.empty((len(levels), 5, s.shape[1]), np.float32)
    columns[:, 0] = 1.0
    columns[:, 1] = edge
    columns[:, 2] = contrast * bell * np.float32(1.0 / shape.sigma)
    columns[:, 3] = columns[:, 2] * (s * np.float32(1.0 / shape.sigma) - np.float32(shape.sigma / (2.0 * shape.r)))
    columns[:, 4] = seen.level - model
    normal = (columns * weight[:, None, :]) @ columns.transpose(0, 2, 1)
    return normal.astype(np.float64), levels


def _plain_levels(seen: Gathered, edge: Floats) -> Floats:
    """B and D of each sector, (S, 2), by least squares with equal weights."""
    w, we = seen.weight, seen.weight * edge
    n, e, ee = w.sum(1), we.sum(1), (we * edge).sum(1)
    y, ye = (w * seen.level).sum(1), (we * seen.level).sum(1)
    det = n * ee - e * e
    contrast = np.where(det > np.float32(1e-4) * n * ee, (n * ye - e * y) / np.maximum(det, np.float32(1e-3)), np.float32(0.0))
    return np.column_stack(((y - contrast * e) / np.maximum(n, np.float32(1.0)), contrast)).astype(np.float32)


def _eliminate_levels(normal: Array, levels: Floats) -> tuple[Array, Floats]:
    """Schur complement (S, 3, 3) over (e, sig, residual), and the levels at the best fit with the circle as it is."""
    a, b, d = normal[:, 0, 0], normal[:, 0, 1], normal[:, 1, 1]
    det = a * d - b * b
    blind = det <= 1e-4 * a * d  # cut off by the image's border: it does not see both levels
    det = np.where(blind, 1.0, det)
    c = np.where(blind[:, None, None], 0.0, normal[:, :2, 2:])
    solved = np.empty_like(c)
    solved[:, 0] = (d[:, None] * c[:, 0] - b[:, None] * c[:, 1]) / det[:, None]
    solved[:, 1] = (a[:, None] * c[:, 1] - b[:, None] * c[:, 0]) / det[:, None]
    reduced = np.where(blind[:, None, None], 0.0, normal[:, 2:, 2:] - c.transpose(0, 2, 1) @ solved)
    return reduced, levels + solved[:, :, 2].astype(np.float32)


def _sectors(reduced: Array, levels: Floats, seen: Gathered) -> Sectors:
    information = np.maximum(reduced[:, 0, 0], 1e-9)
    offset = np.minimum(np.maximum(reduced[:, 0, 2] / information, -2.0), 2.0)
    freedom = np.maximum(seen.weight.sum(axis=1) - 3.0, 1.0)
    chi2 = np.maximum(reduced[:, 2, 2] - reduced[:, 0, 2] ** 2 / information, 0.0) / freedom
    contrast = levels[:, 1].astype(np.float64)
    return Sectors(contrast, levels[:, 0] + 0.5 * contrast, offset, information, chi2)


def _robust_step(reduced: Array, sectors: Sectors, design: Array) -> tuple[Array | None, Array, Array, float]:
    """Step of (x, y, r, sig), its normal matrix, the sectors' weights, and the scale of their errors (>= 1).

    `design` (S, 3): d offset / d (x, y, r)."""
    normalised = sectors.offset_px * np.sqrt(sectors.information)
    telling = sectors.information > 1.0  # knows its edge to 1 px
    if int(telling.sum()) < len(telling) // 3:
        return None, np.eye(4), np.zeros(len(telling)), 1.0
    deviations = np.sort(np.abs(normalised[telling]))
    scale = max(1.0, 1.4826 * float(deviations[len(deviations) // 2]))
    weight = np.maximum(1.0 - (normalised * (1.0 / (TUKEY * scale))) ** 2, 0.0) ** 2
    weight *= np.minimum(1.0, POOR_CHI2 / np.maximum(sectors.chi2, 1e-6)) ** 2 * telling
    hessian, right = np.empty((4, 4)), np.empty(4)
    weighted = design * weight[:, None]
    hessian[:3, :3] = (weighted * sectors.information[:, None]).T @ design
    hessian[:3, 3] = hessian[3, :3] = weighted.T @ reduced[:, 0, 1]
    hessian[3, 3] = weight @ reduced[:, 1, 1]
    hessian.flat[::5] += 1e-6
    right[:3] = weighted.T @ (sectors.information * sectors.offset_px)
    right[3] = weight @ reduced[:, 1, 2]
    return np.asarray(np.linalg.solve(hessian, right), np.float64), hessian, weight, scale


def _move(shape: _Shape, step: Array) -> None:
    """Take a step, kept short: the model is linear over about one blur."""
    dx, dy, dr = (float(v) for v in np.clip(step[:3], -1.5, 1.5))
    shape.x, shape.y, shape.r = shape.x + dx, shape.y + dy, shape.r + dr
    grown = shape.sigma + float(np.clip(step[3], -0.3 * shape.sigma, 0.3 * shape.sigma))
    shape.sigma = min(max(grown, SIGMA_RANGE_PX[0]), SIGMA_RANGE_PX[1])
