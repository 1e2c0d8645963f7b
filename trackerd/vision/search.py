"""Circles anywhere in an image: seeds for the fit, good to a pixel or two, some of them wrong.

A Hough transform by arcs: the edges of a smaller picture are followed as chains of pixels, and points of a chain that lie on
one circle vote for it. That finds what HoughCircles finds, whose time is that of the circles it proposes (seconds in 3 Mpx of
clutter), and EdgeDrawing, whose detectEllipses of OpenCV 5.0 writes beyond its buffers on a picture of small squares.
A small picture is not only faster: weak and blurred edges are steeper in it, against less noise.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from trackerd.contract.model import Image
from trackerd.vision.arcs import circles_on
from trackerd.vision.rays import Circle

CANDIDATES = 6  # of each picture
SAME_SEED_PX = 2.5  # the fit looks round a seed for much more than this
SLACK = 0.15  # of a seed's radius
SMALLEST_SIDE_PX = 16  # of a picture that is worth a look
SMALLEST_RADIUS_PX = 3.0  # in the smaller picture
BUSY = 0.05  # share of pixels that may have a gradient worth following: in texture, only the strongest are followed
WEAKEST, STRONGEST = 24, 160  # gradients (Sobel, both directions' sum) that count as edges
NOISE_DN, WHITE_DN, WHITE_PERCENT = 2.0, 250.0, 99.9  # of deep images in 8 bits
SAMPLED_EVERY = 8  # rows and columns, for the above


@dataclass(frozen=True, slots=True)
class Pyramid:
    """One image in 8 bits: full, half and quarter size."""

    full: Image
    half: Image
    quarter: Image

    @staticmethod
    def of(image: Image) -> "Pyramid":
        full = eight_bits(image)
        half = _halved(full)
        return Pyramid(full, half, _halved(half))

    def at(self, scale: int) -> Image:
        return {1: self.full, 2: self.half, 4: self.quarter}[scale]


def candidates(image: Image, radius_px: tuple[float, float]) -> Iterator[Circle]:
    """Circles (x, y, r) to be fitted and verified: a picture is searched only if those before it are used up.

    Of 200 balls of radius 14 to 120 px and contrast 8 to 110 in clutter, 192 are among the quarter's, all among both.
    """
    pyramid = Pyramid.of(image)
    tried: list[Circle] = []
    for scale in (4, 2):
        for circle in circles_in(pyramid, radius_px, scale):
            if not any(same_seed(circle, other) for other in tried):
                tried.append(circle)
                yield circle


def same_seed(a: Circle, b: Circle) -> bool:
    """Whether a fit from the one would find what a fit from the other did."""
    return max(abs(a[0] - b[0]), abs(a[1] - b[1]), abs(a[2] - b[2])) < SAME_SEED_PX


def circles_in(pyramid: Pyramid, radius_px: tuple[float, float], scale: int) -> list[Circle]:
    """The best few of the picture that is smaller by `scale`, in pixels of the full one."""
    grey = pyramid.at(scale)
    smallest, largest = (1.0 - SLACK) * radius_px[0] / scale, (1.0 + SLACK) * radius_px[1] / scale
    if min(grey.shape) < SMALLEST_SIDE_PX or largest < SMALLEST_RADIUS_PX:
        return []
    chains, _ = cv2.findContours(_edges(grey), cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    found = circles_on(chains, (max(smallest, SMALLEST_RADIUS_PX), largest), CANDIDATES)
    return [((x + 0.5) * scale - 0.5, (y + 0.5) * scale - 0.5, r * scale) for x, y, r in found]


def eight_bits(image: Image) -> Image:
    """Deeper pixels scaled so that all but the brightest thousandth fit, unless that would show the noise as edges.

    Hot pixels, highlights and a dark picture do not matter: what is brighter than white stays white.
    """
    if image.dtype == np.uint8:
        return np.ascontiguousarray(image)
    rows = image[::SAMPLED_EVERY].astype(np.float32)
    white = max(float(np.percentile(rows[:, ::SAMPLED_EVERY], WHITE_PERCENT)), 1.0)
    noise = float(np.median(np.abs(np.diff(rows, axis=1)))) if rows.shape[1] > 1 else 0.0
    return cv2.convertScaleAbs(image, alpha=min(WHITE_DN / white, NOISE_DN / max(noise, 1.0)))


def _edges(grey: Image) -> Image:
    """Canny's, with a threshold that leaves few enough of them."""
    dx, dy = cv2.spatialGradient(np.ascontiguousarray(grey))
    strength = cv2.convertScaleAbs(np.abs(dx) + np.abs(dy))
    histogram = cv2.calcHist([strength], [0], None, [256], [0, 256]).ravel()
    stronger = np.cumsum(histogram[::-1])[::-1]  # pixels of at least each strength
    threshold = int(np.clip(np.count_nonzero(stronger > BUSY * grey.size), WEAKEST, STRONGEST))
    return cv2.Canny(dx, dy, threshold / 2, threshold)


def _halved(image: Image) -> Image:
    """Means of 2 x 2 pixels; an odd row or column is cut off, which keeps X = (x + 0.5) 2 - 0.5 exact."""
    height, width = max(image.shape[0] // 2, 1), max(image.shape[1] // 2, 1)
    return cv2.resize(image[: 2 * height, : 2 * width], (width, height), interpolation=cv2.INTER_AREA)
