"""The rules of the gimbal's map, one by one, in virtual time."""

from dataclasses import replace
from itertools import pairwise

import pytest
from emulators.twin_rig import MS, Rig

from trackerd.contract.model import AxisMode, GimbalFlag
from trackerd.formats import gimbal_map as gm
from trackerd.formats.gimbal_map import ByteOrder
from trackerd.twin.clock import DeviceClock

MOVING = gm.ENABLE | gm.FOLLOW
LOST = GimbalFlag.COMM_LOST


def command(**fields: int) -> gm.CommandRecord:
    return replace(gm.CommandRecord(1, 0, 0, 0, 0, 0, 0, 0, 0), **fields)


def test_power_up_is_disabled_referenced_and_at_rest() -> None:
    rig = Rig()
    status = rig.status(10)
    assert GimbalFlag(status.status) == GimbalFlag.READY | GimbalFlag.HOMED
    assert (status.fault, status.cmd_seq_echo, status.cmd_age_ms, status.latch_total) == (0, 0, 0xFFFF, 0)
    assert rig.rates(10) == (0.0, 0.0)


def test_enabling_takes_an_enable_of_0_and_then_of_1() -> None:
    rig = Rig()
    rig.send(1, gm.ENABLE)
    assert not rig.flags(1) & GimbalFlag.ENABLED
    rig.send(2)
    rig.send(3, gm.ENABLE)
    assert rig.flags(3) & GimbalFlag.ENABLED


def test_every_status_has_a_sequence_of_its_own_and_its_own_instant() -> None:
    rig = Rig(DeviceClock(offset_ns=5_000_000, drift_ppm=100.0))
    first, second = rig.status(10), rig.status(20)
    assert second.status_seq == first.status_seq + 1
    assert first.clock_us == 15_001
    assert second.clock_us - first.clock_us == 10_001


def test_the_echo_is_the_last_accepted_sequence_and_the_age_counts_from_it() -> None:
    rig = Rig()
    rig.send(10, cmd_seq=77)
    status = rig.status(22)
    assert (status.cmd_seq_echo, status.cmd_age_ms) == (77, 12)


def test_the_age_saturates() -> None:
    rig = Rig()
    rig.send(1)
    assert rig.status(70_000).cmd_age_ms == 0xFFFF


def test_unequal_guards_are_not_applied() -> None:
    rig = Rig()
    data = gm.encode_command(command(cmd_seq=9), ByteOrder.MODBUS)
    rig.controller.command(data[:-2] + b"\0\0", MS)
    assert rig.status(1).cmd_seq_echo == 0
    assert rig.controller.torn_commands == 1


def test_a_foreign_map_is_refused_with_its_fault_and_a_reset_clears_it() -> None:
    rig = Rig()
    rig.send(1, map_id=0x0200, cmd_seq=5)
    status = rig.status(1)
    assert (status.fault, status.cmd_seq_echo) == (gm.FAULT_MAP_ID, 0)
    assert GimbalFlag(status.status) & GimbalFlag.FAULT
    rig.send(2, gm.FAULT_RESET)
    assert rig.status(2).fault == 0


def test_fault_reset_works_on_its_edge_only() -> None:
    rig = Rig()
    rig.send(1, gm.FAULT_RESET)
    rig.send(2, map_id=0x0200)
    rig.send(3, gm.FAULT_RESET)
    assert rig.status(3).fault == gm.FAULT_MAP_ID
    rig.send(4)
    rig.send(5, gm.FAULT_RESET)
    assert rig.status(5).fault == 0


def test_sequence_0_is_no_command() -> None:
    rig = Rig()
    rig.send(1, cmd_seq=3)
    rig.send(2, cmd_seq=0)
    assert rig.status(2).cmd_seq_echo == 3


def test_the_watchdog_trips_at_its_time_after_the_last_fresh_record() -> None:
    rig = Rig()
    rig.enable(10)
    assert not rig.flags(59.9) & LOST
    flags = rig.flags(60)
    assert flags & LOST
    assert flags & GimbalFlag.ENABLED
    assert rig.controller.trips == [60 * MS]


def test_an_unchanged_sequence_does_not_feed_the_watchdog_and_is_no_fault() -> None:
    rig = Rig()
    rig.send(10, cmd_seq=5)
    for t_ms in range(15, 60, 5):
        rig.send(t_ms, cmd_seq=5)
    status = rig.status(61)
    assert GimbalFlag(status.status) & LOST
    assert status.fault == 0


@pytest.mark.parametrize(("asked_ms", "kept_ms"), [(0, 50), (1, 5), (5, 5), (200, 200), (1000, 1000), (60_000, 1000)])
def test_the_watchdog_is_clamped_and_has_a_default(asked_ms: int, kept_ms: int) -> None:
    rig = Rig()
    rig.send(10, watchdog_ms=asked_ms)
    assert not rig.flags(10 + kept_ms - 0.1) & LOST
    assert rig.flags(10 + kept_ms) & LOST


def test_a_trip_is_at_its_own_instant_however_late_somebody_asks() -> None:
    rig = Rig()
    rig.enable(10)
    rig.status(5000)
    assert rig.controller.trips == [60 * MS]


def test_comm_lost_ramps_to_hold_and_2_s_later_disables() -> None:
    rig = Rig()
    rig.enable(1)
    rig.follow(1, az=0.05, az_rate=0.1, bits=gm.VELOCITY_VALID)
    assert abs(rig.rates(40)[0]) > 0.01
    flags = rig.flags(60)
    assert LOST in flags
    assert not flags & GimbalFlag.FOLLOWING
    assert rig.rates(300) == (0.0, 0.0)
    assert rig.flags(2050.9) & GimbalFlag.ENABLED
    assert not rig.flags(2051) & GimbalFlag.ENABLED


@pytest.mark.parametrize("after_ms", [100, 3000])
def test_comm_lost_is_left_only_by_enable_0_then_1_with_fresh_records(after_ms: float) -> None:
    rig = Rig()
    rig.enable(1)
    rig.status(after_ms)
    rig.follow(after_ms + 1, az=0.01)
    assert rig.flags(after_ms + 1) & LOST
    assert not rig.flags(after_ms + 1) & GimbalFlag.FOLLOWING
    rig.send(after_ms + 2)
    assert rig.flags(after_ms + 2) & LOST
    rig.send(after_ms + 3, gm.ENABLE, cmd_seq=rig.seq)  # not fresh
    assert rig.flags(after_ms + 3) & LOST
    rig.send(after_ms + 4, gm.ENABLE)
    flags = rig.flags(after_ms + 4)
    assert flags & GimbalFlag.ENABLED
    assert not flags & LOST


def test_a_lost_connection_is_comm_lost() -> None:
    rig = Rig()
    rig.enable(10)
    rig.controller.link_lost(12 * MS)
    assert rig.flags(12) & LOST


def test_a_lost_connection_that_never_commanded_is_nothing() -> None:
    rig = Rig()
    rig.controller.link_lost(12 * MS)
    assert not rig.flags(12) & LOST


def test_nothing_moves_without_follow_and_a_moving_mode() -> None:
    rig = Rig()
    rig.enable(1, watchdog_ms=1000)
    rig.send(2, gm.ENABLE, AxisMode.POSITION, az=0.02, watchdog_ms=1000)
    rig.send(3, MOVING, AxisMode.HOLD, az=0.02, watchdog_ms=1000)
    rig.send(4, MOVING, AxisMode.HOME, az=0.02, watchdog_ms=1000)
    assert rig.offset(500) == (0.0, 0.0)


def test_following_arrives_and_says_so() -> None:
    rig = Rig()
    rig.enable(1, watchdog_ms=1000)
    rig.follow(2, az=0.01, el=-0.02, watchdog_ms=1000)
    flags = rig.flags(3)
    assert flags & GimbalFlag.FOLLOWING
    assert not flags & GimbalFlag.IN_POSITION
    assert rig.offset(900) == pytest.approx((0.01, -0.02), abs=1e-6)
    assert rig.flags(900) & GimbalFlag.IN_POSITION


def test_a_set_point_is_carried_on_at_its_speed_from_the_instant_it_refers_to() -> None:
    rig = Rig(DeviceClock(offset_ns=4_294_900_000 * 1000))  # the low word wraps 67 ms after the start
    rig.enable(1)
    for t_ms in range(5, 505, 5):
        at_ms = t_ms - 20.0  # an instant of the past
        stamp = rig.clock.device_us(round(at_ms * MS)) & gm.LOW_WORD
        rig.follow(t_ms, az=0.05 * at_ms / 1000.0, az_rate=0.05, bits=gm.VELOCITY_VALID | gm.TIME_VALID, cmd_time_us=stamp)
    assert rig.offset(505)[0] == pytest.approx(0.05 * 0.505, abs=2e-6)


def test_a_set_point_without_an_instant_counts_from_its_receipt() -> None:
    rig = Rig()
    rig.enable(1)
    for t_ms in range(5, 505, 5):
        rig.follow(t_ms, az=0.05 * t_ms / 1000.0, az_rate=0.05, bits=gm.VELOCITY_VALID)
    assert rig.offset(505)[0] == pytest.approx(0.05 * 0.505, abs=2e-6)


def test_an_invalid_velocity_is_not_used() -> None:
    rig = Rig()
    rig.enable(1, watchdog_ms=1000)
    rig.follow(5, az=0.01, az_rate=0.5, watchdog_ms=1000)
    assert rig.offset(900)[0] == pytest.approx(0.01, abs=1e-6)


@pytest.mark.parametrize(("watchdog_ms", "carried_s"), [(1000, 0.1), (60, 0.06)])
def test_carrying_on_ends_after_100_ms_or_the_watchdog(watchdog_ms: int, carried_s: float) -> None:
    rig = Rig()
    rig.enable(1, watchdog_ms=watchdog_ms)
    rig.follow(2, az_rate=0.1, bits=gm.VELOCITY_VALID, watchdog_ms=watchdog_ms)
    assert rig.offset(900)[0] == pytest.approx(0.1 * carried_s, abs=2e-3)
    assert rig.rates(900) == pytest.approx((0.0, 0.0), abs=1e-6)


def test_a_wild_stamp_moves_no_axis_far() -> None:
    rig = Rig()
    rig.enable(1)
    rig.follow(5, az_rate=0.1, bits=gm.VELOCITY_VALID | gm.TIME_VALID, cmd_time_us=2_000_000_000)
    assert abs(rig.offset(900)[0]) < 0.021


def test_velocity_mode_turns_until_the_watchdog() -> None:
    rig = Rig()
    rig.enable(1)
    rig.follow(2, mode=AxisMode.VELOCITY, az_rate=0.1, el_rate=-0.05)
    assert rig.rates(50) == pytest.approx((0.1, -0.05), abs=1e-6)
    assert rig.rates(200) == (0.0, 0.0)


def test_halt_ramps_down_and_holds() -> None:
    rig = Rig()
    rig.enable(1, watchdog_ms=1000)
    rig.follow(2, mode=AxisMode.VELOCITY, az_rate=0.3, watchdog_ms=1000)
    assert rig.rates(100)[0] == pytest.approx(0.3, abs=1e-6)
    rig.send(100, MOVING | gm.HALT, AxisMode.VELOCITY, az_rate=0.3, watchdog_ms=1000)
    assert not rig.flags(101) & GimbalFlag.FOLLOWING
    assert 0.0 < rig.rates(105)[0] < 0.3  # 800 deg/s2 takes 21 ms
    assert rig.rates(130) == (0.0, 0.0)


def test_stow_goes_back_to_where_it_started() -> None:
    rig = Rig()
    rig.enable(1, watchdog_ms=1000)
    rig.follow(2, az=0.02, watchdog_ms=1000)
    rig.follow(900, mode=AxisMode.STOW, watchdog_ms=1000)
    assert rig.offset(1800) == pytest.approx((0.0, 0.0), abs=1e-6)


@pytest.mark.parametrize(("axis", "fault"), [({"az": 1.5}, 0x0401), ({"el": -1.5}, 0x0402)])
def test_a_set_point_beyond_the_travel_is_a_fault_and_moves_nothing(axis: dict[str, float], fault: int) -> None:
    rig = Rig()
    rig.enable(1, watchdog_ms=1000)
    rig.follow(2, **axis, watchdog_ms=1000)
    status = rig.status(3)
    assert status.fault == fault
    assert GimbalFlag(status.status) & GimbalFlag.AT_LIMIT
    assert rig.offset(500) == (0.0, 0.0)


@pytest.mark.parametrize("mode", [AxisMode.VELOCITY, AxisMode.POSITION])
def test_running_into_the_end_of_travel_stops_with_a_fault(mode: AxisMode) -> None:
    rig = Rig(axes={"az_limits_deg": (-5.0, 5.0)})
    rig.enable(1)
    for t_ms in range(5, 500, 5):
        rig.follow(t_ms, mode=mode, az=0.4 * t_ms / 1000.0, az_rate=0.4, bits=gm.VELOCITY_VALID)
    assert rig.status(500).fault == 0x0401
    assert rig.flags(500) & GimbalFlag.AT_LIMIT
    assert rig.axes.motion(500 * MS)[0][0] <= rig.axes.limits_rad[0][1]
    assert rig.rates(600) == (0.0, 0.0)


def test_after_a_travel_fault_a_reset_lets_it_move_back() -> None:
    rig = Rig()
    rig.enable(1, watchdog_ms=1000)
    rig.follow(2, az=1.5, watchdog_ms=1000)
    rig.send(3, gm.ENABLE | gm.FAULT_RESET, watchdog_ms=1000)
    rig.follow(4, az=0.01, watchdog_ms=1000)
    assert rig.status(4).fault == 0
    assert rig.offset(900)[0] == pytest.approx(0.01, abs=1e-6)


def test_the_safety_input_disables_until_reset_and_armed_anew() -> None:
    rig = Rig()
    rig.enable(1, watchdog_ms=1000)
    rig.follow(2, mode=AxisMode.VELOCITY, az_rate=0.3, watchdog_ms=1000)
    rig.controller.emergency_stop(50 * MS)
    status = rig.status(50)
    assert status.fault & gm.FAULT_CLASS == gm.FAULT_SAFETY
    assert not GimbalFlag(status.status) & GimbalFlag.ENABLED
    rig.send(60, MOVING | gm.FAULT_RESET, AxisMode.VELOCITY, az_rate=0.3, watchdog_ms=1000)
    assert rig.status(60).fault == 0
    assert not rig.flags(60) & GimbalFlag.ENABLED
    rig.send(61)
    rig.send(62, gm.ENABLE)
    assert rig.flags(62) & GimbalFlag.ENABLED


def test_a_restart_begins_every_count_again() -> None:
    rig = Rig()
    rig.enable(1, watchdog_ms=1000)
    rig.status(10)
    rig.controller.restart(20 * MS)
    status = rig.status(25)
    assert (status.status_seq, status.cmd_seq_echo, status.clock_us, status.latch_total) == (1, 0, 5000, 0)
    assert GimbalFlag(status.status) == GimbalFlag.READY | GimbalFlag.HOMED


def test_torn_records_on_request() -> None:
    rig = Rig()
    rig.controller.tear = 1
    with pytest.raises(gm.TornRecord):
        rig.status(1)
    assert rig.status(2).status_seq == 2


def test_the_history_goes_back_at_1_khz_and_never_before_the_start() -> None:
    rig = Rig()
    assert len(gm.decode_history(rig.controller.history(4 * MS), ByteOrder.MODBUS)) == 5
    rig.enable(5, watchdog_ms=1000)
    rig.follow(6, mode=AxisMode.VELOCITY, az_rate=0.1, watchdog_ms=1000)
    samples = gm.decode_history(rig.controller.history(200 * MS), ByteOrder.MODBUS)
    assert [t_us for t_us, _, _ in samples] == [200_000 - 1000 * n for n in range(20)]
    steps = [gm.signed((a[1] - b[1]) & gm.LOW_WORD) for a, b in pairwise(samples)]
    assert steps == pytest.approx([gm.counts_per_ms(0.1)] * 19, abs=2)


def test_the_static_record_says_what_the_axes_can_do() -> None:
    rig = Rig()
    static = gm.decode_static(rig.controller.static(), ByteOrder.MODBUS)
    assert static.serial == 7
    assert gm.angle(static.az_max[0] & gm.LOW_WORD, static.az_max[1]) == pytest.approx(rig.axes.limits_rad[0][1], abs=1e-9)
    assert gm.rad_per_s(static.max_speed) == pytest.approx(rig.axes.max_rad_s, rel=1e-6)
    assert gm.rad_per_s(static.max_acceleration) * 1000.0 == pytest.approx(rig.axes.max_rad_s2, rel=1e-3)
    assert (static.watchdog_min_ms, static.watchdog_default_ms, static.watchdog_max_ms) == (5, 50, 1000)


def test_a_time_before_the_last_one_changes_nothing() -> None:
    rig = Rig()
    rig.enable(10)
    rig.status(30)
    assert rig.status(20).clock_us == 30_000
