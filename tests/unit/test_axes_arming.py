"""Nothing moves and nothing is enabled before somebody said so; and how the heartbeat goes on meanwhile."""

from itertools import pairwise

import pytest
from closed_loop import NAME, ClosedLoop, quick

from trackerd.contract.clock import ClockKind, ControllerUs, HostNs
from trackerd.contract.model import GimbalFlag, GimbalInfo, GimbalReport
from trackerd.engine.axes import Axes, AxesState
from trackerd.formats.settings import SteeringSettings

READY = GimbalFlag.READY | GimbalFlag.HOMED


def gimbal(steerable: bool = True) -> GimbalInfo:
    return GimbalInfo(NAME, "1", "1.0", steerable, ClockKind.DEVICE, (-1.0, 1.0), (-1.0, 1.0), 1.0, 10.0)


def reported(flags: GimbalFlag = READY, fault: int = 0) -> GimbalReport:
    return GimbalReport(1, flags, fault, 0, 0, 0.0, 0.0, ControllerUs(1), 0, (), HostNs(0), HostNs(1))


def moved(loop: ClosedLoop) -> bool:
    return any(cycle.turned_deg != (0.0, 0.0) or cycle.fastest_deg_s for cycle in loop.cycles)


def test_starting_enables_nothing_and_moves_nothing_until_armed() -> None:
    loop = quick(automatic=False).run(1.5)
    assert loop.steps[-1].set_point is not None  # it could follow
    assert not any(command.enable or command.follow for _, command in loop.commands)
    assert not moved(loop)
    assert (loop.state, loop.snapshot().reason, loop.snapshot().armed) == (AxesState.HELD, "not armed", False)


def test_armed_axes_are_tested_and_then_follow() -> None:
    loop = quick(automatic=False).run(0.3)
    assert loop.axes.arm() == "armed"
    loop.until_state(AxesState.TESTING, 0.1)
    loop.until_state(AxesState.FOLLOWING)
    assert loop.snapshot().tested
    assert loop.run(0.5).cycles[-1].off_px < 2.0


def test_the_twins_axes_are_armed_by_themselves() -> None:
    loop = quick()
    loop.until_state(AxesState.FOLLOWING)
    assert loop.snapshot().armed


def test_nothing_begins_while_there_is_no_target() -> None:
    loop = quick()
    loop.hidden = True
    loop.run(1.0)
    assert (loop.state, loop.snapshot().reason) == (AxesState.HELD, "waiting for the target")
    assert not any(command.enable for _, command in loop.commands)
    assert not moved(loop)


def test_a_picture_of_long_ago_is_no_reason_to_begin() -> None:
    loop = quick(automatic=False).run(0.3)
    loop.stopped = True
    loop.run(1.0)
    assert loop.axes.arm() == "waiting for the target"
    loop.run(0.2)
    assert (loop.state, moved(loop)) == (AxesState.HELD, False)


def test_the_answer_to_arming_says_what_is_missing() -> None:
    axes = Axes(SteeringSettings(), automatic=False)
    assert axes.arm() == "no status from the controller"
    axes.connected(gimbal())
    axes.reported(reported(GimbalFlag.HOMED))
    assert axes.arm() == "the controller is not ready"
    axes.reported(reported(GimbalFlag.READY))
    assert axes.arm() == "the axes are not referenced"
    axes.reported(reported())
    assert axes.arm() == "waiting for the target"


def test_a_gimbal_that_is_not_steered_has_nothing_to_arm() -> None:
    axes = Axes(SteeringSettings(), automatic=False)
    axes.connected(gimbal(steerable=False))
    axes.command(HostNs(0), None)
    axes.reported(reported())
    assert axes.arm().startswith("nothing to arm")
    assert (axes.snapshot().state, axes.snapshot().reason) == (AxesState.FIXED, "")
    assert not axes.command(HostNs(1), None).enable


@pytest.mark.parametrize("missing", [GimbalFlag.READY, GimbalFlag.HOMED])
def test_axes_that_are_not_referenced_or_not_ready_are_not_enabled(missing: GimbalFlag) -> None:
    loop = quick()
    flags = loop.controller.flags
    loop.controller.flags = lambda: flags() & ~missing  # type: ignore[method-assign]
    loop.run(1.0)
    assert loop.state is AxesState.HELD
    assert not any(command.enable for _, command in loop.commands)


def test_a_new_link_listens_before_it_commands() -> None:
    loop = quick(automatic=False).run(0.1)
    assert [command.sequence for _, command in loop.commands[:4]] == [0, 1, 2, 3]
    loop.reconnect()
    loop.run(0.01)
    assert loop.commands[-2][1].sequence == 0


def test_a_new_daemon_leaves_enabled_axes_enabled() -> None:
    """An EL axis that carries an eccentric camera falls when it is disabled."""
    loop = quick()
    loop.until_state(AxesState.FOLLOWING)
    since_ns = loop.now_ns
    loop.axes = Axes(loop.settings.steering, automatic=False)
    loop.connect()
    loop.run(0.5)
    assert all(cycle.enabled for cycle in loop.since(since_ns))
    assert loop.excursion_deg(since_ns) < 0.01


def test_the_heartbeat_counts_on_in_every_state() -> None:
    loop = quick()
    loop.until_state(AxesState.FOLLOWING)
    loop.axes.hold("enough")
    loop.run(0.2)
    sequences = [command.sequence for _, command in loop.commands]
    assert all(b == a + 1 for a, b in pairwise(sequences))


def test_the_heartbeat_skips_0() -> None:
    axes = Axes(SteeringSettings(), automatic=False)
    axes.connected(gimbal())
    axes.reported(reported())
    sequences = [axes.command(HostNs(n), None).sequence for n in range(65_538)]
    assert sequences[0] == 1
    assert sequences[65_534:65_536] == [65_535, 1]
    assert all(a != b for a, b in pairwise(sequences))


def test_every_record_carries_the_configured_watchdog() -> None:
    loop = quick("gimbal.left.steering.watchdog_ms=35")
    loop.until_state(AxesState.FOLLOWING)
    assert {command.watchdog_ms for _, command in loop.commands if command.sequence} == {35}
    assert loop.controller.watchdog_ns == 35_000_000
