"""The figures to reach, and what a measured one is worth beside them. k is the rms error over the bound of that very frame."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite

from scipy.stats import chi2


@dataclass(frozen=True, slots=True)
class Limit:
    """At most these: what has to be reached, and what would be better."""

    quantity: str  # k | p95 | direction k | range k | ...
    reach: float
    stretch: float | None = None

    def verdict(self, value: float) -> str:
        if self.stretch is not None and value <= self.stretch:
            return "stretch"
        return "met" if value <= self.reach else "MISSED"

    def told(self) -> str:
        reach = f" {self.reach:g}" if isfinite(self.reach) else ""
        return f"{self.quantity}{reach}" + ("" if self.stretch is None else f" ({self.stretch:g})")


@dataclass(frozen=True, slots=True)
class Between:
    """The mean normalised error squared of a covariance that is true: 1."""

    reach: tuple[float, float]
    stretch: tuple[float, float]

    def verdict(self, value: float) -> str:
        if self.stretch[0] <= value <= self.stretch[1]:
            return "stretch"
        return "met" if self.reach[0] <= value <= self.reach[1] else "MISSED"

    def told(self) -> str:
        (low, high), (better_low, better_high) = self.reach, self.stretch
        return f"{low:g} to {high:g} ({better_low:g} to {better_high:g})"


# By category of scenes. p95 is the distance in px from the true centre within which 95 % of the outlines are.
LIMITS: dict[str, tuple[Limit, ...]] = {
    "clean": (Limit("k", 1.35, 1.2),),
    "low contrast": (Limit("k", 1.35, 1.2),),
    "stem": (Limit("k", 1.8, 1.4),),
    "hidden": (Limit("k", 1.6, 1.25),),
    "small": (Limit("k", 1.6, 1.2),),
    "large": (Limit("k", 1.8, 1.4),),
    "motion": (Limit("k", 1.8, 1.4),),
    "defocus": (Limit("k", 1.4, 1.2),),
    "shaded": (Limit("p95", 0.025), Limit("k", float("inf"), 3.0)),
    "highlight": (Limit("k", 2.0, 1.6),),
    "ruby": (Limit("k", 4.5, 2.2),),
    "saturated": (Limit("k", 2.6, 1.5),),
    "clutter": (Limit("k", 5.0, 3.0), Limit("p95", 0.03)),
    "wide": (Limit("direction k", 1.5, 1.3), Limit("range k", 1.5, 1.3)),
    "tele": (Limit("direction k", 1.5, 1.3), Limit("range k", 1.5, 1.3)),
}

TRUE = Between((0.8, 1.25), (0.9, 1.1))
INFLATED = Between((0.3, 1.25), (0.9, 1.1))  # where the reason is in the result
MAY_BE_INFLATED = ("shaded", "highlight", "ruby", "clutter")

STILL_SIGMA = Limit("sigma / bound", 1.6, 1.3)
STILL_BIAS_PX = Limit("bias", 0.015, 0.006)
FOUND_BLURS = Limit("median in blurs", 10.0, 8.0)
FIT_BLURS = {"numba": Limit("blurs", 0.6, 0.2), "numpy": Limit("blurs", 3.5)}


def nees_limit(category: str, inflated_share: float) -> Between:
    """A covariance may only be larger than the noise says where the result tells why."""
    return INFLATED if category in MAY_BE_INFLATED and inflated_share > 0.0 else TRUE


def upper_95(events: int, trials: float) -> float:
    """The rate that a count of rare events leaves possible, at 95 % (3 / trials where there were none)."""
    return float(chi2.ppf(0.95, 2 * (events + 1)) / 2.0 / trials) if trials > 0 else float("inf")


def worst(verdicts: Sequence[str]) -> str:
    """Of several limits of one thing, the least that was reached."""
    return min(verdicts, key=("MISSED", "met", "stretch").index) if verdicts else ""
