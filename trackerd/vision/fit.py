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
FARTHEST_PX = 6.0  # from the start, in x, y and r together
SETTLED_PX = 0.01  # each step is a tenth of the one before or less: the rest is far below the noise
SIGMA_START_PX = 0.95  # optics and pixel of a sharp picture
SIGMA_RANGE_PX = (0.3, 6.0)
BLURRED_PX, BLURRED_CHI2 = 1.2, 1.6  # a wider edge, or half of the sectors worse than this: out of focus or in motion
BLUR_SETTLED = 0.05  # of its variance, where it depends on the direction
WIDER_PX, WIDER_RINGS = 2.0, 3  # the first wider ring is good up to this blur
SMEARED_PX, SMEARED_CHI2 = 3.4, 6.0  # and this one's for an image that is far from a sharp edge
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
    sigma_px: float  # blur of the edge, where it is widest
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
    blur_px2: Array  # variance of the blur: (1,) alike all round, or (3,) with its cos and sin of twice the angle (motion)

    def sigma_px(self, pixels: Ring) -> Array:
        """Blur of each sector, (S,)."""
        variance = pixels.blur_design[:, : len(self.blur_px2)] @ self.blur_px2
        return np.sqrt(np.minimum(np.maximum(variance, SIGMA_RANGE_PX[0] ** 2), SIGMA_RANGE_PX[1] ** 2))


def fit_circle(image: Image, start: Circle, noise: NoiseModel) -> CircleFit | None:
    """Fit from a start that is good to about 1.5 px. None: it ran away, or the image does not determine a circle.

    First for a sharp edge, in a narrow ring (clutter is near); where that is not what the image shows, in wider rings, with a
    blur that may depend on the direction.
    """
    fit = _fit(image, start, np.array((SIGMA_START_PX**2,)), noise, SIGMA_START_PX)
    if fit is None:
        return None
    widest_px = WIDER_PX if float(np.median(fit.sectors.chi2)) < SMEARED_CHI2 else SMEARED_PX
    for _ in range(WIDER_RINGS):
        if not (fit.sigma_px > 0.9 * widest_px or _is_blurred(fit)):
            break
        wide = _fit(image, (fit.x_px, fit.y_px, fit.r_px), np.array((fit.sigma_px**2, 0.0, 0.0)), noise, widest_px)
        if wide is None or wide.sigma_px <= 0.9 * widest_px:
            return wide
        fit, widest_px = wide, min(1.25 * wide.sigma_px, SIGMA_RANGE_PX[1])
    return fit


def _blur_settled(shape: _Shape, delta: Array) -> bool:
    return len(delta) == 1 or float(np.abs(delta).max()) < BLUR_SETTLED * float(shape.blur_px2[0])


def _is_blurred(fit: CircleFit) -> bool:
    return fit.sigma_px > BLURRED_PX or float(np.median(fit.sectors.chi2)) > BLURRED_CHI2


def _fit(image: Image, start: Circle, blur_px2: Array, noise: NoiseModel, widest_px: float) -> CircleFit | None:
    pixels = ring_for(start[2], widest_px)
    column, row = round(start[0]), round(start[1])
    seen = gather(image, pixels, column, row)
    saturated_dn = noise.saturation_of(int(np.iinfo(image.dtype).max))
    clipped = _clipped_share(seen, saturated_dn)
    shape = _Shape(start[0] - column, start[1] - row, start[2], blur_px2)
    end = _converge(pixels, seen, shape, noise, saturated_dn if clipped > 0.0 else None)
    if end is None:
        return None
    step, sectors, settled = end
    x_px, y_px, sigma_px = column + shape.x, row + shape.y, float(shape.sigma_px(pixels).max())
    return CircleFit(x_px, y_px, shape.r, sigma_px, step.covariance(), sectors, step.weight, clipped, settled)


def _converge(
    pixels: Ring, seen: Gathered, shape: _Shape, noise: NoiseModel, saturated_dn: float | None
) -> "tuple[_Step, Sectors, bool] | None":
    """Moves the shape to the best fit; last step, sectors, and whether it settled. None: no circle is determined near by."""
    levels: Floats | None = None
    x, y, r = shape.x, shape.y, shape.r
    for n in range(STEPS):
        normal, levels = _normal_matrices(pixels, seen, shape, levels, noise, saturated_dn)
        reduced, levels = _eliminate_levels(normal, levels)
        sectors = _sectors(reduced, levels, seen)
        step = _robust_step(reduced, sectors, pixels, shape)
        if step is None:
            return None
        _move(shape, step.delta)
        if abs(shape.x - x) + abs(shape.y - y) + abs(shape.r - r) > FARTHEST_PX:
            return None
        settled = float(np.abs(step.delta[:3]).max()) < SETTLED_PX and _blur_settled(shape, step.delta[3:])
        if settled or n == STEPS - 1:
            return step, sectors, settled
    return None


def _clipped_share(seen: Gathered, saturated_dn: float) -> float:
    clipped = (seen.level >= saturated_dn) * seen.weight
    return float(clipped.sum() / max(float(seen.weight.sum()), 1.0))


def _normal_matrices(
    pixels: Ring, seen: Gathered, shape: _Shape, levels: Floats | None, noise: NoiseModel, saturated_dn: float | None
) -> tuple[Array, Floats]:
    """Normal matrices (S, 5, 5) over the columns (B, D, e, sig, residual), and the levels (S, 2) they are taken at."""
    dx, dy = pixels.dx - np.float32(shape.x), pixels.dy - np.float32(shape.y)
    s = np.sqrt(dx * dx + dy * dy) - np.float32(shape.r)
    sigma = shape.sigma_px(pixels).astype(np.float32)[:, None]
    scaled, bend = s / sigma, sigma / np.float32(2.0 * shape.r)
    index = ((scaled + (bend + np.float32(TABLE_END))) * np.float32(TABLE_STEPS)).astype(np.intp)
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
    columns[:, 2] = (contrast / sigma) * bell
    columns[:, 3] = columns[:, 2] * (scaled - bend)
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


@dataclass(frozen=True, slots=True)
class _Step:
    delta: Array  # of x, y, r and the blur's variance
    hessian: Array  # its normal matrix
    weight: Array  # (S,)
    scale: float  # of the sectors' errors, at least 1

    def covariance(self) -> Array:
        return np.asarray(np.linalg.inv(self.hessian)[:3, :3] * self.scale**2, np.float64)


def _robust_step(reduced: Array, sectors: Sectors, pixels: Ring, shape: _Shape) -> _Step | None:
    """None: too few sectors know where their edge is."""
    normalised = sectors.offset_px * np.sqrt(sectors.information)
    telling = sectors.information > 1.0  # knows its edge to 1 px
    if int(telling.sum()) < len(telling) // 3:
        return None
    deviations = np.sort(np.abs(normalised[telling]))
    scale = max(1.0, 1.4826 * float(deviations[len(deviations) // 2]))
    weight = np.maximum(1.0 - (normalised * (1.0 / (TUKEY * scale))) ** 2, 0.0) ** 2
    ordered = np.sort(sectors.chi2[telling])
    poor = POOR_CHI2 * max(1.0, float(ordered[3 * len(ordered) // 4]) if len(shape.blur_px2) > 1 else 1.0)
    weight *= np.minimum(1.0, poor / np.maximum(sectors.chi2, 1e-6)) ** 2 * telling
    blurs = len(shape.blur_px2)
    blur_design = pixels.blur_design[:, :blurs] * (0.5 / shape.sigma_px(pixels))[:, None]  # d sig / d unknown
    weighted, weighted_blur = pixels.design * weight[:, None], blur_design * weight[:, None]
    hessian, right = np.empty((3 + blurs, 3 + blurs)), np.empty(3 + blurs)
    hessian[:3, :3] = (weighted * sectors.information[:, None]).T @ pixels.design
    hessian[:3, 3:] = (weighted * reduced[:, 0, 1, None]).T @ blur_design
    hessian[3:, :3] = hessian[:3, 3:].T
    hessian[3:, 3:] = (weighted_blur * reduced[:, 1, 1, None]).T @ blur_design
    hessian.flat[:: 4 + blurs] += 1e-6
    right[:3] = weighted.T @ (sectors.information * sectors.offset_px)
    right[3:] = weighted_blur.T @ reduced[:, 1, 2]
    return _Step(np.asarray(np.linalg.solve(hessian, right), np.float64), hessian, weight, scale)


def _move(shape: _Shape, delta: Array) -> None:
    """Take a step, kept short: the model is linear over about one blur."""
    dx, dy, dr = (float(v) for v in np.minimum(np.maximum(delta[:3], -1.5), 1.5))
    shape.x, shape.y, shape.r = shape.x + dx, shape.y + dy, shape.r + dr
    most = 0.6 * float(shape.blur_px2[0])
    blur = shape.blur_px2 + np.minimum(np.maximum(delta[3:], -most), most)
    blur[0] = min(max(blur[0], SIGMA_RANGE_PX[0] ** 2), SIGMA_RANGE_PX[1] ** 2)
    shape.blur_px2 = blur
