"""Axes that look where a calibration tells them, against the twin's controller in virtual time; and many frames as one view."""

from dataclasses import replace
from math import radians

import numpy as np
import pytest
from closed_loop import ClosedLoop, quick
from made_devices import GIMBAL

from trackerd.contract.clock import ControllerUs, HostNs
from trackerd.contract.model import AxisAngles, AxisMode, Found, GimbalFlag, GimbalReport, Missed, TrackState
from trackerd.engine.axes import AxesState
from trackerd.engine.pointing import THERE_RAD, Pointing
from trackerd.engine.still_look import FLOOR_PX, StillLook
from trackerd.engine.track import Step
from trackerd.formats.settings import SteeringSettings


def loop(*overrides: str) -> tuple[ClosedLoop, Pointing]:
    one = quick(*overrides)
    pointing = Pointing(one.settings.steering)
    one.axes = pointing  # type: ignore[assignment]
    one.connect()
    return one, pointing


def moved_deg(one: ClosedLoop) -> float:
    return max(max(map(abs, cycle.turned_deg)) for cycle in one.cycles)


def test_nothing_moves_before_it_is_armed() -> None:
    one, pointing = loop()
    pointing.go(0.2, 0.1)
    one.run(1.0)
    assert moved_deg(one) == 0.0
    assert pointing.snapshot().reason == "not armed"
    assert {command.mode for _, command in one.commands} == {AxisMode.HOLD}


def test_armed_axes_go_where_they_are_told_and_say_when_they_are_there() -> None:
    one, pointing = loop()
    assert pointing.arm() in ("armed", "no status from the controller")
    az, el = one.gimbal.angles(0)
    pointing.go(az + radians(3.0), el - radians(2.0))
    assert not pointing.arrived
    one.until(lambda _: pointing.arrived, 3.0)
    assert one.gimbal.angles(one.now_ns) == pytest.approx((az + radians(3.0), el - radians(2.0)), abs=THERE_RAD)
    assert one.state is AxesState.POINTING
    fastest = max(cycle.fastest_deg_s for cycle in one.cycles)
    assert fastest < one.settings.steering.max_deg_s * 1.2  # a servo that catches up is faster than its set-point


def test_they_stop_at_the_travel() -> None:
    one, pointing = loop("gimbal.left.steering.az_limits_deg=[-5,5]")
    pointing.arm()
    pointing.go(radians(30.0), 0.0)
    one.run(3.0)
    assert not pointing.arrived
    assert np.degrees(one.gimbal.angles(one.now_ns)[0]) == pytest.approx(5.0, abs=0.01)
    assert "deg away" in pointing.off_words


def test_unreferenced_axes_do_not_move() -> None:
    pointing = Pointing(SteeringSettings())
    pointing.connected(GIMBAL)
    pointing.arm()
    pointing.go(0.2, 0.1)
    pointing.reported(report(GimbalFlag.READY | GimbalFlag.ENABLED))
    assert pointing.missing() == "the axes are not referenced"
    assert {pointing.command(HostNs(n * 5_000_000), None).mode for n in range(20)} == {AxisMode.HOLD}
    pointing.reported(report(GimbalFlag.READY | GimbalFlag.ENABLED | GimbalFlag.HOMED))
    assert pointing.command(HostNs(10**9), None).mode is AxisMode.POSITION


def report(flags: GimbalFlag) -> GimbalReport:
    return GimbalReport(1, flags, 0, 1, 0, 0.1, 0.2, ControllerUs(1), 0, (), HostNs(0), HostNs(1))


def test_a_lost_link_disarms_them_until_a_person_arms_again() -> None:
    one, pointing = loop()
    pointing.arm()
    az, el = one.gimbal.angles(0)
    pointing.go(az + radians(20.0), el)
    one.run(0.4)
    assert one.state is AxesState.POINTING
    one.reconnect()
    there = one.gimbal.angles(one.now_ns)
    one.run(1.0)
    assert np.abs(np.subtract(one.gimbal.angles(one.now_ns), there)).max() < radians(3.0)  # it ramped to rest
    assert pointing.missing() == "the connection is lost; not armed"


def test_a_safety_input_disarms_them() -> None:
    one, pointing = loop()
    pointing.arm()
    az, el = one.gimbal.angles(0)
    pointing.go(az + radians(20.0), el)
    one.run(0.4)
    one.controller.emergency_stop(one.now_ns)
    one.run(0.5)
    assert pointing.missing().startswith("controller fault 0x05")
    assert one.state is AxesState.HELD


# ---- still frames ----------------------------------------------------------------------------------------------------

SIGMA_PX = 0.05


def steps(count: int, drift_px: float = 0.0, scatter_px: float = SIGMA_PX, seed: int = 1) -> list[Step]:
    rng = np.random.default_rng(seed)
    made = []
    for n in range(count):
        x, y = np.array((100.0 + n * drift_px, 200.0)) + rng.normal(0.0, scatter_px, 2)
        found = Found(x, y, 60.0, np.diag((SIGMA_PX**2, SIGMA_PX**2, 1e-4)), 1.0, 1.0, 0.0)
        angles = AxisAngles(0.1 + rng.normal(0.0, 1e-5), 0.2, 1e-5, 0.0, HostNs(n), 0.0, "latch")
        made.append(
            Step(n, HostNs(1000 + n), TrackState.LOCKED, found, None, None, (0.0, 0.0), angles, np.eye(2), "itself", "")
        )
    return made


def fed(look: StillLook, all_steps: list[Step]) -> object:
    return next((view for view in map(look.add, all_steps) if view is not None), None)


def test_many_still_frames_are_one_view_whose_covariance_is_true() -> None:
    errors, stated = [], []
    for seed in range(1000):
        view = fed(StillLook(20, HostNs(0)), steps(20, seed=seed))
        assert view is not None
        errors.append(view.q_px - (100.0, 200.0))  # type: ignore[attr-defined]
        stated.append(np.trace(view.cov_px2))  # type: ignore[attr-defined]
    noise = np.mean(stated) - 2.0 * FLOOR_PX**2
    assert 0.8 < 2.0 * np.mean(np.square(errors)) / noise < 1.05  # the larger of what the fit says and what is seen


def test_frames_before_the_axes_came_to_rest_do_not_count() -> None:
    assert fed(StillLook(5, HostNs(1003)), steps(7)) is None
    view = fed(StillLook(5, HostNs(1003)), steps(8))
    assert view is not None


def test_a_target_that_drifts_is_waited_for() -> None:
    look = StillLook(20, HostNs(0))
    assert fed(look, steps(40, drift_px=0.02)) is None
    assert "it is not still" in look.reason


def test_a_target_that_shakes_is_waited_for() -> None:
    look = StillLook(20, HostNs(0))
    assert fed(look, steps(40, scatter_px=2.0)) is None
    assert "scatter" in look.reason


def test_a_frame_without_the_target_begins_the_look_anew() -> None:
    look, some = StillLook(5, HostNs(0)), steps(9)
    some[4] = replace(some[4], outline=Missed("hidden"), state=TrackState.COASTING, why="hidden")
    assert fed(look, some) is None
    assert look.reason == "4 of 5 frames so far"
