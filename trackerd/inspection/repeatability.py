"""What a still series says: scatter, drift and Allan deviation of the outline, beside the sigma that the fit states.

The columns are those of the source thesis's Table 4.10 (x, y and diameter d of a probe that stands still). All numbers are
of the outline in the image, in pixels: what moves the machine, the air or the light between the frames is in them.
"""

from dataclasses import dataclass

import numpy as np

from trackerd.contract.model import Array, Found, Missed, Outline
from trackerd.inspection.allan import Allan, interval, overlapping


@dataclass(frozen=True, slots=True)
class Scatter:
    """Of one quantity over the frames in which the ball was found; px."""

    mean: float
    deviation: float  # standard deviation
    interval: tuple[float, float]  # 95 % interval of it, for frames that are independent of each other
    peak_to_peak: float
    drift: float  # over the whole series, along the straight line that fits best
    drift_sigma: float
    stated: float  # rms of the sigma that the fit states
    neighbours: float  # Allan deviation at one frame: the scatter without drift; NaN where no two neighbours were found

    @property
    def ratio(self) -> float:
        """Scatter over stated sigma: 1 where the series has the pixels' noise only."""
        return self.deviation / self.stated


@dataclass(frozen=True, slots=True)
class Repeatability:
    """x, y, r and d of a series, by name; Allan deviations of x and y."""

    found: int
    missed: int
    reasons: dict[str, int]  # why nothing was found, and how often; the most frequent first
    scatter: dict[str, Scatter]
    allan: dict[str, Allan]


def repeatability(outlines: list[Outline]) -> Repeatability | None:
    """None: there are not two frames with a ball."""
    found = [outline for outline in outlines if isinstance(outline, Found)]
    if len(found) < 2:
        return None
    values, sigmas = positions(outlines), stated_sigmas(outlines)
    allan = {name: overlapping(values[:, k]) for k, name in enumerate("xy")}
    scatter = {name: _scatter(values[:, k], sigmas[:, k]) for k, name in enumerate("xyr")}
    scatter["d"] = _scatter(2.0 * values[:, 2], 2.0 * sigmas[:, 2])
    return Repeatability(len(found), len(outlines) - len(found), reasons(outlines), scatter, allan)


def reasons(outlines: list[Outline]) -> dict[str, int]:
    """Why nothing was found, and how often: the most frequent first."""
    said = [outline.reason for outline in outlines if isinstance(outline, Missed)]
    return {reason: said.count(reason) for reason in sorted(set(said), key=lambda reason: -said.count(reason))}


def positions(outlines: list[Outline]) -> Array:
    """x, y and r of each frame, (n, 3); NaN where nothing was found."""
    rows = [(o.x_px, o.y_px, o.r_px) if isinstance(o, Found) else (np.nan,) * 3 for o in outlines]
    return np.array(rows, np.float64).reshape(-1, 3)


def stated_sigmas(outlines: list[Outline]) -> Array:
    """Stated sigma of x, y and r, (n, 3); NaN where nothing was found."""
    rows = [np.sqrt(o.cov_px2.diagonal()) if isinstance(o, Found) else np.full(3, np.nan) for o in outlines]
    return np.array(rows, np.float64).reshape(-1, 3)


def _scatter(values: Array, sigmas: Array) -> Scatter:
    there = np.isfinite(values)
    frame, value = np.flatnonzero(there).astype(np.float64), values[there]
    deviation = float(value.std(ddof=1))
    slope, slope_sigma = _slope(frame, value)
    length = float(len(values) - 1)
    allan = overlapping(values)
    neighbours = float(allan.deviation[0]) if len(allan.frames) and allan.frames[0] == 1.0 else float("nan")
    return Scatter(
        float(value.mean()),
        deviation,
        interval(deviation, len(value) - 1.0),
        float(np.ptp(value)),
        slope * length,
        slope_sigma * length,
        float(np.sqrt((sigmas[there] ** 2).mean())),
        neighbours,
    )


def _slope(frame: Array, value: Array) -> tuple[float, float]:
    """Slope a frame of the least-squares line and its sigma (NaN from two frames: nothing is left over)."""
    centred = frame - frame.mean()
    spread = float(centred @ centred)
    slope = float(centred @ value) / spread
    left = value - value.mean() - slope * centred
    if len(value) < 3:
        return slope, float("nan")
    return slope, float(np.sqrt((left @ left) / (len(value) - 2) / spread))
