"""A ball that stands still, frame after frame: what repeats, what does not, and what no repetition would show."""

from collections.abc import Iterable
from math import nan

import numpy as np
from limits import STILL_BIAS_PX, STILL_SIGMA, worst
from score import circle_of
from tables import Table
from trials import Trial, ours

from trackerd.contract.model import Found
from trackerd.vision.limb import LimbChoice

AXES = ("x", "y", "r")


def still_table(frames: Iterable[Trial]) -> Table:
    """One scene; the choice of the limb term is kept as a tracker keeps it."""
    limb, errors, sigma_px, misses, count = LimbChoice(), [], np.full(3, nan), 0, 0
    for trial in frames:
        outline, sigma_px, count = ours(trial, limb), trial.sigma_px, count + 1
        if isinstance(outline, Found):
            errors.append(trial.error_px(circle_of(outline)))
        else:
            misses += 1
    columns = ("sigma px", "bound px", "sigma / bound", "bias px", "missed")
    table = Table(f"A still series of {count} frames; the limb term was {'' if limb.used else 'not '}used", columns)
    for n, axis in enumerate(AXES):
        error = np.array(errors)[:, n] if errors else np.full(1, nan)
        ratio, bias = float(error.std() / sigma_px[n]), float(error.mean())
        limits = (STILL_SIGMA.verdict(ratio), STILL_BIAS_PX.verdict(abs(bias))) if axis != "r" else ()
        told = f"{STILL_SIGMA.told()}, {STILL_BIAS_PX.told()} px" if limits else ""
        table.add(axis, float(error.std()), float(sigma_px[n]), ratio, bias, misses, verdict=worst(limits), limit=told)
    return table
