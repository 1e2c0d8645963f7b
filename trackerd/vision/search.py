"""Circles anywhere in an image: seeds for the fit, good to a pixel or two, many of them wrong."""

from collections.abc import Iterator
from typing import Any

import cv2
import numpy as np

from trackerd.contract.model import Image
from trackerd.vision.rays import Circle

_cv2: Any = cv2  # its stubs lack the settings of EdgeDrawing

CANNY_HIGH, VOTES = 30, 18  # of HoughCircles at half size: found 118 of 120 balls down to 16 grey levels of contrast
CANDIDATES = 6
BUSY = 0.06  # share of edge pixels from which HoughCircles takes 50 ms and more at 640 x 480, and finds chance circles
ED_GRADIENT = 20
ROUND = 0.8  # smallest ratio of an ellipse's axes that may still be a ball with a part of it hidden


def candidates(image: Image, radius_px: tuple[float, float]) -> Iterator[Circle]:
    """Circles (x, y, r) to be fitted and verified: the cheap search's first; the thorough one runs only if they are used up."""
    grey = _eight_bits(image)
    yield from hough_circles(grey, radius_px)
    yield from edge_circles(grey, radius_px)


def hough_circles(grey: Image, radius_px: tuple[float, float]) -> list[Circle]:
    """The best few of HoughCircles at half size; none in a picture that is all edges."""
    half = cv2.resize(grey, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    threshold = _edge_threshold(half)
    if threshold is None:
        return []
    smallest, largest = max(int(radius_px[0] / 2.0), 2), int(np.ceil(radius_px[1] / 2.0)) + 1
    found = cv2.HoughCircles(
        half,
        cv2.HOUGH_GRADIENT,
        1.5,
        minDist=max(smallest, 8),
        param1=threshold,
        param2=VOTES,
        minRadius=smallest,
        maxRadius=largest,
    )
    if found is None:
        return []
    return [(2.0 * x + 0.5, 2.0 * y + 0.5, 2.0 * r) for x, y, r in found.reshape(-1, 3)[:CANDIDATES].astype(float)]


def edge_circles(grey: Image, radius_px: tuple[float, float]) -> list[Circle]:
    """The roundest ellipses of EdgeDrawing at full size: slower, and finds weak and partly hidden outlines."""
    drawing = cv2.ximgproc.createEdgeDrawing()
    settings = _cv2.ximgproc_EdgeDrawing_Params()  # NFA validation is on by default: without it, hundreds a frame
    settings.GradientThresholdValue = ED_GRADIENT
    drawing.setParams(settings)
    drawing.detectEdges(grey)
    found = drawing.detectEllipses()
    if found is None:
        return []
    circles = []
    for x, y, radius, a, b, _ in found.reshape(-1, 6).astype(float):
        long, short = (radius, radius) if radius > 0.0 else (max(a, b), min(a, b))  # a circle has no axes
        r = float(np.sqrt(long * short))
        if short >= ROUND * long and radius_px[0] <= r <= radius_px[1]:
            circles.append((short / long, (x, y, r)))
    return [circle for _, circle in sorted(circles, reverse=True)[:CANDIDATES]]


def _edge_threshold(half: Image) -> int | None:
    """The lowest Canny threshold that leaves a picture of few edges."""
    for threshold in (CANNY_HIGH, 2 * CANNY_HIGH, 4 * CANNY_HIGH):
        if cv2.countNonZero(cv2.Canny(half, threshold / 2, threshold)) <= BUSY * half.size:
            return threshold
    return None


def _eight_bits(image: Image) -> Image:
    """Deeper pixels are scaled so that the brightest is 255."""
    if image.dtype == np.uint8:
        return np.ascontiguousarray(image)
    return cv2.convertScaleAbs(image, alpha=255.0 / max(float(image.max()), 1.0))
