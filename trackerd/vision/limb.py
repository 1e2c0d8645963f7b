"""Whether the ball's rim is shaded so that the limb term is needed: decided by the pictures, and not anew for every one.

The term costs some noise of the radius, and time; without it a lamp from one side shifts the centre by up to 0.8 px, and a
darkened rim makes the radius small. Switching from frame to frame would let both errors flicker.
"""

import sys
from math import inf

import numpy as np

from trackerd.vision.convergence import CircleFit

NEEDED = 16.0  # Wald statistic of the term, 3 degrees of freedom: one plain picture in 900 passes it
ASKED_EVERY = 16  # frames; in between the choice stands
FORGOTTEN = 0.7  # share of the older evidence that is kept at each question
MOST_CLIPPED = 0.2  # share of the ring
SMEARED = 0.15  # anisotropy of the blur
LEAST = 0.02  # of the contrast: what a lens whose blur is no Gaussian may feign
AT_MOST = 3.0  # of one answer, in units of NEEDED: one odd picture does not decide for long
ON, OFF = 1.3, 0.5  # mean evidence in these units: hysteresis


def evidence(limbed: CircleFit | None, flat: CircleFit | None) -> float:
    """Wald statistic of the limb term; 0 where the picture cannot tell.

    A smear is no Gaussian blur, and the term would fit the difference: there only a limb that explains the smear away counts.
    Where the sensor clips most of the ball or of its background, half of what the term needs is missing.
    """
    if limbed is None or not limbed.settled or limbed.clipped > MOST_CLIPPED:
        return 0.0
    if flat is None or (len(limbed.blur_px2) < len(flat.blur_px2) and limbed.chi2 < flat.chi2):
        return inf  # what looked like a smear, or like nothing, is a sharp edge under a lamp
    if anisotropy(limbed) > SMEARED:
        return 0.0
    contrast_dn = float(np.median(np.abs(limbed.sectors.contrast_dn)))
    variance = float(limbed.limb_cov_dn2[2, 2]) * max(limbed.chi2, 1.0) + (LEAST * contrast_dn) ** 2
    return float(limbed.limb_dn[2]) ** 2 / variance


def anisotropy(fit: CircleFit) -> float:
    """Of the blur: amplitude of its variance's change with the direction, as a share."""
    return float(np.hypot(*fit.blur_px2[1:3]) / fit.blur_px2[0]) if len(fit.blur_px2) > 1 else 0.0


class LimbChoice:
    """Whether the term is used, for one target of one camera; kept from frame to frame."""

    def __init__(self) -> None:
        self.used = False
        self._mean: float | None = None  # evidence, in units of NEEDED
        self._frames = 0  # since the last question

    @property
    def open(self) -> bool:
        """The next picture is to be asked."""
        return self._mean is None or self._frames >= ASKED_EVERY

    def kept(self) -> "LimbChoice | None":
        """The same choice for good, for other balls in the same light; None before the first answer."""
        if self._mean is None:
            return None
        kept = LimbChoice()
        kept.used, kept._mean, kept._frames = self.used, self._mean, -sys.maxsize
        return kept

    def count(self) -> None:
        """A picture was fitted, with the choice as it stands."""
        self._frames += 1

    def learn(self, seen: float) -> None:
        """The evidence of one picture."""
        worth = min(seen / NEEDED, AT_MOST)
        if self._mean is None:
            self._mean, self.used = worth, worth > 1.0
        else:
            self._mean = FORGOTTEN * self._mean + (1.0 - FORGOTTEN) * worth
            self.used = self._mean > (OFF if self.used else ON)
        self._frames = 0
