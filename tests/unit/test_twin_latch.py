"""Exposures, the latches that they leave in the controller, and the clocks that stamp both."""

import pytest
from emulators.twin_rig import MS, Rig
from hypothesis import given
from hypothesis import strategies as st

from trackerd.contract.model import AxisMode, GimbalFlag
from trackerd.formats import gimbal_map as gm
from trackerd.sim.trigger import Trigger
from trackerd.twin.clock import DeviceClock
from trackerd.twin.exposure import ExposureLine
from trackerd.twin.latch import LatchRing

PERIOD_NS = 1e9 / 55.0
EXPOSURE_NS = 2 * MS


def line(phase_ns: int = 0) -> ExposureLine:
    return ExposureLine(Trigger(phase_ns, PERIOD_NS, EXPOSURE_NS))


def armed_rig(**twin: object) -> Rig:
    """Zeroed and armed at 1 ms, its camera started at 2 ms."""
    rig = Rig(**twin)
    rig.send(1, gm.LATCH_ENABLE | gm.LATCH_ZERO, watchdog_ms=1000)
    rig.line.start(2 * MS)
    return rig


# ---- exposures -------------------------------------------------------------------------------------------------------


def test_frames_of_a_stream_count_from_0_and_lie_on_the_trigger() -> None:
    exposures = line()
    exposures.start(5 * MS)
    taken = exposures.finished(100 * MS)
    assert [e.frame_id for e in taken] == [0, 1, 2, 3, 4]
    assert [e.rising_ns for e in taken] == [round(k * PERIOD_NS) for k in range(1, 6)]
    assert all(e.falling_ns - e.rising_ns == EXPOSURE_NS and e.mid_ns == e.rising_ns + MS for e in taken)


def test_every_exposure_and_edge_is_told_once() -> None:
    exposures = line()
    exposures.start(0)
    told = [exposure for t in range(0, 200, 7) for exposure in exposures.finished(t * MS)]
    edges = [edge for t in range(0, 200, 7) for edge in exposures.edges(t * MS)]
    assert [e.frame_id for e in told] == list(range(10))
    assert [edge.falling for edge in edges] == [False, True] * 10
    assert [edge.t_ns for edge in edges] == [t for e in told for t in (e.rising_ns, e.falling_ns)]


def test_no_exposure_before_start_or_after_stop() -> None:
    exposures = line()
    assert exposures.edges(100 * MS) == []
    exposures.start(100 * MS)
    assert exposures.stop(150 * MS) == 150 * MS
    assert [e.frame_id for e in exposures.finished(400 * MS)] == [0, 1, 2]
    assert exposures.next_end() is None


def test_stopping_within_an_exposure_tells_when_it_is_over() -> None:
    exposures = line()
    exposures.start(0)
    assert exposures.stop(round(PERIOD_NS) + MS) == round(PERIOD_NS) + EXPOSURE_NS


def test_a_new_start_counts_from_0_again_and_numbers_go_on() -> None:
    exposures = line()
    exposures.start(0)
    before = exposures.finished(100 * MS)
    exposures.stop(100 * MS)
    exposures.start(200 * MS)
    after = exposures.finished(300 * MS)
    assert after[0].frame_id == 0
    assert after[0].number == before[-1].number + 1


def test_a_held_up_stream_goes_on_without_a_gap_in_its_count() -> None:
    exposures = line()
    exposures.start(0)
    first = exposures.finished(100 * MS)
    exposures.hold_up(100 * MS, True)
    assert exposures.finished(500 * MS) == []
    exposures.hold_up(500 * MS, False)
    assert exposures.finished(600 * MS)[0].frame_id == first[-1].frame_id + 1


# ---- latches ---------------------------------------------------------------------------------------------------------


def test_the_first_exposure_after_a_zero_has_index_1_and_both_edges_share_it() -> None:
    status = armed_rig().status(25)
    assert status.latch_total == 1
    assert [latch.index for latch in status.latches] == [1 | gm.FALLING_EDGE, 1]
    assert GimbalFlag(status.status) & GimbalFlag.LATCH_ARMED


def test_latches_are_stamped_at_the_exact_scheduled_instants() -> None:
    rig = armed_rig()
    status = rig.status(50)
    edges_us = [round(k * PERIOD_NS) // 1000 + late for k in (1, 2) for late in (0, 2000)]
    assert [latch.t_us for latch in reversed(status.latches)] == edges_us
    assert status.latch_total == 2


def test_latches_hold_the_angles_of_their_edges() -> None:
    rig = armed_rig()
    rig.enable(3, watchdog_ms=1000)
    rig.send(4, gm.ENABLE | gm.FOLLOW | gm.LATCH_ENABLE, AxisMode.VELOCITY, az_rate=0.5, el_rate=-0.25, watchdog_ms=1000)
    rig.send(5, gm.ENABLE | gm.FOLLOW | gm.LATCH_ENABLE, AxisMode.VELOCITY, az_rate=0.5, el_rate=-0.25, watchdog_ms=1000)
    for latch in rig.status(250).latches:
        az, el = rig.scene.gimbals["left"].angles(latch.t_us * 1000)
        assert gm.angle(latch.az) == pytest.approx(az, abs=1e-6)  # the stamp is cut to microseconds
        assert gm.angle(latch.el) == pytest.approx(el, abs=1e-6)


def test_the_skew_of_the_latch_shifts_its_angles_and_not_its_stamps() -> None:
    rigs = [armed_rig(), armed_rig(encoder={"latch_skew_us": 300.0})]
    for rig in rigs:
        rig.enable(3, watchdog_ms=1000)
        rig.send(4, gm.ENABLE | gm.FOLLOW | gm.LATCH_ENABLE, AxisMode.VELOCITY, az_rate=0.5, watchdog_ms=1000)
    exact, late = (rig.status(250).latches for rig in rigs)
    assert [a.t_us for a in exact] == [b.t_us for b in late]
    shifts = [gm.signed((b.az - a.az) & gm.LOW_WORD) * gm.RAD_PER_COUNT for a, b in zip(exact, late, strict=True)]
    assert shifts == pytest.approx([0.5 * 300e-6] * 4, rel=1e-3)


def test_the_ring_is_four_deep_and_an_unread_edge_that_is_lost_is_an_overrun() -> None:
    rig = armed_rig()
    assert not rig.flags(50) & GimbalFlag.LATCH_OVERRUN
    status = rig.status(150)
    assert [latch.index & gm.INDEX_MASK for latch in status.latches] == [8, 8, 7, 7]
    assert GimbalFlag(status.status) & GimbalFlag.LATCH_OVERRUN
    rig.send(151, gm.LATCH_ENABLE)
    rig.send(152, gm.LATCH_ENABLE | gm.LATCH_ZERO)
    assert not rig.flags(152) & GimbalFlag.LATCH_OVERRUN


def test_a_zero_works_on_its_edge_only() -> None:
    rig = armed_rig()
    rig.send(100, gm.LATCH_ENABLE | gm.LATCH_ZERO)
    assert rig.status(100).latch_total == 5
    rig.send(101, gm.LATCH_ENABLE)
    rig.send(102, gm.LATCH_ENABLE | gm.LATCH_ZERO)
    assert rig.status(102).latch_total == 0
    assert rig.status(102).latches == ()


def test_an_exposure_that_began_before_the_zero_is_not_counted() -> None:
    rig = armed_rig()
    inside = round(PERIOD_NS) / MS + 1.0
    rig.send(10, gm.LATCH_ENABLE)
    rig.send(inside, gm.LATCH_ENABLE | gm.LATCH_ZERO)
    assert rig.status(inside + 2).latch_total == 0
    assert rig.status(40).latches[0].index == 1 | gm.FALLING_EDGE


def test_an_unarmed_latch_takes_nothing() -> None:
    rig = armed_rig()
    rig.send(3)
    assert rig.status(100).latch_total == 0


def test_a_jump_of_the_index_on_request() -> None:
    rig = armed_rig()
    rig.status(25)
    rig.controller.latch.jump(3)
    assert rig.status(45).latches[0].index == 5 | gm.FALLING_EDGE


def test_no_latch_of_the_life_before_a_restart() -> None:
    rig = armed_rig()
    rig.controller.restart(100 * MS)
    rig.send(100, gm.LATCH_ENABLE)
    status = rig.status(100)
    assert (status.latch_total, status.latches) == (0, ())


def test_the_index_wraps_at_31_bits() -> None:
    ring = LatchRing(armed=True, total=gm.INDEX_MASK)
    ring.edge(False, 0, 0, 0)
    assert ring.total == 0


# ---- clocks ----------------------------------------------------------------------------------------------------------


@given(
    offset=st.integers(0, 10**18),
    drift=st.floats(-500, 500),
    started=st.integers(0, 10**12),
    t=st.integers(0, 10**13),
)
def test_a_device_clock_goes_there_and_back(offset: int, drift: float, started: int, t: int) -> None:
    clock = DeviceClock(offset, drift, started)
    assert abs(clock.scene_ns(clock.device_us(started + t)) - (started + t)) <= 1002


def test_a_device_clock_drifts_and_a_restart_takes_it_back_to_its_offset() -> None:
    clock = DeviceClock(1_000_000, 100.0)
    assert clock.device_ns(10**9) == 10**9 + 1_000_000 + 100_000
    assert clock.restarted(10**9).device_ns(10**9) == 1_000_000
