"""Frames of a still target from a gimbal that sweeps, with the encoders' angles and speeds at each frame.

Angles come as the daemon gets them, one latched pair a frame, or from a history of encoder samples on the frames' clock.
"""

from dataclasses import dataclass

import numpy as np

from trackerd.contract.errors import Undetermined
from trackerd.contract.model import Array

NEIGHBOURS = 5  # frames whose quartic tells the speed in their middle: to 0.1 % up to a tenth of the frame rate
FARTHEST = 1.6  # such a group may be longer than without gaps by this factor: one frame may be missing
WINDOW_S = 8e-3  # to either side: encoder samples whose cubic tells angle and speed in their middle
FEWEST_SAMPLES = 6
BENT = 3.0  # times the usual scatter about a cubic: the axis turned round within the window


@dataclass(frozen=True, slots=True)
class Sweep:
    """One gimbal's frames, n of them."""

    t_s: Array  # (n,) mid-exposure, rising
    q_px: Array  # (n, 2) the target on the sensor
    cov_px2: Array  # (n, 2, 2)
    angles_rad: Array  # (n, 2) encoder az and el as they were stamped for mid-exposure
    rates_rad_s: Array  # (n, 2)
    sigma_rad: float  # 1 sigma of one angle, independent from frame to frame
    exposure_s: float = 0.0  # where it is known it tells the motion blur


@dataclass(frozen=True, slots=True)
class Sightings:
    """Where the target was seen in n frames, without angles."""

    t_s: Array  # (n,) mid-exposure, rising
    q_px: Array  # (n, 2)
    cov_px2: Array  # (n, 2, 2)
    exposure_s: float = 0.0


def sweep_of_latches(seen: Sightings, angles_rad: Array, sigma_rad: float) -> Sweep:
    """With one latched pair of angles (n, 2) a frame; speeds are those of the neighbours' angles, so that two frames at either
    end, and those beside gaps, are left out.

    The frame's own angle has no share in its speed: their noise is independent. Raises Undetermined where nothing is left.
    """
    _refuse_disorder(seen.t_s, "frames")
    count = len(seen.t_s)
    first = np.arange(max(0, count - NEIGHBOURS + 1))
    if not len(first):
        raise Undetermined(f"{count} frames with the target and angles: a sweep needs a hundred")
    groups = first[:, None] + np.arange(NEIGHBOURS)
    middle = first + NEIGHBOURS // 2
    times = seen.t_s[groups] - seen.t_s[middle][:, None]
    whole = times[:, -1] - times[:, 0] <= FARTHEST * (NEIGHBOURS - 1) * float(np.median(np.diff(seen.t_s)))
    if not whole.any():
        raise Undetermined("the frames have gaps everywhere: their angles tell no speed")
    scale = np.abs(times[whole]).max()
    powers = (times[whole] / scale)[:, :, None] ** np.arange(NEIGHBOURS)
    curves = np.linalg.solve(powers, angles_rad[groups[whole]] - angles_rad[middle[whole]][:, None, :])
    which = middle[whole]
    return Sweep(
        seen.t_s[which],
        seen.q_px[which],
        seen.cov_px2[which],
        angles_rad[which],
        curves[:, 1] / scale,
        sigma_rad,
        seen.exposure_s,
    )


def sweep_of_history(seen: Sightings, t_s: Array, angles_rad: Array) -> Sweep:
    """With encoder samples (m,) and (m, 2) on the frames' clock, rising; frames without enough of them round it are left out.

    A cubic through the samples round a frame tells its angles and speeds, and their scatter about it the noise of both, white
    from sample to sample. Frames at turns that are too sharp for a cubic are left out, too. Raises Undetermined where no frame
    is left.
    """
    _refuse_disorder(seen.t_s, "frames")
    _refuse_disorder(t_s, "encoder samples")
    window_s = min(WINDOW_S, 0.5 * float(np.median(np.diff(seen.t_s)))) if len(seen.t_s) > 1 else WINDOW_S
    begin, end = np.searchsorted(t_s, (seen.t_s - window_s, seen.t_s + window_s))
    fits = [_cubic(t_s[a:b] - t, angles_rad[a:b], window_s) for t, a, b in zip(seen.t_s, begin, end, strict=True)]
    scatter = np.array([np.nan if fit is None else fit.squares / fit.freedom for fit in fits])
    if np.isnan(scatter).all():
        raise Undetermined(f"no frame has {FEWEST_SAMPLES} encoder samples within {window_s * 1e3:.0f} ms of it on both sides")
    which = scatter <= BENT * np.nanmedian(scatter)
    found = [fit for fit, taken in zip(fits, which, strict=True) if fit is not None and taken]
    variance = sum(fit.squares for fit in found) / sum(fit.freedom for fit in found)
    share = float(np.mean([fit.share for fit in found]))
    return Sweep(
        seen.t_s[which],
        seen.q_px[which],
        seen.cov_px2[which],
        np.array([fit.angles_rad for fit in found]),
        np.array([fit.rates_rad_s for fit in found]),
        float(np.sqrt(variance * share)),
        seen.exposure_s,
    )


def _refuse_disorder(t_s: Array, what: str) -> None:
    if not np.all(np.diff(t_s) > 0.0):  # also where one is not a number
        raise Undetermined(
            f"the instants of the {what} do not rise from one to the next: they are shuffled, or their clock stepped"
        )


@dataclass(frozen=True, slots=True)
class _Cubic:
    angles_rad: Array  # (2,) in the middle
    rates_rad_s: Array  # (2,)
    squares: float  # of the samples about it, both axes
    freedom: int
    share: float  # of one sample's variance that the angle in the middle has


def _cubic(times_s: Array, angles_rad: Array, window_s: float) -> _Cubic | None:
    """Through samples round 0; None where they are too few, or on one side of it."""
    if len(times_s) < FEWEST_SAMPLES or not (times_s[0] < -0.5 * window_s and times_s[-1] > 0.5 * window_s):
        return None
    powers = (times_s / window_s)[:, None] ** np.arange(4)
    inverse = np.linalg.pinv(powers)
    curve = inverse @ angles_rad
    squares = float(((angles_rad - powers @ curve) ** 2).sum())
    return _Cubic(curve[0], curve[1] / window_s, squares, 2 * (len(times_s) - 4), float(inverse[0] @ inverse[0]))
