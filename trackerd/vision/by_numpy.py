"""The circle fit's iteration in NumPy: the reference, and the kernel where numba is not installed.

Sector j: I = B_j + D_j E(t) + f, E = erfc(t / sqrt 2) / 2, t = s / sig + sig / (2 r), s the distance from the outline. The last
term of t is the curvature of the edge; without it r is low by sig^2 / (2 r). f is the limb term, see limb. B_j and D_j are
eliminated (Schur), which leaves the offset e_j of the edge in each sector with its information w_j; Tukey's weights on
e_j sqrt(w_j) make the outline robust. Pixels weigh by the noise of the *model's* level: weights by the observed one would
bias r. A saturated pixel says only that its level is beyond.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from trackerd.contract.model import Array, Image
from trackerd.vision.annulus import Gathered, Ring, gather
from trackerd.vision.convergence import RULES, CircleFit, Sectors, Start
from trackerd.vision.curve import Curve
from trackerd.vision.noise import NoiseModel
from trackerd.vision.numpy_levels import Ties, eliminate_levels, plain_levels, tie
from trackerd.vision.numpy_light import limb_light, profile_at


@dataclass(slots=True)
class _Shape:
    """The shared unknowns; x and y from the ring's whole-numbered centre."""

    x: float
    y: float
    r: float
    blur_px2: Array  # as in Start
    limb_dn: Array
    ground_dn: Array  # (2,): gradient of the level outside, over one radius
    lamp: bool  # whether the limb's unknowns are a lamp's; else the harmonics of its strength

    def limb_at(self, pixels: Ring) -> tuple[Array, Array]:
        """The light's strength along each sector and towards the camera, (S, 1)."""
        if self.lamp:
            return (pixels.middle @ self.limb_dn[:2])[:, None], np.full((len(pixels.middle), 1), self.limb_dn[2])
        return np.zeros((len(pixels.middle), 1)), (self.limb_dn[2] + pixels.middle @ self.limb_dn[:2])[:, None]

    def sigma_px(self, pixels: Ring) -> Array:
        """Blur of each sector, (S,)."""
        variance = pixels.blur_design[:, : len(self.blur_px2)] @ self.blur_px2
        return np.asarray(np.sqrt(np.minimum(np.maximum(variance, RULES.least_px2), RULES.most_px2)))


@dataclass(frozen=True, slots=True)
class _Seen:
    """The pixels, what they are pixels of, and the sensor's rules for them."""

    pixels: Ring
    curve: Curve
    level: Array  # (S, n)
    weight: Array
    noise: NoiseModel
    saturated_dn: float
    clipped: bool  # some pixels are saturated


@dataclass(frozen=True, slots=True)
class _Step:
    delta: Array  # of x, y, r, the blur's variance and the limb term
    covariance: Array
    weight: Array  # (S,)
    towards: Array  # (S, k, m): d (e, sig, G) / d unknowns


def converge(image: Image, pixels: Ring, curve: Curve, start: Start, noise: NoiseModel) -> CircleFit | None:
    """The best fit near a start. None: it ran away, or the image does not determine a circle."""
    column, row = round(start.x_px), round(start.y_px)
    shape = _Shape(
        start.x_px - column,
        start.y_px - row,
        start.r_px,
        np.array(start.blur_px2),
        np.array(start.limb_dn),
        np.zeros(2),
        any(start.limb_dn),
    )
    gathered = gather(image, pixels, column, row)
    weight = gathered.weight if curve.round else gathered.weight * _near(pixels, curve, shape)
    saturated_dn = noise.saturation_of(int(np.iinfo(image.dtype).max))
    clipped = bool(((gathered.level >= saturated_dn) & (weight > 0.0)).any())
    seen = _Seen(pixels, curve, gathered.level, weight, noise, saturated_dn, clipped)
    end = _iterate(seen, shape)
    if end is None:
        return None
    step, sectors, settled = end
    blurs = 3 + len(shape.blur_px2)
    return CircleFit(
        column + shape.x,
        row + shape.y,
        shape.r,
        shape.blur_px2,
        shape.limb_dn,
        float(shape.sigma_px(pixels).max()),
        step.covariance[:3, :3],
        step.covariance[blurs:-6, blurs:-6],
        sectors,
        step.weight,
        float(np.median(sectors.chi2)),
        _clipped_share(gathered, weight, saturated_dn),
        settled,
        curve,
    )


def _iterate(seen: _Seen, shape: _Shape) -> tuple[_Step, Sectors, bool] | None:
    """Moves the shape to the best fit; last step, sectors, and whether it settled. None: no circle is determined near by."""
    levels: Array | None = None
    x, y, r = shape.x, shape.y, shape.r
    steps = int(RULES.steps)
    for n in range(steps):
        normal, levels = _normal_matrices(seen, shape, levels)
        ties = [] if n == 0 else tie(normal, levels, seen.pixels.middle, _ambient_spread_dn(shape))
        shape.ground_dn = ties[0][1] if ties else shape.ground_dn
        reduced, levels, coupling = eliminate_levels(normal, levels, seen.saturated_dn)
        sectors = _sectors(reduced, levels, seen)
        step = _robust_step(reduced, sectors, seen, shape, ties)
        if step is None:
            return None
        if seen.clipped:  # where levels are found beyond saturation they hang on the blur: they take the step with it
            levels = levels - (coupling @ (step.towards @ step.delta)[:, :, None])[:, :, 0]
        _move(shape, step.delta)
        if not abs(shape.x - x) + abs(shape.y - y) + abs(shape.r - r) <= RULES.farthest_px:  # a NaN is no place either
            return None
        settled = (
            n >= RULES.least_steps
            and float(np.abs(step.delta[:3]).max()) < RULES.settled_px * (RULES.lamp_settled if shape.lamp else 1.0)
            and _blur_settled(shape, step.delta)
        )
        if len(shape.limb_dn) > 0 and not shape.lamp:
            if settled or n >= RULES.harmonic_steps:
                shape.limb_dn, shape.lamp = _lamp_of(levels, shape.limb_dn, step.weight, seen.pixels), True
                levels = None
            continue
        if settled or n == steps - 1:
            return step, sectors, settled
    return None


def _lamp_of(levels: Array, harmonics_dn: Array, weight: Array, pixels: Ring) -> Array:
    """The lamp that such levels and such a limb come from: of half a cosine round the rim, the harmonic is half as strong."""
    design = np.column_stack((np.ones(len(weight)), pixels.middle))
    weighted = design * weight[:, None]
    side = 2.0 * np.linalg.solve(weighted.T @ design + 1e-6 * np.eye(3), weighted.T @ levels.sum(axis=1))[1:]
    length = max(float(np.hypot(*side)), 1e-9)
    return np.array((*side, harmonics_dn[2] + 0.8 * float(harmonics_dn[:2] @ side) / length))


def _ambient_spread_dn(shape: _Shape) -> float | None:
    """By how much the light that comes from everywhere may differ round the rim of a ball that a lamp shines on."""
    lamp_dn = float(np.linalg.norm(shape.limb_dn))
    return RULES.ambient_spread_dn + RULES.ambient_spread * lamp_dn if shape.lamp else None


def _blur_settled(shape: _Shape, delta: Array) -> bool:
    blurs = len(shape.blur_px2)
    return blurs == 1 or float(np.abs(delta[3 : 3 + blurs]).max()) < RULES.blur_settled * float(shape.blur_px2[0])


def _near(pixels: Ring, curve: Curve, shape: _Shape) -> Array:
    """1 for the pixels that a ring round a circle would have, 0 for the others."""
    s = _distance(pixels, curve, shape)
    return np.asarray((s >= -pixels.inside_px) & (s <= pixels.outside_px), np.float64)


def _clipped_share(gathered: Gathered, weight: Array, saturated_dn: float) -> float:
    clipped = (gathered.level >= saturated_dn) * weight
    return float(clipped.sum() / max(float(weight.sum()), 1.0))


def _distance(pixels: Ring, curve: Curve, shape: _Shape) -> Array:
    """Of the pixels (S, n) from the outline, along its normal; negative inside."""
    dx, dy = pixels.dx - shape.x, pixels.dy - shape.y
    rho = np.sqrt(dx * dx + dy * dy)
    if curve.round:
        return np.asarray(rho - shape.r)
    angle = (dy * pixels.middle[:, 0, None] - dx * pixels.middle[:, 1, None]) / rho  # from the sector's middle
    bulge, first, second, slant = (curve.bulge[:, n, None] for n in range(4))
    return np.asarray((rho - shape.r - bulge - angle * (first + 0.5 * angle * second)) * slant)


def _normal_matrices(seen: _Seen, shape: _Shape, levels: Array | None) -> tuple[Array, Array]:
    """Normal matrices (S, c, c) over the columns (B, D, e, sig, the limb's two if it is free, residual), and the levels (S, 2)
    they are taken at."""
    sigma = shape.sigma_px(seen.pixels)[:, None]
    distance = _distance(seen.pixels, seen.curve, shape)
    scaled, bend = distance / sigma, sigma / (2.0 * shape.r)
    edge, bell = profile_at(scaled + bend)
    limb = len(shape.limb_dn) > 0
    columns = np.empty((len(edge), 7 if limb else 5, edge.shape[1]))
    light = limb_light(columns, distance, scaled + bend, sigma, shape.limb_at(seen.pixels), shape.r) if limb else None
    slope = (seen.pixels.middle @ shape.ground_dn)[:, None] / shape.r
    ground = slope * (distance * (1.0 - edge) + sigma * bell)  # outside, the ground goes on as it does round the ball
    if levels is None:
        levels = plain_levels(seen.level if light is None else seen.level - light.level, seen.weight, edge)
    base, contrast = levels[:, 0, None], levels[:, 1, None]
    model = base + contrast * edge + ground
    columns[:, 0] = 1.0
    columns[:, 1] = edge
    columns[:, 2] = (contrast / sigma) * bell - slope * (1.0 - edge)
    if light is not None:
        model += light.level
        columns[:, 2] += light.slope
    columns[:, 3] = columns[:, 2] * (scaled - bend)
    if light is not None:
        columns[:, 3] += light.rim * (0.5 / sigma)
    variance = np.maximum(model, 0.0) / seen.noise.gain_e_per_dn + seen.noise.floor_dn2
    columns[:, -1] = seen.level - model
    weight = _censor(columns[:, -1], model, variance, seen) if seen.clipped else seen.weight / variance
    own = (columns * weight[:, None, :]) @ columns.transpose(0, 2, 1)
    last = own.shape[1] - 1
    normal = np.zeros((len(own), last + 3, last + 3))
    normal[:, :last, :last] = own[:, :last, :last]
    normal[:, :last, -1], normal[:, -1, :last] = own[:, :last, -1], own[:, -1, :last]
    normal[:, -1, -1] = own[:, -1, -1]
    return normal, levels


def _censor(residual: Array, model: Array, variance: Array, seen: _Seen) -> Array:
    """The weights (S, n) of pixels some of which are saturated, and in `residual` what to compare those with.

    A saturated pixel says only that its level is beyond: the score of its likelihood is the hazard of the normal distribution
    (Tobin 1958). Dropping such pixels would select the darker noise of the others.
    """
    weight = seen.weight / variance
    clipped = seen.level >= seen.saturated_dn
    sd = np.sqrt(variance[clipped])
    below = np.minimum((seen.saturated_dn - 0.5 - model[clipped]) / sd, RULES.farthest_below)
    beyond, bell = profile_at(below)
    hazard = bell / np.maximum(beyond, 1e-30)
    excess = np.maximum(hazard - below, 1e-3)
    residual[clipped] = sd / excess
    weight[clipped] *= hazard * excess
    return np.asarray(weight)


def _sectors(reduced: Array, levels: Array, seen: _Seen) -> Sectors:
    information = np.maximum(reduced[:, 0, 0], 1e-9)
    offset = np.minimum(np.maximum(reduced[:, 0, -1] / information, -2.0), 2.0)
    chi2 = np.maximum(reduced[:, -1, -1] - reduced[:, 0, -1] ** 2 / information, 0.0) / _freedom(seen)
    contrast = levels[:, 1]
    return Sectors(contrast, levels[:, 0] + 0.5 * contrast, offset, information, chi2)


def _freedom(seen: _Seen) -> Array:
    return np.asarray(np.maximum(seen.weight.sum(axis=1) - 3.0, 1.0))


def _robust_step(reduced: Array, sectors: Sectors, seen: _Seen, shape: _Shape, ties: Ties) -> _Step | None:
    """None: too few sectors know where their edge is."""
    normalised = sectors.offset_px * np.sqrt(sectors.information)
    telling = sectors.information > 1.0  # knows its edge to 1 px
    if int(telling.sum()) < len(telling) // 3:
        return None
    deviations = np.sort(np.abs(normalised[telling]))
    scale = max(1.0, 1.4826 * float(deviations[len(deviations) // 2]))
    ordered = np.sort(sectors.chi2[telling])
    free = len(shape.blur_px2) > 1 or len(shape.limb_dn) > 0
    usual = max(1.0, float(ordered[3 * len(ordered) // 4])) if free else 1.0
    poor = usual * (1.0 + RULES.poor_sigmas * np.sqrt(2.0 / _freedom(seen)))
    weight = np.maximum(1.0 - (normalised * (1.0 / (RULES.tukey * scale))) ** 2, 0.0) ** 2
    own = np.minimum(1.0, poor / np.maximum(sectors.chi2, 1e-6)) ** 2
    fair = np.minimum(own, np.minimum(np.roll(own, 1), np.roll(own, -1)))  # what spoils one spreads into its neighbours
    weight *= fair * telling * _plain_skin(sectors, telling)
    towards = _towards(seen, shape)
    k = towards.shape[1]
    weighted = towards.transpose(0, 2, 1) * weight[:, None, None]
    hessian = (weighted @ reduced[:, :k, :k] @ towards).sum(axis=0)
    hessian.flat[:: len(hessian) + 1] += 1e-6
    residual = reduced[:, :k, -1].copy()
    residual[:, 0] = sectors.information * sectors.offset_px
    right = (weighted @ residual[:, :, None]).sum(axis=0)[:, 0]
    for first, (firmness, gradient) in zip((-5, -2), ties, strict=False):
        for n in range(2):
            hessian[first + n, first + n] += firmness
            right[first + n] -= firmness * gradient[n]
    inverse = np.linalg.inv(hessian)
    return _Step(np.asarray(inverse @ right, np.float64), inverse, weight, towards)


def _plain_skin(sectors: Sectors, telling: npt.NDArray[np.bool_]) -> Array:
    """0 for the sectors in or beside which the ball has another level than elsewhere: a mirrored lamp, something in front."""
    inside = sectors.level_dn + 0.5 * sectors.contrast_dn
    away = np.abs(inside - np.median(inside[telling]))
    spot = telling & (away > RULES.spot * (1.4826 * np.median(away[telling]) + RULES.least_spot_dn))
    near = spot.copy()
    for n in range(1, int(RULES.beside_spot) + 1):
        near |= np.roll(spot, n) | np.roll(spot, -n)
    return np.where(near, 0.0, 1.0)


def _towards(seen: _Seen, shape: _Shape) -> Array:
    blurs, limbs = len(shape.blur_px2), len(shape.limb_dn)
    towards = np.zeros((len(seen.curve.design), 6 if limbs else 4, 9 + blurs + limbs))
    towards[:, 0, :3] = seen.curve.design
    towards[:, 1, 3 : 3 + blurs] = seen.pixels.blur_design[:, :blurs] * (0.5 / shape.sigma_px(seen.pixels))[:, None]
    if limbs:
        towards[:, 2 if shape.lamp else 3, 3 + blurs : 5 + blurs] = seen.pixels.middle
        towards[:, 3, 5 + blurs] = 1.0
    towards[:, -2, -6] = towards[:, -1, -3] = 1.0
    towards[:, -2, -5:-3] = towards[:, -1, -2:] = seen.pixels.middle
    return towards


def _move(shape: _Shape, delta: Array) -> None:
    """Take a step, kept short: the model is linear over about one blur."""
    blurs = len(shape.blur_px2)
    dx, dy, dr = (float(v) for v in np.minimum(np.maximum(delta[:3], -1.5), 1.5))
    shape.x, shape.y, shape.r = shape.x + dx, shape.y + dy, shape.r + dr
    most = 0.6 * float(shape.blur_px2[0])
    blur = shape.blur_px2 + np.minimum(np.maximum(delta[3 : 3 + blurs], -most), most)
    blur[0] = min(max(blur[0], RULES.least_px2), RULES.most_px2)
    shape.blur_px2 = blur
    shape.limb_dn = shape.limb_dn + delta[3 + blurs : -6]
