"""A device's clock to the host's: offset and rate from the least delayed samples of the last seconds, never finished.

An exchange brackets the device's instant between request and reply, so that host - device lies under every `latest - device`
and over every `earliest - device`. In each bin of device time only the tightest bound of either side is kept; one line of
common rate is laid through each side, and the clock runs midway. A one-way stream has the upper side alone, less a known delay.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from math import hypot, sqrt
from typing import TypeAlias

import numpy as np

from trackerd.contract.clock import HostNs
from trackerd.contract.model import Array

BIN_NS = 200_000_000  # 40 exchanges of a 5 ms bus: the least delayed is nearly free of queueing; also the pause between refits
EARLY_BINS = 6  # until then it is refitted 8 times as often: the rate is still being found
WINDOW_NS = 12_000_000_000  # longer gains little, and a crystal that warms up bends
RATE_SIGMA = 100e-6  # what is believed of a crystal before it is measured: fades the rate in without a jump
MAX_RATE = 500e-6
START_SCATTER_NS = 20_000.0  # of the bounds, as long as too few are there to tell
MIN_SCATTER_NS = 1_000.0  # whole microseconds
ASYMMETRY = 0.15  # share of the gap between both sides: request and reply are rarely delayed alike (uniform would be 0.29)
STEP_NS = 5_000_000
STEP_RUN = 3  # brackets in a row that the clock would have to be outside of
LATE_RUN = 50  # one-way samples in a row that are late: no host is busy for so long
READY_SAMPLES = 8
PASSES = 3

Bound: TypeAlias = tuple[int, int]  # (device, host - device) in ns


class Sample(StrEnum):
    """What became of a sample."""

    TAKEN = "taken"
    REFUSED = "refused"  # no bracket, or outside of the fit once or twice
    STEPPED = "stepped"  # the device's clock has stepped: the fit starts again


@dataclass(frozen=True, slots=True)
class FitStatistics:
    samples: int
    refused: int
    steps: int
    rate_ppm: float
    gap_ns: float  # between both sides: the least round trip; 0 for a one-way stream
    sigma_ns: float  # at the newest bound


@dataclass(frozen=True, slots=True)
class _Line:
    """host - device = base + offset + rate (device - reference)."""

    reference_ns: int
    base_ns: int
    offset_ns: float
    rate: float
    cov: Array  # (2, 2) of rate and offset
    gap_ns: float

    def host(self, device_ns: int) -> HostNs:
        return HostNs(device_ns + self.base_ns + round(self.offset_ns + self.rate * (device_ns - self.reference_ns)))

    def sigma_ns(self, device_ns: int) -> float:
        t = float(device_ns - self.reference_ns)
        variance = self.cov[0, 0] * t * t + 2.0 * self.cov[0, 1] * t + self.cov[1, 1]
        return hypot(sqrt(max(0.0, float(variance))), ASYMMETRY * self.gap_ns)


class _Side:
    """The tightest bound of every bin; `sign` is +1 for bounds from above."""

    def __init__(self, sign: int) -> None:
        self.sign = sign
        self.bounds: deque[Bound] = deque()
        self._bin = -1
        self._tightest = 0.0

    def add(self, device_ns: int, difference_ns: int, rate: float) -> None:
        number, inside = divmod(device_ns, BIN_NS)
        height = self.sign * (difference_ns - rate * inside)
        if number != self._bin:
            self._bin, self._tightest = number, height
            self.bounds.append((device_ns, difference_ns))
            while self.bounds[0][0] < device_ns - WINDOW_NS:
                self.bounds.popleft()
        elif height < self._tightest:
            self._tightest = height
            self.bounds[-1] = (device_ns, difference_ns)


class _Fit:
    """What both fits share: sides, refits at most once a bin, and the count of what happened."""

    def __init__(self, signs: Sequence[int]) -> None:
        self._signs = signs
        self._samples = self._refused = self._steps = 0
        self.reset()

    def reset(self) -> None:
        """Forget the clock; the statistics go on."""
        self._sides = [_Side(sign) for sign in self._signs]
        self._line: _Line | None = None
        self._taken = 0
        self._outside = 0
        self._fitted_ns = 0

    @property
    def ready(self) -> bool:
        return self._line is not None and self._taken >= READY_SAMPLES

    def host(self, device_ns: int) -> tuple[HostNs, float] | None:
        """The host's instant of a device stamp and its sigma in ns; None before the fit is ready."""
        if self._line is None or not self.ready:
            return None
        return self._line.host(device_ns), self._line.sigma_ns(device_ns)

    def statistics(self) -> FitStatistics:
        line = self._line
        if line is None:
            return FitStatistics(self._samples, self._refused, self._steps, 0.0, 0.0, float("inf"))
        sigma_ns = line.sigma_ns(line.reference_ns)
        return FitStatistics(self._samples, self._refused, self._steps, line.rate * 1e6, line.gap_ns, sigma_ns)

    def _refuse(self) -> Sample:
        self._refused += 1
        return Sample.REFUSED

    def _outside_of_fit(self, run: int) -> bool:
        """Count a sample that contradicts the fit; True once that is a step."""
        self._outside += 1
        if self._outside < run:
            return False
        self._steps += 1
        self.reset()
        return True

    def _take(self, device_ns: int, differences_ns: Sequence[int]) -> None:
        rate = self._line.rate if self._line is not None else 0.0
        for side, difference_ns in zip(self._sides, differences_ns, strict=True):
            side.add(device_ns, difference_ns, rate)
        self._samples += 1
        self._taken += 1
        self._outside = 0
        pause_ns = BIN_NS if len(self._sides[0].bounds) > EARLY_BINS else BIN_NS // 8
        if self._taken <= 2 * READY_SAMPLES or device_ns - self._fitted_ns >= pause_ns:
            self._fitted_ns = device_ns
            self._line = _line(self._sides)


class ClockFit(_Fit):
    """From exchanges: the device's instant lies between `earliest` and `latest`."""

    def __init__(self) -> None:
        super().__init__((1, -1))

    def add(self, device_ns: int, earliest: HostNs, latest: HostNs) -> Sample:
        """One exchange. Where the device reports a snapshot, `earliest` is the request less the snapshot's greatest age."""
        if latest < earliest:
            return self._refuse()
        stepped = False
        if self._line is not None and self._taken >= READY_SAMPLES:
            host = self._line.host(device_ns)
            if max(earliest - host, host - latest) > STEP_NS:
                stepped = self._outside_of_fit(STEP_RUN)
                if not stepped:
                    return self._refuse()
        self._take(device_ns, (latest - device_ns, earliest - device_ns))
        return Sample.STEPPED if stepped else Sample.TAKEN


class OneWayFit(_Fit):
    """From a stream that only arrives: a camera's stamps and the arrival of its frames."""

    def __init__(self, delay_ns: int = 0) -> None:
        """`delay_ns`: the least time from the device's stamp to the arrival, which cannot be seen from here."""
        super().__init__((1,))
        self._delay_ns = delay_ns

    def add(self, device_ns: int, arrived: HostNs) -> Sample:
        stepped = False
        if self._line is not None and self._taken >= READY_SAMPLES:
            late_ns = arrived - self._delay_ns - self._line.host(device_ns)
            if abs(late_ns) > STEP_NS:
                stepped = self._outside_of_fit(STEP_RUN if late_ns < 0 else LATE_RUN)
                if not stepped:
                    return self._refuse()
        self._take(device_ns, (arrived - self._delay_ns - device_ns,))
        return Sample.STEPPED if stepped else Sample.TAKEN


def _line(sides: Sequence[_Side]) -> _Line:
    """Weighted least squares of a common rate and one height per side, the loose bounds losing weight in each pass."""
    reference_ns, base_ns = sides[0].bounds[-1]
    design, heights, signs = _system(sides, reference_ns, base_ns)
    prior = np.zeros((design.shape[1], design.shape[1]))
    prior[0, 0] = RATE_SIGMA**-2
    weights, scatter_ns = np.ones(len(heights)), START_SCATTER_NS
    for _ in range(PASSES):
        weighted = design * (weights / scatter_ns**2)[:, None]
        cov = np.linalg.inv(weighted.T @ design + prior)
        solution = cov @ (weighted.T @ heights)
        weights, scatter_ns = _reweigh(signs * (heights - design @ solution), weights)
    rate = min(MAX_RATE, max(-MAX_RATE, float(solution[0])))
    pick = np.zeros((2, design.shape[1]))
    pick[0, 0], pick[1, 1:] = 1.0, 1.0 / len(sides)
    gap_ns = float(solution[1] - solution[2]) if len(sides) == 2 else 0.0
    return _Line(reference_ns, base_ns, float(solution[1:].mean()), rate, pick @ cov @ pick.T, abs(gap_ns))


def _system(sides: Sequence[_Side], reference_ns: int, base_ns: int) -> tuple[Array, Array, Array]:
    """Design (n, 1 + sides), heights (n,) and signs (n,), from the reference on."""
    points = [np.array(side.bounds, dtype=np.int64) - (reference_ns, base_ns) for side in sides]
    count = [len(p) for p in points]
    design = np.zeros((sum(count), 1 + len(sides)))
    signs = np.empty(len(design))
    start = 0
    for i, side in enumerate(sides):
        part = slice(start, start + count[i])
        design[part, 0], design[part, 1 + i], signs[part] = points[i][:, 0], 1.0, side.sign
        start += count[i]
    return design, np.concatenate(points)[:, 1].astype(float), signs


def _reweigh(excess_ns: Array, weights: Array) -> tuple[Array, float]:
    """Less weight the further a bound stands off on the loose side; and the scatter of those that count."""
    if len(excess_ns) < 2 * READY_SAMPLES:
        return weights, START_SCATTER_NS
    scatter = max(MIN_SCATTER_NS, sqrt(float((weights * excess_ns**2).sum() / weights.sum())))
    loose = np.maximum(0.0, excess_ns - float(np.median(excess_ns)))
    scale = max(MIN_SCATTER_NS, float(np.median(np.abs(excess_ns))))
    return 1.0 / (1.0 + (loose / (2.0 * scale)) ** 2), scatter
