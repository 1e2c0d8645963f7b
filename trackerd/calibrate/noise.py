"""Gain and read noise of a camera from pictures of a still scene: the photon transfer curve.

Photons come one by one, so a pixel's variance grows in a straight line with its level: variance = level / gain + (read /
gain)^2 + rounding. The line through many levels of one scene tells both (Janesick, Photon Transfer, 2007; EMVA 1288, 6.3).
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from math import inf, sqrt

import numpy as np
import numpy.typing as npt

from trackerd.calibrate.still_frames import LEVELS, USUAL, Frames, Levels, Scatter, look_at_levels, look_at_scatter
from trackerd.calibrate.still_pixels import FEWEST_STILL, correlation, freedom_of, median_of_mean, still_pixels
from trackerd.contract.errors import Undetermined
from trackerd.contract.model import Array

FEWEST_PIXELS = 50  # of a level: fewer tell a variance too badly for a chi-square
FEWEST_LEVELS = 3
WORST_GAIN = 0.05  # relative sigma: beyond it the gain is not determined
LEAST_RATIO = 1.5  # of the highest level to the lowest one: below it a bend or an offset passes for a gain
READ_SEEN = 2.0  # sigmas of the line's intercept above 0: less is an upper bound
UPPER_95 = 1.645  # one-sided 95 % of a normal distribution, in sigmas
BENT = 3.72  # sigmas, one-sided 1e-4
BLACK = 3.0  # sigmas of the intercept below 0: the levels do not begin at 0
ROLL_OFF_FROM = 0.8  # of the highest level
ROLLED_OFF = 4.0  # sigmas of the highest level below the line: the sensor's well is full there
NEIGHBOURLY = 0.02  # correlation of neighbours' noise: beyond it, and beyond
CHANCE = 4.0  # sigmas, the camera filters
ROUGHLY = 0.1  # a first line may be off by as much of the variance
OTHER_SCENE = 0.6  # correlation of neighbours' differences: no filter makes so much, moving things do
REPEATS = 5
TOO_FAR = 10.0
SHOW_MORE = "show the camera more grey levels at once, such as a wall that is lit from one side, out of focus"


@dataclass(frozen=True, slots=True)
class Points:
    """Variance by level, (n,) each."""

    level_dn: Array
    variance_dn2: Array  # rounding is taken out
    relative_sigma: Array  # of the variance with rounding
    rounding_dn2: float

    def sigma_dn2(self, variance_dn2: Array) -> Array:
        """1 sigma of measured variances whose true values are these."""
        return self.relative_sigma * (np.maximum(variance_dn2, 0.0) + self.rounding_dn2)

    def without_highest(self) -> "Points":
        return Points(self.level_dn[:-1], self.variance_dn2[:-1], self.relative_sigma[:-1], self.rounding_dn2)


@dataclass(frozen=True, slots=True)
class Line:
    """variance = level * slope_dn + intercept_dn2."""

    slope_dn: float
    intercept_dn2: float
    cov: Array  # (2, 2)
    chi2: float
    freedom: int

    def variance_dn2(self, level_dn: Array | float) -> Array:
        return np.asarray(level_dn * self.slope_dn + self.intercept_dn2)

    @property
    def bent(self) -> bool:
        """Chi-square is beyond chance: one sound line of 10 000 (Wilson and Hilferty's quantile)."""
        spread = 2.0 / (9.0 * self.freedom)
        return self.chi2 > self.freedom * (1.0 - spread + BENT * sqrt(spread)) ** 3


@dataclass(frozen=True, slots=True)
class CameraNoise:
    """What the stack tells of the camera. Covariances hold also where the points scatter more than they should."""

    line: Line
    points: Points
    frames: int
    used: float  # share of the pixels
    step_dn: int
    saturation_dn: int | None  # None: not reached
    flicker: float
    drift: float
    shake_px: float
    notes: tuple[str, ...]

    @property
    def gain_e_per_dn(self) -> float:
        return 1.0 / self.line.slope_dn

    @property
    def read_noise_e(self) -> float:
        return self.gain_e_per_dn * sqrt(max(self.line.intercept_dn2, 0.0))

    @property
    def cov(self) -> Array:
        """(2, 2) of gain, e-/DN, and read noise, e-, to first order; where no read noise is seen, taken at 1 sigma of it."""
        slope, intercept = self.line.slope_dn, max(self.line.intercept_dn2, sqrt(self.line.cov[1, 1]))
        jacobian = np.array([[-1.0 / slope**2, 0.0], [-sqrt(intercept) / slope**2, 0.5 / (slope * sqrt(intercept))]])
        return np.asarray(jacobian @ self.line.cov @ jacobian.T)

    @property
    def gain_sigma_e_per_dn(self) -> float:
        return float(sqrt(self.cov[0, 0]))

    @property
    def read_sigma_e(self) -> float:
        return float(sqrt(self.cov[1, 1]))

    @property
    def read_below_e(self) -> float | None:
        """Upper 95 % bound of a read noise that does not rise above its own sigma; None where it does."""
        sigma = sqrt(self.line.cov[1, 1])
        if self.line.intercept_dn2 > READ_SEEN * sigma:
            return None
        return self.gain_e_per_dn * sqrt(max(self.line.intercept_dn2, 0.0) + UPPER_95 * sigma)

    @property
    def rounding_dn2(self) -> float:
        return self.points.rounding_dn2


def measure_noise(frames: Frames, progress: Callable[[], None] = lambda: None) -> CameraNoise:
    """The noise of the camera that took `frames`; `progress` is called for each picture of both passes.

    Raises Undetermined where the pictures do not tell it, in words that say what would, and ConfigError for unreadable ones.
    """
    levels = look_at_levels(frames, progress)
    scatter = look_at_scatter(frames, levels, progress)
    _refuse_other_scenes(scatter)
    still = still_pixels(levels, scatter, _rough_line(levels, scatter).variance_dn2(levels.mean_dn), ROUGHLY)
    line = fit_line(_points(levels, scatter, still.pixels))
    still = still_pixels(levels, scatter, line.variance_dn2(levels.mean_dn), 0.0)
    points = _points(levels, scatter, still.pixels)
    line = fit_line(points)
    highest_dn = points.level_dn[-1]
    points, line = _below_roll_off(points, line)
    _refuse_what_is_not_determined(points, line)
    return CameraNoise(
        line=line,
        points=points,
        frames=levels.frames,
        used=float(still.pixels.mean()),
        step_dn=levels.step_dn,
        saturation_dn=levels.saturation_dn,
        flicker=levels.flicker,
        drift=levels.drift,
        shake_px=still.shake_px,
        notes=(*still.notes, *_notes(levels, correlation(scatter.last_dn, still.pixels), points, line, highest_dn)),
    )


def fit_line(points: Points) -> Line:
    """Least squares with the weights of the line itself, not of the points: a point that is low by chance weighs no more.

    Where the points scatter more than their sigmas say, the covariance is that of their scatter. Raises Undetermined below
    three points.
    """
    count = len(points.level_dn)
    if count < FEWEST_LEVELS:
        raise Undetermined(
            f"only {count} levels with {FEWEST_PIXELS} still pixels or more, {FEWEST_LEVELS} are needed: {SHOW_MORE}"
        )
    design = np.column_stack([points.level_dn, np.ones(count)])
    expected = points.variance_dn2
    for _ in range(REPEATS):
        weights = 1.0 / np.square(points.sigma_dn2(expected))
        cov: Array = np.linalg.pinv(design.T @ (weights[:, None] * design)).astype(np.float64)
        solution = cov @ (design.T @ (weights * points.variance_dn2))
        expected = design @ solution
    chi2 = float(np.sum(weights * np.square(points.variance_dn2 - expected)))
    line = Line(float(solution[0]), float(solution[1]), cov, chi2, count - 2)
    return Line(line.slope_dn, line.intercept_dn2, cov * chi2 / line.freedom, chi2, line.freedom) if line.bent else line


def _points(levels: Levels, scatter: Scatter, pixels: npt.NDArray[np.bool_]) -> Points:
    """Means over the pixels of each level that are still.

    Light of factor f scales the photons' part of a difference by 1 / f, the rest by 1 / f^2.
    """
    bands = levels.band[pixels]
    counts = np.bincount(bands, minlength=LEVELS)
    told = counts >= FEWEST_PIXELS
    mean = np.bincount(bands, levels.mean_dn[pixels], minlength=LEVELS)[told] / counts[told]
    variance = np.bincount(bands, scatter.variance_dn2[pixels], minlength=LEVELS)[told] / counts[told]
    everyone = np.bincount(levels.band.ravel(), minlength=LEVELS)[told]
    variance *= everyone / (everyone - 1.0)  # a mean of each difference was taken out
    inverse = 1.0 / levels.factors
    photons, rest = ((np.mean(inverse[1:] ** n) + np.mean(inverse[:-1] ** n)) / 2.0 for n in (1, 2))
    relative = np.sqrt(2.0 / freedom_of(levels.frames) / (counts[told] - 1.0))
    return Points(mean * photons / rest, variance / rest - levels.rounding_dn2, relative, levels.rounding_dn2)


def _rough_line(levels: Levels, scatter: Scatter) -> Line:
    """Of the median pixel of each level: edges, hot pixels and what moves are not yet known."""
    order = np.argsort(levels.mean_dn, axis=None)
    ceiling_dn = inf if levels.saturation_dn is None else 0.95 * levels.saturation_dn
    order = order[levels.mean_dn.ravel()[order] < ceiling_dn]
    if len(order) < FEWEST_STILL:
        raise Undetermined(f"the picture is saturated at {levels.saturation_dn} DN: lower exposure, gain or light")
    groups = np.array_split(order, LEVELS)
    level = np.array([levels.mean_dn.ravel()[group].mean() for group in groups])
    variance = np.array([np.median(scatter.variance_dn2.ravel()[group]) for group in groups]) / median_of_mean(levels.frames)
    points = Points(level, variance - levels.rounding_dn2, np.ones(LEVELS), levels.rounding_dn2)
    return fit_line(points)


def _below_roll_off(points: Points, line: Line) -> tuple[Points, Line]:
    """Without the highest levels, as long as they lie below the line through all lower ones."""
    least_dn = ROLL_OFF_FROM * points.level_dn[-1]
    while len(points.level_dn) > 2 * FEWEST_LEVELS and points.level_dn[-1] > least_dn:
        fewer = points.without_highest()
        lower = fit_line(fewer)
        expected = float(lower.variance_dn2(points.level_dn[-1]))
        if points.variance_dn2[-1] > expected - ROLLED_OFF * points.sigma_dn2(np.asarray(expected))[-1]:
            break
        points, line = fewer, lower
    return points, line


def _refuse_other_scenes(scatter: Scatter) -> None:
    """Most of the picture moves; what moves in a part of it is told with its place, later."""
    limit = USUAL * float(np.median(np.abs(scatter.last_dn)))
    alike, sigma = correlation(np.clip(scatter.last_dn, -limit, limit), np.ones(scatter.last_dn.shape, bool))
    if alike > OTHER_SCENE + CHANCE * sigma:
        raise Undetermined(
            "the scene is not still: what changes from frame to frame is alike in neighbouring pixels (correlation "
            f"{alike:.2f}), which noise is not: fix camera and scene, keep the light steady"
        )


def _refuse_what_is_not_determined(points: Points, line: Line) -> None:
    low, high = float(points.level_dn[0]), float(points.level_dn[-1])
    covered = f"the still pixels cover levels from {low:.1f} to {high:.1f} DN"
    relative = sqrt(line.cov[0, 0]) / line.slope_dn if line.slope_dn > 0.0 else inf
    if relative > WORST_GAIN and line.bent:
        raise Undetermined(f"{covered}, and {_crooked(line)}: the gain is not determined")
    if relative > WORST_GAIN:
        more = relative / WORST_GAIN
        known = f"to {relative:.0%}" if relative < 1.0 else "not at all"
        need = f"levels over {more * (high - low):.0f} DN, or {more**2:.0f} times as many frames; " if more < TOO_FAR else ""
        raise Undetermined(f"{covered}, which tell the gain {known}; it must be to {WORST_GAIN:.0%}: {need}{SHOW_MORE}")
    if high < LEAST_RATIO * low:
        raise Undetermined(f"{covered}: the highest must be at least {LEAST_RATIO:g} times the lowest: {SHOW_MORE}")


def _crooked(line: Line) -> str:
    told = f"chi2 {line.chi2:.0f} of {line.freedom}"
    return f"their variance is no straight line of the level ({told}): gamma, sharpening or vibration"


def _notes(levels: Levels, alike: tuple[float, float], points: Points, line: Line, highest_dn: float) -> Iterator[str]:
    if line.bent:
        yield f"{_crooked(line)}; the sigmas are those of the scatter"
    if abs(alike[0]) > NEIGHBOURLY + CHANCE * alike[1]:
        yield (
            f"the noise of neighbouring pixels is correlated by {alike[0]:+.2f}: the pictures were filtered, compressed or"
            " resized, and the gain is not the sensor's"
        )
    if line.intercept_dn2 < -BLACK * sqrt(line.cov[1, 1]):
        black = f"a black level of {-line.intercept_dn2 / line.slope_dn:.1f} DN or more"
        yield f"the camera adds {black}: set its BlackLevel to 0, or the read noise is not seen"
    if highest_dn > points.level_dn[-1]:
        yield f"above {points.level_dn[-1]:.0f} DN the sensor's wells are full: levels from there on were left out"
    if levels.step_dn > 1:
        yield f"grey levels come in steps of {levels.step_dn} DN (fewer bits, stored in the upper ones): the gain is per DN"
