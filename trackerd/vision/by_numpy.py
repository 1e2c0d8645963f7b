"""The circle fit's iteration in NumPy: the reference, and the kernel where numba is not installed.

Sector j: I = B_j + D_j E(t), E = erfc(t / sqrt 2) / 2, t = s / sig + sig / (2 r), s = distance - r. The last term is the
curvature of the edge; without it r is low by sig^2 / (2 r). B_j and D_j are eliminated (Schur), which leaves the offset e_j of
the edge in each sector with its information w_j; Tukey's weights on e_j sqrt(w_j) make the circle robust. Pixels weigh by the
noise of the *model's* level: weights by the observed one would bias r.
"""

from dataclasses import dataclass

import numpy as np

from trackerd.contract.model import Array, Image
from trackerd.vision.annulus import Gathered, Ring, gather
from trackerd.vision.convergence import PROFILE, RULES, TABLE_END, TABLE_STEPS, Blur, CircleFit, Sectors
from trackerd.vision.noise import NoiseModel
from trackerd.vision.rays import Circle

_EDGE, _BELL = (np.ascontiguousarray(column) for column in PROFILE.T)
_EDGE_RISE, _BELL_RISE = np.diff(_EDGE), np.diff(_BELL)


@dataclass(slots=True)
class _Shape:
    """The shared unknowns; x and y from the ring's whole-numbered centre."""

    x: float
    y: float
    r: float
    blur_px2: Array  # as Blur

    def sigma_px(self, pixels: Ring) -> Array:
        """Blur of each sector, (S,)."""
        variance = pixels.blur_design[:, : len(self.blur_px2)] @ self.blur_px2
        return np.asarray(np.sqrt(np.minimum(np.maximum(variance, RULES.least_px2), RULES.most_px2)))


@dataclass(frozen=True, slots=True)
class _Step:
    delta: Array  # of x, y, r and the blur's variance
    hessian: Array  # its normal matrix
    weight: Array  # (S,)
    scale: float  # of the sectors' errors, at least 1

    def covariance(self) -> Array:
        return np.asarray(np.linalg.inv(self.hessian)[:3, :3] * self.scale**2, np.float64)


def converge(image: Image, pixels: Ring, start: Circle, blur_px2: Blur, noise: NoiseModel) -> CircleFit | None:
    """The best fit near a start. None: it ran away, or the image does not determine a circle."""
    column, row = round(start[0]), round(start[1])
    seen = gather(image, pixels, column, row)
    saturated_dn = noise.saturation_of(int(np.iinfo(image.dtype).max))
    shape = _Shape(start[0] - column, start[1] - row, start[2], np.array(blur_px2))
    end = _iterate(pixels, seen, shape, noise, saturated_dn)
    if end is None:
        return None
    step, sectors, settled = end
    return CircleFit(
        column + shape.x,
        row + shape.y,
        shape.r,
        float(shape.sigma_px(pixels).max()),
        step.covariance(),
        sectors,
        step.weight,
        float(np.median(sectors.chi2)),
        _clipped_share(seen, saturated_dn),
        settled,
    )


def _iterate(
    pixels: Ring, seen: Gathered, shape: _Shape, noise: NoiseModel, saturated_dn: float
) -> tuple[_Step, Sectors, bool] | None:
    """Moves the shape to the best fit; last step, sectors, and whether it settled. None: no circle is determined near by."""
    levels: Array | None = None
    x, y, r = shape.x, shape.y, shape.r
    steps = int(RULES.steps)
    for n in range(steps):
        normal, levels = _normal_matrices(pixels, seen, shape, levels, noise, saturated_dn)
        reduced, levels = _eliminate_levels(normal, levels)
        sectors = _sectors(reduced, levels, seen)
        step = _robust_step(reduced, sectors, pixels, shape)
        if step is None:
            return None
        _move(shape, step.delta)
        if not abs(shape.x - x) + abs(shape.y - y) + abs(shape.r - r) <= RULES.farthest_px:  # a NaN is no place either
            return None
        settled = float(np.abs(step.delta[:3]).max()) < RULES.settled_px and _blur_settled(shape, step.delta[3:])
        if settled or n == steps - 1:
            return step, sectors, settled
    return None


def _blur_settled(shape: _Shape, delta: Array) -> bool:
    return len(delta) == 1 or float(np.abs(delta).max()) < RULES.blur_settled * float(shape.blur_px2[0])


def _clipped_share(seen: Gathered, saturated_dn: float) -> float:
    clipped = (seen.level >= saturated_dn) * seen.weight
    return float(clipped.sum() / max(float(seen.weight.sum()), 1.0))


def _profile_at(t: Array) -> tuple[Array, Array]:
    """E(t) and its bell."""
    place = np.minimum(np.maximum((t + TABLE_END) * TABLE_STEPS, 0.0), 2.0 * TABLE_END * TABLE_STEPS)
    index = place.astype(np.intp)
    share = place - index
    return _EDGE.take(index) + share * _EDGE_RISE.take(index), _BELL.take(index) + share * _BELL_RISE.take(index)


def _normal_matrices(
    pixels: Ring, seen: Gathered, shape: _Shape, levels: Array | None, noise: NoiseModel, saturated_dn: float
) -> tuple[Array, Array]:
    """Normal matrices (S, 5, 5) over the columns (B, D, e, sig, residual), and the levels (S, 2) they are taken at."""
    dx, dy = pixels.dx - shape.x, pixels.dy - shape.y
    sigma = shape.sigma_px(pixels)[:, None]
    scaled, bend = (np.sqrt(dx * dx + dy * dy) - shape.r) / sigma, sigma / (2.0 * shape.r)
    edge, bell = _profile_at(scaled + bend)
    if levels is None:
        levels = _plain_levels(seen, edge)
    base, contrast = levels[:, 0, None], levels[:, 1, None]
    model = base + contrast * edge
    weight = seen.weight / (np.maximum(model, 0.0) / noise.gain_e_per_dn + noise.floor_dn2)
    saturated = (seen.level >= saturated_dn) & (model >= saturated_dn)  # by observation alone selects the brighter noise
    weight[saturated] = 0.0
    columns = np.empty((len(levels), 5, edge.shape[1]))
    columns[:, 0] = 1.0
    columns[:, 1] = edge
    columns[:, 2] = (contrast / sigma) * bell
    columns[:, 3] = columns[:, 2] * (scaled - bend)
    columns[:, 4] = seen.level - model
    return np.asarray((columns * weight[:, None, :]) @ columns.transpose(0, 2, 1)), levels


def _plain_levels(seen: Gathered, edge: Array) -> Array:
    """B and D of each sector, (S, 2), by least squares with equal weights."""
    w, we = seen.weight, seen.weight * edge
    n, e, ee = w.sum(1), we.sum(1), (we * edge).sum(1)
    y, ye = (w * seen.level).sum(1), (we * seen.level).sum(1)
    det = n * ee - e * e
    contrast = np.where(det > RULES.blind * n * ee, (n * ye - e * y) / np.maximum(det, 1e-3), 0.0)
    return np.column_stack(((y - contrast * e) / np.maximum(n, 1.0), contrast))


def _eliminate_levels(normal: Array, levels: Array) -> tuple[Array, Array]:
    """Schur complement (S, 3, 3) over (e, sig, residual), and the levels at the best fit with the circle as it is."""
    a, b, d = normal[:, 0, 0], normal[:, 0, 1], normal[:, 1, 1]
    det = a * d - b * b
    blind = det <= RULES.blind * a * d
    det = np.where(blind, 1.0, det)
    c = np.where(blind[:, None, None], 0.0, normal[:, :2, 2:])
    solved = np.empty_like(c)
    solved[:, 0] = (d[:, None] * c[:, 0] - b[:, None] * c[:, 1]) / det[:, None]
    solved[:, 1] = (a[:, None] * c[:, 1] - b[:, None] * c[:, 0]) / det[:, None]
    reduced = np.where(blind[:, None, None], 0.0, normal[:, 2:, 2:] - c.transpose(0, 2, 1) @ solved)
    return reduced, levels + solved[:, :, 2]


def _sectors(reduced: Array, levels: Array, seen: Gathered) -> Sectors:
    information = np.maximum(reduced[:, 0, 0], 1e-9)
    offset = np.minimum(np.maximum(reduced[:, 0, 2] / information, -2.0), 2.0)
    freedom = np.maximum(seen.weight.sum(axis=1) - 3.0, 1.0)
    chi2 = np.maximum(reduced[:, 2, 2] - reduced[:, 0, 2] ** 2 / information, 0.0) / freedom
    contrast = levels[:, 1]
    return Sectors(contrast, levels[:, 0] + 0.5 * contrast, offset, information, chi2)


def _robust_step(reduced: Array, sectors: Sectors, pixels: Ring, shape: _Shape) -> _Step | None:
    """None: too few sectors know where their edge is."""
    normalised = sectors.offset_px * np.sqrt(sectors.information)
    telling = sectors.information > 1.0  # knows its edge to 1 px
    if int(telling.sum()) < len(telling) // 3:
        return None
    deviations = np.sort(np.abs(normalised[telling]))
    scale = max(1.0, 1.4826 * float(deviations[len(deviations) // 2]))
    weight = np.maximum(1.0 - (normalised * (1.0 / (RULES.tukey * scale))) ** 2, 0.0) ** 2
    ordered = np.sort(sectors.chi2[telling])
    poor = RULES.poor_chi2 * max(1.0, float(ordered[3 * len(ordered) // 4]) if len(shape.blur_px2) > 1 else 1.0)
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
    blur[0] = min(max(blur[0], RULES.least_px2), RULES.most_px2)
    shape.blur_px2 = blur
