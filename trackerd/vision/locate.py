"""The outline of the ball in one image: near a guess, or anywhere. Every answer has passed the same fit and verification."""

from math import hypot, isfinite

import numpy as np

from trackerd.contract.model import Found, Image, Missed, Outline
from trackerd.vision.convergence import CircleFit
from trackerd.vision.curve import View
from trackerd.vision.fit import fit_circle
from trackerd.vision.kernels import first_circle
from trackerd.vision.limb import LimbChoice, evidence
from trackerd.vision.noise import NoiseModel
from trackerd.vision.rays import REACH_PX, Circle
from trackerd.vision.search import candidates
from trackerd.vision.verify import LEAST_COVERAGE, LEAST_COVERAGE_SEARCHED, verified

RADIUS_PX = (4.0, 2000.0)  # what the ring and its sectors can do
SEARCHED_PX = (12.0, 250.0)
SMALLEST_IMAGE_PX = 16
GUESSED_RADII = 3.0
NEAR_RADII = 1.2  # a target chosen by pixel is the nearest outline within this many of its radii,
PATCH_RADII = 0.25  # whose level a patch of this radius about the pixel has: not that of something in front of it


def locate(
    image: Image,
    guess: Circle | None,
    noise: NoiseModel = NoiseModel(),  # noqa: B008
    reach_px: float = REACH_PX,
    view: View | None = None,
    limb: LimbChoice | None = None,
) -> Outline:
    """Outline of the ball; coordinates are the image's own, an integer is a pixel's centre.

    With a guess (x, y, r) the outline is looked for within r (1 ± 0.2) ± `reach_px` of the guessed centre; without, everywhere.
    With a view it is the outline of a sphere behind that lens, else a circle. `limb` keeps the choice of the limb term from
    frame to frame; without, this image decides.
    Raises TypeError for pixels that are not uint8 or uint16, ValueError for an image that is not (height, width).
    """
    check_image(image)
    if guess is None:
        return search(image, noise, view=view)
    refusal = _refusal(image, guess)
    return Missed(refusal) if refusal else _outline(image, guess, noise, LEAST_COVERAGE, reach_px, view, limb)


def refine(image: Image, guess: Circle, noise: NoiseModel, view: View | None = None, limb: LimbChoice | None = None) -> Outline:
    """As `locate`, for a guess that is a prediction good to about 1.5 px: the fit alone, without looking around first."""
    check_image(image)
    refusal = _refusal(image, guess)
    return Missed(refusal) if refusal else _fitted(image, guess, noise, LEAST_COVERAGE, view, limb)


def search(
    image: Image,
    noise: NoiseModel,
    radius_px: tuple[float, float] = SEARCHED_PX,
    near_px: tuple[float, float] | None = None,
    view: View | None = None,
    guessed: bool = False,
) -> Outline:
    """The outline with the best coverage of those found anywhere, or the nearest one that a pixel belongs to.

    `guessed`: the pixel may be off by three radii.
    """
    check_image(image)
    if min(image.shape) < SMALLEST_IMAGE_PX:
        return Missed(f"the image of {image.shape[1]} x {image.shape[0]} px is too small to search")
    found: list[Found] = []
    for seed in candidates(image, radius_px):
        if _refusal(image, seed) or any(_same(seed, other) for other in found):
            continue
        outline = _outline(image, seed, noise, LEAST_COVERAGE_SEARCHED, REACH_PX, view)
        if isinstance(outline, Missed) or not radius_px[0] <= outline.r_px <= radius_px[1]:
            continue
        if near_px is None:
            return outline
        found.append(outline)
    within = [f for f in found if near_px is not None and _has(f, near_px, None if guessed else image)]
    if near_px is None:
        return Missed("nothing round in the image passes the verification")
    if not within:
        return Missed(f"no ball at pixel ({near_px[0]:.0f}, {near_px[1]:.0f})")
    return min(within, key=lambda f: _distance(f, near_px))


def check_image(image: Image) -> None:
    if not isinstance(image, np.ndarray) or image.dtype not in (np.uint8, np.uint16):
        raise TypeError(f"an image of uint8 or uint16 is expected, not {getattr(image, 'dtype', type(image).__name__)}")
    if image.ndim != 2 or image.size == 0:
        raise ValueError(f"an image of shape (height, width) is expected, not {image.shape}")


def _outline(
    image: Image,
    guess: Circle,
    noise: NoiseModel,
    least_coverage: float,
    reach_px: float,
    view: View | None = None,
    limb: LimbChoice | None = None,
) -> Outline:
    first = first_circle(image, guess, noise, reach_px, view)
    if first is None:
        return Missed("no circle of edges near the guess")
    return _fitted(image, first, noise, least_coverage, view, limb)


def _fitted(
    image: Image, start: Circle, noise: NoiseModel, least_coverage: float, view: View | None, limb: LimbChoice | None
) -> Outline:
    choice = LimbChoice() if limb is None else limb
    if not choice.open:
        choice.count()
        return _verified(fit_circle(image, start, noise, view, choice.used), noise, least_coverage)
    flat = fit_circle(image, start, noise, view)
    plain = _verified(flat, noise, least_coverage)
    limbed = fit_circle(image, start, noise, view, limb=True)  # not from the flat one: under a lamp that may be far off
    shaded = _verified(limbed, noise, least_coverage)
    if isinstance(plain, Missed) and isinstance(shaded, Missed):
        return plain
    choice.learn(evidence(limbed, flat))
    return shaded if choice.used else plain


def _verified(fit: CircleFit | None, noise: NoiseModel, least_coverage: float) -> Outline:
    return Missed("the edges near the guess are no outline") if fit is None else verified(fit, noise, least_coverage)


def _refusal(image: Image, guess: Circle) -> str:
    """Why a guess cannot be used; empty if it can."""
    x, y, r = guess
    height, width = image.shape
    if not all(isfinite(value) for value in guess):
        return "the guess is not a number"
    if not RADIUS_PX[0] <= r <= min(RADIUS_PX[1], max(width, height)):
        return f"the guessed radius of {r:.1f} px is absurd"
    if not (-r < x < width + r and -r < y < height + r):
        return f"the guess ({x:.0f}, {y:.0f}) is outside the image"
    return ""


def _same(seed: Circle, found: Found) -> bool:
    return hypot(seed[0] - found.x_px, seed[1] - found.y_px) < 0.3 * found.r_px


def _has(found: Found, pixel: tuple[float, float], image: Image | None) -> bool:
    """Whether a pixel shows this ball, or is just beside it; without an image, whether it may be meant."""
    away_px = _distance(found, pixel)
    if image is None:
        return away_px <= GUESSED_RADII * found.r_px
    if away_px > found.r_px:
        return away_px <= NEAR_RADII * found.r_px
    column, row, half = round(pixel[0]), round(pixel[1]), max(round(PATCH_RADII * found.r_px), 1)
    patch = image[max(row - half, 0) : row + half + 1, max(column - half, 0) : column + half + 1]
    level_dn, contrast_dn = float(np.median(patch)), found.inside_dn - found.outside_dn
    return (level_dn - found.outside_dn) * contrast_dn > 0.0 or abs(level_dn - found.inside_dn) < abs(contrast_dn)


def _distance(found: Found, pixel: tuple[float, float]) -> float:
    return hypot(found.x_px - pixel[0], found.y_px - pixel[1])
