"""Subpixel circle: Gauss-Newton on the raw pixels of a ring, an edge model per sector, one circle and one blur for all.

The model and its maths are in by_numpy. First for a sharp edge, in a narrow ring (clutter is near); where that is not what the
image shows, in wider rings, with a blur that may depend on the direction.
"""

from trackerd.contract.model import Image
from trackerd.vision.annulus import ring_for
from trackerd.vision.convergence import SIGMA_RANGE_PX, CircleFit, Converge
from trackerd.vision.kernels import converge
from trackerd.vision.noise import NoiseModel
from trackerd.vision.rays import Circle

SIGMA_START_PX = 0.95  # optics and pixel of a sharp picture
BLURRED_PX, BLURRED_CHI2 = 1.2, 1.6  # a wider edge, or half of the sectors worse than this: out of focus or in motion
WIDER_PX, WIDER_RINGS = 2.0, 3  # the first wider ring is good up to this blur
SMEARED_PX, SMEARED_CHI2 = 3.4, 6.0  # and this one's for an image that is far from a sharp edge


def fit_circle(image: Image, start: Circle, noise: NoiseModel, kernel: Converge | None = None) -> CircleFit | None:
    """Fit from a start that is good to about 1.5 px. None: it ran away, or the image does not determine a circle."""
    kernel = kernel or converge()
    fit = kernel(image, ring_for(start[2], SIGMA_START_PX), start, (SIGMA_START_PX**2,), noise)
    if fit is None:
        return None
    widest_px = WIDER_PX if fit.chi2 < SMEARED_CHI2 else SMEARED_PX
    for _ in range(WIDER_RINGS):
        if not (fit.sigma_px > 0.9 * widest_px or _is_blurred(fit)):
            break
        pixels = ring_for(fit.r_px, widest_px)
        wide = kernel(image, pixels, (fit.x_px, fit.y_px, fit.r_px), (fit.sigma_px**2, 0.0, 0.0), noise)
        if wide is None or wide.sigma_px <= 0.9 * widest_px:
            return wide
        fit, widest_px = wide, min(1.25 * wide.sigma_px, SIGMA_RANGE_PX[1])
    return fit


def _is_blurred(fit: CircleFit) -> bool:
    return fit.sigma_px > BLURRED_PX or fit.chi2 > BLURRED_CHI2
