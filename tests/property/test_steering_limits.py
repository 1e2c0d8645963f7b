"""Whatever is asked of the axes: travel, velocity, acceleration and jerk hold, and the target is reached."""

from math import radians

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from trackerd.formats.settings import SteeringSettings
from trackerd.steering.limits import SetPointLimiter

CYCLE_S = 0.005
STEERING = SteeringSettings(az_limits_deg=(-10.0, 15.0), el_limits_deg=(-5.0, 60.0))
LOW, HIGH = np.radians(((-10.0, -5.0), (15.0, 60.0)))
FASTEST, HARDEST, SHARPEST = radians(30.0), radians(300.0), radians(20_000.0)
SLACK = 1.0 + 1e-6

angle = st.floats(-1.5, 1.5)
rate = st.floats(-1.0, 1.0)
target = st.tuples(angle, angle, rate, rate)
cycles = st.integers(1, 60)


def limiter(az_rad: float = 0.0, el_rad: float = 0.0) -> SetPointLimiter:
    made = SetPointLimiter(STEERING)
    made.reset(az_rad, el_rad, 0.0, 0.0)
    return made


def obeys_every_limit(points: np.ndarray, start: tuple[float, float] = (0.0, 0.0), cycle_s: float = CYCLE_S) -> bool:
    """`points` (n, 4) from rest at the start. Position and velocity are judged at the points, the rest by differences."""
    points = np.vstack(((*start, 0.0, 0.0), points))
    place, velocity = points[:, :2], points[:, 2:]
    acceleration = np.diff(velocity, axis=0) / cycle_s
    jerk = np.diff(np.vstack(((0.0, 0.0), acceleration)), axis=0) / cycle_s
    mean_velocity = np.diff(place, axis=0) / cycle_s
    return bool(
        (place >= LOW - 1e-8).all()
        and (place <= HIGH + 1e-8).all()
        and np.abs(velocity).max() <= FASTEST * SLACK
        and np.abs(mean_velocity).max() <= FASTEST * SLACK + 1e-9
        and np.abs(acceleration).max() <= HARDEST * SLACK + 1e-9
        and np.abs(jerk).max() <= SHARPEST * SLACK + 1e-6
    )


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(target, cycles), min_size=1, max_size=12))
def test_any_sequence_of_targets_stays_within_every_limit(asked: list[tuple[tuple[float, ...], int]]) -> None:
    made = limiter()
    points = [made.step(*wanted, CYCLE_S) for wanted, count in asked for _ in range(count)]
    assert obeys_every_limit(np.array(points))


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(target, cycles, st.booleans()), min_size=1, max_size=12))
def test_stopping_in_between_stays_within_every_limit(asked: list[tuple[tuple[float, ...], int, bool]]) -> None:
    made = limiter()
    points = [
        made.stop_step(CYCLE_S) if stop else made.step(*wanted, CYCLE_S) for wanted, count, stop in asked for _ in range(count)
    ]
    assert obeys_every_limit(np.array(points))
    points = [made.stop_step(CYCLE_S) for _ in range(100)]
    assert points[-1][2:] == pytest.approx((0.0, 0.0), abs=1e-9)
    assert points[-1] == pytest.approx(points[-2], abs=1e-9)


@settings(max_examples=40, deadline=None)
@given(angle, angle, st.tuples(target, cycles))
def test_a_target_at_rest_is_reached_or_the_nearest_end_of_the_travel(
    az_rad: float, el_rad: float, before: tuple[tuple[float, ...], int]
) -> None:
    made = limiter()
    for _ in range(before[1]):
        made.step(*before[0], CYCLE_S)
    for _ in range(1200):
        last = made.step(az_rad, el_rad, 0.0, 0.0, CYCLE_S)
    assert last[:2] == pytest.approx(tuple(np.clip((az_rad, el_rad), LOW, HIGH)), abs=1e-9)
    assert last[2:] == pytest.approx((0.0, 0.0), abs=1e-9)


@settings(max_examples=40, deadline=None)
@given(st.floats(-0.08, 0.05), st.floats(-0.08, 0.08), st.floats(-0.05, 0.08), st.floats(-0.02, 0.05))
def test_a_target_of_constant_velocity_is_met_and_not_trailed(az: float, az_rate: float, el: float, el_rate: float) -> None:
    made = limiter()
    for n in range(1, 200):
        t_s = n * CYCLE_S
        wanted = (az + az_rate * t_s, el + el_rate * t_s)
        point = made.step(*wanted, az_rate, el_rate, CYCLE_S)
    assert point == pytest.approx((*wanted, az_rate, el_rate), abs=1e-8)


@settings(max_examples=40, deadline=None)
@given(st.lists(st.tuples(target, st.floats(0.0, 0.3)), min_size=1, max_size=40))
def test_an_irregular_cycle_keeps_travel_and_velocity(asked: list[tuple[tuple[float, ...], float]]) -> None:
    made = limiter()
    points = np.array([made.step(*wanted, dt_s) for wanted, dt_s in asked])
    assert (points[:, :2] >= LOW - 1e-8).all()
    assert (points[:, :2] <= HIGH + 1e-8).all()
    assert np.abs(points[:, 2:]).max() <= FASTEST * SLACK


@settings(max_examples=30, deadline=None)
@given(st.floats(-1.5, 1.5), angle)
def test_axes_that_start_outside_their_travel_come_back_into_it(start_rad: float, el_rad: float) -> None:
    made = limiter(start_rad, 0.0)
    points = np.array([made.step(0.05, el_rad, 0.0, 0.0, CYCLE_S) for _ in range(1200)])
    assert points[-1, 0] == pytest.approx(0.05, abs=1e-9)
    assert points[:, 0].max() <= max(HIGH[0], start_rad) + 1e-8
    assert points[:, 0].min() >= min(LOW[0], start_rad) - 1e-8


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), -float("inf")])
def test_a_target_that_is_not_a_number_brakes(bad: float) -> None:
    made = limiter()
    for _ in range(40):
        moving = made.step(0.2, 0.1, 0.0, 0.0, CYCLE_S)
    assert moving[2] > 0.0
    points = np.array([made.step(bad, 0.1, 0.0, bad, CYCLE_S) for _ in range(100)])
    assert np.isfinite(points).all()
    assert points[-1, 2:] == pytest.approx((0.0, 0.0), abs=1e-9)


def test_no_time_means_no_move() -> None:
    made = limiter(0.1, 0.2)
    assert made.step(0.2, 0.3, 0.0, 0.0, 0.0) == (0.1, 0.2, 0.0, 0.0)
    assert made.stop_step(-1.0) == (0.1, 0.2, 0.0, 0.0)
