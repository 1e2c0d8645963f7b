"""The target's motion in the encoder angles of one station: where would the axes have to be to see it at the aim pixel?

Kalman filter with constant acceleration and white jerk, at the frames' own, irregular instants. Both axes have the same noise
and the same instants, so they share one covariance.
"""

from dataclasses import dataclass
from math import sqrt

import numpy as np

from trackerd.contract.clock import HostNs
from trackerd.contract.model import Array

MEASURED_RAD = 1.2e-5  # 2.5 arcsec: encoder repeatability and a tenth of a pixel
JERK_RAD2_S5 = 0.1  # power of the jerk's white noise: 0.5 rad/s^2 at 3 rad/s stays within 7 px of 6.6 arcsec, 30 ms late
UNKNOWN_RAD_S, UNKNOWN_RAD_S2 = 2.0, 3.0  # before anything is known
HONEST_SAMPLES = 2  # and what they tell has to stand out of their noise: a probe that flies through the view is caught
STEADY_SAMPLES = 6  # fewer tell no acceleration
STILL_SIGMA = 4.0  # rates and accelerations below this, two of each, are taken for noise
LONGEST_GAP_S = 0.5
ACCELERATING_S = 0.05  # an acceleration is believed for this long ahead, then the velocity stays


@dataclass(frozen=True, slots=True)
class Predicted:
    az_rad: float
    el_rad: float
    az_rad_s: float
    el_rad_s: float


class Motion:
    """Filter of one target; `reset` when it is lost or another one is chosen."""

    def __init__(self, measured_rad: float = MEASURED_RAD, jerk_rad2_s5: float = JERK_RAD2_S5) -> None:
        self._variance = measured_rad**2
        self._jerk = jerk_rad2_s5
        self.reset()

    def reset(self) -> None:
        self._state = np.zeros((3, 2))  # angle, rate, acceleration of (az, el)
        self._cov = np.zeros((3, 3))
        self._instant: HostNs | None = None
        self._samples = 0

    @property
    def samples(self) -> int:
        return self._samples

    def update(self, instant: HostNs, az_rad: float, el_rad: float) -> None:
        """The target's angles at an instant. A stamp that does not move on is ignored, a long gap starts anew."""
        measured = np.array((az_rad, el_rad))
        if self._instant is not None and (instant - self._instant) * 1e-9 > LONGEST_GAP_S:
            self.reset()
        if self._instant is None:
            self._state[0] = measured
            self._cov = np.diag((self._variance, UNKNOWN_RAD_S**2, UNKNOWN_RAD_S2**2))
        elif instant <= self._instant:
            return
        else:
            self._advance((instant - self._instant) * 1e-9)
            gain = self._cov[:, 0] / (self._cov[0, 0] + self._variance)
            self._state = self._state + np.outer(gain, measured - self._state[0])
            self._cov = self._cov - np.outer(gain, self._cov[0])
        self._instant = instant
        self._samples += 1

    def predict(self, instant: HostNs) -> Predicted | None:
        """Angles and rates at an instant, rates 0 until two samples have been seen. None: nothing has been seen."""
        if self._instant is None:
            return None
        dt_s = (instant - self._instant) * 1e-9
        angle, rate, acceleration = self._state
        share = self._moving_share()
        if share == 0.0:
            return Predicted(float(angle[0]), float(angle[1]), 0.0, 0.0)
        rate, acceleration = share * rate, share * acceleration
        bent_s = min(max(dt_s, -ACCELERATING_S), ACCELERATING_S) if self._samples >= STEADY_SAMPLES else 0.0
        then = angle + rate * dt_s + acceleration * bent_s * (dt_s - 0.5 * bent_s)
        rates = rate + acceleration * bent_s
        return Predicted(float(then[0]), float(then[1]), float(rates[0]), float(rates[1]))

    def _moving_share(self) -> float:
        """0: stands still as far as its noise tells, 1: it moves, linear between. Noise fed forward would make the axes hunt.

        Rate and acceleration are judged together: where a target turns round, its rate alone looks like standing still.
        """
        if self._samples < HONEST_SAMPLES:
            return 0.0
        (a, b), (_, d) = self._cov[1:, 1:].tolist()
        (az_rate, el_rate), (az_bend, el_bend) = self._state[1:].tolist()
        squares = (
            d * (az_rate**2 + el_rate**2) - 2.0 * b * (az_rate * az_bend + el_rate * el_bend) + a * (az_bend**2 + el_bend**2)
        )
        return min(max(sqrt(max(squares, 0.0) / (a * d - b * b)) / STILL_SIGMA - 1.0, 0.0), 1.0)

    def _advance(self, dt_s: float) -> None:
        step = np.array(((1.0, dt_s, 0.5 * dt_s * dt_s), (0.0, 1.0, dt_s), (0.0, 0.0, 1.0)))
        self._state = step @ self._state
        self._cov = step @ self._cov @ step.T + self._jerk * white_jerk(dt_s)


def white_jerk(dt_s: float) -> Array:
    """Covariance (3, 3) that white jerk of unit power adds to angle, rate and acceleration."""
    d2, d3, d4, d5 = dt_s**2, dt_s**3, dt_s**4, dt_s**5
    return np.array(((d5 / 20.0, d4 / 8.0, d3 / 6.0), (d4 / 8.0, d3 / 3.0, d2 / 2.0), (d3 / 6.0, d2 / 2.0, dt_s)))
