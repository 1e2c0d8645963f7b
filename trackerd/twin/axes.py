"""What a controller moves, as the controller sees it: two channels, az and el, in encoder radians and scene ns."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from trackerd.formats.gimbal_map import counts
from trackerd.formats.twin import EncoderSettings
from trackerd.sim.gimbal import SimGimbal

Pair = tuple[float, float]  # az, el


@dataclass(frozen=True, slots=True)
class SetPoints:
    """A straight line in time for both channels, which ends in standing still."""

    rad: Pair
    rad_s: Pair
    at_ns: int  # the instant that `rad` is of
    until_ns: int  # carried on until here

    def at(self, t_ns: int) -> Pair:
        s = (min(t_ns, self.until_ns) - self.at_ns) * 1e-9
        return self.rad[0] + self.rad_s[0] * s, self.rad[1] + self.rad_s[1] * s


class Axes(Protocol):
    """Both servo axes with their encoders. Commands take effect at the instant that was advanced to."""

    @property
    def limits_rad(self) -> tuple[Pair, Pair]: ...

    @property
    def max_rad_s(self) -> float: ...

    @property
    def max_rad_s2(self) -> float: ...

    def advance(self, t_ns: int) -> None: ...

    def hold(self, t_ns: int) -> None:
        """Ramp down, then stay."""
        ...

    def go(self, t_ns: int, target: SetPoints) -> None: ...

    def turn(self, t_ns: int, rad_s: Pair) -> None: ...

    def reading(self, t_ns: int) -> Pair:
        """The encoders, with all their errors; at most 0.5 s back."""
        ...

    def latched(self, edge_ns: int, exposure_ns: int) -> Pair:
        """What the latch input captures for an edge of the exposure that began at `exposure_ns`."""
        ...

    @property
    def latch_settles_ns(self) -> int:
        """So long after an edge its angles are captured for certain."""
        ...

    def motion(self, t_ns: int) -> tuple[Pair, Pair]:
        """True angles and rates."""
        ...


class GimbalAxes:
    """The axes of a simulated gimbal."""

    def __init__(self, gimbal: SimGimbal, encoder: EncoderSettings) -> None:
        self._gimbal = gimbal
        self.latch_settles_ns = max(0, round(1000.0 * (encoder.latch_skew_us + 5.0 * encoder.latch_jitter_us)))
        self.limits_rad = (gimbal.az.limits.travel_rad, gimbal.el.limits.travel_rad)
        self.max_rad_s = gimbal.az.limits.rad_s
        self.max_rad_s2 = gimbal.az.limits.rad_s2

    def advance(self, t_ns: int) -> None:
        self._gimbal.az.advance(t_ns)
        self._gimbal.el.advance(t_ns)

    def hold(self, t_ns: int) -> None:
        self._gimbal.az.hold(t_ns)
        self._gimbal.el.hold(t_ns)

    def go(self, t_ns: int, target: SetPoints) -> None:
        for servo, rad, rad_s in zip((self._gimbal.az, self._gimbal.el), target.rad, target.rad_s, strict=True):
            servo.follow(t_ns, rad, rad_s, target.at_ns, target.until_ns - t_ns)

    def turn(self, t_ns: int, rad_s: Pair) -> None:
        self._gimbal.az.turn(t_ns, rad_s[0])
        self._gimbal.el.turn(t_ns, rad_s[1])

    def reading(self, t_ns: int) -> Pair:
        return self._gimbal.encoder(t_ns)

    def latched(self, edge_ns: int, exposure_ns: int) -> Pair:
        return self._gimbal.latched(edge_ns, exposure_ns)

    def motion(self, t_ns: int) -> tuple[Pair, Pair]:
        return self._gimbal.angles(t_ns), self._gimbal.rates(t_ns)


def fractions(angles_rad: Pair) -> tuple[int, int]:
    """u32 fractions of a turn."""
    return counts(angles_rad[0])[0], counts(angles_rad[1])[0]


def outside(rad: Pair, limits_rad: Sequence[Pair], slack_rad: float = 0.0) -> int | None:
    """The first channel (0 az, 1 el) whose angle is beyond its travel."""
    for channel, (angle, (low, high)) in enumerate(zip(rad, limits_rad, strict=True)):
        if not low - slack_rad <= angle <= high + slack_rad:
            return channel
    return None
