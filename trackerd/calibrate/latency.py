"""How late an encoder's angles are: the constant time from a frame's mid-exposure to the instant at which they were taken.

A gimbal sweeps to and fro over a still target. Angles that are late by tau are off by speed x tau, one way on the way there and
the other way on the way back; whatever is wrong with lens, kinematics or the encoder's scale is a function of the angle, and
the same on both. So the images' offsets are fitted with the latency of each axis beside free functions of the angles, and a
calibration of the station that is roughly right is enough.

A target that moves in step with the sweep, on a stand that the gimbal shakes, cannot be told from a latency.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from math import log, sqrt

import numpy as np

from trackerd.calibrate import latency_refusals as refuse
from trackerd.calibrate.latency_model import Fit, Mask, Model, fitted, model_of, rank, rescaled
from trackerd.calibrate.sweep import Sweep
from trackerd.contract.model import Array
from trackerd.geometry.gimbal import Station

OUTLIER = 4.5**2  # squared distance of a frame from the fit
USUAL = 2.0 * log(2.0)  # median of a chi-square of two degrees of freedom
REPEATS = 8
ONE_SPEED = 0.05  # share of a latency that a hysteresis does not imitate: a sine's is 0.2


@dataclass(frozen=True, slots=True)
class Latency:
    """Angles that are stamped t are those of t + `offset_s`. Covariances hold for the scatter that was found."""

    offset_s: Array  # (2,) of az and el
    cov_s2: Array  # (2, 2)
    loose_s: Array  # (2,) with a hysteresis of each axis left free: what no sound gimbal needs, and less certain
    loose_sigma_s: Array  # (2,)
    chi2: float
    freedom: int
    left_out: int  # frames, of the n
    smear_px: float  # the longest; 0 where the exposure is not known
    rates_rad_s: Array  # (n, 2)
    before_rad: Array  # (n, 2) encoder minus image, but for the functions of the angles: speed x offset, and noise
    after_rad: Array  # (n, 2) the noise alone
    notes: tuple[str, ...]

    @property
    def sigma_s(self) -> Array:
        return np.sqrt(self.cov_s2.diagonal())

    @property
    def common_s(self) -> float:
        """Best single value for both axes: one edge latches both."""
        weights = np.linalg.solve(self.cov_s2, np.ones(2))
        return float(weights @ self.offset_s / weights.sum())

    @property
    def common_sigma_s(self) -> float:
        return 1.0 / sqrt(float(np.linalg.solve(self.cov_s2, np.ones(2)).sum()))

    @property
    def apart(self) -> float:
        """By how many sigmas the axes differ."""
        across = np.array((1.0, -1.0))
        return abs(float(across @ self.offset_s)) / sqrt(float(across @ self.cov_s2 @ across))


@dataclass(frozen=True, slots=True)
class _Solution:
    fit: Fit
    kept: Mask
    left: Array  # (n, 2) whitened
    chi2: float
    freedom: int

    @property
    def excess(self) -> float:
        """By what the scatter is larger than pixels and encoders explain; at least 1."""
        return max(1.0, self.chi2 / self.freedom)


def latency_of(station: Station, sweep: Sweep, range_mm: float = 2000.0) -> Latency:
    """The latency of both axes from one sweep; the range to the target is needed to a tenth or two.

    Raises Undetermined, in words that say what would do, where an axis stands still, goes one way only or too slowly, where
    frames are too few, where the offsets are not proportional to the speed (hysteresis, smear), and where more is left over
    than pixels and encoders explain (the target or the stand moves).
    """
    refuse.what_cannot_tell(sweep)
    rough = model_of(station, sweep, range_mm)
    first = _solve(rough)
    model = rescaled(rough, sweep, first.fit.value, first.kept)
    smear_px = sweep.exposure_s * float(np.sqrt(((model.jacobian @ sweep.rates_rad_s[:, :, None]) ** 2).sum(axis=1)).max())
    refuse.smear(smear_px)
    solved = _solve(model)
    fit, kept, excess = solved.fit, solved.kept, solved.excess
    odd = np.concatenate((model.hysteresis, model.smear), axis=2)
    refuse.odd_ones(fitted(odd, np.concatenate((model.angles, model.late), axis=2), model.offsets, kept), excess)
    refuse.leftovers(solved.chi2 / solved.freedom, 1.0 - float(kept.mean()))
    refuse.uncertain(fit.cov * excess, fit.value)
    loose = fitted(model.late, np.concatenate((model.angles, model.hysteresis), axis=2), model.offsets, kept)
    after = model.angles_of(solved.left)
    return Latency(
        offset_s=fit.value,
        cov_s2=fit.cov * excess,
        loose_s=loose.value,
        loose_sigma_s=np.sqrt(loose.cov.diagonal() * excess),
        chi2=solved.chi2,
        freedom=solved.freedom,
        left_out=int((~kept).sum()),
        smear_px=smear_px,
        rates_rad_s=sweep.rates_rad_s,
        before_rad=after + sweep.rates_rad_s * fit.value,
        after_rad=after,
        notes=tuple(_notes(loose)),
    )


def _solve(model: Model) -> _Solution:
    """Frames that are far off the fit are left out, and judged anew by each fit."""
    kept = np.ones(len(model.offsets), bool)
    for _ in range(REPEATS):
        refuse.few(int(kept.sum()))
        fit = fitted(model.late, model.angles, model.offsets, kept)
        refuse.mimicry(fit)
        left = model.left_over(fit.value, kept)
        squares = (left**2).sum(axis=1)
        before, kept = kept, squares < OUTLIER * max(1.0, float(np.median(squares[kept])) / USUAL)
        if np.array_equal(before, kept):
            break
    return _Solution(fit, before, left, float(squares[before].sum()), 2 * int(before.sum()) - rank(model.angles, before) - 2)


def _notes(loose: Fit) -> Iterator[str]:
    for name, share in zip(refuse.AXES, loose.share, strict=True):
        if share < ONE_SPEED:
            yield (
                f"the {name} axis sweeps at one speed only: a hysteresis would pass for a latency unseen; a sine, or sweeps of"
                " two speeds, tell them apart"
            )
