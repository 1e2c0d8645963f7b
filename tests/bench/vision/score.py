"""What a row of answers is worth against the truth and the bound of each frame."""

from dataclasses import dataclass, field
from math import nan
from re import sub

import numpy as np
from trials import Trial

from trackerd.contract.model import Array, Found, Missed, Outline

FAR_PX, FAR_SIGMAS = 1.0, 8.0  # an answer farther than the greater of both from the true centre is a failure

Circle = tuple[float, float, float]


@dataclass(slots=True)
class Score:
    """Errors (x, y, r) of the answers, and the bound's sigmas; failures are counted, and left out of everything else."""

    frames: int = 0
    failures: int = 0
    inflated: int = 0
    errors_px: list[Array] = field(default_factory=list)
    sigmas_px: list[Array] = field(default_factory=list)
    nees: list[tuple[float, float]] = field(default_factory=list)  # of (x, y) / 2, of (x, y, r) / 3
    reasons: dict[str, list[int]] = field(default_factory=dict)  # seeds of the frames: why inflated, or why nothing was found

    def add(self, trial: Trial, circle: Circle | None) -> bool:
        """False: a failure."""
        self.frames += 1
        error, sigma = trial.error_px(circle) if circle is not None else None, trial.sigma_px
        if error is None or not np.hypot(error[0], error[1]) <= max(FAR_PX, FAR_SIGMAS * float(sigma[:2].max())):
            self.failures += 1
            return False
        self.errors_px.append(error)
        self.sigmas_px.append(sigma)
        return True

    def add_outline(self, trial: Trial, outline: Outline) -> None:
        """With the covariance that the outline claims."""
        if isinstance(outline, Missed):
            self.add(trial, None)
            self._note(outline.reason, trial)
        elif self.add(trial, circle_of(outline)):
            error, cov = self.errors_px[-1], outline.cov_px2
            self.nees.append((_normalised(error[:2], cov[:2, :2]), _normalised(error, cov)))
            self.inflated += bool(outline.inflated)
            if outline.inflated:
                self._note(outline.inflated, trial)
        else:
            self._note("found somewhere else", trial)

    def _note(self, reason: str, trial: Trial) -> None:
        self.reasons.setdefault(sub(r"\d+ %", ".. %", reason), []).append(trial.seed)

    @property
    def k(self) -> float:
        """rms of error over bound, x and y pooled, bias included."""
        return rms((self._errors / self._sigmas)[:, :2])

    @property
    def k_r(self) -> float:
        return rms((self._errors / self._sigmas)[:, 2])

    @property
    def bias_px(self) -> Array:
        """Mean error of x, y and r, (3,)."""
        return np.asarray(self._errors.mean(axis=0)) if self.errors_px else np.full(3, nan)

    @property
    def sigma_px(self) -> float:
        """About the bias, x and y pooled."""
        return rms((self._errors - self.bias_px)[:, :2])

    @property
    def rms_px(self) -> float:
        return rms(self._errors[:, :2])

    @property
    def p95_px(self) -> float:
        """Distance from the true centre."""
        return float(np.percentile(np.hypot(*self._errors[:, :2].T), 95)) if self.errors_px else nan

    @property
    def nees_2(self) -> float:
        return float(np.mean([two for two, _ in self.nees])) if self.nees else nan

    @property
    def nees_3(self) -> float:
        return float(np.mean([three for _, three in self.nees])) if self.nees else nan

    @property
    def inflated_share(self) -> float:
        return self.inflated / max(len(self.nees), 1)

    @property
    def _errors(self) -> Array:
        return np.array(self.errors_px).reshape(-1, 3)

    @property
    def _sigmas(self) -> Array:
        return np.array(self.sigmas_px).reshape(-1, 3)


def circle_of(outline: Found) -> Circle:
    return outline.x_px, outline.y_px, outline.r_px


def rms(values: Array) -> float:
    return float(np.sqrt((values**2).mean())) if values.size else nan


def _normalised(error: Array, cov: Array) -> float:
    return float(error @ np.linalg.solve(cov, error)) / len(error)
