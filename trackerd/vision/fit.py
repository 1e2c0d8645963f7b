"""Subpixel circle: Gauss-Newton on the raw pixels of a ring, an edge model per sector, one circle and one blur for all.

The model and its maths are in by_numpy. First for a sharp edge, in a narrow ring (clutter is near); where that is not what the
image shows, in wider rings, with a blur that may depend on the direction.
"""

from trackerd.contract.model import Image
from trackerd.vision.annulus import ring_for, sectors_of
from trackerd.vision.convergence import SIGMA_RANGE_PX, CircleFit, Converge, Start
from trackerd.vision.curve import View, circle
from trackerd.vision.kernels import converge
from trackerd.vision.noise import NoiseModel
from trackerd.vision.rays import Circle

SIGMA_START_PX = 0.95  # optics and pixel of a sharp picture
BLURRED_PX, BLURRED_CHI2 = 1.2, 1.6  # a wider edge, or half of the sectors worse than this: out of focus or in motion
WIDER_PX, WIDER_RINGS = 2.0, 3  # the first wider ring is good up to this blur
SMEARED_PX, SMEARED_CHI2 = 3.4, 6.0  # and this one's for an image that is far from a sharp edge


NO_LIGHT = (0.0, 0.0, 0.0)  # of the limb term: to be found
ROUNDS = 4  # of making the curve anew where the fit has moved


def fit_circle(
    image: Image,
    start: Circle,
    noise: NoiseModel,
    view: View | None = None,
    limb: bool = False,
    kernel: Converge | None = None,
) -> CircleFit | None:
    """Fit from a start that is good to about 1.5 px. None: it ran away, or the image does not determine an outline.

    With a view the outline is the sphere's through this lens, else a circle. `limb`: with the limb term.
    """
    fitter = _Fitter(image, noise, view, kernel or converge())
    fit = fitter.fit(Start(*start, (SIGMA_START_PX**2,)), SIGMA_START_PX)
    if limb:  # also where a flat ball's model finds no outline
        shaded = (
            Start(*start, (SIGMA_START_PX**2,), NO_LIGHT) if fit is None else _from(fit, tuple(fit.blur_px2.tolist()), limb)
        )
        fit = fitter.fit(shaded, SIGMA_START_PX)
    if fit is None:
        return None
    widest_px = WIDER_PX if fit.chi2 < SMEARED_CHI2 else SMEARED_PX
    for _ in range(WIDER_RINGS):
        if not (fit.sigma_px > 0.9 * widest_px or _is_blurred(fit)):
            break
        wide = fitter.fit(_from(fit, (fit.sigma_px**2, 0.0, 0.0), limb), widest_px)
        if wide is None or wide.sigma_px <= 0.9 * widest_px:
            return wide
        fit, widest_px = wide, min(1.25 * wide.sigma_px, SIGMA_RANGE_PX[1])
    return fit


def _from(fit: CircleFit, blur_px2: tuple[float, ...], limb: bool) -> Start:
    limb_dn = tuple(fit.limb_dn.tolist()) or NO_LIGHT
    return Start(fit.x_px, fit.y_px, fit.r_px, blur_px2, limb_dn if limb else ())


class _Fitter:
    """One image, to be fitted in several ways."""

    def __init__(self, image: Image, noise: NoiseModel, view: View | None, kernel: Converge) -> None:
        self._image, self._noise, self._view, self._kernel = image, noise, view, kernel

    def fit(self, start: Start, sigma_px: float) -> CircleFit | None:
        """In the ring for a blur of sigma."""
        if self._view is None:
            pixels = ring_for(start.r_px, sigma_px)
            return self._kernel(self._image, pixels, circle(len(pixels.count)), start, self._noise)
        for _ in range(ROUNDS):
            fit = self._fit_curve(start, sigma_px, self._view)
            if fit is None or self._view.holds(fit.x_px, fit.y_px, fit.r_px, fit.curve):
                return fit
            start = Start(fit.x_px, fit.y_px, fit.r_px, tuple(fit.blur_px2.tolist()), tuple(fit.limb_dn.tolist()))
        return None

    def _fit_curve(self, start: Start, sigma_px: float, view: View) -> CircleFit | None:
        sectors = sectors_of(start.r_px)
        try:
            curve = view.curve(start.x_px, start.y_px, start.r_px, sectors)
        except ValueError:
            return None
        pixels = ring_for(start.r_px, sigma_px, curve.reach_px)
        return self._kernel(self._image, pixels, curve, start, self._noise)


def _is_blurred(fit: CircleFit) -> bool:
    return fit.sigma_px > BLURRED_PX or fit.chi2 > BLURRED_CHI2
