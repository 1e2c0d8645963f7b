"""The angles of a frame from status records: freshness, restarts, kinds of gimbals, and whose clock tells when."""

from dataclasses import replace
from math import cos, hypot, sin

import numpy as np
import pytest

from drivers.gimbal.records import info
from trackerd.contract.clock import CameraNs, ClockKind, ControllerUs, HostNs
from trackerd.contract.model import AxisAngles, Frame, GimbalFlag, GimbalInfo, GimbalReport, Latch, NoAngle
from trackerd.engine.latched import REMEMBERED, STILL_CYCLES, LatchedAngles, RecordingTime
from trackerd.estimate.latching import Waiting
from trackerd.formats import gimbal_map as gm
from trackerd.formats.settings import ARCSEC, GimbalSettings
from trackerd.twin.records import static_record

MS = 1_000_000
CYCLE_NS, STALE_NS = 5 * MS, 20 * MS
HOST_NS, CONTROLLER_US = 1_000_000 * MS, 7_000_000
SETTINGS = GimbalSettings(driver="modbus", camera="left", encoder_sigma_arcsec=2.0, encoder_fixed_arcsec=1.0)
GIMBAL = GimbalInfo("left", "1", "1.0", True, ClockKind.DEVICE, (-1.0, 1.0), (-1.0, 1.0), 1.0, 10.0)
REQUEST_NS = 200_000  # one way


class Bus:
    """Exchanges at 5 ms; `exposed` latches the middle of an exposure, 2 ms long, at an instant of the host's."""

    def __init__(self, gimbal: GimbalInfo = GIMBAL, recording: RecordingTime | None = None) -> None:
        self.latched = LatchedAngles(gimbal, SETTINGS, recording or RecordingTime(), STALE_NS)
        self.gimbal = gimbal
        self.now = HostNs(HOST_NS)
        self.sequence = 0
        self.latches: tuple[Latch, ...] = ()
        self.clock_us = CONTROLLER_US - HOST_NS // 1000  # controller - host
        self.age_ns = 0  # of the snapshot that is served

    def cycle(self, count: int = 1, still: bool = False) -> bool:
        """True: a restart was noticed."""
        restarted = False
        for _ in range(count):
            self.sequence += not still
            sampled_us = (self.now + REQUEST_NS - self.age_ns) // 1000 + self.clock_us
            received = HostNs(self.now + 2 * REQUEST_NS)
            restarted |= self.latched.reported(
                GimbalReport(
                    self.sequence & 0xFFFF, GimbalFlag.READY, 0, 0, 0, 0.25, -0.5, ControllerUs(sampled_us),
                    len(self.latches), self.latches[:4], self.now, received,
                )
            )  # fmt: skip
            self.now = HostNs(self.now + CYCLE_NS)
        return restarted

    def exposed(self, index: int, mid_ns: int) -> Frame:
        for falling in (False, True):
            edge_us = (mid_ns + (1 if falling else -1) * MS) // 1000 + self.clock_us
            self.latches = (Latch(index, falling, 0.1 + index, -0.2, ControllerUs(edge_us)), *self.latches)
        return frame(index, mid_ns)

    def match(self, taken: Frame) -> AxisAngles | NoAngle | Waiting:
        return self.latched.match(taken, self.now)


def frame(frame_id: int, mid_ns: int) -> Frame:
    return Frame(np.zeros((2, 2), np.uint8), frame_id, CameraNs(mid_ns), HostNs(mid_ns + 10 * MS), 2 * MS)


def known() -> Bus:
    bus = Bus()
    bus.cycle(20)
    return bus


def test_a_frame_gets_the_latched_angles_and_their_instant_in_the_hosts_time() -> None:
    bus = known()
    taken = bus.exposed(0, bus.now - 3 * MS)
    bus.cycle()
    angles = bus.match(taken)
    assert isinstance(angles, AxisAngles)
    assert (angles.az_rad, angles.el_rad, angles.source) == (0.1, -0.2, "latch")
    assert angles.instant == pytest.approx(HOST_NS + 97 * MS, abs=2_000)
    assert 0.0 < angles.instant_sigma_ns < 200_000.0


def test_a_latch_that_is_not_there_yet_is_waited_for() -> None:
    bus = known()
    assert isinstance(bus.match(frame(0, bus.now)), Waiting)


def test_a_frame_that_is_late_still_finds_its_latch() -> None:
    bus = known()
    frames = []
    for index in range(REMEMBERED // 2):
        frames.append(bus.exposed(index, bus.now))
        bus.cycle(4)
    assert isinstance(bus.match(frames[0]), AxisAngles)


def test_the_sigmas_are_the_encoders_and_the_latchs() -> None:
    bus = Bus(replace(GIMBAL, latch_sigma_rad=3.0 * ARCSEC))
    bus.cycle(20)
    taken = bus.exposed(0, bus.now)
    bus.cycle()
    angles = bus.match(taken)
    assert isinstance(angles, AxisAngles)
    assert angles.sigma_rad == pytest.approx(hypot(2.0, 3.0) * ARCSEC)
    assert angles.fixed_sigma_rad == pytest.approx(1.0 * ARCSEC)


def test_without_any_status_there_are_no_angles() -> None:
    assert Bus().match(frame(0, HOST_NS)) == NoAngle("no status from the controller")


def test_a_status_that_stands_still_for_three_exchanges_is_stale() -> None:
    bus = known()
    taken = bus.exposed(0, bus.now)
    bus.cycle()
    bus.cycle(STILL_CYCLES - 1, still=True)
    assert isinstance(bus.match(taken), AxisAngles)
    bus.cycle(still=True)
    assert bus.match(taken) == NoAngle("the controller's status stands still since 3 exchanges")
    bus.cycle()
    assert isinstance(bus.match(taken), AxisAngles)


def test_a_status_older_than_20_ms_is_stale() -> None:
    bus = known()
    received = bus.now - CYCLE_NS + 2 * REQUEST_NS
    assert bus.latched.stale(HostNs(received + STALE_NS)) == ""
    assert bus.latched.stale(HostNs(received + 31 * MS)) == "the controller's status is 31 ms old"


def test_a_controller_that_restarts_is_noticed_and_its_clock_learned_anew() -> None:
    bus = known()
    assert bus.latched.controller_time(bus.now) == pytest.approx(bus.now // 1000 + bus.clock_us, abs=2)
    bus.clock_us = 1_000 - bus.now // 1000
    assert bus.cycle()
    assert bus.latched.controller_time(bus.now) is None
    assert not bus.cycle(20)
    assert bus.latched.controller_time(bus.now) == pytest.approx(bus.now // 1000 + bus.clock_us, abs=2)


def test_frames_and_latches_begin_at_0_again_after_a_restart() -> None:
    bus = known()
    for index in range(3):
        taken = bus.exposed(index, bus.now)
        bus.cycle(4)
        assert isinstance(bus.match(taken), AxisAngles)
    bus.clock_us, bus.latches = 1_000 - bus.now // 1000, ()
    bus.cycle(20)
    taken = bus.exposed(0, bus.now)
    bus.cycle()
    angles = bus.match(taken)
    assert isinstance(angles, AxisAngles)
    assert angles.instant == pytest.approx(taken.mid_exposure, abs=2_000)


def test_until_the_clock_is_known_a_latch_is_no_angle() -> None:
    bus = Bus()
    taken = bus.exposed(0, bus.now)
    bus.cycle(2)
    assert bus.match(taken) == NoAngle("the controller's clock is not known yet")


def test_a_fixed_gimbal_has_its_angles_for_every_frame_and_no_instant() -> None:
    bus = Bus(replace(GIMBAL, clock=ClockKind.NONE, edges=0, steerable=False))
    bus.cycle()
    angles = bus.match(frame(77, HOST_NS))
    assert isinstance(angles, AxisAngles)
    assert (angles.az_rad, angles.el_rad, angles.instant, angles.source) == (0.25, -0.5, None, "fixed")
    assert bus.latched.clock_fit is None


def test_recorded_instants_of_all_devices_are_moved_by_one_offset() -> None:
    recording = RecordingTime()
    recorded = replace(GIMBAL, clock=ClockKind.RECORDING, edges=1, steerable=False)
    instants = []
    for index, at_us in ((0, 5_000_000), (3, 5_054_545)):  # two gimbals; the second is asked later
        bus = Bus(recorded, recording)
        bus.latches = (Latch(index, False, 0.5, 0.6, ControllerUs(at_us)),)
        bus.now = HostNs(HOST_NS + index * 40 * MS)
        bus.cycle()
        angles = bus.match(frame(index, at_us * 1000))
        assert isinstance(angles, AxisAngles)
        assert (angles.az_rad, angles.source, angles.instant_sigma_ns) == (0.5, "recording", 0.0)
        assert angles.instant is not None
        instants.append(angles.instant)
    assert instants[1] - instants[0] == 54_545_000
    assert instants[0] == HOST_NS + CYCLE_NS


@pytest.mark.parametrize("told", [True, False])
def test_the_age_of_a_snapshot_is_no_bias_of_the_clock_where_the_controller_tells_its_cycle(told: bool) -> None:
    """Status records are 0 to 2 ms old when they are served."""
    bus = Bus(replace(GIMBAL, snapshot_ns=2 * MS if told else 0))
    for n in range(400):
        bus.age_ns = n * 370_000 % (2 * MS)
        bus.cycle()
    taken = bus.exposed(0, bus.now)
    bus.cycle()
    angles = bus.match(taken)
    assert isinstance(angles, AxisAngles)
    assert angles.instant is not None
    assert taken.mid_exposure is not None
    bias_ns = abs(angles.instant - taken.mid_exposure)
    assert (bias_ns < 100_000) is told
    assert not told or bias_ns < 3.0 * angles.instant_sigma_ns


def test_the_cycle_of_the_static_block_becomes_the_snapshots_age() -> None:
    from closed_loop import quick

    loop = quick()
    twins = gm.decode_static(static_record(7, loop.controller.axes), gm.ByteOrder.MODBUS)
    assert info("left", twins).snapshot_ns == 0  # the twin answers with the instant that it was asked at
    assert info("left", replace(twins, cycle_us=1000)).snapshot_ns == MS


# ---- late angles -----------------------------------------------------------------------------------------------------


def swinging(t_s: float) -> tuple[float, float]:
    """Encoder angles of a following gimbal: 0.3 rad/s at most, 1 rad/s^2."""
    return 0.09 * sin(3.3 * t_s), 0.05 * cos(4.1 * t_s)


@pytest.mark.parametrize("edges", [1, 2])
def test_angles_that_were_latched_late_are_taken_back_to_mid_exposure_by_their_speed(edges: int) -> None:
    """250 us and -120 us at up to 0.3 rad/s are 15 arcsec; what is left is below a tenth of one."""
    late_us, sigma_us = (250.0, -120.0), (4.0, 2.0)
    settings = SETTINGS.model_copy(update={"latch_offset_us": late_us, "latch_offset_sigma_us": sigma_us})
    gimbal, period_ns = replace(GIMBAL, clock=ClockKind.RECORDING, edges=edges), 18 * MS
    latched, offsets = LatchedAngles(gimbal, settings, RecordingTime(), STALE_NS), []
    latches: tuple[Latch, ...] = ()
    for frame_id in range(40):
        mid_ns = HOST_NS + frame_id * period_ns
        for edge_ns in (-MS, MS) if edges == 2 else (0,):
            az, el = (swinging((mid_ns + edge_ns + late * 1000) * 1e-9)[i] for i, late in enumerate(late_us))
            latches = (Latch(frame_id, edge_ns > 0, az, el, ControllerUs((mid_ns + edge_ns) // 1000)), *latches)
        now = HostNs(mid_ns + 5 * MS)
        latched.reported(
            GimbalReport(frame_id, GimbalFlag.READY, 0, 0, 0, az, el, ControllerUs(mid_ns // 1000), 1, latches, now, now)
        )
        found = latched.match(replace(frame(frame_id, mid_ns), mid_exposure=CameraNs(mid_ns)), now)
        assert isinstance(found, AxisAngles)
        true = swinging(mid_ns * 1e-9)
        if frame_id >= 2:
            offsets.append((found.az_rad - true[0], found.el_rad - true[1]))
            speeds = 0.297 * abs(cos(3.3 * mid_ns * 1e-9)), 0.205 * abs(sin(4.1 * mid_ns * 1e-9))
            unknown = max(speed * sigma * 1e-6 for speed, sigma in zip(speeds, sigma_us, strict=True))
            assert found.fixed_sigma_rad == pytest.approx(hypot(1.0 * ARCSEC, unknown), rel=1e-2)
            assert found.sigma_rad == pytest.approx(2.0 * ARCSEC)
    assert np.abs(offsets).max() < (0.1 * ARCSEC if edges == 1 else 0.35 * ARCSEC)  # both edges' mean is off by acc T^2 / 8


def test_the_first_frame_has_no_speed_but_that_of_its_edges() -> None:
    bus = Bus()
    bus.latched = LatchedAngles(
        GIMBAL, SETTINGS.model_copy(update={"latch_offset_us": (1000.0, 0.0)}), RecordingTime(), STALE_NS
    )
    bus.cycle(20)
    taken = bus.exposed(0, bus.now)
    rising = bus.latches[1]
    bus.latches = (bus.latches[0], replace(rising, az_rad=rising.az_rad - 0.002))  # 1 rad/s over 2 ms
    bus.cycle()
    found = bus.match(taken)
    assert isinstance(found, AxisAngles)
    assert found.az_rad == pytest.approx(0.1 - 0.001 - 0.001)


def test_axes_that_do_not_move_are_not_corrected_and_lose_no_certainty() -> None:
    bus = Bus()
    late = SETTINGS.model_copy(update={"latch_offset_us": (500.0, 500.0), "latch_offset_sigma_us": (50.0, 50.0)})
    bus.latched = LatchedAngles(replace(GIMBAL, clock=ClockKind.NONE, edges=0), late, RecordingTime(), STALE_NS)
    bus.cycle()
    found = bus.match(frame(0, bus.now))
    assert isinstance(found, AxisAngles)
    assert (found.az_rad, found.el_rad, found.fixed_sigma_rad) == (0.25, -0.5, 1.0 * ARCSEC)
