"""One servo axis: set-points in, angle and rate at any recent instant out. Limits of speed, acceleration and travel hold.

It steps at 1 kHz of the scene's time, and only when somebody asks. Between two steps the acceleration is constant, so the cubic
through both ends is the exact motion. A command counts from the first step after its instant.
"""

from dataclasses import dataclass
from enum import IntEnum
from math import pi, radians, sqrt

from trackerd.formats.twin import AxesSettings

STEP_NS = 1_000_000
STEP_S = 1e-3
RING = 1024  # steps that are remembered, about one second
RING_MASK = RING - 1
EXTRAPOLATE_NS = 100_000_000  # a moving set-point that is not renewed stands still after this
STOP_SHARE = 0.8  # of the acceleration, planned for stopping at a distant set-point: the rest is for the loop


class ServoMode(IntEnum):
    HOLD = 0
    POSITION = 1
    VELOCITY = 2


@dataclass(frozen=True, slots=True)
class AxisLimits:
    """What the axis can do, in rad and s."""

    rad_s: float
    rad_s2: float
    travel_rad: tuple[float, float]
    bandwidth_rad_s: float
    damping: float

    @classmethod
    def of(cls, axes: AxesSettings, travel_rad: tuple[float, float]) -> "AxisLimits":
        return cls(radians(axes.max_deg_s), radians(axes.max_deg_s2), travel_rad, 2.0 * pi * axes.bandwidth_hz, axes.damping)


class AxisServo:
    """Second-order position loop with velocity feed-forward; far from its set-point it plans its stop instead."""

    def __init__(self, limits: AxisLimits, angle_rad: float, t_ns: int = 0) -> None:
        self.limits = limits
        self.mode = ServoMode.HOLD
        self._step = t_ns // STEP_NS
        self._angle, self._rate = angle_rad, 0.0
        self._angles, self._rates = [angle_rad] * RING, [0.0] * RING
        self._set_angle, self._set_rate = angle_rad, 0.0
        self._set_at_ns, self._set_until_ns = t_ns, t_ns
        self._gain = 2.0 * limits.damping * limits.bandwidth_rad_s
        self._approach = limits.bandwidth_rad_s / (2.0 * limits.damping)
        self._stop_zone = limits.rad_s**2 / (2.0 * limits.rad_s2) + 2.0 * limits.rad_s * STEP_S

    def hold(self, t_ns: int) -> None:
        """Ramp down, then stay."""
        self.advance(t_ns)
        self.mode = ServoMode.HOLD

    def follow(
        self, t_ns: int, angle_rad: float, rad_s: float = 0.0, at_ns: int | None = None, extrapolate_ns: int = EXTRAPOLATE_NS
    ) -> None:
        """The set-point angle + rad_s (t - at_ns); the motion ends `extrapolate_ns` after t_ns, and the angle there stays."""
        self.advance(t_ns)
        self.mode = ServoMode.POSITION
        self._set_angle, self._set_rate = angle_rad, rad_s
        self._set_at_ns = t_ns if at_ns is None else at_ns
        self._set_until_ns = t_ns + extrapolate_ns

    def turn(self, t_ns: int, rad_s: float) -> None:
        """A speed, until told otherwise."""
        self.advance(t_ns)
        self.mode = ServoMode.VELOCITY
        self._set_rate = rad_s

    def angle(self, t_ns: int) -> float:
        """True angle at an instant of the last second; the axis is advanced to it where it is ahead."""
        self.advance(t_ns)
        a0, v0, a1, v1, u = self._around(t_ns)
        hermite = a0 + u * u * (3.0 - 2.0 * u) * (a1 - a0)
        return hermite + STEP_S * u * (1.0 - u) * ((1.0 - u) * v0 - u * v1)

    def rate(self, t_ns: int) -> float:
        """True rate, as `angle`."""
        self.advance(t_ns)
        _, v0, _, v1, u = self._around(t_ns)
        return v0 + u * (v1 - v0)

    def advance(self, t_ns: int) -> None:
        """Step up to the first step at or after t_ns."""
        last = -(-t_ns // STEP_NS)
        while self._step < last:
            self._take_step()

    def _take_step(self) -> None:
        angle, rate = self._angle, self._rate
        low, high = self._reachable(angle, rate)
        new_rate = min(max(self._wanted_rate(angle, rate), low), high)
        self._angle = angle = angle + (rate + new_rate) * (STEP_S / 2.0)
        self._rate = new_rate
        self._step += 1
        place = self._step & RING_MASK
        self._angles[place], self._rates[place] = angle, new_rate

    def _wanted_rate(self, angle: float, rate: float) -> float:
        """The rate after the next step, before any limit."""
        if self.mode is ServoMode.HOLD:
            return 0.0
        if self.mode is ServoMode.VELOCITY:
            return self._set_rate
        t_ns = self._step * STEP_NS
        wanted = self._set_rate
        if t_ns > self._set_until_ns:
            t_ns, wanted = self._set_until_ns, 0.0
        error = self._set_angle + self._set_rate * (t_ns - self._set_at_ns) * 1e-9 - angle
        approach = self._approach * error
        stopping = sqrt(2.0 * STOP_SHARE * self.limits.rad_s2 * abs(error))
        wanted += min(max(approach, -stopping), stopping)
        return rate + self._gain * STEP_S * (wanted - rate)

    def _reachable(self, angle: float, rate: float) -> tuple[float, float]:
        """The rates that keep all limits after the next step, and leave room to keep them ever after."""
        limits = self.limits
        change = limits.rad_s2 * STEP_S
        low, high = max(rate - change, -limits.rad_s), min(rate + change, limits.rad_s)
        travel_low, travel_high = limits.travel_rad
        if travel_high - angle < self._stop_zone:
            high = min(high, _stoppable(travel_high - angle, rate, change))
            low = min(low, high)
        if angle - travel_low < self._stop_zone:
            low = max(low, -_stoppable(angle - travel_low, -rate, change))
            high = max(low, high)
        return low, high

    def _around(self, t_ns: int) -> tuple[float, float, float, float, float]:
        """Angle and rate at the steps before and after an instant, and where between them it is (0..1)."""
        before, rest_ns = divmod(t_ns, STEP_NS)
        before = max(before, self._step - RING + 1)
        a, b = before & RING_MASK, min(before + 1, self._step) & RING_MASK
        return self._angles[a], self._rates[a], self._angles[b], self._rates[b], rest_ns / STEP_NS


def _stoppable(distance: float, rate: float, change: float) -> float:
    """The highest rate towards an end of travel after the next step from which whole steps of braking stop in front of it.

    In units of the braking step, n' = -1/2 + sqrt(2 D - n): the way n/2 + n'/2 now, n'^2/2 + 1/8 at most afterwards. Braking
    at the limit always satisfies it again at the next step.
    """
    room = 2.0 * distance / (change * STEP_S) - rate / change
    return change * max(0.0, sqrt(room) - 0.5) if room > 0.25 else 0.0
