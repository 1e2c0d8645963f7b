"""Allan deviation of a series of positions: how far means of m neighbouring frames differ, and so what averaging is good for.

Overlapping estimator and its degrees of freedom after W. J. Riley, Handbook of Frequency Stability Analysis, NIST SP 1065
(2008), sections 5.2.4 and 5.4; terms as in IEEE Std 1139. A position takes the part of the fractional frequency: noise that is
white in the position falls as m^-1/2, a random walk rises as m^+1/2, a steady drift rises as m.
"""

from dataclasses import dataclass
from math import inf

import numpy as np
from scipy.special import chdtri

from trackerd.contract.model import Array

LEAST_SHARE = 0.5  # of a mean's frames that must be there: frames without a ball leave gaps
LONGEST_SHARE = 4  # means of more than a quarter of the series are too few to tell anything
CONFIDENCE = 0.95


@dataclass(frozen=True, slots=True)
class Allan:
    """Deviation against the number of frames averaged; all (k,), with the 95 % interval for white noise."""

    frames: Array
    deviation: Array
    low: Array
    high: Array

    @property
    def white_until(self) -> int:
        """The most frames whose mean is still as good as independent frames would make it; 0 without any deviation."""
        inside = (self.low <= self.deviation[:1] / np.sqrt(self.frames)) if len(self.frames) else np.zeros(0, bool)
        fails = np.flatnonzero(~inside)
        last = int(fails[0]) if len(fails) else len(inside)
        return int(self.frames[last - 1]) if last else 0


def overlapping(values: Array) -> Allan:
    """Of values (n,), NaN where there is none. Empty where no two neighbours are there."""
    rows = []
    for length in _lengths(len(values)):
        squares = _squares(values, length)
        if len(squares) == 0:
            continue
        deviation = float(np.sqrt(0.5 * squares.mean()))
        freedom = degrees_of_freedom(int(np.isfinite(values).sum()), length)
        rows.append((length, deviation, *interval(deviation, freedom)))
    frames, deviations, low, high = np.array(rows, np.float64).reshape(-1, 4).T
    return Allan(frames, deviations, low, high)


def degrees_of_freedom(count: int, length: int) -> float:
    """Of the overlapping estimate for white noise of `count` values (SP 1065, table 5: white FM of count + 1 phases)."""
    phases = count + 1
    m = float(length)
    return max((3 * (phases - 1) / (2 * m) - 2 * (phases - 2) / phases) * 4 * m * m / (4 * m * m + 5), 1.0)


def interval(deviation: float, freedom: float) -> tuple[float, float]:
    """95 % interval of a standard deviation that was estimated with so many degrees of freedom."""
    if freedom <= 0.0:
        return 0.0, inf
    tail = 0.5 * (1.0 - CONFIDENCE)
    low, high = (deviation * float(np.sqrt(freedom / chdtri(freedom, p))) for p in (tail, 1.0 - tail))
    return low, high


def _lengths(count: int) -> list[int]:
    """1, 2, 3, 4, 6, 8, 12 ... up to a quarter of the series, which in logarithms is even enough to draw."""
    longest = max(count // LONGEST_SHARE, 1)
    doubled = [2**k for k in range(longest.bit_length())]
    return [m for m in sorted({*doubled, *(3 * m // 2 for m in doubled if m > 1)}) if m <= longest and 2 * m <= count]


def _squares(values: Array, length: int) -> Array:
    """Squared differences of neighbouring means, of all overlapping pairs that have enough frames in both."""
    there = np.isfinite(values)
    sums, counts = (np.concatenate(((0.0,), np.cumsum(part))) for part in (np.where(there, values, 0.0), there))
    total, count = sums[length:] - sums[:-length], counts[length:] - counts[:-length]
    means = np.where(count >= max(LEAST_SHARE * length, 1), total / np.maximum(count, 1), np.nan)
    difference = means[length:] - means[:-length]
    return np.asarray(difference[np.isfinite(difference)] ** 2)
