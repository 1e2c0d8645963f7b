"""Every outline in an image that passes the fit and its verification."""

from collections.abc import Sequence
from math import hypot

from trackerd.contract.model import Found, Image
from trackerd.vision.curve import View
from trackerd.vision.locate import locate
from trackerd.vision.noise import NoiseModel
from trackerd.vision.rays import Circle
from trackerd.vision.search import Pyramid, circles_in
from trackerd.vision.verify import LEAST_COVERAGE_SEARCHED

SAME_RADII = 0.3  # two outlines nearer than this are one


def everywhere(
    image: Image, noise: NoiseModel, radius_px: tuple[float, float], view: View | None, scales: Sequence[int] = (4, 2)
) -> list[Found]:
    """All outlines of an admitted radius, in image coordinates, looked for in the pictures smaller by `scales`."""
    found: list[Found] = []
    pyramid = Pyramid.of(image)
    for scale in scales:
        for seed in circles_in(pyramid, radius_px, scale):
            if _is_one_of(seed[0], seed[1], found):
                continue
            outline = locate(image, seed, noise, view=view)
            if (
                isinstance(outline, Found)
                and _admitted(outline, radius_px)
                and not _is_one_of(outline.x_px, outline.y_px, found)
            ):
                found.append(outline)
    return found


def without(outlines: Sequence[Found], circle: Circle, radii: float) -> list[Found]:
    """Those whose centre is farther from a circle's than this many of its radii."""
    x, y, r = circle
    return [found for found in outlines if hypot(found.x_px - x, found.y_px - y) > radii * r]


def _admitted(outline: Found, radius_px: tuple[float, float]) -> bool:
    return outline.coverage >= LEAST_COVERAGE_SEARCHED and radius_px[0] <= outline.r_px <= radius_px[1]


def _is_one_of(x_px: float, y_px: float, found: Sequence[Found]) -> bool:
    return any(hypot(x_px - other.x_px, y_px - other.y_px) < SAME_RADII * other.r_px for other in found)
