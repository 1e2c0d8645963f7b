"""What to turn: exposure, light and the lens's ring, told from one outline or the last few, in words for a person."""

from dataclasses import dataclass
from math import floor

from trackerd.contract.model import Found

CLIPPED = 0.005  # of the outline's pixels; fewer are a highlight's
FULL = 0.98  # of the full scale: a level there is clipped, and could be anything above
AIM = 0.70  # of the full scale, for the brighter side of the outline: head room for highlights and for a lamp that flickers
DARK = 0.35  # of the full scale: there is room for twice the light
WEAK_DN_SIGMA = 12.0  # contrast in units of a pixel's noise, below which light or background should be improved
THIN = 0.75  # of the outline carry an edge
FOCUSED = 1.05  # edge width over the best one so far
BAR = 24  # characters
NIGHT = 0.10  # of the full scale, in the brightest parts of the image: nothing can be seen
SMEAR_PX = 0.3  # rms width of the movement within the exposure from which the edge width says nothing about focus


@dataclass(frozen=True, slots=True)
class Level:
    """The grey scale of a camera's images."""

    full_dn: float
    sigma_dn: float  # of one pixel at mid-edge


def exposure_advice(found: Found, level: Level) -> str:
    """ "good", or what is wrong with the exposure and how far to turn it."""
    bright = max(found.inside_dn, found.outside_dn)
    if found.clipped > CLIPPED or bright >= FULL * level.full_dn:
        clipped = _percent(found.clipped)
        return f"too bright: {clipped} of the outline is clipped: lower exposure or gain by about {_less(bright, level)} %"
    if bright < DARK * level.full_dn:
        factor = floor(10.0 * AIM * level.full_dn / max(bright, 1.0)) / 10.0
        return f"dark: {bright:.0f} of {level.full_dn:.0f}: exposure x {min(factor, 99.0):.2g} possible"
    return "good"


def light_advice(found: Found, level: Level) -> str:
    """ "good", or what makes the outline weak."""
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


def _less(bright: float, level: Level) -> int:
    """Per cent. A level at the end of the scale is not known: halve it, and look again."""
    if bright >= FULL * level.full_dn:
        return 50
    return max(10, round(100.0 * (1.0 - AIM * level.full_dn / bright)))


def _percent(share: float) -> str:
    return f"{100.0 * share:.0f} %" if share >= 0.01 else f"{100.0 * share:.1f} %"
