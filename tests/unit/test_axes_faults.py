"""What goes wrong while the axes are armed: they stop, say why, and begin again only as the rules allow."""

import pytest
from closed_loop import MS, ClosedLoop, circling, quick

from trackerd.contract.model import AxisMode, GimbalFlag, TrackState
from trackerd.engine.axes import MOST_FAULTS, AxesState

FOLLOWING, HELD = AxesState.FOLLOWING, AxesState.HELD


def following(automatic: bool) -> ClosedLoop:
    loop = quick(automatic=automatic).run(0.3)
    loop.axes.arm()
    loop.until_state(FOLLOWING)
    return loop


def fault(loop: ClosedLoop, number: int) -> None:
    """A drive's or a limit's: the controller stops following and stays enabled."""
    loop.controller._raise_fault(number)


def hang(loop: ClosedLoop, duration_s: float) -> None:
    loop.hung = True
    loop.run(duration_s)
    loop.hung = False


@pytest.mark.parametrize("automatic", [True, False])
def test_after_a_safety_input_arming_is_always_the_operators(automatic: bool) -> None:
    loop = following(automatic)
    loop.controller.emergency_stop(loop.now_ns)
    loop.until_state(HELD, 0.1)
    loop.run(1.0)
    assert loop.snapshot().reason == "safety input (fault 0x0501): arm again once it is cleared"
    assert (loop.state, loop.snapshot().armed, loop.controller.fault) == (HELD, False, 0x0501)
    assert loop.axes.arm() == "armed"
    loop.until_state(FOLLOWING, 1.0)
    assert loop.controller.fault == 0


def test_a_safety_input_that_stays_pressed_ends_held_again() -> None:
    loop = following(automatic=True)
    loop.controller.emergency_stop(loop.now_ns)
    loop.run(0.1)
    loop.axes.arm()
    loop.until(_presses_again, 2.0)
    assert loop.snapshot().reason.startswith(("safety input (fault 0x0501)", "controller fault 0x0501 does not clear"))
    assert loop.state is HELD


def _presses_again(loop: ClosedLoop) -> bool:
    loop.controller.emergency_stop(loop.now_ns)
    return not loop.snapshot().armed


def test_a_safety_input_that_was_there_before_the_daemon_is_not_armed_by_itself() -> None:
    loop = quick()
    loop.controller.emergency_stop(0)
    loop.run(1.0)
    assert (loop.state, loop.snapshot().armed) == (HELD, False)
    assert not any(command.enable or command.reset_fault for _, command in loop.commands)


@pytest.mark.parametrize("number", [0x0101, 0x0201, 0x0301, 0x0401])
def test_any_other_fault_is_reset_by_itself_and_the_drives_are_never_switched_off(number: int) -> None:
    loop = following(automatic=True)
    since_ns = loop.now_ns
    fault(loop, number)
    loop.until_state(HELD, 0.1)
    assert loop.snapshot().reason == f"controller fault 0x{number:04x}"
    loop.until_state(FOLLOWING, 1.0)
    assert all(cycle.enabled for cycle in loop.since(since_ns))


def test_on_a_real_bus_a_fault_waits_for_the_operator() -> None:
    loop = following(automatic=False)
    fault(loop, 0x0201)
    loop.run(0.5)
    assert (loop.state, loop.snapshot().reason) == (HELD, "controller fault 0x0201; not armed")
    assert loop.controller.fault == 0x0201
    loop.axes.arm()
    loop.until_state(FOLLOWING, 1.0)


def test_a_fault_while_the_target_is_awaited_disarms_as_well() -> None:
    loop = quick(automatic=False)
    loop.hidden = True
    loop.run(0.1)
    assert loop.axes.arm() == "waiting for the target"
    fault(loop, 0x0301)
    loop.run(0.1)
    assert (loop.snapshot().armed, loop.snapshot().reason) == (False, "controller fault 0x0301; not armed")


def test_a_fault_that_does_not_clear_is_a_persons() -> None:
    loop = following(automatic=True)
    accept = loop.controller._accept

    def refaulting(record: object) -> None:
        accept(record)  # type: ignore[arg-type]
        loop.controller.fault = 0x0201

    loop.controller._accept = refaulting  # type: ignore[method-assign]
    loop.until(lambda loop: not loop.snapshot().armed, 2.0)
    assert "controller fault 0x0201 does not clear: arm again once its cause is gone" in loop.snapshot().reason


def test_faults_that_come_again_and_again_are_a_persons() -> None:
    loop = following(automatic=True)
    for _ in range(MOST_FAULTS - 1):
        fault(loop, 0x0401)
        loop.until_state(HELD, 0.1)
        loop.until_state(FOLLOWING, 1.0)
    fault(loop, 0x0401)
    loop.run(0.5)
    assert loop.snapshot().reason == f"controller fault 0x0401, {MOST_FAULTS} faults since it was armed; not armed"


def test_out_of_comm_lost_the_controller_disables_itself_before_it_is_enabled_anew() -> None:
    loop = following(automatic=True)
    hang(loop, 0.4)
    since_ns, lost_ns = loop.now_ns, loop.controller.trips[-1]
    assert loop.flags & GimbalFlag.ENABLED
    loop.until_state(FOLLOWING, 4.0)
    enables = [(t, command.enable) for t, command in loop.commands if t > since_ns]
    off = [t for t, enable in enables if not enable]
    assert len(off) >= 2
    assert min(off) >= lost_ns + 2_000 * MS  # the brake's time
    assert dict(enables)[loop.commands[-1][0]]
    assert loop.snapshot().tested  # the controller is the same, and so are the axes


def test_on_a_real_bus_comm_lost_stays_held() -> None:
    loop = following(automatic=False)
    hang(loop, 0.4)
    loop.run(3.0)
    assert (loop.state, loop.snapshot().armed) == (HELD, False)
    assert loop.snapshot().reason == "the controller's watchdog took over (comm lost); not armed"
    assert not loop.flags & GimbalFlag.ENABLED
    loop.axes.arm()
    loop.until_state(FOLLOWING, 1.0)


def test_a_hang_shorter_than_the_watchdog_is_nothing() -> None:
    loop = following(automatic=False)
    hang(loop, 0.1)
    loop.run(0.5)
    assert (loop.state, loop.controller.trips) == (FOLLOWING, [])


@pytest.mark.parametrize("automatic", [True, False])
def test_a_restart_of_the_controller_drops_the_proof_and_an_operators_arming(automatic: bool) -> None:
    loop = following(automatic)
    loop.restart_controller()
    loop.run(0.05)
    assert (loop.snapshot().tested, loop.snapshot().armed) == (False, automatic)
    assert loop.snapshot().reason == "the controller has restarted" + ("" if automatic else "; not armed")
    loop.run(0.3)
    loop.axes.arm()
    loop.until_state(AxesState.TESTING, 1.0)
    loop.until_state(FOLLOWING)


@pytest.mark.parametrize("automatic", [True, False])
def test_a_lost_link_drops_an_operators_arming_and_keeps_the_proof(automatic: bool) -> None:
    loop = following(automatic)
    loop.reconnect()
    assert loop.state is AxesState.OFFLINE
    loop.run(0.3)
    assert (loop.snapshot().tested, loop.snapshot().armed) == (True, automatic)
    if not automatic:
        assert loop.snapshot().reason == "the connection is lost; not armed"
        loop.axes.arm()
    loop.until_state(FOLLOWING, 4.0)
    assert AxesState.TESTING not in {cycle.state for cycle in loop.cycles[-200:]}


def test_a_restart_while_the_link_was_down_is_noticed_by_the_clock() -> None:
    loop = following(automatic=True)
    loop.axes.link_lost("the connection is lost")
    loop.controller.restart(loop.now_ns)
    loop.hung = True
    loop.run(3.0)  # its clock is beyond where it was when the link broke
    loop.hung = False
    loop.connect()
    loop.run(0.02)
    assert not loop.snapshot().tested


def test_without_frames_the_axes_ramp_to_rest_and_hold_there() -> None:
    loop = circling().run(3.3)
    assert loop.cycles[-1].fastest_deg_s > 3.0
    loop.stopped = True
    stopped_ns = loop.now_ns
    loop.run(0.5)
    resting = [cycle.t_ns for cycle in loop.since(stopped_ns) if cycle.fastest_deg_s < 0.05]
    assert resting[0] - stopped_ns < 250 * MS
    assert loop.state is FOLLOWING
    assert loop.commands[-1][1].mode is AxisMode.POSITION  # the heartbeat goes on, at rest


@pytest.mark.parametrize("hidden_s", [0.8, 2.1])
def test_after_a_loss_the_axes_wait_where_the_probe_was_last_seen_and_meet_it_there(hidden_s: float) -> None:
    loop = circling().run(3.3)
    seen_deg = loop.cycles[-1].turned_deg
    loop.hidden = True
    loop.run(hidden_s)
    waiting = loop.cycles[-1]
    assert waiting.fastest_deg_s < 0.05
    assert waiting.turned_deg == pytest.approx(seen_deg, abs=0.4)  # 7 deg/s, and at most 50 ms until the last frame
    loop.hidden = False
    loop.until(lambda loop: loop.steps[-1].state is TrackState.LOCKED, 8.0)  # it comes round every 3.8 s
    loop.run(0.5)
    assert loop.steps[-1].state is TrackState.LOCKED
    assert loop.cycles[-1].fastest_deg_s > 3.0


def test_without_angles_a_motion_is_not_carried_on_for_long() -> None:
    loop = circling().run(3.3)
    loop.angles_fail = "its latch did not come"
    since_ns = loop.now_ns
    loop.run(1.0)  # out on the tangent, and back to where the probe was last seen
    assert loop.cycles[-1].fastest_deg_s < 0.05
    assert loop.excursion_deg(since_ns) < 3.0


def test_set_points_keep_inside_the_configured_travel_and_the_controllers() -> None:
    """The circle leads out of both; the controller never has a set-point to refuse."""
    loop = circling("gimbal.left.steering.az_limits_deg=[-7.0,60.0]", "twin.axes.el_limits_deg=[-75.0,4.5]")
    loop.run(5.0)
    asked = [command for _, command in loop.commands if command.follow]
    assert min(command.az_rad for command in asked) == pytest.approx(-0.12217, abs=1e-4)
    assert loop.controller.fault == 0
    assert max(command.el_rad for command in asked) <= 0.0785399


def test_holding_needs_an_operator_although_arming_is_automatic() -> None:
    loop = following(automatic=True)
    loop.axes.hold("the operator said so")
    loop.run(0.5)
    assert (loop.state, loop.snapshot().armed, loop.snapshot().reason) == (HELD, False, "the operator said so")
    assert loop.flags & GimbalFlag.ENABLED  # held, not dropped
