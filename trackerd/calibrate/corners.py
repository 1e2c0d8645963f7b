"""Corners of squares to a fraction of a pixel: OpenCV's cornerSubPix in a window as large as the neighbours allow."""

import cv2
import numpy as np

from trackerd.contract.model import Array, Image

CLEAR_SHARE = 0.35  # of the distance to the next corner: the window may be turned, and its corners reach 1.4 times as far
SMALLEST_WINDOW, LARGEST_WINDOW = 2, 12  # half, in px; more than 12 px of edge add little and bend with the distortion
STEPS = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 100, 1e-5)
FARTHEST_SHARE = 0.5  # of the window: a corner that moves farther was none
WORST_CONDITION = 1e6  # of the gradients: an edge is no corner
FLOOR_PX, FLOOR_BY_WINDOW_PX2 = 0.015, 0.12  # of the detector itself, from rendered pictures: a small window is worse
NOISE_KERNEL = np.array([[1.0, -2.0, 1.0], [-2.0, 4.0, -2.0], [1.0, -2.0, 1.0]]) / 6.0  # blind to slopes (Immerkaer 1996)
NORMAL = 1.4826  # sigma over median deviation of a normal distribution


def refine(image: Image, q_px: Array, clear_px: Array) -> tuple[Array, Array]:
    """Corners (k, 2) and their sigma (k,), px, from a start that is good to a few px; `clear_px` (k,): half of the largest
    window that has no other edges in it than the corner's own.

    A corner that ran away keeps its start, and gets the distance as its sigma.
    """
    grey = image.astype(np.float32)
    found, sigma = q_px.astype(np.float32), np.empty(len(q_px))
    half = np.clip(np.floor(clear_px), SMALLEST_WINDOW, LARGEST_WINDOW).astype(int)
    for size in np.unique(half):
        chosen = half == size
        start = np.ascontiguousarray(found[chosen])
        found[chosen] = cv2.cornerSubPix(grey, start, (int(size), int(size)), (-1, -1), STEPS)
    noise_dn = noise_of(grey)
    for k, (q, size) in enumerate(zip(found, half, strict=True)):
        sigma[k] = np.sqrt(FLOOR_PX**2 + (FLOOR_BY_WINDOW_PX2 / size) ** 2 + _sigma(grey, q, int(size), noise_dn) ** 2)
    moved = np.linalg.norm(found - q_px, axis=1)
    ran = moved > FARTHEST_SHARE * half
    return np.where(ran[:, None], q_px, found).astype(np.float64), np.where(ran, moved, sigma)


def noise_of(grey: Image) -> float:
    """Sigma of a picture's pixels, DN; at least that of rounding."""
    deviation = np.abs(cv2.filter2D(grey, cv2.CV_32F, NOISE_KERNEL))
    return float(max(NORMAL * np.median(deviation), 1.0 / np.sqrt(12.0)))


def spacing(q_px: Array) -> Array:
    """Distance of each point (k, 2) to the nearest other one, px."""
    distance = np.linalg.norm(q_px[:, None] - q_px[None], axis=2)
    np.fill_diagonal(distance, np.inf)
    return np.asarray(distance.min(1))


def _sigma(grey: Image, q_px: Image, half: int, noise_dn: float) -> float:
    """Of a coordinate, the larger: q solves sum w g g^T (p - q) = 0 over the window's pixels p with their gradients g, whose
    noise moves it by (sum w g g^T)^-1 sum w g (noise of g . (p - q))."""
    patch = cv2.getRectSubPix(grey, (2 * half + 3, 2 * half + 3), tuple(map(float, q_px))).astype(np.float64)
    slopes = np.stack((patch[1:-1, 2:] - patch[1:-1, :-2], patch[2:, 1:-1] - patch[:-2, 1:-1])).reshape(2, -1)
    along = np.arange(-half, half + 1) / half
    distance2 = half**2 * np.add.outer(along**2, along**2).ravel()
    weights = np.exp(-distance2 / half**2)  # cornerSubPix's own
    information = (slopes * weights) @ slopes.T
    if not np.linalg.cond(information) < WORST_CONDITION:
        return float(half)
    inverse = np.linalg.inv(information)
    scatter = (slopes * weights**2 * distance2) @ slopes.T * 2.0 * noise_dn**2
    return float(np.sqrt(np.linalg.eigvalsh(inverse @ scatter @ inverse)[-1]))
