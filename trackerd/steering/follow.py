"""From the target's place in the image to a set-point of the axes: command = latched angle + gain x pixel angle + motion."""

from collections.abc import Callable
from dataclasses import dataclass
from math import hypot

from trackerd.contract.clock import HostNs
from trackerd.contract.errors import Degenerate
from trackerd.contract.model import Array, AxisAngles
from trackerd.steering.motion import Predicted

LEAST_DETERMINANT = 1e-3  # of the Jacobian, relative to its squares: the axes' effects are within 0.1 deg of parallel

Predict = Callable[[HostNs], Predicted | None]


@dataclass(frozen=True, slots=True)
class SetPoint:
    """Where the axes should be, and how fast, at an instant; encoder angles."""

    az_rad: float
    el_rad: float
    az_rad_s: float
    el_rad_s: float
    at: HostNs

    def moved_to(self, instant: HostNs) -> "SetPoint":
        """Extrapolated with its rates."""
        ahead_s = (instant - self.at) * 1e-9
        return SetPoint(
            self.az_rad + self.az_rad_s * ahead_s, self.el_rad + self.el_rad_s * ahead_s, self.az_rad_s, self.el_rad_s, instant
        )


@dataclass(frozen=True, slots=True)
class Looked:
    """What one frame says: the latched angles, and what is missing to the aim pixel."""

    exposed: HostNs
    angles: AxisAngles
    pixel_angle_rad: tuple[float, float]  # turn by this (az, el), and the target is at the aim pixel
    offset_px: tuple[float, float]  # of the target from the aim pixel


def angle_from_offset(jacobian: Array, offset_px: tuple[float, float]) -> tuple[float, float]:
    """The turn (az, el), rad, that takes a target at `offset_px` from the aim pixel to it; `jacobian` (2, 2) is d px / d rad.

    Raises Degenerate where the axes cannot move the target both ways (it is seen along an axis).
    """
    (a, b), (c, d) = jacobian.tolist()
    x, y = offset_px
    det = a * d - b * c
    if abs(det) < LEAST_DETERMINANT * (a * a + b * b + c * c + d * d):
        raise Degenerate("the target is seen along an axis: the axes cannot move it in the image both ways")
    return (b * y - d * x) / det, (c * x - a * y) / det


def follow(
    looked: Looked, gain: float, deadband_px: float, at: HostNs, predict: Predict | None, previous: SetPoint | None
) -> SetPoint:
    """Set-point for the instant `at`.

    Outside the deadband: latched angle + gain x pixel angle, moved on by the predicted motion (None: no feed-forward). Inside,
    the previous set-point is kept, moved on likewise: no proportional part, and the encoders' noise is not fed back, which
    would make the axes wander. Between one and two deadbands the one goes over into the other: no edge to chatter at.
    """
    az_move, el_move, az_rate, el_rate = _motion(predict, looked.exposed, at)
    az = looked.angles.az_rad + gain * looked.pixel_angle_rad[0] + az_move
    el = looked.angles.el_rad + gain * looked.pixel_angle_rad[1] + el_move
    share = correction_share(hypot(*looked.offset_px), deadband_px)
    if previous is not None and share < 1.0:
        az_held, el_held, _, _ = _motion(predict, previous.at, at)
        az = share * az + (1.0 - share) * (previous.az_rad + az_held)
        el = share * el + (1.0 - share) * (previous.el_rad + el_held)
    return SetPoint(az, el, az_rate, el_rate, at)


def correction_share(offset_px: float, deadband_px: float) -> float:
    """0 inside the deadband, 1 from twice its width on, linear between."""
    if deadband_px == 0.0:
        return 1.0
    return min(max(offset_px / deadband_px - 1.0, 0.0), 1.0)


def _motion(predict: Predict | None, since: HostNs, until: HostNs) -> tuple[float, float, float, float]:
    """Predicted movement between two instants, and the rates at the second."""
    before, after = (None, None) if predict is None else (predict(since), predict(until))
    if before is None or after is None:
        return 0.0, 0.0, 0.0, 0.0
    return after.az_rad - before.az_rad, after.el_rad - before.el_rad, after.az_rad_s, after.el_rad_s
