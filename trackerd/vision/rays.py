"""A first circle from edges along rays: good to a few tenths of a pixel, robust against stems, clutter and half an outline.

Up to three edges a ray, RANSAC over triples of rays, then a few steps of Tukey's robust least squares.
"""

from dataclasses import dataclass
from math import pi

import cv2
import numpy as np
import numpy.typing as npt

from trackerd.contract.model import Array, Image
from trackerd.vision.curve import View
from trackerd.vision.noise import NoiseModel

Circle = tuple[float, float, float]  # x, y, r
Floats = npt.NDArray[np.float32]

RAYS = 64
EDGES = 3  # the strongest edges that a ray may offer
TRIPLES = 160
NEAR_PX = 1.5  # an edge this near to a circle speaks for it
TUKEY_PX = 2.5
WEAKEST = 0.35  # of a ray's strongest edge
WEAKEST_SIGMA = 2.5  # of a pixel's noise
ENOUGH_RAYS = 22  # a third of the outline: the fit's verification asks for more
REACH_PX = 8.0
REACH_RATIO = 0.2

_THREE_AGAINST_THREE = np.array(((-1, -1, -1, 0, 1, 1, 1),), np.float32) / 3.0  # noise of 0.8 of a pixel's
_ANGLE = (np.arange(RAYS) + 0.5) * (2.0 * pi / RAYS)
_COS, _SIN = np.cos(_ANGLE).astype(np.float32), np.sin(_ANGLE).astype(np.float32)


@dataclass(frozen=True, slots=True)
class Edges:
    """Strongest edges along the rays. (RAYS, EDGES); `there` is False where a ray has fewer."""

    x_px: npt.NDArray[np.float32]
    y_px: npt.NDArray[np.float32]
    there: npt.NDArray[np.bool_]


def first_circle(
    image: Image, guess: Circle, noise: NoiseModel, reach_px: float = REACH_PX, view: View | None = None
) -> Circle | None:
    """Circle (x, y, r) near a guess, by edges within r (1 ± 0.2) ± reach of its centre. None: too few rays agree.

    With a view the edges are brought from the sphere's outline to the circle that has its centre and r.
    """
    bulge = None if view is None else bulge_of(view, guess)
    edges = edges_on_rays(image, guess, noise, reach_px, None if bulge is None else bulge[:, None].astype(np.float32))
    if int(edges.there[:, 0].sum()) < ENOUGH_RAYS:
        return None
    best = _most_agreed(edges, guess[2], reach_px)
    return None if best is None else _refined(edges, best)


def bulge_of(view: View, circle: Circle) -> Array | None:
    """By how much the outline's radius exceeds r on each ray, (RAYS,)."""
    try:
        return np.ascontiguousarray(view.curve(*circle, RAYS).bulge[:, 0])
    except ValueError:  # the lens shows no sphere there: the fit will say so
        return None


def edges_on_rays(image: Image, guess: Circle, noise: NoiseModel, reach_px: float, bulge_px: Floats | None = None) -> Edges:
    """The edges of each ray, strongest first; nearer by the bulge (RAYS, 1) of the outline that is looked for."""
    x, y, r = guess
    nearest = max(1.0, (1.0 - REACH_RATIO) * r - reach_px)
    radii = np.arange(nearest, (1.0 + REACH_RATIO) * r + reach_px + 1.0, dtype=np.float32)
    map_x = np.float32(x) + _COS[:, None] * radii
    map_y = np.float32(y) + _SIN[:, None] * radii
    level = _sample(image, map_x, map_y)
    height, width = image.shape
    outside = (map_x < 0) | (map_y < 0) | (map_x > width - 1) | (map_y > height - 1)
    strength = np.abs(cv2.filter2D(level, -1, _THREE_AGAINST_THREE, borderType=cv2.BORDER_REPLICATE))
    if outside.any():
        strength[outside] = 0.0
    return _peaks(strength, radii, guess, WEAKEST_SIGMA * noise.sigma_dn(float(level.mean())), bulge_px)


def _sample(image: Image, map_x: npt.NDArray[np.float32], map_y: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """Bilinear grey values in float32 (remap of whole numbers would round them), of the region that is needed."""
    height, width = image.shape
    x0, y0 = max(int(map_x.min()) - 1, 0), max(int(map_y.min()) - 1, 0)
    x1, y1 = min(int(map_x.max()) + 2, width), min(int(map_y.max()) + 2, height)
    region = image[y0:y1, x0:x1].astype(np.float32)
    level = cv2.remap(region, map_x - np.float32(x0), map_y - np.float32(y0), cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(level, np.float32)


def _peaks(strength: Floats, radii: Floats, guess: Circle, floor_dn: float, bulge_px: Floats | None) -> Edges:
    middle = strength[:, 1:-1]
    least = np.maximum(WEAKEST * strength.max(axis=1, keepdims=True), np.float32(floor_dn))
    peak = np.where((middle >= strength[:, :-2]) & (middle > strength[:, 2:]) & (middle > least), middle, np.float32(0.0))
    rows = np.arange(RAYS)
    radius = np.zeros((RAYS, EDGES), np.float32)
    there = np.zeros((RAYS, EDGES), bool)
    for n in range(EDGES):
        k = peak.argmax(axis=1)
        there[:, n] = peak[rows, k] > 0.0
        a, b, c = strength[rows, k], strength[rows, k + 1], strength[rows, k + 2]
        radius[:, n] = radii[k + 1] + 0.5 * (a - c) / np.minimum(a - 2.0 * b + c, np.float32(-1e-6))
        peak[rows, k] = 0.0
    if bulge_px is not None:
        radius -= bulge_px
    x, y, _ = guess
    return Edges(np.float32(x) + _COS[:, None] * radius, np.float32(y) + _SIN[:, None] * radius, there)


def _draw_triples() -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """Rays (TRIPLES, 3) about 120 deg apart and the edge to take on each: fixed, so that equal images give equal results."""
    random = np.random.default_rng(20)
    first = random.integers(0, RAYS, TRIPLES)
    apart = RAYS // 3
    rays = np.column_stack(
        (first, first + apart + random.integers(-8, 9, TRIPLES), first - apart + random.integers(-8, 9, TRIPLES))
    )
    which = random.choice(EDGES, (TRIPLES, 3), p=(0.7, 0.2, 0.1))
    return (rays % RAYS).astype(np.int64), which.astype(np.int64)


TRIPLE_RAYS, TRIPLE_EDGES = _draw_triples()


def radius_range(r_px: float, reach_px: float) -> tuple[float, float]:
    """Of the circles that may be meant by a guess."""
    return (1.0 - 1.5 * REACH_RATIO) * r_px - reach_px, (1.0 + 1.5 * REACH_RATIO) * r_px + reach_px


def _most_agreed(edges: Edges, r_px: float, reach_px: float) -> Circle | None:
    """The circle through three edges that most rays have an edge near to."""
    usable = edges.there[TRIPLE_RAYS, TRIPLE_EDGES].all(axis=1)
    px, py = edges.x_px[TRIPLE_RAYS, TRIPLE_EDGES][usable], edges.y_px[TRIPLE_RAYS, TRIPLE_EDGES][usable]
    x, y, r = _through_three(px.astype(np.float64), py.astype(np.float64))
    least, most = radius_range(r_px, reach_px)
    fits = (r > least) & (r < most)
    circles = np.column_stack((x, y, r))[fits]
    if len(circles) == 0:
        return None
    agreed = _agreed(edges, circles)
    best = int(agreed.argmax())
    if agreed[best] < ENOUGH_RAYS:
        return None
    return float(circles[best, 0]), float(circles[best, 1]), float(circles[best, 2])


def _agreed(edges: Edges, circles: Array) -> npt.NDArray[np.intp]:
    """How many rays have an edge near to each circle (m, 3), by |d^2 - r^2| < 2 r near: one product of matrices."""
    x0, y0 = float(edges.x_px[0, 0]), float(edges.y_px[0, 0])  # near by, for the digits of single precision
    px, py = (edges.x_px - np.float32(x0)).T.ravel(), (edges.y_px - np.float32(y0)).T.ravel()
    x, y, r = circles[:, 0] - x0, circles[:, 1] - y0, circles[:, 2]
    points = np.stack((px, py, np.ones_like(px), px * px + py * py))
    terms = np.column_stack((-2.0 * x, -2.0 * y, x * x + y * y - r * r, np.ones(len(r)))).astype(np.float32)
    near = np.abs(terms @ points) < (2.0 * NEAR_PX * r).astype(np.float32)[:, None]
    near &= edges.there.T.ravel()
    each = near.reshape(len(r), EDGES, RAYS)
    return np.asarray(np.count_nonzero(each[:, 0] | each[:, 1] | each[:, 2], axis=1))


def _through_three(px: Array, py: Array) -> tuple[Array, Array, Array]:
    """Circles through three points each, (m, 3) in; nearly straight triples get a huge radius."""
    ax, ay = px[:, 1] - px[:, 0], py[:, 1] - py[:, 0]
    bx, by = px[:, 2] - px[:, 0], py[:, 2] - py[:, 0]
    double = 2.0 * (ax * by - ay * bx)
    double = np.where(np.abs(double) < 1e-6, 1e-6, double)
    a2, b2 = ax * ax + ay * ay, bx * bx + by * by
    ux, uy = (by * a2 - ay * b2) / double, (ax * b2 - bx * a2) / double
    return px[:, 0] + ux, py[:, 0] + uy, np.hypot(ux, uy)


def _refined(edges: Edges, circle: Circle) -> Circle | None:
    """Tukey-weighted least squares over each ray's nearest edge."""
    x, y, r = circle
    rows = np.arange(RAYS)
    for _ in range(2):
        dx, dy = edges.x_px - np.float32(x), edges.y_px - np.float32(y)
        distance = np.sqrt(dx * dx + dy * dy)
        off = np.where(edges.there, distance - np.float32(r), np.float32(np.inf))
        k = np.abs(off).argmin(axis=1)
        e = off[rows, k].astype(np.float64)
        rho = np.maximum(distance[rows, k].astype(np.float64), 1e-3)
        near = np.abs(e) < TUKEY_PX
        e = np.where(near, e, 0.0)
        weight = np.where(near, (1.0 - (e / TUKEY_PX) ** 2) ** 2, 0.0)
        a = np.ones((RAYS, 3))
        a[:, 0], a[:, 1] = dx[rows, k] / rho, dy[rows, k] / rho
        normal = (a * weight[:, None]).T @ a + 1e-9 * np.eye(3)
        step = np.linalg.solve(normal, a.T @ (weight * e))
        x, y, r = x + float(step[0]), y + float(step[1]), r + float(step[2])
    return (x, y, r) if r > 1.0 else None
