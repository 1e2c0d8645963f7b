"""The circle fit's iteration for numba: the maths of by_numpy step by step, without the interpreter and without its lock.

numba's cache on disk looks at this file alone: what may change elsewhere (rules, tables) is an argument.
"""

from collections.abc import Callable
from math import sqrt
from typing import Any, TypeVar

import numba
import numpy as np

from trackerd.contract.model import Array, Image
from trackerd.vision.convergence import Rules, Sensor

_F = TypeVar("_F", bound=Callable[..., Any])
_OPTIONS = {"nogil": True, "fastmath": False, "error_model": "numpy"}

_part: Callable[[_F], _F] = numba.njit(**_OPTIONS)


def _kept(function: _F) -> _F:
    """Compiled, and kept on disk where there is a folder that can be written."""
    try:
        kept: _F = numba.njit(cache=True, **_OPTIONS)(function)
    except RuntimeError:
        kept = numba.njit(**_OPTIONS)(function)
    return kept


@_part
def _sigma(shape: Array, blur_design: Array, s: int, rules: Rules) -> float:
    variance = 0.0
    for i in range(len(shape) - 3):
        variance += blur_design[s, i] * shape[3 + i]
    return sqrt(min(max(variance, rules.least_px2), rules.most_px2))


@_part
def _normal_matrix(
    seen: Any, shape: Array, sigma: float, levels: Array, first: bool, profile: Array, rules: Rules, sensor: Sensor
) -> Any:  # fmt: skip
    """The 15 sums over (B, D, e, sig, residual) of one sector, row by row. `seen` (3, n) is place and grey value."""
    n, inverse, bend = seen.shape[1], 1.0 / sigma, sigma / (2.0 * shape[2])
    scaled, edge, bell = np.empty(n), np.empty(n), np.empty(n)
    end, last = rules.table_end, 2.0 * rules.table_end * rules.table_steps
    for k in range(n):
        dx, dy = seen[0, k] - shape[0], seen[1, k] - shape[1]
        scaled[k] = (sqrt(dx * dx + dy * dy) - shape[2]) * inverse
        place = min(max((scaled[k] + bend + end) * rules.table_steps, 0.0), last)
        i = int(place)
        share = place - i
        edge[k] = profile[i, 0] * (1.0 - share) + profile[i + 1, 0] * share
        bell[k] = profile[i, 1] * (1.0 - share) + profile[i + 1, 1] * share
    if first:
        _plain_levels(seen[2], edge, levels, rules)
    base, contrast = levels[0], levels[1]
    slope = contrast * inverse
    a00 = a01 = a02 = a03 = a04 = a11 = a12 = a13 = a14 = a22 = a23 = a24 = a33 = a34 = a44 = 0.0
    for k in range(n):
        e, level = edge[k], seen[2, k]
        model = base + contrast * e
        weight = 1.0 / (max(model, 0.0) * sensor.dn_per_e + sensor.floor_dn2)
        if level >= sensor.saturated_dn and model >= sensor.saturated_dn:
            weight = 0.0
        d = slope * bell[k]
        b, residual = d * (scaled[k] - bend), level - model
        we, wd, wb, wr = weight * e, weight * d, weight * b, weight * residual
        a00, a01, a02, a03, a04 = a00 + weight, a01 + we, a02 + wd, a03 + wb, a04 + wr
        a11, a12, a13, a14 = a11 + we * e, a12 + we * d, a13 + we * b, a14 + we * residual
        a22, a23, a24 = a22 + wd * d, a23 + wd * b, a24 + wd * residual
        a33, a34, a44 = a33 + wb * b, a34 + wb * residual, a44 + wr * residual
    return a00, a01, a02, a03, a04, a11, a12, a13, a14, a22, a23, a24, a33, a34, a44


@_part
def _plain_levels(level: Any, edge: Array, levels: Array, rules: Rules) -> None:
    n, e, ee, y, ye = float(len(edge)), 0.0, 0.0, 0.0, 0.0
    for k in range(len(edge)):
        e, ee, y, ye = e + edge[k], ee + edge[k] * edge[k], y + level[k], ye + edge[k] * level[k]
    det = n * ee - e * e
    levels[1] = (n * ye - e * y) / max(det, 1e-3) if det > rules.blind * n * ee else 0.0
    levels[0] = (y - levels[1] * e) / max(n, 1.0)


@_part
def _eliminate_levels(normal: Any, levels: Array, reduced: Array, rules: Rules) -> None:
    """Schur complement over (e, sig, residual), row by row, and the levels at the best fit with the circle as it is."""
    a, b, c02, c03, c04, d, c12, c13, c14, a22, a23, a24, a33, a34, a44 = normal
    det = a * d - b * b
    if det <= rules.blind * a * d:
        reduced[:] = 0.0
        return
    s02, s12 = (d * c02 - b * c12) / det, (a * c12 - b * c02) / det
    s03, s13 = (d * c03 - b * c13) / det, (a * c13 - b * c03) / det
    s04, s14 = (d * c04 - b * c14) / det, (a * c14 - b * c04) / det
    reduced[0] = a22 - c02 * s02 - c12 * s12
    reduced[1] = a23 - c02 * s03 - c12 * s13
    reduced[2] = a24 - c02 * s04 - c12 * s14
    reduced[3] = a33 - c03 * s03 - c13 * s13
    reduced[4] = a34 - c03 * s04 - c13 * s14
    reduced[5] = a44 - c04 * s04 - c14 * s14
    levels[0] += s04
    levels[1] += s14


@_part
def _say(said: Array, levels: Array, reduced: Array, pixels: int) -> None:
    information = max(reduced[0], 1e-9)
    said[0], said[1] = levels[1], levels[0] + 0.5 * levels[1]
    said[2], said[3] = min(max(reduced[2] / information, -2.0), 2.0), information
    said[4] = max(reduced[5] - reduced[2] ** 2 / information, 0.0) / max(pixels - 3.0, 1.0)


@_part
def _weigh(said: Array, free_blur: bool, rules: Rules) -> float:
    """Tukey's weights; the scale of the sectors' errors, 0 where too few sectors know where their edge is."""
    sectors = said.shape[1]
    deviations, chi2, told = np.empty(sectors), np.empty(sectors), 0
    for s in range(sectors):
        if said[3, s] > 1.0:
            deviations[told], chi2[told] = abs(said[2, s]) * sqrt(said[3, s]), said[4, s]
            told += 1
    if told < sectors // 3:
        return 0.0
    _sort(deviations[:told])
    _sort(chi2[:told])
    scale = max(1.0, 1.4826 * deviations[told // 2])
    poor = rules.poor_chi2 * (max(1.0, chi2[3 * told // 4]) if free_blur else 1.0)
    for s in range(sectors):
        normalised = said[2, s] * sqrt(said[3, s]) / (rules.tukey * scale)
        weight = max(1.0 - normalised**2, 0.0) ** 2 * min(1.0, poor / max(said[4, s], 1e-6)) ** 2
        said[5, s] = weight if said[3, s] > 1.0 else 0.0
    return float(scale)


@_part
def _sort(values: Array) -> None:
    """In place, by insertion: a hundred values at most."""
    for i in range(1, len(values)):
        value, k = values[i], i
        while k > 0 and values[k - 1] > value:
            values[k] = values[k - 1]
            k -= 1
        values[k] = value


@_part
def _solve(
    said: Array, reduced: Array, design: Array, blur_design: Array, shape: Array, rules: Rules, normal: Array, delta: Array
) -> None:
    """The step of (x, y, r, blur); the inverse of its normal matrix, (n, n), in the right half of `normal`."""
    normal[:] = 0.0
    size, right, towards = len(shape), np.zeros(len(shape)), np.empty(len(shape))
    for s in range(said.shape[1]):
        weight, half = said[5, s], 0.5 / _sigma(shape, blur_design, s, rules)  # d sig / d unknown
        for i in range(size):
            towards[i] = design[s, i] if i < 3 else blur_design[s, i - 3] * half
        for i in range(size):
            w = weight * towards[i]
            right[i] += w * (said[3, s] * said[2, s] if i < 3 else reduced[s, 4])
            for k in range(size):
                both = said[3, s] if i < 3 and k < 3 else (reduced[s, 3] if i >= 3 and k >= 3 else reduced[s, 1])
                normal[i, k] += w * towards[k] * both
    for i in range(size):
        normal[i, i] += 1e-6
        normal[i, size + i] = 1.0
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
def _move(shape: Array, delta: Array, rules: Rules) -> None:
    """Take a step, kept short: the model is linear over about one blur."""
    most = 0.6 * shape[3]
    for i in range(len(shape)):
        longest = 1.5 if i < 3 else most
        shape[i] += min(max(delta[i], -longest), longest)
    shape[3] = min(max(shape[3], rules.least_px2), rules.most_px2)


@_part
def _has_settled(shape: Array, delta: Array, rules: Rules) -> bool:
    for i in range(len(shape) if len(shape) > 4 else 3):
        if not abs(delta[i]) < (rules.settled_px if i < 3 else rules.blur_settled * shape[3]):
            return False
    return True


@_part
def _sum_up(
    sums: Array, seen: Any, inside: Any, said: Array, shape: Array, blur_design: Array, sensor: Sensor, rules: Rules
) -> None:
    """Clipped share, median of chi2, and the widest blur."""
    clipped, pixels, widest = 0, 0, 0.0
    for s in range(len(inside)):
        pixels += inside[s]
        widest = max(widest, _sigma(shape, blur_design, s, rules))
        for k in range(inside[s]):
            clipped += seen[2, s, k] >= sensor.saturated_dn
    chi2 = said[4].copy()
    _sort(chi2)
    half = len(chi2) // 2  # sectors are even in number
    sums[0], sums[1], sums[2] = clipped / max(pixels, 1), 0.5 * (chi2[half - 1] + chi2[half]), widest


@_part
def _iterate(
    seen: Any, inside: Any, design: Array, blur_design: Array, profile: Array, rules: Rules, sensor: Sensor,
    circle: Array, cov: Array, said: Array,
) -> bool:  # fmt: skip
    shape, size = circle[:-4].copy(), len(circle) - 4
    levels, reduced = np.zeros((len(inside), 2)), np.empty((len(inside), 6))
    both, delta = np.empty((size, 2 * size)), np.empty(size)
    settled, scale = False, 1.0
    for n in range(int(rules.steps)):
        for s in range(len(inside)):
            normal = _normal_matrix(
                seen[:, s, : inside[s]], shape, _sigma(shape, blur_design, s, rules), levels[s], n == 0, profile, rules, sensor
            )  # fmt: skip
            _eliminate_levels(normal, levels[s], reduced[s], rules)
            _say(said[:, s], levels[s], reduced[s], inside[s])
        scale = _weigh(said, size > 4, rules)
        if scale == 0.0:
            return False
        _solve(said, reduced, design, blur_design, shape, rules, both, delta)
        _move(shape, delta, rules)
        far_px = abs(shape[0] - circle[0]) + abs(shape[1] - circle[1]) + abs(shape[2] - circle[2])
        if not far_px <= rules.farthest_px:  # a NaN is no place either
            return False
        settled = _has_settled(shape, delta, rules)
        if settled:
            break
    for i, k in np.ndindex(3, 3):
        cov[i, k] = both[i, size + k] * scale**2
    for i in range(size):
        circle[i] = shape[i]
    _sum_up(circle[size:], seen, inside, said, shape, blur_design, sensor, rules)
    circle[-1] = 1.0 if settled else 0.0
    return True


@_part
def _gather(image: Image, column: Any, row: Any, count: Any, x0: int, y0: int) -> Any:
    """Place and grey value of the pixels inside the image, (3, S, n), and how many there are in each sector."""
    height, width = image.shape
    seen = np.empty((3, *column.shape), np.float32)
    inside = np.zeros(len(count), np.int32)
    for s in range(len(count)):
        for j in range(count[s]):
            dx, dy = column[s, j], row[s, j]
            x, y = x0 + dx, y0 + dy
            if 0 <= x < width and 0 <= y < height:
                k = inside[s]
                seen[0, s, k], seen[1, s, k], seen[2, s, k] = dx, dy, image[y, x]
                inside[s] = k + 1
    return seen, inside


@_kept
def fit(
    image: Image, column: Any, row: Any, count: Any, design: Array, blur_design: Array, profile: Array, rules: Rules,
    sensor: Sensor, circle: Array, cov: Array, said: Array,
) -> bool:  # fmt: skip
    """False: no circle is determined near by, and what is out means nothing.

    In and out: circle: x, y, r, blur (1 or 3); and out in its next 4: clipped share, median chi2, widest blur, settled.
    Out: cov (3, 3); said (6, S): contrast, level, offset, information, chi2, weight of the sectors.
    In: pixels and designs as in Ring.
    """
    x0, y0 = round(circle[0]), round(circle[1])
    seen, inside = _gather(image, column, row, count, x0, y0)
    circle[0] -= x0
    circle[1] -= y0
    found = _iterate(seen, inside, design, blur_design, profile, rules, sensor, circle, cov, said)
    circle[0] += x0
    circle[1] += y0
    return found
