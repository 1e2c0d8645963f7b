"""What a sweep does not tell, in words that say what would: each raises Undetermined."""

from math import pi

import numpy as np

from trackerd.calibrate.latency_model import Fit
from trackerd.calibrate.sweep import Sweep
from trackerd.contract.errors import Undetermined
from trackerd.contract.model import Array

AXES = "AZ", "EL"
ARCSEC = pi / 648_000.0
FEWEST_FRAMES = 40
STILL_RAD_S = 1e-3  # rms speed of an axis that does not sweep
FAST_SHARE, EACH_WAY = 0.2, 0.15  # at least 15 % of the frames move faster than 20 % of the rms speed either way
MOST_OUTLIERS = 0.1
WORST_CHI2 = 1.5  # per degree of freedom
WORST_SIGMA_S = 10e-6
LATEST_S = 3e-3  # beyond it the angles are another frame's; a sine of f turns/s is modelled to (2 pi f tau)^2 / 6
CHANCE = 30.0  # gain in chi-square by four free terms: one sound sweep in 200 000
TOLD_APART = 0.01  # share of a term that other terms do not imitate, below which nothing is said of it
LONGEST_SMEAR_PX = 20.0  # during the exposure: longer ones are no outlines any more


def what_cannot_tell(sweep: Sweep) -> None:
    few(len(sweep.t_s))
    if not all(np.isfinite(part).all() for part in (sweep.t_s, sweep.q_px, sweep.cov_px2, sweep.angles_rad, sweep.rates_rad_s)):
        raise Undetermined("a frame's instant, pixel or angle is not a finite number")
    for name, rates in zip(AXES, sweep.rates_rad_s.T, strict=True):
        rms = float(np.sqrt((rates**2).mean()))
        if rms < STILL_RAD_S:
            raise Undetermined(
                f"the {name} axis does not sweep (rms speed {np.degrees(rms):.3f} deg/s): move both axes to and fro"
            )
        ways = float((rates > FAST_SHARE * rms).mean()), float((rates < -FAST_SHARE * rms).mean())
        if min(ways) < EACH_WAY:
            raise Undetermined(
                f"the {name} axis moves one way in {max(ways):.0%} and the other in {min(ways):.0%} of the frames: an error of"
                " its angle cannot be told from a latency: sweep to and fro"
            )


def few(frames: int) -> None:
    if frames < FEWEST_FRAMES:
        raise Undetermined(f"{frames} frames of the sweep are usable, {FEWEST_FRAMES} are needed: sweep for 3 s or longer")


def smear(length_px: float) -> None:
    if length_px > LONGEST_SMEAR_PX:
        raise Undetermined(
            f"the target is smeared by {length_px:.0f} px at the highest speed, {LONGEST_SMEAR_PX:.0f} px are the most: expose"
            f" {length_px / LONGEST_SMEAR_PX:.1f} times shorter, or sweep slower"
        )


def mimicry(fit: Fit) -> None:
    for name, share in zip(AXES, fit.share, strict=True):
        if not share > TOLD_APART:
            raise Undetermined(
                f"the {name} axis passes each angle at one speed only: an error of its angle cannot be told from a latency:"
                " sweep to and fro at a steady pace"
            )


def leftovers(chi2: float, outliers: float) -> None:
    """`chi2` is per degree of freedom."""
    if outliers > MOST_OUTLIERS:
        raise Undetermined(
            f"{outliers:.0%} of the frames fit no steady latency: the target moves, or is not always the same ball"
        )
    if chi2 > WORST_CHI2:
        raise Undetermined(
            f"more is left over than pixels and encoders explain (chi2 {chi2:.1f} per degree of freedom, at most"
            f" {WORST_CHI2:g}): the target or the stand moves or shakes, the encoders are noisier than they were said to be, or"
            " stamps jitter"
        )


def odd_ones(fit: Fit, excess: float) -> None:
    """Errors that change sign with the speed, but are not proportional to it."""
    usable = fit.share > TOLD_APART / 10.0
    if not usable.any():
        return
    value, cov = fit.value[usable], fit.cov[np.ix_(usable, usable)] * excess
    if float(value @ np.linalg.pinv(cov, rcond=1e-12, hermitian=True) @ value) > CHANCE:
        raise Undetermined(
            f"the angles are off by up to {float(np.abs(value).max()) / ARCSEC:.1f} arcsec otherwise than in proportion to the"
            " speed, which is no latency: backlash or friction between encoder and camera, smear, or turns too sharp for the"
            " frame rate: expose shorter, sweep slower, and a sine"
        )


def uncertain(cov_s2: Array, offset_s: Array) -> None:
    for name, sigma_s in zip(AXES, np.sqrt(cov_s2.diagonal()), strict=True):
        if not sigma_s <= WORST_SIGMA_S:
            more = sigma_s / WORST_SIGMA_S
            raise Undetermined(
                f"the {name} axis' latency is known to {sigma_s * 1e6:.0f} us only, {WORST_SIGMA_S * 1e6:.0f} us are needed:"
                f" sweep {more:.1f} times as fast, or {more**2:.1f} times as long"
            )
    latest_s = float(offset_s[np.abs(offset_s).argmax()])
    if abs(latest_s) > LATEST_S:
        raise Undetermined(
            f"the angles are {latest_s * 1e3:+.1f} ms late, more than {LATEST_S * 1e3:g} ms: they are another frame's, or the"
            " stamps are not those of mid-exposure"
        )
