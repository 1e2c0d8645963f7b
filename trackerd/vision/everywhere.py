"""Every outline in an image that passes the fit and its verification."""

from collections.abc import Iterable, Sequence
from math import hypot

import numpy as np

from trackerd.contract.model import Found, Image
from trackerd.vision.curve import View
from trackerd.vision.kernels import first_circle
from trackerd.vision.limb import LimbChoice
from trackerd.vision.locate import refine
from trackerd.vision.noise import NoiseModel
from trackerd.vision.rays import Circle, edges_on_rays
from trackerd.vision.search import Pyramid, circles_in, same_seed
from trackerd.vision.verify import LEAST_COVERAGE_SEARCHED

PROMISING_PX = 2.5  # from the circle; a smeared edge is not sharper than this
PROMISING_MARGIN = 0.05  # of the outline
ITSELF_RADII = 0.5  # two outlines so near to each other are one ball's
SIMILAR, SOMETHING = 1.15, 0.35  # ratio of the radii; share of the outline
SAME_RADII = 0.3  # two outlines nearer than this are one


def everywhere(
    image: Image,
    noise: NoiseModel,
    radius_px: tuple[float, float],
    view: View | None,
    scales: Sequence[int] = (4, 2),
    besides: Circle | None = None,
    limb: LimbChoice | None = None,
) -> list[Found]:
    """All outlines of an admitted radius, in image coordinates, looked for in the pictures smaller by `scales`.

    Not those whose centre is within half a radius of the circle `besides`, which is known. `limb` is the choice that was made
    for this light, if any: asking anew for each outline takes five times as long.
    """
    pyramid = Pyramid.of(image)
    seeds = (seed for scale in scales for seed in circles_in(pyramid, radius_px, scale))
    return outlines_at(image, noise, seeds, radius_px, view, besides, limb)


def outlines_at(
    image: Image,
    noise: NoiseModel,
    seeds: Iterable[Circle],
    radius_px: tuple[float, float],
    view: View | None,
    besides: Circle | None = None,
    limb: LimbChoice | None = None,
) -> list[Found]:
    """As `everywhere`, from seeds that are given."""
    found: list[Found] = []
    tried: list[Circle] = []
    known = (0.0, 0.0, 0.0) if besides is None else besides
    chosen = None if limb is None else limb.kept()
    for seed in seeds:
        if (
            _is_in(seed[0], seed[1], known)
            or _is_one_of(seed[0], seed[1], found)
            or any(same_seed(seed, other) for other in tried)
        ):
            continue
        tried.append(seed)
        first = first_circle(image, seed, noise)
        if first is None or not _is_promising(image, first, noise):
            continue
        outline = refine(image, first, noise, view, chosen)
        if (
            isinstance(outline, Found)
            and _admitted(outline, radius_px)
            and not _is_in(outline.x_px, outline.y_px, known)
            and not _is_one_of(outline.x_px, outline.y_px, found)
        ):
            found.append(outline)
    return found


def is_something_at(image: Image, noise: NoiseModel, circle: Circle) -> bool:
    """Whether edges speak for a circle of this size about there, be they too few for an outline."""
    first = first_circle(image, circle, noise)
    if first is None or not circle[2] / SIMILAR < first[2] < circle[2] * SIMILAR:
        return False
    return _is_in(first[0], first[1], circle) and _share_of_edges(image, first, noise) >= SOMETHING


def _is_in(x_px: float, y_px: float, known: Circle) -> bool:
    return hypot(x_px - known[0], y_px - known[1]) < ITSELF_RADII * known[2]


def _is_promising(image: Image, circle: Circle, noise: NoiseModel) -> bool:
    """Whether enough rays meet an edge near a circle: a tenth of a fit's time, which is longest where there is no outline."""
    return _share_of_edges(image, circle, noise) >= LEAST_COVERAGE_SEARCHED - PROMISING_MARGIN


def _share_of_edges(image: Image, circle: Circle, noise: NoiseModel) -> float:
    edges = edges_on_rays(image, circle, noise, PROMISING_PX)
    off = np.hypot(edges.x_px - circle[0], edges.y_px - circle[1]) - circle[2]
    near = ((np.abs(off) < PROMISING_PX) & edges.there).any(axis=1)
    return float(near.mean())


def _admitted(outline: Found, radius_px: tuple[float, float]) -> bool:
    return outline.coverage >= LEAST_COVERAGE_SEARCHED and radius_px[0] <= outline.r_px <= radius_px[1]


def _is_one_of(x_px: float, y_px: float, found: Sequence[Found]) -> bool:
    return any(hypot(x_px - other.x_px, y_px - other.y_px) < SAME_RADII * other.r_px for other in found)
