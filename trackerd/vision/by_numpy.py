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
from trackerd.vision.convergence import (
    DAWN,
    DAWN_END,
    DAWN_STEPS,
    PROFILE,
    RULES,
    TABLE_END,
    TABLE_STEPS,
    CircleFit,
    Sectors,
    Start,
)
from trackerd.vision.curve import Curve
from trackerd.vision.noise import NoiseModel

_EDGE, _BELL = (np.ascontiguousarray(column) for column in PROFILE.T)
_EDGE_RISE, _BELL_RISE = np.diff(_EDGE), np.diff(_BELL)


Ties = list[tuple[float, Array]]


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
        ties = [] if n == 0 else _tie(normal, levels, seen.pixels.middle, _ambient_spread_dn(shape))
        shape.ground_dn = ties[0][1] if ties else shape.ground_dn
        reduced, levels, coupling = _eliminate_levels(normal, levels, seen.saturated_dn)
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


def _tie(normal: Array, levels: Array, middle: Array, ambient_spread_dn: float | None) -> Ties:
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


def _profile_at(t: Array) -> tuple[Array, Array]:
    """E(t) and its bell."""
    place = np.minimum(np.maximum((t + TABLE_END) * TABLE_STEPS, 0.0), 2.0 * TABLE_END * TABLE_STEPS)
    index = place.astype(np.intp)
    share = place - index
    return _EDGE.take(index) + share * _EDGE_RISE.take(index), _BELL.take(index) + share * _BELL_RISE.take(index)


def _normal_matrices(seen: _Seen, shape: _Shape, levels: Array | None) -> tuple[Array, Array]:
    """Normal matrices (S, c, c) over the columns (B, D, e, sig, the limb's two if it is free, residual), and the levels (S, 2)
    they are taken at."""
    sigma = shape.sigma_px(seen.pixels)[:, None]
    distance = _distance(seen.pixels, seen.curve, shape)
    scaled, bend = distance / sigma, sigma / (2.0 * shape.r)
    edge, bell = _profile_at(scaled + bend)
    limb = len(shape.limb_dn) > 0
    columns = np.empty((len(edge), 7 if limb else 5, edge.shape[1]))
    light = _limb(columns, distance, scaled + bend, sigma, seen, shape) if limb else None
    slope = (seen.pixels.middle @ shape.ground_dn)[:, None] / shape.r
    ground = slope * (distance * (1.0 - edge) + sigma * bell)  # outside, the ground goes on as it does round the ball
    if levels is None:
        levels = _plain_levels(seen.level if light is None else seen.level - light.level, seen.weight, edge)
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


@dataclass(frozen=True, slots=True)
class _Light:
    """The limb term, (S, n)."""

    level: Array
    rim: Array  # the part of it that goes with the root of the blur
    slope: Array  # its change with the edge's offset


def _limb(columns: Array, distance: Array, t: Array, sigma: Array, seen: _Seen, shape: _Shape) -> _Light:
    """The lamp's light; in columns 4 and 5 its derivatives by the lamp's strength along the sector and towards the camera."""
    along, towards = shape.limb_at(seen.pixels)
    lit = (along >= 0.0) | (towards <= 0.0)
    dawn = np.where(
        lit, 0.0, np.sqrt(np.maximum(1.0 - towards / np.maximum(np.hypot(along, towards), 1e-9), 0.0) * shape.r / sigma)
    )
    root, rise = _dawn_at(t, dawn)
    scale = np.sqrt(2.0 * sigma / shape.r) * np.sqrt(1.0 - np.minimum(np.maximum(-distance / (2.0 * shape.r), 0.0), 0.5))
    deeper = t + dawn * dawn
    share, bell = _profile_at(deeper)
    fade = (sigma / shape.r) * (bell - deeper * share)
    rim = towards * scale * root
    columns[:, 4] = share - fade
    columns[:, 5] = scale * root
    columns[:, 5] -= np.where(lit, 0.0, along / np.where(lit, 1.0, towards)) * share
    return _Light(
        rim + along * (lit * share - fade),
        rim,
        np.asarray((along * (lit * bell) - towards * scale * rise) / sigma - (along / shape.r) * share),
    )


def _dawn_at(t: Array, u: Array) -> tuple[Array, Array]:
    """T(t, u) and its slope by t, t (S, n) and u (S, 1); deeper than the table without the blur."""
    last_row, last_column = len(DAWN) - 2, DAWN.shape[1] - 2
    row = np.minimum(u * DAWN_STEPS, last_row)
    k = row.astype(np.intp)
    rows = DAWN[k[:, 0]] + (row - k)[:, :, None] * (DAWN[k[:, 0] + 1] - DAWN[k[:, 0]])  # (S, n, 2): each sector's own
    place = np.minimum(np.maximum((t + TABLE_END) * DAWN_STEPS, 0.0), last_column)
    i = place.astype(np.intp)
    share = (place - i)[:, :, None]
    sector = np.arange(len(t))[:, None]
    found = rows[sector, i] * (1.0 - share) + rows[sector, i + 1] * share
    depth = np.maximum(-t, 1.0)
    second = 0.125 / (depth * depth)
    deep = (t < -TABLE_END) | (u > DAWN_END)
    root = np.sqrt(depth)
    beyond = root * (1.0 - second) - u
    seen = beyond > 0.0
    rise = -0.5 / root * (1.0 + 3.0 * second)
    return (
        np.where(deep, np.where(seen, beyond, 0.0), found[:, :, 0]),
        np.where(deep, np.where(seen, rise, 0.0), found[:, :, 1]),
    )


def _censor(residual: Array, model: Array, variance: Array, seen: _Seen) -> Array:
    """The weights (S, n) of pixels some of which are saturated, and in `residual` what to compare those with.

    A saturated pixel says only that its level is beyond: the score of its likelihood is the hazard of the normal distribution
    (Tobin 1958). Dropping such pixels would select the darker noise of the others.
    """
    weight = seen.weight / variance
    clipped = seen.level >= seen.saturated_dn
    sd = np.sqrt(variance[clipped])
    below = np.minimum((seen.saturated_dn - 0.5 - model[clipped]) / sd, RULES.farthest_below)
    beyond, bell = _profile_at(below)
    hazard = bell / np.maximum(beyond, 1e-30)
    excess = np.maximum(hazard - below, 1e-3)
    residual[clipped] = sd / excess
    weight[clipped] *= hazard * excess
    return np.asarray(weight)


def _plain_levels(level: Array, weight: Array, edge: Array) -> Array:
    """B and D of each sector, (S, 2), by least squares with equal weights."""
    w, we = weight, weight * edge
    n, e, ee = w.sum(1), we.sum(1), (we * edge).sum(1)
    y, ye = (w * level).sum(1), (we * level).sum(1)
    det = n * ee - e * e
    contrast = np.where(det > RULES.blind * n * ee, (n * ye - e * y) / np.maximum(det, 1e-3), 0.0)
    return np.column_stack(((y - contrast * e) / np.maximum(n, 1.0), contrast))


def _eliminate_levels(normal: Array, levels: Array, saturated_dn: float) -> tuple[Array, Array, Array]:
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
