"""From a pixel offset to a set-point, and the closed loop with its delays, noise and limits."""

from collections.abc import Callable
from dataclasses import dataclass, field
from math import hypot

import numpy as np
import pytest

from trackerd.contract.clock import HostNs
from trackerd.contract.errors import Degenerate
from trackerd.contract.model import AxisAngles
from trackerd.formats.settings import SteeringSettings
from trackerd.steering.follow import Looked, SetPoint, angle_from_offset, correction_share, follow
from trackerd.steering.limits import SetPointLimiter
from trackerd.steering.motion import Motion, Predicted

ARCSEC = np.pi / 648_000.0
PX_RAD = 6.6 * ARCSEC
Path = Callable[[float], tuple[float, float]]


def angles(az_rad: float, el_rad: float) -> AxisAngles:
    return AxisAngles(az_rad, el_rad, 1e-5, 0.0, None, 0.0, "latch")


def test_turning_by_the_answer_takes_the_target_to_the_aim_pixel() -> None:
    jacobian = np.array(((-40.0, -31000.0), (30990.0, 25.0)))
    turn = angle_from_offset(jacobian, (12.0, -7.0))
    assert jacobian @ np.array(turn) + np.array((12.0, -7.0)) == pytest.approx((0.0, 0.0), abs=1e-9)


def test_a_target_seen_along_an_axis_cannot_be_steered_to() -> None:
    with pytest.raises(Degenerate, match="along an axis"):
        angle_from_offset(np.array(((31000.0, 31000.0), (10.0, 10.0))), (1.0, 1.0))


def looked(offset_px: float = 30.0) -> Looked:
    return Looked(HostNs(0), angles(0.2, 0.1), (offset_px * PX_RAD, 0.0), (offset_px, 0.0))


def test_the_command_is_latched_angle_plus_gain_times_pixel_angle() -> None:
    point = follow(looked(), 0.7, 0.5, HostNs(30_000_000), None, None)
    assert point == SetPoint(0.2 + 0.7 * 30.0 * PX_RAD, 0.1, 0.0, 0.0, HostNs(30_000_000))


def test_predicted_motion_moves_the_command_on_and_gives_its_rate() -> None:
    def predict(instant: HostNs) -> Predicted:
        return Predicted(5.0 + 0.1 * instant * 1e-9, 3.0, 0.1, 0.0)

    point = follow(looked(), 0.7, 0.5, HostNs(30_000_000), predict, None)
    assert point.az_rad == pytest.approx(0.2 + 0.7 * 30.0 * PX_RAD + 0.003)
    assert (point.az_rad_s, point.el_rad_s) == (0.1, 0.0)
    assert point.moved_to(HostNs(40_000_000)).az_rad == pytest.approx(point.az_rad + 0.001)


def test_inside_the_deadband_the_set_point_stays_whatever_the_encoders_noise() -> None:
    previous = SetPoint(0.2001, 0.0999, 0.0, 0.0, HostNs(0))
    point = follow(looked(0.4), 0.7, 0.5, HostNs(30_000_000), None, previous)
    assert (point.az_rad, point.el_rad) == (previous.az_rad, previous.el_rad)


def test_the_deadband_has_no_step_at_its_edge() -> None:
    shares = [correction_share(px, 0.5) for px in np.linspace(0.0, 2.0, 401)]
    assert max(np.diff(shares)) < 0.011
    assert (shares[0], shares[-1]) == (0.0, 1.0)
    assert correction_share(0.0, 0.0) == 1.0


@dataclass
class Loop:
    """One station's loop: frames at 55 Hz, 25 ms from mid-exposure to the bus, set-points every 5 ms, a quick servo."""

    settings: SteeringSettings = field(default_factory=SteeringSettings)
    latency_s: float = 0.025
    noise_rad: float = 2.0 * ARCSEC
    pixel_noise: float = 0.02

    def run(self, path: Path, duration_s: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
        """Pixel offsets of the frames (n, 2), and the axes every millisecond (m, 2)."""
        random, motion = np.random.default_rng(seed), Motion()
        limiter = SetPointLimiter(self.settings)
        axes = np.array(path(0.0))
        limiter.reset(*axes.tolist(), 0.0, 0.0)
        command, rates = axes, np.zeros(2)
        offsets, trace, on_the_way, previous, point = [], [], [], None, None
        for tick in range(round(duration_s * 1000)):
            t_s, now = tick * 1e-3, HostNs(tick * 1_000_000)
            if t_s * 55.0 >= len(offsets):
                offset = (np.array(path(t_s)) - axes) / PX_RAD
                offsets.append(offset)
                seen = offset + self.pixel_noise * random.standard_normal(2)
                latched = angles(*(axes + self.noise_rad * random.standard_normal(2)).tolist())
                turn = (seen * PX_RAD).tolist()
                motion.update(now, latched.az_rad + turn[0], latched.el_rad + turn[1])
                at = HostNs(now + round((self.latency_s + 0.009) * 1e9))
                predict = motion.predict if self.settings.feed_forward else None
                view = Looked(now, latched, (turn[0], turn[1]), (seen[0], seen[1]))
                previous = follow(view, self.settings.gain, self.settings.deadband_px, at, predict, previous)
                on_the_way.append((t_s + self.latency_s, previous))
            while on_the_way and on_the_way[0][0] <= t_s:
                point = on_the_way.pop(0)[1]
            if tick % 5 == 0 and point is not None:
                target = point.moved_to(now)
                *place, az_rate, el_rate = limiter.step(target.az_rad, target.el_rad, target.az_rad_s, target.el_rad_s, 5e-3)
                command, rates = np.array(place), np.array((az_rate, el_rate))
            axes = axes + rates * 1e-3 + (command + rates * (tick % 5) * 1e-3 - axes) * 0.25
            trace.append(axes)
        return np.array(offsets), np.array(trace)


def settled(offsets: np.ndarray) -> np.ndarray:
    return np.hypot(*offsets[60:].T)


def circle(t_s: float) -> tuple[float, float]:
    w = 0.25 / 0.15  # 250 mm/s on a radius of 150 mm, 2 m away
    return 0.075 * np.cos(w * t_s), 0.075 * np.sin(w * t_s)


def swing(t_s: float) -> tuple[float, float]:
    return 0.5 / 3.0**2 * np.sin(3.0 * t_s), 0.0  # up to 1 m/s^2 at 2 m


def still(t_s: float) -> tuple[float, float]:
    return 0.01, 0.02


@pytest.mark.parametrize("path", [circle, swing])
@pytest.mark.parametrize("latency_s", [0.02, 0.03])
def test_the_loop_keeps_the_target_within_twenty_pixels(path: Path, latency_s: float) -> None:
    offsets, _ = Loop(latency_s=latency_s).run(path, 4.0)
    assert settled(offsets).max() < 12.0


def test_a_proportional_loop_alone_trails_far_behind() -> None:
    offsets, _ = Loop(SteeringSettings(feed_forward=False)).run(circle, 3.0)
    assert settled(offsets).mean() > 50.0


@pytest.mark.parametrize("gain", [0.1, 0.4, 1.0])
def test_the_loop_is_stable_and_finds_its_target_at_every_gain(gain: float) -> None:
    def step(t_s: float) -> tuple[float, float]:
        return (0.0, 0.0) if t_s == 0.0 else (0.002, -0.001)  # 60 px away

    offsets, _ = Loop(SteeringSettings(gain=gain)).run(step, 4.0)
    assert settled(offsets)[-40:].max() < 1.5


def test_a_still_target_is_not_hunted() -> None:
    offsets, trace = Loop().run(still, 4.0)
    assert settled(offsets).max() < 1.0
    assert np.abs(np.diff(trace[1500:], axis=0)).sum() < 0.5 * PX_RAD


def test_without_a_deadband_the_axes_carry_the_encoders_noise() -> None:
    _, calm = Loop().run(still, 3.0)
    _, busy = Loop(SteeringSettings(deadband_px=0.0)).run(still, 3.0)
    way = [np.abs(np.diff(trace[1500:], axis=0)).sum() for trace in (calm, busy)]
    assert way[1] > 20.0 * way[0]


def test_a_slow_target_at_the_edge_of_the_deadband_is_followed_without_chatter() -> None:
    def creep(t_s: float) -> tuple[float, float]:
        return 2.0 * PX_RAD * t_s, 0.0  # two pixels a second

    offsets, trace = Loop().run(creep, 6.0)
    assert settled(offsets).max() < 2.0
    _, busy = Loop(SteeringSettings(deadband_px=0.0)).run(creep, 6.0)
    way = [np.abs(np.diff(moves[2000:, 0])).sum() for moves in (trace, busy)]
    assert way[0] < 3.0 * 4.0 * 2.0 * PX_RAD  # 4 s of 2 px/s: little to and fro
    assert way[0] < 0.4 * way[1]


def test_the_offset_of_a_lost_and_found_target_is_worked_off_within_the_limits() -> None:
    def jump(t_s: float) -> tuple[float, float]:
        return (0.0, 0.0) if t_s < 1.0 else (0.005, 0.004)

    offsets, trace = Loop().run(jump, 3.0)
    assert hypot(*offsets[-1]) < 1.5
    assert np.abs(np.diff(trace, axis=0)).max() < np.radians(30.0) * 1e-3 * 1.3
