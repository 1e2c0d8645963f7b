"""The circle fit's iteration for numba: the maths of by_numpy step by step, without the interpreter and without its lock.

numba's cache on disk looks at this file alone: what may change elsewhere (rules, tables) is an argument.

Columns of a sector's normal matrix: B, D, e, sig, (along, towards where the limb is free,) common B, common F, residual.
"""

from collections.abc import Callable
from math import hypot, sqrt
from typing import Any, TypeVar

import numba
import numpy as np

from trackerd.contract.model import Array, Image
from trackerd.vision.convergence import Rules, Sensor

COMMON = 6  # unknowns that the sectors' levels have in common: outside and inside, a mean and a gradient each

_F = TypeVar("_F", bound=Callable[..., Any])
_OPTIONS: dict[str, Any] = {"nogil": True, "fastmath": {"reassoc", "contract", "nsz"}, "error_model": "numpy"}

_part: Callable[[_F], _F] = numba.njit(**_OPTIONS)


def _kept(function: _F) -> _F:
    """Compiled, and kept on disk where there is a folder that can be written."""
    try:
        kept: _F = numba.njit(cache=True, **_OPTIONS)(function)
    except RuntimeError:
        kept = numba.njit(**_OPTIONS)(function)
    return kept


# ---- the model of a pixel ---------------------------------------------------------------------------------------------


@_part
def _sigma(blur: Array, blur_design: Array, s: int, rules: Rules) -> float:
    variance = 0.0
    for i in range(len(blur)):
        variance += blur_design[s, i] * blur[i]
    return sqrt(min(max(variance, rules.least_px2), rules.most_px2))


@_part
def _distance(dx: float, dy: float, r: float, cosine: float, sine: float, bulge: Any, curved: bool) -> float:
    rho = sqrt(dx * dx + dy * dy)
    if not curved:
        return rho - r
    angle = (dy * cosine - dx * sine) / rho
    return float((rho - r - bulge[0] - angle * (bulge[1] + 0.5 * angle * bulge[2])) * bulge[3])


@_part
def _profile_at(t: float, profile: Array, rules: Rules) -> Any:
    place = min(max((t + rules.table_end) * rules.table_steps, 0.0), 2.0 * rules.table_end * rules.table_steps)
    i = int(place)
    share = place - i
    edge = profile[i, 0] + share * (profile[i + 1, 0] - profile[i, 0])
    return edge, profile[i, 1] + share * (profile[i + 1, 1] - profile[i, 1])


@_part
def _dawn_at(t: float, u: float, dawn: Any, rules: Rules) -> Any:
    if t < -rules.table_end or u > rules.dawn_end:
        depth = max(-t, 1.0)
        second, root = 0.125 / (depth * depth), sqrt(depth)
        beyond = root * (1.0 - second) - u
        return (beyond, -0.5 / root * (1.0 + 3.0 * second)) if beyond > 0.0 else (0.0, 0.0)
    row = min(u * rules.dawn_steps, len(dawn) - 2.0)
    place = min(max((t + rules.table_end) * rules.dawn_steps, 0.0), dawn.shape[1] - 2.0)
    k, i = int(row), int(place)
    a, b = row - k, place - i
    left = dawn[k, i, 0] + a * (dawn[k + 1, i, 0] - dawn[k, i, 0])
    right = dawn[k, i + 1, 0] + a * (dawn[k + 1, i + 1, 0] - dawn[k, i + 1, 0])
    left_rise = dawn[k, i, 1] + a * (dawn[k + 1, i, 1] - dawn[k, i, 1])
    right_rise = dawn[k, i + 1, 1] + a * (dawn[k + 1, i + 1, 1] - dawn[k, i + 1, 1])
    return left * (1.0 - b) + right * b, left_rise * (1.0 - b) + right_rise * b


@_part
def _light(
    distance: float, t: float, along: float, towards: float, sigma: float, r: float, profile: Array, dawn: Any, rules: Rules
) -> Any:  # fmt: skip
    """Level, its part that goes with the root of the blur, its slope over e; derivatives by along and towards."""
    lit = along >= 0.0 or towards <= 0.0
    u = 0.0 if lit else sqrt(max(1.0 - towards / max(hypot(along, towards), 1e-9), 0.0) * r / sigma)
    root, rise = _dawn_at(t, u, dawn, rules)
    scale = sqrt(2.0 * sigma / r) * sqrt(1.0 - min(max(-distance / (2.0 * r), 0.0), 0.5))
    deeper = t + u * u
    share, bell = _profile_at(deeper, profile, rules)
    fade = (sigma / r) * (bell - deeper * share)
    rim = towards * scale * root
    if lit:
        slope = (along * bell - towards * scale * rise) / sigma - (along / r) * share
        return rim + along * (share - fade), rim, slope, share - fade, scale * root
    slope = -towards * scale * rise / sigma - (along / r) * share
    return rim - along * fade, rim, slope, share - fade, scale * root - along / towards * share


@_part
def _weigh_pixel(level: float, model: float, profile: Array, sensor: Sensor, rules: Rules) -> Any:
    """Weight, and what it is of: the residual; a saturated pixel only says that its level is beyond."""
    variance = max(model, 0.0) * sensor.dn_per_e + sensor.floor_dn2
    if level < sensor.saturated_dn:
        return 1.0 / variance, level - model
    sd = sqrt(variance)
    below = min((sensor.saturated_dn - sensor.rounded_dn - model) / sd, rules.farthest_below)
    beyond, bell = _profile_at(below, profile, rules)
    hazard = bell / max(beyond, 1e-30)
    excess = max(hazard - below, 1e-3)
    return hazard * excess / variance, sd / excess


# ---- one sector -------------------------------------------------------------------------------------------------------


@_part
def _add_pixels(
    normal: Array, seen: Any, shape: Array, sigma: float, cosine: float, sine: float, bulge: Any, curved: bool, ground: float,
    levels: Array, first: bool, profile: Array, rules: Rules, sensor: Sensor, scratch: Array,
) -> None:  # fmt: skip
    """The sums of one sector without a limb term. `seen` (3, n) is place and grey value."""
    n, inverse, bend, r = seen.shape[1], 1.0 / sigma, sigma / (2.0 * shape[2]), shape[2]
    scaled, edge, bell = scratch[0, :n], scratch[1, :n], scratch[2, :n]
    if curved:
        for k in range(n):
            scaled[k] = _distance(seen[0, k] - shape[0], seen[1, k] - shape[1], r, cosine, sine, bulge, True) * inverse
    else:
        for k in range(n):
            dx, dy = seen[0, k] - shape[0], seen[1, k] - shape[1]
            scaled[k] = (sqrt(dx * dx + dy * dy) - r) * inverse
    for k in range(n):
        edge[k], bell[k] = _profile_at(scaled[k] + bend, profile, rules)
    if first:
        _plain_levels(seen[2], edge, levels, rules)
    base, contrast = levels[0], levels[1]
    slope = contrast * inverse
    a00 = a01 = a02 = a03 = a04 = a11 = a12 = a13 = a14 = a22 = a23 = a24 = a33 = a34 = a44 = 0.0
    for k in range(n):
        e = edge[k]
        outside = ground * sigma * (scaled[k] * (1.0 - e) + bell[k])
        weight, residual = _weigh_pixel(seen[2, k], base + contrast * e + outside, profile, sensor, rules)
        we, wr = weight * e, weight * residual
        a00, a01, a04, a11 = a00 + weight, a01 + we, a04 + wr, a11 + we * e
        a14, a44 = a14 + we * residual, a44 + wr * residual
        if bell[k] < rules.no_slope and e > 0.5:  # deep inside only the levels are seen
            continue
        d = slope * bell[k] - ground * (1.0 - e)
        b = d * (scaled[k] - bend)
        wd, wb = weight * d, weight * b
        a02, a03, a12, a13 = a02 + wd, a03 + wb, a12 + we * d, a13 + we * b
        a22, a23, a24 = a22 + wd * d, a23 + wd * b, a24 + wd * residual
        a33, a34 = a33 + wb * b, a34 + wb * residual
    normal[0, 0], normal[0, 1], normal[0, 2], normal[0, 3], normal[0, 6] = a00, a01, a02, a03, a04
    normal[1, 1], normal[1, 2], normal[1, 3], normal[1, 6] = a11, a12, a13, a14
    normal[2, 2], normal[2, 3], normal[2, 6] = a22, a23, a24
    normal[3, 3], normal[3, 6], normal[6, 6] = a33, a34, a44


@_part
def _add_shaded_pixels(
    normal: Array, seen: Any, shape: Array, sigma: float, cosine: float, sine: float, bulge: Any, curved: bool, ground: float,
    along: float, towards: float, levels: Array, first: bool, profile: Array, dawn: Any, rules: Rules, sensor: Sensor,
) -> None:  # fmt: skip
    """The same with one."""
    n, bend, r = seen.shape[1], sigma / (2.0 * shape[2]), shape[2]
    columns, level, scaled = np.empty((7, n)), np.empty(n), np.empty(n)
    bell, rim = np.empty(n), np.empty(n)
    for k in range(n):
        distance = _distance(seen[0, k] - shape[0], seen[1, k] - shape[1], r, cosine, sine, bulge, curved)
        scaled[k] = distance / sigma
        columns[1, k], bell[k] = _profile_at(scaled[k] + bend, profile, rules)
        level[k], rim[k], columns[2, k], columns[4, k], columns[5, k] = _light(
            distance, scaled[k] + bend, along, towards, sigma, r, profile, dawn, rules
        )
    if first:
        _plain_levels(seen[2] - level, columns[1], levels, rules)
    base, contrast = levels[0], levels[1]
    place = (0, 1, 2, 3, 4, 5, len(normal) - 1)
    for k in range(n):
        e = columns[1, k]
        model = base + contrast * e + level[k] + ground * sigma * (scaled[k] * (1.0 - e) + bell[k])
        weight, columns[6, k] = _weigh_pixel(seen[2, k], model, profile, sensor, rules)
        columns[0, k] = 1.0
        columns[2, k] += contrast / sigma * bell[k] - ground * (1.0 - e)
        columns[3, k] = columns[2, k] * (scaled[k] - bend) + rim[k] * (0.5 / sigma)
        for i in range(7):
            w = weight * columns[i, k]
            for j in range(i, 7):
                normal[place[i], place[j]] += w * columns[j, k]


@_part
def _plain_levels(level: Any, edge: Any, levels: Array, rules: Rules) -> None:
    n, e, ee, y, ye = float(len(edge)), 0.0, 0.0, 0.0, 0.0
    for k in range(len(edge)):
        e, ee, y, ye = e + edge[k], ee + edge[k] * edge[k], y + level[k], ye + edge[k] * level[k]
    det = n * ee - e * e
    levels[1] = (n * ye - e * y) / max(det, 1e-3) if det > rules.blind * n * ee else 0.0
    levels[0] = (y - levels[1] * e) / max(n, 1.0)


@_part
def _eliminate_levels(normal: Array, levels: Array, reduced: Array, coupling: Array, sensor: Sensor, rules: Rules) -> None:
    """Schur complement, the levels at the best fit with the circle as it is, and minus their change with the other columns."""
    damping, last = 1.0 / sensor.saturated_dn**2, len(normal) - 1
    a, b, d = normal[0, 0] + damping, normal[0, 1], normal[1, 1] + damping
    det = a * d - b * b
    if det <= rules.blind * a * d:
        reduced[:] = 0.0
        coupling[:] = 0.0
        return
    for j in range(2, last + 1):
        c0, c1 = normal[0, j], normal[1, j]
        coupling[0, j - 2], coupling[1, j - 2] = (d * c0 - b * c1) / det, (a * c1 - b * c0) / det
    for i in range(2, last + 1):
        for j in range(i, last + 1):
            value = normal[i, j] - normal[0, i] * coupling[0, j - 2] - normal[1, i] * coupling[1, j - 2]
            reduced[i - 2, j - 2], reduced[j - 2, i - 2] = value, value
    levels[0] += coupling[0, last - 2]
    levels[1] += coupling[1, last - 2]


@_part
def _say(said: Array, levels: Array, reduced: Array, pixels: int) -> None:
    last = len(reduced) - 1
    information = max(reduced[0, 0], 1e-9)
    said[0], said[1] = levels[1], levels[0] + 0.5 * levels[1]
    said[2], said[3] = min(max(reduced[0, last] / information, -2.0), 2.0), information
    said[4] = max(reduced[last, last] - reduced[0, last] ** 2 / information, 0.0) / max(pixels - 3.0, 1.0)


# ---- all sectors ------------------------------------------------------------------------------------------------------


@_part
def _select(values: Array, k: int) -> float:
    """The k-th smallest; smaller ones end before it, larger ones behind (Hoare 1961). In place."""
    low, high = 0, len(values) - 1
    while low < high:
        pivot, i, j = values[(low + high) // 2], low, high
        while i <= j:
            while values[i] < pivot:
                i += 1
            while values[j] > pivot:
                j -= 1
            if i <= j:
                values[i], values[j] = values[j], values[i]
                i, j = i + 1, j - 1
        if k <= j:
            high = j
        elif k >= i:
            low = i
        else:
            break
    return float(values[k])


@_part
def _middle(values: Array) -> float:
    """Median. In place."""
    half = len(values) // 2
    upper = _select(values, half)
    if len(values) % 2:
        return upper
    lower = values[0]
    for i in range(1, half):
        lower = max(lower, values[i])
    return float(0.5 * (lower + upper))


@_part
def _median(values: Array, kept: Any, scratch: Array) -> float:
    n = 0
    for s in range(len(values)):
        if kept[s]:
            scratch[n] = values[s]
            n += 1
    return _middle(scratch[:n])


@_part
def _common_gradient(deviation: Array, share: Array, middle: Array, found: Array, both: Array) -> None:
    """Mean and gradient (3,) of what the sectors show; their covariance in the right half of `both` (3, 6)."""
    right, row = np.zeros(3), np.empty(3)
    both[:] = 0.0
    for s in range(len(share)):
        row[0], row[1], row[2] = 1.0, middle[s, 0], middle[s, 1]
        for i in range(3):
            right[i] += share[s] * row[i] * deviation[s]
            for k in range(3):
                both[i, k] += share[s] * row[i] * row[k]
    for i in range(3):
        both[i, i] += 1e-9
        both[i, 3 + i] = 1.0
    _invert(both)
    for i in range(3):
        found[i] = both[i, 3] * right[0] + both[i, 4] * right[1] + both[i, 5] * right[2]


@_part
def _firmness(value: Array, variance: Array, seeing: Any, middle: Array, firm: Array, centre: Array, rules: Rules) -> Any:
    """1 / variance of the levels about what they have in common, into firm (S,), and that into centre; 1 / variance of its
    gradient, and the gradient."""
    sectors = len(value)
    scratch, deviation, share = np.empty(sectors), np.empty(sectors), np.zeros(sectors)
    found, both = np.empty(3), np.empty((3, 6))
    middle_dn, own = _median(value, seeing, scratch), _median(variance, seeing, scratch)
    for s in range(sectors):
        deviation[s] = abs(value[s] - middle_dn)
    typical = 1.4826 * _median(deviation, seeing, scratch)
    for s in range(sectors):
        if seeing[s] and deviation[s] < rules.stands_out * (typical + sqrt(variance[s])):
            share[s] = 1.0 / variance[s]
        deviation[s] = value[s] - middle_dn
    _common_gradient(deviation, share, middle, found, both)
    noise, strength = 0.5 * (both[1, 4] + both[2, 5]), 0.5 * (found[1] ** 2 + found[2] ** 2)
    firmness = 1.0 / (max(strength - rules.gradient_noise * noise, 0.0) + 1.0 / rules.firmest)
    for s in range(sectors):
        part = found[0] + middle[s, 0] * found[1] + middle[s, 1] * found[2]
        centre[s] = middle_dn + part
        deviation[s] = abs(deviation[s] - part)
    spread2 = max((1.4826 * _median(deviation, seeing, scratch)) ** 2 - own, 0.0) + rules.least_spread_dn**2
    for s in range(sectors):
        near = seeing[s] and deviation[s] < rules.stands_out * sqrt(spread2 + variance[s])
        firm[s] = 1.0 / spread2 if near else 0.0
    return firmness, found[1], found[2]


@_part
def _tie(normal: Array, levels: Array, middle: Array, ambient_spread_dn: float, ties: Array, rules: Rules) -> None:
    """Ties the levels outside, and those inside, to what the sectors have in common. Out: ties (2, 3): 1 / variance of the
    gradient, and the gradient. A negative spread of the levels inside is to be found."""
    sectors, last = len(normal), normal.shape[1] - 1
    value, variance = np.empty((2, sectors)), np.ones((2, sectors))
    seeing, any_seeing = np.zeros(sectors, np.bool_), False
    firm, centre, scratch = np.empty(sectors), np.empty(sectors), np.empty(sectors)
    for s in range(sectors):
        m = normal[s]
        a, b, d = m[0, 0], m[0, 1], m[1, 1]
        det = a * d - b * b
        seeing[s] = det > rules.blind * a * d
        any_seeing = any_seeing or seeing[s]
        det = det if seeing[s] else 1.0
        value[0, s] = levels[s, 0] + (d * m[0, last] - b * m[1, last]) / det
        value[1, s] = value[0, s] + levels[s, 1] + (a * m[1, last] - b * m[0, last]) / det
        if seeing[s]:
            variance[0, s], variance[1, s] = d / det, max((a - 2.0 * b + d) / det, 1e-12)
    ties[:] = 0.0
    if not any_seeing:
        return
    for end in range(2):
        if end == 1 and ambient_spread_dn >= 0.0:
            ties[1, 0] = rules.firmest
            common_dn = _median(value[1], seeing, scratch)
            for s in range(sectors):
                off = (value[1, s] - common_dn) / (rules.doubted * ambient_spread_dn)
                firm[s], centre[s] = 1.0 / (ambient_spread_dn**2 * (1.0 + off**2)) if seeing[s] else 0.0, common_dn
        else:
            ties[end, 0], ties[end, 1], ties[end, 2] = _firmness(value[end], variance[end], seeing, middle, firm, centre, rules)
        common = last - 2 + end
        for s in range(sectors):
            m, w = normal[s], firm[s]
            gap = centre[s] - levels[s, 0] - end * levels[s, 1]
            for i in range(end + 1):
                for j in range(i, end + 1):
                    m[i, j] += w
                m[i, common] -= w
                m[i, last] += w * gap
            m[common, common] += w
            m[common, last] -= w * gap
            m[last, last] += w * gap * gap


@_part
def _weigh(said: Array, inside: Any, relative: bool, rules: Rules) -> bool:
    """Tukey's weights; False where too few sectors know where their edge is."""
    sectors = said.shape[1]
    deviations, chi2, told = np.empty(sectors), np.empty(sectors), 0
    for s in range(sectors):
        if said[3, s] > 1.0:
            deviations[told], chi2[told] = abs(said[2, s]) * sqrt(said[3, s]), said[4, s]
            told += 1
    if told < sectors // 3:
        return False
    scale = max(1.0, 1.4826 * _select(deviations[:told], told // 2))
    poor, fair = max(1.0, _select(chi2[:told], 3 * told // 4)) if relative else 1.0, np.empty(sectors)
    for s in range(sectors):
        most = poor * (1.0 + rules.poor_sigmas * sqrt(2.0 / max(inside[s] - 3.0, 1.0)))
        fair[s] = min(1.0, most / max(said[4, s], 1e-6)) ** 2
    for s in range(sectors):
        normalised = said[2, s] * sqrt(said[3, s]) / (rules.tukey * scale)
        worst = min(fair[s - 1], fair[s], fair[(s + 1) % sectors])  # what spoils one spreads into its neighbours
        weight = max(1.0 - normalised**2, 0.0) ** 2 * worst
        said[5, s] = weight if said[3, s] > 1.0 else 0.0
    _leave_out_spots(said, rules)
    return True


@_part
def _leave_out_spots(said: Array, rules: Rules) -> None:
    """No weight for the sectors in or beside which the ball has another level than elsewhere: a mirrored lamp, something in
    front."""
    sectors, beside = said.shape[1], int(rules.beside_spot)
    telling, away, scratch = np.empty(sectors, np.bool_), np.empty(sectors), np.empty(sectors)
    for s in range(sectors):
        telling[s], away[s] = said[3, s] > 1.0, said[1, s] + 0.5 * said[0, s]
    middle_dn = _median(away, telling, scratch)
    for s in range(sectors):
        away[s] = abs(away[s] - middle_dn)
    most = rules.spot * (1.4826 * _median(away, telling, scratch) + rules.least_spot_dn)
    for s in range(sectors):
        if telling[s] and away[s] > most:
            for n in range(-beside, beside + 1):
                said[5, (s + n) % sectors] = 0.0


@_part
def _point(towards: Array, column: Any, s: int, design: Any, blur_design: Any, middle: Any, shape: Any, blurs: int,
           limbs: int, lamp: bool, rules: Rules) -> None:  # fmt: skip
    """Which column of the sector each unknown moves, and by how much."""
    half = 0.5 / _sigma(shape[3 : 3 + blurs], blur_design, s, rules)  # d sig / d unknown
    for i in range(3):
        towards[i], column[i] = design[s, i], 0
    for i in range(blurs):
        towards[3 + i], column[3 + i] = blur_design[s, i] * half, 1
    first = 3 + blurs
    if limbs:
        towards[first], towards[first + 1], towards[first + 2] = middle[s, 0], middle[s, 1], 1.0
        column[first] = column[first + 1] = 2 if lamp else 3
        column[first + 2] = 3
    last = 4 if limbs else 2
    for end in range(2):
        at = first + limbs + 3 * end
        towards[at], towards[at + 1], towards[at + 2] = 1.0, middle[s, 0], middle[s, 1]
        column[at] = column[at + 1] = column[at + 2] = last + end


@_part
def _solve(
    said: Array, reduced: Array, design: Array, blur_design: Array, middle: Array, shape: Array, blurs: int, limbs: int,
    lamp: bool, ties: Array, rules: Rules, normal: Array, delta: Array, towards: Array, column: Any,
) -> None:  # fmt: skip
    """The step of all unknowns; the inverse of its normal matrix, (n, n), in the right half of `normal`."""
    normal[:] = 0.0
    size, right, last = len(delta), np.zeros(len(delta)), reduced.shape[1] - 1
    for s in range(said.shape[1]):
        _point(towards[s], column, s, design, blur_design, middle, shape, blurs, limbs, lamp, rules)
        weight, own = said[5, s], reduced[s]
        if weight == 0.0:
            continue
        for i in range(size):
            w, a = weight * towards[s, i], column[i]
            right[i] += w * (said[3, s] * said[2, s] if a == 0 else own[a, last])
            for k in range(i, size):
                normal[i, k] += w * towards[s, k] * own[a, column[k]]
    for i in range(size):
        for k in range(i):
            normal[i, k] = normal[k, i]
        normal[i, i] += 1e-6
        normal[i, size + i] = 1.0
    for end in range(2):
        for k in range(2):
            at = size - 5 + 3 * end + k
            normal[at, at] += ties[end, 0]
            right[at] -= ties[end, 0] * ties[end, 1 + k]
    _invert(normal)
    for i in range(size):
        delta[i] = 0.0
        for k in range(size):
            delta[i] += normal[i, size + k] * right[k]


@_part
def _invert(both: Array) -> None:
    """Gauss and Jordan, the greatest pivot of each column: (A, 1), (n, 2 n), becomes (1, A^-1)."""
    size = len(both)
    for i in range(size):
        best = i
        for k in range(i + 1, size):
            if abs(both[k, i]) > abs(both[best, i]):
                best = k
        pivot = both[best, i]
        for j in range(2 * size):
            both[best, j], both[i, j] = both[i, j], both[best, j] / pivot
        for k in range(size):
            factor = both[k, i]
            if k != i:
                for j in range(2 * size):
                    both[k, j] -= factor * both[i, j]


@_part
def _follow(levels: Array, coupling: Array, towards: Array, column: Any, delta: Array) -> None:
    """The levels take the step with the shape."""
    for s in range(len(levels)):
        for i in range(len(delta)):
            moved = towards[s, i] * delta[i]
            levels[s, 0] -= coupling[s, 0, column[i]] * moved
            levels[s, 1] -= coupling[s, 1, column[i]] * moved


# ---- the iteration ----------------------------------------------------------------------------------------------------


@_part
def _move(shape: Array, delta: Array, blurs: int, rules: Rules) -> None:
    """Take a step, kept short: the model is linear over about one blur."""
    most = 0.6 * shape[3]
    for i in range(len(shape)):
        longest = 1.5 if i < 3 else most if i < 3 + blurs else 1e9
        shape[i] += min(max(delta[i], -longest), longest)
    shape[3] = min(max(shape[3], rules.least_px2), rules.most_px2)


@_part
def _has_settled(shape: Array, delta: Array, blurs: int, settled_px: float, rules: Rules) -> bool:
    for i in range(3 + blurs if blurs > 1 else 3):
        if not abs(delta[i]) < (settled_px if i < 3 else rules.blur_settled * shape[3]):
            return False
    return True


@_part
def _lamp_of(limb: Array, levels: Array, weight: Array, middle: Array) -> None:
    """From the harmonics of a limb to the lamp that such levels and such a limb come from. In place."""
    both = np.zeros((3, 6))
    right, row = np.zeros(3), np.empty(3)
    for s in range(len(weight)):
        row[0], row[1], row[2] = 1.0, middle[s, 0], middle[s, 1]
        for i in range(3):
            right[i] += weight[s] * row[i] * (levels[s, 0] + levels[s, 1])
            for k in range(3):
                both[i, k] += weight[s] * row[i] * row[k]
    for i in range(3):
        both[i, i] += 1e-6
        both[i, 3 + i] = 1.0
    _invert(both)
    x, y = 0.0, 0.0
    for k in range(3):
        x, y = x + 2.0 * both[1, 3 + k] * right[k], y + 2.0 * both[2, 3 + k] * right[k]
    limb[2] += 0.8 * (limb[0] * x + limb[1] * y) / max(hypot(x, y), 1e-9)
    limb[0], limb[1] = x, y


@_part
def _sum_up(
    sums: Array, seen: Any, inside: Any, said: Array, blur: Array, blur_design: Array, sensor: Sensor, rules: Rules
) -> None:
    """Clipped share, median of chi2, and the widest blur."""
    clipped, pixels, widest = 0, 0, 0.0
    for s in range(len(inside)):
        pixels += inside[s]
        widest = max(widest, _sigma(blur, blur_design, s, rules))
        for k in range(inside[s]):
            clipped += seen[2, s, k] >= sensor.saturated_dn
    sums[0], sums[1], sums[2] = clipped / max(pixels, 1), _middle(said[4].copy()), widest


@_kept
def fit(  # noqa: PLR0912
    seen: Any, inside: Any, middle: Array, design: Array, blur_design: Array, bulge: Array, curved: bool, profile: Array,
    dawn: Any, rules: Rules, sensor: Sensor, circle: Array, blurs: int, limbs: int, cov: Array, said: Array,
) -> bool:  # fmt: skip
    """False: no circle is determined near by, and what is out means nothing.

    In and out: circle: x, y (from the whole-numbered centre that `gather` saw about), r, blur (1 or 3), limb (0 or 3); and out
    in its next 4: clipped share, median chi2, widest blur, settled. Out: cov of those, and of six of the common levels; said
    (6, S): contrast, level, offset, information, chi2, weight of the sectors. In: what `gather` saw, and designs as in Ring and
    Curve.
    """
    sectors, shape = len(inside), circle[:-4].copy()
    size, columns = len(shape) + COMMON, 9 if limbs else 7
    ties, ground, scratch = np.zeros((2, 3)), np.zeros(2), np.empty((3, seen.shape[2]))
    limb = shape[3 + blurs :]
    lamp = limbs > 0 and (limb[0] != 0.0 or limb[1] != 0.0 or limb[2] != 0.0)
    clipped = _is_clipped(seen, inside, sensor)
    levels, normal = np.zeros((sectors, 2)), np.empty((sectors, columns, columns))
    reduced, coupling = np.zeros((sectors, columns - 2, columns - 2)), np.empty((sectors, 2, columns - 2))
    both, delta = np.empty((size, 2 * size)), np.empty(size)
    towards, column = np.empty((sectors, size)), np.empty(size, np.int64)
    first, settled = True, False
    for n in range(int(rules.steps)):
        normal[:] = 0.0
        for s in range(sectors):
            pixels, sigma = seen[:, s, : inside[s]], _sigma(shape[3 : 3 + blurs], blur_design, s, rules)
            slope = (ground[0] * middle[s, 0] + ground[1] * middle[s, 1]) / shape[2]
            if limbs:
                swing = limb[0] * middle[s, 0] + limb[1] * middle[s, 1]
                along, upon = (swing, limb[2]) if lamp else (0.0, limb[2] + swing)
                _add_shaded_pixels(
                    normal[s], pixels, shape, sigma, middle[s, 0], middle[s, 1], bulge[s], curved, slope, along, upon,
                    levels[s], first, profile, dawn, rules, sensor,
                )  # fmt: skip
            else:
                _add_pixels(
                    normal[s], pixels, shape, sigma, middle[s, 0], middle[s, 1], bulge[s], curved, slope, levels[s], first,
                    profile, rules, sensor, scratch,
                )  # fmt: skip
        first = False
        if n > 0:
            length = sqrt(limb[0] ** 2 + limb[1] ** 2 + limb[2] ** 2) if lamp else 0.0
            spread_dn = rules.ambient_spread_dn + rules.ambient_spread * length if lamp else -1.0
            _tie(normal, levels, middle, spread_dn, ties, rules)
            ground[0], ground[1] = ties[0, 1], ties[0, 2]
        for s in range(sectors):
            _eliminate_levels(normal[s], levels[s], reduced[s], coupling[s], sensor, rules)
            _say(said[:, s], levels[s], reduced[s], inside[s])
        if not _weigh(said, inside, blurs > 1 or limbs > 0, rules):
            return False
        _solve(said, reduced, design, blur_design, middle, shape, blurs, limbs, lamp, ties, rules, both, delta, towards, column)
        if clipped:
            _follow(levels, coupling, towards, column, delta)
        _move(shape, delta, blurs, rules)
        far_px = abs(shape[0] - circle[0]) + abs(shape[1] - circle[1]) + abs(shape[2] - circle[2])
        if not far_px <= rules.farthest_px:  # a NaN is no place either
            return False
        settled_px = rules.settled_px * (rules.lamp_settled if lamp else 1.0)
        settled = n >= rules.least_steps and _has_settled(shape, delta, blurs, settled_px, rules)
        if limbs and not lamp:
            if settled or n >= rules.harmonic_steps:
                _lamp_of(limb, levels, said[5], middle)
                lamp, first, settled = True, True, False
            continue
        if settled:
            break
    for i in range(size):
        for k in range(size):
            cov[i, k] = both[i, size + k]
    for i in range(len(shape)):
        circle[i] = shape[i]
    _sum_up(circle[len(shape) :], seen, inside, said, shape[3 : 3 + blurs], blur_design, sensor, rules)
    circle[-1] = 1.0 if settled else 0.0
    return True


@_part
def _is_clipped(seen: Any, inside: Any, sensor: Sensor) -> bool:
    for s in range(len(inside)):
        for k in range(inside[s]):
            if seen[2, s, k] >= sensor.saturated_dn:
                return True
    return False


@_kept
def gather(
    image: Image, column: Any, row: Any, count: Any, x0: int, y0: int, circle: Array, middle: Array, bulge: Array, curved: bool,
    span: Any,
) -> Any:  # fmt: skip
    """Place, from the pixel (x0, y0), and grey value of the pixels inside the image, (3, S, n), and how many
    there are in each sector. All that depends on the type of the pixels: the rest is compiled once.

    In: pixels as in Ring; circle: x, y (from that pixel), r; span: how far inside and outside a curve its pixels may be.
    """
    height, width = image.shape
    seen = np.empty((3, *column.shape), np.float32)
    inside = np.zeros(len(count), np.int32)
    for s in range(len(count)):
        for j in range(count[s]):
            dx, dy = column[s, j], row[s, j]
            x, y = x0 + dx, y0 + dy
            if curved:
                d = _distance(dx - circle[0], dy - circle[1], circle[2], middle[s, 0], middle[s, 1], bulge[s], True)
                if not -span[0] <= d <= span[1]:
                    continue
            if 0 <= x < width and 0 <= y < height:
                k = inside[s]
                seen[0, s, k], seen[1, s, k], seen[2, s, k] = dx, dy, image[y, x]
                inside[s] = k + 1
    return seen, inside
