"""Which dot of a picture is which point of an array, without a guess.

Three dots that lie together are taken for every three neighbours of the array in turn: three pairs determine a scaled
orthographic view up to a reversal of depth (Alter 1994). The views that put most points on dots grow into a full projection.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations
from math import ceil

import cv2
import numpy as np
import numpy.typing as npt

from trackerd.calibrate.board_kinds import FEWEST_DOTS, Indices
from trackerd.calibrate.corners import spacing
from trackerd.contract.model import Array

NEAR = 0.3  # of the dots' spacing: a point is on a dot
CLOSE = 0.05  # rms of a match, the same unit: what distortion bends within a picture
STRAY, LEAST_STRAY = 4.0, 0.01  # medians, and at least so much of the unit: farther off, a dot is another thing
REACH = 20  # nearest points in space of each, among which those of three dots that lie together in a picture are
NEIGHBOURS, MOST_TRIPLES = 6, 30  # of a dot; three dots that are tried
BROAD, CANDIDATES = 3000, 32  # views with most points on dots; of different ones among them, those that grow
GROWTHS = 6
CANVAS_PX = 512  # of the map of nearest dots
FLATTEST = 0.15  # of the area of three dots to their longest side squared: flatter ones determine no view
FEWEST_IN_SPACE = 10
PLANAR = 1e-3  # of the array's size


@dataclass(frozen=True, slots=True)
class Match:
    """Points (k,) of the array and the dots (k,) that they are; `front`: the camera is on the side that the array faces."""

    points: Indices
    dots: Indices
    rms: float  # of the dots' spacing
    front: bool


def match_dots(points_mm: Array, facing: Array, q_px: Array, fewest: int) -> list[Match]:
    """All matches of `fewest` points or more that are as good as the best; empty where there is none.

    More than one with the same `front`: the array looks alike from several sides.
    """
    unit_px = float(np.median(spacing(q_px)))
    views = _Views(points_mm - points_mm.mean(0), facing)
    seen = _NearestDot(q_px, NEAR * unit_px)
    for triple in _triples(q_px):
        maps, fronts = views.through(q_px[list(triple)])
        counts = seen.count(maps)
        best = _distinct(maps, counts, unit_px)
        grown = [_grow(points_mm, q_px, maps[n], unit_px, bool(fronts[n])) for n in best if counts[n] >= 4]
        good = [one for one in grown if one is not None and len(one.points) >= fewest]
        if good:
            return _best(good)
    return []


def fewest_dots(points_mm: Array, share: float) -> int:
    """How many must be matched: a share of the array, and as many as no chance matches. In space it takes more of them, because
    a projection of space has more parameters than one of a plane."""
    least = FEWEST_DOTS if _in_plane(points_mm, points_mm) is not None else FEWEST_IN_SPACE
    return max(least, ceil(share * len(points_mm)))


class _Views:
    """Every three neighbours of the array, in every order, as the three dots."""

    def __init__(self, points_mm: Array, facing: Array) -> None:
        self._points_mm, self._facing = points_mm, facing / np.linalg.norm(facing)
        near = _nearest(points_mm, REACH)
        first, j, k = (grid.ravel() for grid in np.meshgrid(*map(np.arange, (*near.shape, near.shape[1])), indexing="ij"))
        second, third = near[first, j], near[first, k]
        apart = second != third
        self._first = first[apart]
        self._one = points_mm[second[apart]] - points_mm[self._first]
        self._two = points_mm[third[apart]] - points_mm[self._first]
        across = np.cross(self._one, self._two)
        longest = np.maximum((self._one**2).sum(1), (self._two**2).sum(1))
        told = np.linalg.norm(across, axis=1) > FLATTEST / 2 * longest
        self._first, self._one, self._two = self._first[told], self._one[told], self._two[told]
        self._inverse = np.linalg.inv(np.stack((self._one, self._two, across[told]), axis=2))

    def through(self, q_px: Array) -> tuple[Array, npt.NDArray[np.bool_]]:
        """Pixels (views, n, 2) of all points where three of them are `q_px` (3, 2), and which are from the front."""
        d1, d2 = q_px[1] - q_px[0], q_px[2] - q_px[0]
        aa, bb, ab = (self._one**2).sum(1), (self._two**2).sum(1), (self._one * self._two).sum(1)
        a, b, c = float(d1 @ d1), float(d2 @ d2), float(d1 @ d2)
        alpha, beta, gamma = aa * bb - ab**2, aa * b + bb * a - 2 * ab * c, a * b - c * c
        scale2 = (beta + np.sqrt(np.maximum(beta**2 - 4 * alpha * gamma, 0.0))) / (2 * alpha)
        h1 = np.sqrt(np.maximum(scale2 * aa - a, 0.0))
        h2 = np.sqrt(np.maximum(scale2 * bb - b, 0.0)) * np.where(scale2 * ab - c < 0.0, -1.0, 1.0)
        halves = [self._maps(d1, d2, sign * h1, sign * h2, np.sqrt(scale2), q_px[0]) for sign in (1.0, -1.0)]
        return np.concatenate([half[0] for half in halves]), np.concatenate([half[1] for half in halves])

    def _maps(
        self, d1: Array, d2: Array, h1: Array, h2: Array, scale: Array, origin: Array
    ) -> tuple[Array, npt.NDArray[np.bool_]]:
        w1, w2 = (np.column_stack((np.broadcast_to(d, (len(h), 2)), h)) for d, h in ((d1, h1), (d2, h2)))
        w3 = np.cross(w1, w2) / scale[:, None]
        turned = np.stack((w1, w2, w3), axis=2) @ self._inverse  # scale times rotation
        mapped = self._points_mm @ turned[:, :2].transpose(0, 2, 1)
        first = mapped[np.arange(len(mapped)), self._first]
        return mapped - first[:, None] + origin, turned[:, 2] @ self._facing < 0.0


class _NearestDot:
    """A picture of which pixels are near a dot."""

    def __init__(self, q_px: Array, near_px: float) -> None:
        self._low = q_px.min(0) - 2 * near_px
        self._scale = CANVAS_PX / float((q_px.max(0) + 2 * near_px - self._low).max())
        far = np.full((CANVAS_PX, CANVAS_PX), 255, np.uint8)
        x, y = np.rint((q_px - self._low) * self._scale).astype(int).clip(0, CANVAS_PX - 1).T
        far[y, x] = 0
        self._near = cv2.distanceTransform(far, cv2.DIST_L2, 5) < near_px * self._scale
        self._near[[0, -1]], self._near[:, [0, -1]] = False, False  # what lies outside is put there

    def count(self, q_px: Array) -> Indices:
        """How many of (..., n, 2) are near a dot, (...)."""
        x, y = np.moveaxis(np.rint((q_px - self._low) * self._scale), -1, 0).clip(0, CANVAS_PX - 1).astype(np.intp)
        return np.asarray(self._near[y, x].sum(-1))


def _distinct(maps: Array, counts: Indices, unit_px: float) -> Indices:
    """Numbers of the views with most points on dots, each once: those that put three points at the same places are one."""
    order = np.argsort(-counts, kind="stable")[:BROAD]
    n = maps.shape[1]
    places = np.rint(maps[order][:, [0, n // 3, 2 * n // 3]] / unit_px).reshape(len(order), -1)
    first = np.unique(places, axis=0, return_index=True)[1]
    return np.asarray(order[np.sort(first)[:CANDIDATES]])


def _triples(q_px: Array) -> Iterator[tuple[int, int, int]]:
    """Three dots that lie together, spread over the picture, and not in a line."""
    near = _nearest(q_px, NEIGHBOURS)
    found = [(i, int(j), int(k)) for i in range(len(q_px)) for j, k in combinations(near[i], 2)]
    wide = [t for t in found if _breadth(q_px[list(t)]) > FLATTEST]
    yield from (wide[n] for n in np.random.default_rng(0).permutation(len(wide))[:MOST_TRIPLES])


def _nearest(points: Array, count: int) -> Indices:
    """Numbers of the nearest other points of each, (n, count)."""
    distance = np.linalg.norm(points[:, None] - points[None], axis=2)
    return np.asarray(distance.argsort(1)[:, 1 : count + 1])


def _breadth(q_px: Array) -> float:
    (ax, ay), (bx, by) = q_px[1] - q_px[0], q_px[2] - q_px[0]
    return float(abs(ax * by - ay * bx) / max(ax * ax + ay * ay, bx * bx + by * by))


def _grow(points_mm: Array, q_px: Array, mapped: Array, unit_px: float, front: bool) -> Match | None:
    points, dots = _pairs(mapped, q_px, NEAR * unit_px)
    for _ in range(GROWTHS):
        if len(points) < 4:
            return None
        mapped = _project(points_mm, points_mm[points], q_px[dots])
        more, others = _pairs(mapped, q_px, NEAR * unit_px)
        if np.array_equal(more, points) and np.array_equal(others, dots):
            break
        points, dots = more, others
    if len(points) < 4:
        return None
    off = np.linalg.norm(_project(points_mm, points_mm[points], q_px[dots])[points] - q_px[dots], axis=1) / unit_px
    fit = off <= max(STRAY * float(np.median(off)), LEAST_STRAY)  # a stray dot may be near the place of one that is not lit
    off = np.linalg.norm(_project(points_mm, points_mm[points[fit]], q_px[dots[fit]])[points[fit]] - q_px[dots[fit]], axis=1)
    rms = float(np.sqrt(np.square(off).mean())) / unit_px
    return Match(points[fit], dots[fit], rms, front) if rms < CLOSE else None


def _pairs(mapped: Array, q_px: Array, near_px: float) -> tuple[Indices, Indices]:
    """Points and dots that are each other's nearest."""
    distance = np.linalg.norm(mapped[:, None] - q_px[None], axis=2)
    dot, point = distance.argmin(1), distance.argmin(0)
    n = np.arange(len(mapped))
    chosen = (point[dot] == n) & (distance[n, dot] < near_px)
    return n[chosen], dot[chosen]


def _project(points_mm: Array, p_mm: Array, q_px: Array) -> Array:
    """All points through the projection that pairs tell: of as many parameters as there are pairs for."""
    flat = _in_plane(points_mm, p_mm)
    p, everything = flat if flat is not None else (p_mm, points_mm)
    p, everything = (np.column_stack((part, np.ones(len(part)))) for part in (p, everything))
    columns = p.shape[1]
    if len(p) < 3 * columns:
        return np.asarray(everything @ np.linalg.lstsq(p, q_px, rcond=None)[0])
    middle, size = q_px.mean(0), float(np.ptp(q_px))
    u, v = ((q_px - middle) / size).T
    zero = np.zeros_like(p)
    rows = np.concatenate((np.hstack((p, zero, -u[:, None] * p)), np.hstack((zero, p, -v[:, None] * p))))
    matrix = np.linalg.svd(rows)[2][-1].reshape(3, columns)
    mapped = everything @ matrix.T
    least = 1e-6 * float(np.abs(mapped[:, 2]).max()) + 1e-300  # a point on the horizon is far from every dot
    depth = np.where(np.abs(mapped[:, 2:]) < least, least, mapped[:, 2:])
    return np.asarray(mapped[:, :2] / depth * size + middle)


def _in_plane(points_mm: Array, p_mm: Array) -> tuple[Array, Array] | None:
    """Coordinates of the pairs and of all points in the array's plane, of order 1; None where it fills space."""
    middle = points_mm.mean(0)
    _, sizes, axes = np.linalg.svd(points_mm - middle, full_matrices=False)
    if sizes[2] > PLANAR * sizes[0]:
        return None
    return (p_mm - middle) @ axes[:2].T / sizes[0], (points_mm - middle) @ axes[:2].T / sizes[0]


def _best(good: list[Match]) -> list[Match]:
    """The best of each side, and those that are as good and pair otherwise."""
    most = max(len(one.points) for one in good)
    alike: dict[tuple[object, ...], Match] = {}
    for one in sorted(good, key=lambda m: m.rms):
        if len(one.points) >= most - 1:
            alike.setdefault((tuple(one.dots), tuple(one.points)), one)
    finest = min(one.rms for one in alike.values())
    return [one for one in alike.values() if one.rms <= max(3.0 * finest, CLOSE / 4.0)]
