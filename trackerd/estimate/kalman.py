"""The target's motion: filterpy's Kalman filter over points with covariances, at irregular instants.

The state is position, velocity and, for constant acceleration, acceleration, in mm and s, blocks of three. Process noise is
continuous white acceleration or jerk, integrated exactly over each interval; surprising innovations raise it for a while.
"""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from filterpy.kalman import KalmanFilter

from trackerd.contract.clock import HostNs
from trackerd.contract.model import Array

SPEED_SIGMA_MM_S = 1000.0  # of a target that has been seen once
ACCELERATION_SIGMA_MM_S2 = 10_000.0
SURPRISE_CHI2 = 13.0  # innovation that 1 in 200 exceeds: the target moves harder than the process noise says
LEVELS = 6  # of process noise, each ten times the one below: the last follows 5 m/s^2 from one frame to the next
CALM_UPDATES = 10  # without surprise, before the noise goes down one level
UNIT = np.eye(3)


class MotionModel(StrEnum):
    CONSTANT_VELOCITY = "constant_velocity"
    CONSTANT_ACCELERATION = "constant_acceleration"


@dataclass(frozen=True, slots=True)
class Motion:
    """State at an instant, in W."""

    p_mm: Array  # (3,)
    v_mm_s: Array  # (3,)
    cov_mm2: Array  # (3, 3) of the position


@dataclass(frozen=True, slots=True)
class Innovation:
    chi2: float  # 3 degrees of freedom
    accepted: bool


class MotionFilter:
    """One target. Starts at its first point; a point that fails the gate leaves the state as it was."""

    def __init__(self, model: MotionModel, process_noise: float, gate_chi2: float) -> None:
        """`process_noise`: mm^2/s^3 for constant velocity, mm^2/s^5 for constant acceleration."""
        self._order = 2 if model is MotionModel.CONSTANT_VELOCITY else 3
        self._process_noise = process_noise
        self._gate_chi2 = gate_chi2
        self._filter: KalmanFilter | None = None
        self._instant = HostNs(0)
        self._level = self._calm = 0

    @property
    def instant(self) -> HostNs | None:
        """Of the last accepted point; None before the first."""
        return None if self._filter is None else self._instant

    def reset(self) -> None:
        self._filter = None

    def update(self, instant: HostNs, p_mm: Array, cov_mm2: Array) -> Innovation:
        """Take a point (3,) with its covariance (3, 3). One that is not newer than the state is not accepted."""
        if self._filter is None:
            self._start(instant, p_mm, cov_mm2)
            return Innovation(0.0, True)
        if instant <= self._instant:
            return Innovation(0.0, False)
        for level in range(self._level, LEVELS):
            transition, noise = self._step((instant - self._instant) * 1e-9, level)
            chi2 = self._chi2(transition, noise, p_mm, cov_mm2)
            if chi2 <= SURPRISE_CHI2:
                break
        if not chi2 <= self._gate_chi2:
            return Innovation(chi2, False)
        self._settle(level)
        self._filter.predict(F=transition, Q=noise)
        self._filter.update(p_mm[:, None], R=cov_mm2)
        self._filter.P = (self._filter.P + self._filter.P.T) / 2.0
        self._instant = instant
        return Innovation(chi2, True)

    def predict(self, instant: HostNs) -> Motion:
        """State at any instant from the last accepted point on; the filter itself does not move. At least one point first."""
        if self._filter is None:
            raise ValueError("a motion without a point has no state")
        x, cov = self._filter.x, self._filter.P
        if instant != self._instant:
            transition, noise = self._step(max(0, instant - self._instant) * 1e-9, self._level)
            x, cov = transition @ x, transition @ cov @ transition.T + noise
        return Motion(x[:3, 0].copy(), x[3:6, 0].copy(), cov[:3, :3].copy())

    def _start(self, instant: HostNs, p_mm: Array, cov_mm2: Array) -> None:
        size = 3 * self._order
        self._filter = KalmanFilter(dim_x=size, dim_z=3)
        self._filter.H = np.eye(3, size)
        self._filter.x[:3, 0] = p_mm
        sigmas = np.repeat((0.0, SPEED_SIGMA_MM_S, ACCELERATION_SIGMA_MM_S2)[: self._order], 3)
        self._filter.P = np.diag(sigmas**2)
        self._filter.P[:3, :3] = cov_mm2
        self._instant = instant
        self._level = self._calm = 0

    def _settle(self, level: int) -> None:
        """Up at once, down after a calm while."""
        self._calm = self._calm + 1 if level == self._level else 0
        self._level = level
        if self._calm >= CALM_UPDATES:
            self._level, self._calm = max(0, level - 1), 0

    def _step(self, dt_s: float, level: int) -> tuple[Array, Array]:
        """Transition and process noise over an interval."""
        t = dt_s
        if self._order == 2:
            f = np.array(((1.0, t), (0.0, 1.0)))
            q = np.array(((t**3 / 3, t**2 / 2), (t**2 / 2, t)))
        else:
            f = np.array(((1.0, t, t * t / 2), (0.0, 1.0, t), (0.0, 0.0, 1.0)))
            q = np.array(((t**5 / 20, t**4 / 8, t**3 / 6), (t**4 / 8, t**3 / 3, t**2 / 2), (t**3 / 6, t**2 / 2, t)))
        return _per_axis(f), _per_axis(self._process_noise * 10.0**level * q)

    def _chi2(self, transition: Array, noise: Array, p_mm: Array, cov_mm2: Array) -> float:
        assert self._filter is not None
        top = transition[:3]
        y = p_mm - (top @ self._filter.x)[:, 0]
        spread = top @ self._filter.P @ top.T + noise[:3, :3] + cov_mm2
        return float(y @ np.linalg.solve(spread, y))


def _per_axis(block: Array) -> Array:
    """Kronecker product with the unit matrix of the three axes; numpy's own costs five times as much."""
    size = 3 * len(block)
    return np.asarray((block[:, None, :, None] * UNIT[None, :, None, :]).reshape(size, size))
