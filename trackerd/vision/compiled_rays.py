"""The first circle for numba: what rays does, without the interpreter and without its lock.

numba's cache on disk looks at this file alone: what may change elsewhere (rules, drawn triples) is an argument.
"""

from collections.abc import Callable
from math import sqrt
from typing import Any, NamedTuple, TypeVar

import numba
import numpy as np

from trackerd.contract.model import Array, Image

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


class RayRules(NamedTuple):
    """As in rays."""

    nearest_px: float  # from the guessed centre, on every ray
    samples: float
    dn_per_e: float
    floor_dn2: float
    weakest: float
    weakest_sigma: float
    least_r_px: float
    most_r_px: float
    near_px: float
    tukey_px: float
    enough_rays: float


@_part
def _sample(image: Image, x: float, y: float) -> float:
    """Bilinear; the image's border goes on outside."""
    height, width = image.shape
    x0, y0 = int(np.floor(x)), int(np.floor(y))
    a, b = x - x0, y - y0
    left, right = min(max(x0, 0), width - 1), min(max(x0 + 1, 0), width - 1)
    top, bottom = min(max(y0, 0), height - 1), min(max(y0 + 1, 0), height - 1)
    upper = image[top, left] * (1.0 - a) + image[top, right] * a
    lower = image[bottom, left] * (1.0 - a) + image[bottom, right] * a
    return float(upper * (1.0 - b) + lower * b)


@_kept
def strengths(image: Image, x: float, y: float, ways: Array, strength: Array, rules: RayRules) -> float:
    """Steepness of the grey levels along each ray, into strength (rays, samples); the least that counts as an edge. All that
    depends on the type of the pixels: the rest is compiled once."""
    height, width = image.shape
    rays, samples = strength.shape
    level, total = np.empty(samples), 0.0
    for i in range(rays):
        for k in range(samples):
            level[k] = _sample(image, x + ways[i, 0] * (rules.nearest_px + k), y + ways[i, 1] * (rules.nearest_px + k))
            total += level[k]
        for k in range(samples):
            u, v = x + ways[i, 0] * (rules.nearest_px + k), y + ways[i, 1] * (rules.nearest_px + k)
            slope, last = 0.0, samples - 1
            for n in range(1, 4):
                slope += level[min(k + n, last)] - level[max(k - n, 0)]
            outside = u < 0.0 or v < 0.0 or u > width - 1 or v > height - 1
            strength[i, k] = 0.0 if outside else abs(slope) / 3.0
    mean = max(total / (rays * samples), 0.0)
    return float(rules.weakest_sigma * sqrt(mean * rules.dn_per_e + rules.floor_dn2))


@_part
def _strongest(strength: Array, floor_dn: float, places: Array, rules: RayRules) -> int:
    """Where a ray's strongest edges are, in samples, into places (edges,), strongest first; how many there are."""
    samples, least, found = len(strength), floor_dn, 0
    for k in range(samples):
        least = max(least, rules.weakest * strength[k])
    best = np.zeros(len(places))
    for k in range(1, samples - 1):
        b = strength[k]
        if not (b >= strength[k - 1] and b > strength[k + 1] and b > least):
            continue
        n = min(found, len(places) - 1)
        if found == len(places) and b <= best[n]:
            continue
        while n > 0 and best[n - 1] < b:
            best[n], places[n] = best[n - 1], places[n - 1]
            n -= 1
        a, c = strength[k - 1], strength[k + 1]
        best[n], places[n] = b, k + 0.5 * (a - c) / min(a - 2.0 * b + c, -1e-6)
        found = min(found + 1, len(places))
    return found


@_part
def _through_three(p: Array, q: Array, s: Array) -> Any:
    ax, ay, bx, by = q[0] - p[0], q[1] - p[1], s[0] - p[0], s[1] - p[1]
    double = 2.0 * (ax * by - ay * bx)
    if abs(double) < 1e-6:
        double = 1e-6
    a2, b2 = ax * ax + ay * ay, bx * bx + by * by
    ux, uy = (by * a2 - ay * b2) / double, (ax * b2 - bx * a2) / double
    return p[0] + ux, p[1] + uy, sqrt(ux * ux + uy * uy)


@_part
def _agreeing(points: Array, count: Any, x: float, y: float, r: float, near_px: float) -> int:
    """How many rays have an edge near to a circle."""
    agreed, most = 0, 2.0 * near_px * r
    for i in range(len(count)):
        for n in range(count[i]):
            dx, dy = points[i, n, 0] - x, points[i, n, 1] - y
            if abs(dx * dx + dy * dy - r * r) < most:
                agreed += 1
                break
    return agreed


@_part
def _most_agreed(points: Array, count: Any, rays: Any, edges: Any, circle: Array, rules: RayRules) -> bool:
    best = 0
    for t in range(len(rays)):
        a, b, c = rays[t]
        i, j, k = edges[t]
        if i >= count[a] or j >= count[b] or k >= count[c]:
            continue
        x, y, r = _through_three(points[a, i], points[b, j], points[c, k])
        if not rules.least_r_px < r < rules.most_r_px:
            continue
        agreed = _agreeing(points, count, x, y, r, rules.near_px)
        if agreed > best:
            best, circle[0], circle[1], circle[2] = agreed, x, y, r
    return best >= rules.enough_rays


@_part
def _refine(points: Array, count: Any, circle: Array, rules: RayRules) -> bool:
    """One step of Tukey-weighted least squares over each ray's nearest edge. False: nothing determines it."""
    s00, s01, s02, s11, s12, s22 = 1e-9, 0.0, 0.0, 1e-9, 0.0, 1e-9
    y0 = y1 = y2 = 0.0
    for i in range(len(count)):
        nearest, ux, uy = 1e9, 0.0, 0.0
        for n in range(count[i]):
            dx, dy = points[i, n, 0] - circle[0], points[i, n, 1] - circle[1]
            rho = max(sqrt(dx * dx + dy * dy), 1e-3)
            if abs(rho - circle[2]) < abs(nearest):
                nearest, ux, uy = rho - circle[2], dx / rho, dy / rho
        if not abs(nearest) < rules.tukey_px:
            continue
        w = (1.0 - (nearest / rules.tukey_px) ** 2) ** 2
        s00, s01, s02 = s00 + w * ux * ux, s01 + w * ux * uy, s02 + w * ux
        s11, s12, s22 = s11 + w * uy * uy, s12 + w * uy, s22 + w
        y0, y1, y2 = y0 + w * nearest * ux, y1 + w * nearest * uy, y2 + w * nearest
    c00, c01, c02 = s11 * s22 - s12 * s12, s02 * s12 - s01 * s22, s01 * s12 - s02 * s11
    det = s00 * c00 + s01 * c01 + s02 * c02
    if det == 0.0:
        return False
    c11, c12, c22 = s00 * s22 - s02 * s02, s01 * s02 - s00 * s12, s00 * s11 - s01 * s01
    circle[0] += (c00 * y0 + c01 * y1 + c02 * y2) / det
    circle[1] += (c01 * y0 + c11 * y1 + c12 * y2) / det
    circle[2] += (c02 * y0 + c12 * y1 + c22 * y2) / det
    return True


@_kept
def first(
    strength: Array, floor_dn: float, x: float, y: float, ways: Array, bulge: Array, triple_rays: Any, triple_edges: Any,
    rules: RayRules, circle: Array,
) -> bool:  # fmt: skip
    """False: too few rays agree. In: what `strengths` says, ways (rays, 2) unit vectors, bulge (rays,), triples (m, 3). Out:
    circle x, y, r."""
    rays, edges = len(ways), 3
    places = np.zeros((rays, edges))
    points, count, told = np.empty((rays, edges, 2)), np.zeros(rays, np.int64), 0
    for i in range(rays):
        count[i] = _strongest(strength[i], floor_dn, places[i], rules)
        told += count[i] > 0
        for n in range(count[i]):
            radius = rules.nearest_px + places[i, n] - bulge[i]
            points[i, n, 0], points[i, n, 1] = x + ways[i, 0] * radius, y + ways[i, 1] * radius
    if told < rules.enough_rays or not _most_agreed(points, count, triple_rays, triple_edges, circle, rules):
        return False
    for _ in range(2):
        if not _refine(points, count, circle, rules):
            return False
    return bool(circle[2] > 1.0)
