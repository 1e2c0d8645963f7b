"""Jerk-limited motion along a line, in closed form. Only limits are given; times follow from them."""

from dataclasses import dataclass
from math import sqrt
from typing import TypeAlias

Motion: TypeAlias = tuple[float, float, float]  # way, speed, acceleration


@dataclass(frozen=True, slots=True)
class Ramp:
    """From rest to a speed, within acceleration and jerk. Its speed is point-symmetric, so its way is speed x duration / 2."""

    speed: float
    acceleration: float
    jerk: float

    @property
    def jerk_s(self) -> float:
        """Each of the two phases in which the acceleration changes."""
        return min(self.acceleration / self.jerk, sqrt(self.speed / self.jerk))

    @property
    def duration_s(self) -> float:
        bend_s = self.jerk_s
        return self.speed / (self.jerk * bend_s) + bend_s

    @property
    def way(self) -> float:
        return self.speed * self.duration_s / 2.0

    def at(self, t_s: float) -> Motion:
        """After the ramp the speed is kept."""
        bend_s, total_s = self.jerk_s, self.duration_s
        if t_s <= 0.0:
            return 0.0, 0.0, 0.0
        if t_s >= total_s:
            return self.way + self.speed * (t_s - total_s), self.speed, 0.0
        if t_s > total_s - bend_s:  # the last bend, seen from its end
            left_s = total_s - t_s
            return (
                self.way - self.speed * left_s + self.jerk * left_s**3 / 6.0,
                self.speed - self.jerk * left_s**2 / 2.0,
                self.jerk * left_s,
            )
        if t_s <= bend_s:
            return self.jerk * t_s**3 / 6.0, self.jerk * t_s**2 / 2.0, self.jerk * t_s
        peak, bend_speed = self.jerk * bend_s, self.jerk * bend_s**2 / 2.0
        steady_s = t_s - bend_s
        return (
            self.jerk * bend_s**3 / 6.0 + bend_speed * steady_s + peak * steady_s**2 / 2.0,
            bend_speed + peak * steady_s,
            peak,
        )


@dataclass(frozen=True, slots=True)
class Stroke:
    """From rest to rest over a length: a ramp up, a cruise, the ramp mirrored."""

    length: float
    ramp: Ramp

    @classmethod
    def over(cls, length: float, fastest: Ramp) -> "Stroke":
        """At the speed of `fastest`, or the highest that leaves room to stop."""
        if 2.0 * fastest.way <= length:
            return cls(length, fastest)
        low, high = 0.0, fastest.speed
        for _ in range(60):  # bisection to the last bit
            speed = (low + high) / 2.0
            fits = 2.0 * Ramp(speed, fastest.acceleration, fastest.jerk).way <= length
            low, high = (speed, high) if fits else (low, speed)
        return cls(length, Ramp(low, fastest.acceleration, fastest.jerk))

    @property
    def duration_s(self) -> float:
        return self.ramp.duration_s + self.length / self.ramp.speed  # ramps and cruise, each at its mean speed

    def at(self, t_s: float) -> Motion:
        if t_s * 2.0 <= self.duration_s:
            return self.ramp.at(t_s)
        way, speed, acceleration = self.ramp.at(self.duration_s - t_s)
        return self.length - way, speed, -acceleration
