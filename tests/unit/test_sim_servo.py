from math import cos, exp, pi, sin

import pytest

from trackerd.formats.twin import AxesSettings
from trackerd.sim.servo import AxisLimits, AxisServo

MS = 1_000_000
LIMITS = AxisLimits.of(AxesSettings(), (-1.0, 1.0))


def test_a_ramp_of_set_points_is_followed_without_lag():
    servo = AxisServo(LIMITS, 0.0)
    for t_ns in range(0, 500 * MS, 5 * MS):
        servo.follow(t_ns, 0.125 * t_ns * 1e-9, 0.125)
    assert servo.angle(503 * MS) == pytest.approx(0.125 * 0.503, abs=1e-9)
    assert servo.rate(503 * MS) == pytest.approx(0.125, abs=1e-9)


def test_a_probe_on_a_circle_is_followed_within_a_pixel():
    size, turn = 0.075, 250.0 / 150.0  # 150 mm at 2 m, 250 mm/s
    servo = AxisServo(LIMITS, size)
    worst = 0.0
    for t_ns in range(0, 3000 * MS, 5 * MS):
        angle = turn * t_ns * 1e-9
        servo.follow(t_ns, size * cos(angle), -size * turn * sin(angle))
        if t_ns > 300 * MS:
            worst = max(worst, abs(servo.angle(t_ns) - size * cos(angle)))
    assert worst * 31000 < 1.0


def test_a_set_point_for_a_past_instant_is_carried_on_to_now():
    servo = AxisServo(LIMITS, 0.0)
    servo.follow(10 * MS, 0.0, 0.1, at_ns=0, extrapolate_ns=10**12)
    assert servo.angle(900 * MS) == pytest.approx(0.09, abs=1e-6)


def test_a_moving_set_point_that_is_not_renewed_comes_to_rest():
    servo = AxisServo(LIMITS, 0.0)
    servo.follow(0, 0.0, 0.1, extrapolate_ns=100 * MS)
    assert servo.angle(900 * MS) == pytest.approx(0.01, abs=1e-6)
    assert servo.rate(900 * MS) == pytest.approx(0.0, abs=1e-6)


def test_hold_ramps_down_with_the_acceleration_limit_and_stays():
    servo = AxisServo(LIMITS, 0.0)
    servo.turn(0, 0.5)
    servo.hold(500 * MS)
    way = 0.5**2 / (2 * LIMITS.rad_s2)
    began = servo.angle(500 * MS)
    assert servo.angle(900 * MS) == pytest.approx(began + way, rel=0.05)
    assert servo.rate(900 * MS) == 0.0
    assert servo.angle(1900 * MS) == servo.angle(900 * MS)


def test_a_far_set_point_is_reached_with_hardly_any_overshoot():
    servo = AxisServo(LIMITS, 0.0)
    servo.follow(0, 0.4)
    angles = [servo.angle(t * MS) for t in range(1500)]
    assert max(angles) < 0.401
    assert angles[-1] == pytest.approx(0.4, abs=1e-9)


def test_the_end_of_travel_stops_the_axis_in_front_of_it():
    servo = AxisServo(LIMITS, 0.0)
    servo.turn(0, 5.0)
    assert 1.0 - 1e-4 < servo.angle(4000 * MS) <= 1.0
    assert servo.rate(4000 * MS) == 0.0
    servo.turn(4000 * MS, -1.0)
    assert servo.angle(4300 * MS) < 0.9


def test_the_bandwidth_is_that_of_the_settings():
    servo = AxisServo(LIMITS, 0.0)
    step = 1e-4  # small: no limit is met
    servo.follow(0, step)
    omega = 2 * pi * 20.0
    t = 0.02
    expected = step * (1.0 - exp(-omega * t) * (1.0 + omega * t))  # critically damped
    assert servo.angle(20 * MS) == pytest.approx(expected, rel=0.03)


def test_past_instants_are_interpolated_between_the_steps():
    servo = AxisServo(LIMITS, 0.0)
    servo.turn(0, 0.3)
    servo.advance(700 * MS)
    t_ns = 400 * MS + 321_000
    middle = (servo.angle(t_ns + 100) - servo.angle(t_ns - 100)) / 200e-9
    assert middle == pytest.approx(servo.rate(t_ns), rel=1e-6)
    assert servo.angle(t_ns) == pytest.approx(servo.angle(400 * MS) + 0.3 * 321e-6, rel=1e-9)


def test_asking_early_or_late_changes_nothing():
    eager, lazy = AxisServo(LIMITS, 0.0), AxisServo(LIMITS, 0.0)
    for t_ns in range(0, 300 * MS, 7 * MS):
        for now_ns in range(t_ns, t_ns + 7 * MS, MS):
            eager.advance(now_ns)
        for servo in (eager, lazy):
            servo.follow(t_ns + 7 * MS, 1e-3 * (t_ns % 5), 0.02)
    assert eager.angle(400 * MS) == lazy.angle(400 * MS)
