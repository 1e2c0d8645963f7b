"""What else finds a circle in an image: each as a user of its library would call it, and helped where that is fair.

All get the same crop about the same guess and the range of radii that the guess allows, or a whole image and all radii. An
answer that no user would take for the guessed ball (another radius, another place) is none; of several the strongest counts
where a peer ranks them, else the one nearest to the guess. Radii are sqrt(a b) where an ellipse is found; integer coordinates
are pixel centres.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from math import hypot, inf, sqrt
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from trackerd.contract.model import Image

try:
    from skimage.filters import gaussian, threshold_otsu
    from skimage.measure import CircleModel, find_contours, ransac
except ImportError:
    SKIMAGE = False
else:
    SKIMAGE = True

_cv2: Any = cv2  # its stubs lack parts of the contributed modules

Circle = tuple[float, float, float]  # x, y, r
Points = npt.NDArray[np.float64]  # (n, 2)


@dataclass(frozen=True, slots=True)
class Wanted:
    """A ball about here, of a radius in this range; coordinates are the image's."""

    x_px: float
    y_px: float
    radii_px: tuple[float, float]
    apart_px: float  # how far an answer may be off

    @property
    def whole_radii(self) -> tuple[int, int]:
        return max(int(self.radii_px[0]), 1), int(np.ceil(self.radii_px[1]))


Peer = Callable[[Image, Wanted], Circle | None]

RADII = 0.2  # of the guessed radius to either side: the guess is off by up to 8 %
APART_PX, APART_RADII = 10.0, 0.15  # how far an answer may be from the guess: that is off by up to 6 px in x and in y
CROP_RADII, CROP_PX = 1.4, 12.0  # from the guess to the crop's border
CANNY = 50.0, 100.0  # of 8-bit images
NEAR_PX = 3.0  # an edge this near to Hough's circle belongs to it
VOTES = 20  # of HoughCircles
PERFECT = 0.8  # of HOUGH_GRADIENT_ALT, as its documentation advises for circles that are not quite perfect
GRADIENT = 20  # of EdgeDrawing
OFF_CONTOUR_PX = 0.5  # of scikit-image's RANSAC
TRIALS = 100  # of the same


def near_guess(peer: Peer, image: Image, guess: Circle) -> Circle | None:
    """The peer's answer in the coordinates of a whole image."""
    x, y, r = guess
    reach = CROP_RADII * r + CROP_PX
    left, top = max(round(x - reach), 0), max(round(y - reach), 0)
    crop = image[top : max(round(y + reach) + 1, 0), left : max(round(x + reach) + 1, 0)]
    if crop.size == 0:
        return None
    radii = (1.0 - RADII) * r, (1.0 + RADII) * r
    found = peer(np.ascontiguousarray(crop), Wanted(x - left, y - top, radii, APART_PX + APART_RADII * r))
    return None if found is None else (found[0] + left, found[1] + top, found[2])


def anywhere(peer: Peer, image: Image, radii_px: tuple[float, float]) -> Circle | None:
    """The peer's answer where nothing is known but the range of radii."""
    height, width = image.shape
    return peer(image, Wanted(0.5 * width, 0.5 * height, radii_px, inf))


# ---- the peers -------------------------------------------------------------------------------------------------------


def hough(image: Image, wanted: Wanted) -> Circle | None:
    smallest, largest = wanted.whole_radii
    found = cv2.HoughCircles(image, cv2.HOUGH_GRADIENT, 1, 8, None, CANNY[1], VOTES, smallest, largest)
    return next(_plausible(_rows(found), wanted), None)


def hough_alt(image: Image, wanted: Wanted) -> Circle | None:
    smallest, largest = wanted.whole_radii
    found = cv2.HoughCircles(image, cv2.HOUGH_GRADIENT_ALT, 1.5, 8, None, 300, PERFECT, smallest, largest)
    return next(_plausible(_rows(found), wanted), None)


def hough_canny_circle(image: Image, wanted: Wanted) -> Circle | None:
    """The source thesis's chain: Canny's edges near Hough's circle, and the circle of least squares through them."""
    seed = hough(image, wanted)
    if seed is None:
        return None
    rows, columns = np.nonzero(cv2.Canny(image, *CANNY))
    points = np.column_stack((columns, rows)).astype(np.float64)
    near = np.abs(np.hypot(points[:, 0] - seed[0], points[:, 1] - seed[1]) - seed[2]) < NEAR_PX
    return _nearest(_least_squares(points[near]), wanted)


def blob(image: Image, wanted: Wanted) -> Circle | None:
    smallest, largest = wanted.whole_radii
    settings = _cv2.SimpleBlobDetector_Params()
    settings.filterByColor = settings.filterByInertia = False
    settings.filterByArea, settings.filterByCircularity, settings.filterByConvexity = True, True, True
    settings.minArea, settings.maxArea = np.pi * smallest**2, np.pi * largest**2
    settings.minCircularity, settings.minConvexity = 0.7, 0.8
    points = _cv2.SimpleBlobDetector_create(settings).detect(image)
    return _nearest([(p.pt[0], p.pt[1], 0.5 * p.size) for p in points], wanted)


def ellipse_on_canny(image: Image, wanted: Wanted) -> Circle | None:
    edges = cv2.Canny(image, *CANNY)
    contours, _ = cv2.findContours(edges, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    return _nearest([_of_ellipse(cv2.fitEllipse(contour)) for contour in contours if len(contour) > wanted.radii_px[0]], wanted)


def edge_drawing(image: Image, wanted: Wanted) -> Circle | None:
    drawing = _cv2.ximgproc.createEdgeDrawing()
    settings = _cv2.ximgproc_EdgeDrawing_Params()  # with its validation, which is on by default
    settings.GradientThresholdValue = GRADIENT
    drawing.setParams(settings)
    drawing.detectEdges(image)
    found = _rows(drawing.detectEllipses())  # x, y, radius of a circle (0: it is an ellipse), a, b, angle
    return _nearest([(x, y, r if r > 0.0 else sqrt(a * b)) for x, y, r, a, b, _ in found], wanted)


def skimage_contours(image: Image, wanted: Wanted) -> Circle | None:
    """Contours half-way between dark and bright, smoothed a little, and a robust circle through the longest of them."""
    smooth = gaussian(image.astype(np.float64), 1.0)
    if smooth.min() == smooth.max():
        return None
    contours = find_contours(smooth, threshold_otsu(smooth))
    return _nearest(
        [c for contour in contours if len(contour) > wanted.radii_px[0] for c in _robust_circle(contour[:, ::-1])], wanted
    )


PEERS: dict[str, Peer] = {
    "HoughCircles": hough,
    "HOUGH_GRADIENT_ALT": hough_alt,
    "Hough + Canny + least squares": hough_canny_circle,
    "SimpleBlobDetector": blob,
    "fitEllipse on Canny": ellipse_on_canny,
    "EdgeDrawing": edge_drawing,
} | ({"scikit-image contours + RANSAC": skimage_contours} if SKIMAGE else {})

ABSENT = "" if SKIMAGE else "scikit-image is not installed and not compared: pip install 'trackerd[bench]'"


# ---- what they share -------------------------------------------------------------------------------------------------


def _rows(found: Any) -> list[list[float]]:
    """OpenCV gives None, (1, n, k) or (n, 1, k)."""
    return [] if found is None else np.asarray(found, np.float64).reshape(-1, np.shape(found)[-1]).tolist()


def _plausible(circles: Iterable[Iterable[float]], wanted: Wanted) -> Iterator[Circle]:
    smallest, largest = wanted.radii_px
    for x, y, r in circles:
        if smallest <= r <= largest and _off_px(x, y, wanted) <= wanted.apart_px:
            yield x, y, r


def _nearest(circles: Iterable[Iterable[float]], wanted: Wanted) -> Circle | None:
    return min(_plausible(circles, wanted), key=lambda c: _off_px(c[0], c[1], wanted), default=None)


def _off_px(x: float, y: float, wanted: Wanted) -> float:
    return hypot(x - wanted.x_px, y - wanted.y_px)


def _least_squares(points: Points) -> list[Circle]:
    """Of the distances from the circle: algebraic first, then two steps of Gauss and Newton."""
    if len(points) < 8:
        return []
    x, y = points.T
    a = np.column_stack((x, y, np.ones_like(x)))
    (p, q, s), *_ = np.linalg.lstsq(a, x * x + y * y, rcond=None)
    cx, cy = 0.5 * p, 0.5 * q
    r = sqrt(max(s + cx * cx + cy * cy, 1.0))
    for _ in range(2):
        rho = np.maximum(np.hypot(x - cx, y - cy), 1e-9)
        step, *_ = np.linalg.lstsq(np.column_stack(((x - cx) / rho, (y - cy) / rho, np.ones_like(x))), rho - r, rcond=None)
        cx, cy, r = cx + step[0], cy + step[1], r + step[2]
    return [(float(cx), float(cy), float(r))]


def _of_ellipse(found: Any) -> Circle:
    (x, y), (long, short), _ = found
    return x, y, 0.5 * sqrt(max(long * short, 0.0))


def _robust_circle(points: Points) -> list[Circle]:
    model, inliers = ransac(points, CircleModel, 3, OFF_CONTOUR_PX, max_trials=TRIALS, rng=1)
    return [] if model is None or inliers is None else _least_squares(points[inliers])
