"""What to turn: exposure, light and the lens's ring, told from one outline or the last few, in words for a person."""

from dataclasses import dataclass
from math import floor

import numpy as np

from trackerd.contract.model import Found, Image
from trackerd.vision.noise import NoiseModel

CLIPPED = 0.005  # of the outline's pixels; fewer are a highlight's
FULL = 0.98  # of the full scale: a level there is clipped, and could be anything above
AIM = 0.70  # of the full scale, for the brighter side of the outline: head room for highlights and for a lamp that flickers
BRIGHT_PERCENT = 95.0  # of the pixels near the ball are darker than what is called bright: highlights are smaller
NEAR_RADII, SAMPLES = 1.2, 20  # what is near the ball; sampled so often a radius
DARK = 0.35  # of the full scale: there is room for twice the light
WEAK_DN_SIGMA = 12.0  # contrast in units of a pixel's noise, below which light or background should be improved
THIN = 0.75  # of the outline carry an edge
FOCUSED = 1.05  # edge width over the best one so far
BAR = 24  # characters
NIGHT = 0.10  # of the full scale, in the brightest parts of the image: nothing can be seen
SMEAR_PX = 0.3  # rms width of the movement within the exposure from which the edge width says nothing about focus


@dataclass(frozen=True, slots=True)
class Level:
    """The grey values round one outline."""

    full_dn: float  # the end of the scale
    bright_dn: float  # of the brighter parts of ball and background; the rim of a shaded ball is darker
    sigma_dn: float  # noise of one pixel at mid-edge


def level_at(image: Image, found: Found, noise: NoiseModel) -> Level:
    """Of the square round the ball."""
    height, width = image.shape
    half, step = NEAR_RADII * found.r_px, max(round(found.r_px / SAMPLES), 1)
    rows, columns = (
        slice(min(max(int(middle - half), 0), size - 1), max(int(middle + half), 1), step)
        for middle, size in ((found.y_px, height), (found.x_px, width))
    )
    bright_dn = float(np.percentile(image[rows, columns], BRIGHT_PERCENT))
    middle_dn = 0.5 * (found.inside_dn + found.outside_dn)
    return Level(noise.saturation_of(int(np.iinfo(image.dtype).max)), bright_dn, noise.sigma_dn(middle_dn))


def exposure_advice(found: Found, level: Level) -> str:
    """Good, or what is wrong with the exposure and how far to turn it."""
    bright_dn = max(level.bright_dn, found.inside_dn, found.outside_dn)  # the fit tells levels beyond the scale, too
    clipped = found.clipped > CLIPPED
    if clipped or bright_dn >= FULL * level.full_dn:
        what = f"{_percent(found.clipped)} of the outline is clipped" if clipped else "the ball or what is round it is clipped"
        return f"too bright: {what}: lower exposure or gain by about {_less(bright_dn, level)} %"
    if bright_dn < DARK * level.full_dn:
        factor = floor(10.0 * AIM * level.full_dn / max(bright_dn, 1.0)) / 10.0
        return f"dark: {bright_dn:.0f} of {level.full_dn:.0f}: exposure x {min(factor, 99.0):.2g} possible"
    return "good"


def light_advice(found: Found, level: Level) -> str:
    """Good, or what makes the outline weak."""
    contrast = abs(found.inside_dn - found.outside_dn)
    if contrast < WEAK_DN_SIGMA * level.sigma_dn:
        ratio = contrast / level.sigma_dn
        return f"weak: a contrast of {contrast:.0f} is {ratio:.0f} x a pixel's noise: other background or light"
    if found.coverage < THIN:
        return f"only {_percent(found.coverage)} of the outline carry an edge: free it, or make background and light even"
    return "good"


def focus_advice(blur_px: float, best_px: float, smear_px: float) -> str:
    """What the edge's width says about the lens's ring, beside the best of this run."""
    if smear_px > SMEAR_PX:
        return f"moving: {smear_px:.1f} px of smear in the exposure: hold it still to focus"
    if blur_px <= FOCUSED * best_px:
        return "the best so far"
    return f"{blur_px / best_px:.2f} x as wide as the best so far: turn back"


def unseen_advice(bright: float) -> str:
    """What to try where no ball is seen; `bright` is the share of the full scale that the image's brightest parts reach."""
    if bright < NIGHT:
        return "the image is dark: lens cap, light, exposure"
    if bright >= FULL:
        return "parts of the image are clipped: if the ball is one of them, lower exposure or gain"
    return "if the ball is in the picture, bring it roughly into focus, and free at least half of its outline"


def focus_bar(blur_px: float, best_px: float) -> str:
    """Full at the best edge of this run; a blur twice as wide fills half of it."""
    filled = round(BAR * min(best_px / blur_px, 1.0)) if blur_px > 0.0 else BAR
    return "█" * filled + "·" * (BAR - filled)


def _less(bright_dn: float, level: Level) -> int:
    """Per cent. A level at the end of the scale is not known: halve it, and look again."""
    if FULL * level.full_dn <= bright_dn <= level.full_dn:
        return 50
    return min(max(10, round(100.0 * (1.0 - AIM * level.full_dn / bright_dn))), 90)


def _percent(share: float) -> str:
    return f"{100.0 * share:.0f} %" if share >= 0.01 else f"{100.0 * share:.1f} %"
