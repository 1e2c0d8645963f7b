"""What a lens and a pixel do to the light of a scene: smear, blur circle, Gaussian blur, the integral over the pixel's area.

Everything works on subpixels that hold the mean of their own area. That mean is already a blur, of variance h^2/12 for a
subpixel of side h (and so is that of the blur circle's); it is taken off the Gaussian's: an error of fourth order is left.
"""

from functools import lru_cache
from math import ceil, erf, sqrt

import cv2
import numpy as np

from trackerd.contract.model import Array
from trackerd.sim.raster import half_plane_cover

REACH = 6.5  # sigmas from its middle at which the Gaussian ends: 1e-10
BLOCK_PX = 32  # pixels that are gathered at once: a narrow band of subpixels, no larger than the caches


def margin_px(psf_px: float, defocus_px: float, motion_px: tuple[float, float]) -> int:
    """Pixels round an image from which light still comes into it."""
    return ceil(REACH * psf_px + 0.5 + defocus_px + 0.5 * max(abs(motion_px[0]), abs(motion_px[1]))) + 1


def gather(light: Array, fine: int, margin: int, psf_px: float, means: int = 1) -> Array:
    """Pixels (height, width) of subpixels ((height + 2 margin) fine, (width + 2 margin) fine): Gaussian blur and pixel area.

    `means` counts how often a mean over the subpixels' area has been taken already.
    """
    kernel = _pixel_kernel(fine, margin, sqrt(psf_px * psf_px - means / (12.0 * fine * fine)))
    rows = _gather_rows(light, fine, margin, kernel)
    return np.ascontiguousarray(_gather_rows(np.ascontiguousarray(rows.T), fine, margin, kernel).T)


def defocus(light: Array, fine: int, radius_px: float) -> Array:
    """A blur circle, evenly filled: what a point out of focus becomes. Of the outermost `radius_px`, nothing is said."""
    size = _fast_size(light)
    spectrum = np.fft.rfft2(light, size) * _blur_circle(size, fine, radius_px)
    return np.asarray(np.fft.irfft2(spectrum, size)[: light.shape[0], : light.shape[1]])


def smear(light: Array, fine: int, motion_px: tuple[float, float]) -> Array:
    """The mean over an even motion, centred. Of the outermost half motion, nothing is said."""
    size = _fast_size(light)
    spectrum = np.fft.rfft2(light, size) * _smear(size, fine, motion_px)
    return np.asarray(np.fft.irfft2(spectrum, size)[: light.shape[0], : light.shape[1]])


def _fast_size(light: Array) -> tuple[int, int]:
    """At least that of the light: with small prime factors."""
    return cv2.getOptimalDFTSize(light.shape[0]), cv2.getOptimalDFTSize(light.shape[1])


@lru_cache(maxsize=8)
def _smear(size: tuple[int, int], fine: int, motion_px: tuple[float, float]) -> Array:
    fy = np.fft.fftfreq(size[0])[:, None] * (motion_px[1] * fine)
    fx = np.fft.rfftfreq(size[1])[None, :] * (motion_px[0] * fine)
    return np.asarray(np.sinc(fx + fy))


def _gather_rows(light: Array, fine: int, margin: int, kernel: Array) -> Array:
    """Over the first axis."""
    height = light.shape[0] // fine - 2 * margin
    out = np.empty((height, light.shape[1]))
    for first in range(0, height, BLOCK_PX):
        count = min(BLOCK_PX, height - first)
        band = _band(count, fine, tuple(kernel.tolist()))
        begin = first * fine
        np.matmul(band, light[begin : begin + band.shape[1]], out=out[first : first + count])
    return out


@lru_cache(maxsize=64)
def _band(count: int, fine: int, kernel: tuple[float, ...]) -> Array:
    """Weights (count, subpixels) of successive pixels."""
    band = np.zeros((count, (count - 1) * fine + len(kernel)))
    for n in range(count):
        band[n, n * fine : n * fine + len(kernel)] = kernel
    return band


@lru_cache(maxsize=32)
def _pixel_kernel(fine: int, margin: int, sigma_px: float) -> Array:
    """Weights of the (1 + 2 margin) fine subpixels about a pixel."""
    offset = (np.arange((1 + 2 * margin) * fine) + 0.5) / fine - 0.5 - margin
    scale = 1.0 / (sqrt(2.0) * sigma_px)
    weights = np.array([erf((t + 0.5) * scale) - erf((t - 0.5) * scale) for t in offset])
    return np.asarray(weights / weights.sum())


@lru_cache(maxsize=8)
def _blur_circle(size: tuple[int, int], fine: int, radius_px: float) -> Array:
    """Its transform; it stands about subpixel (0, 0)."""
    y = np.fft.fftfreq(size[0], 1.0 / size[0])[:, None]
    x = np.fft.fftfreq(size[1], 1.0 / size[1])[None, :]
    distance = np.maximum(np.hypot(x, y), 1e-9)
    disc = half_plane_cover(radius_px * fine - distance, x / distance, y / distance)
    return np.asarray(np.fft.rfft2(disc / disc.sum()))
