"""Whatever a controller reports, a tracker sees and a person says: what the axes never ask for."""

from dataclasses import dataclass
from math import radians

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from trackerd.contract.clock import ClockKind, ControllerUs, HostNs
from trackerd.contract.model import (
    AxisAngles,
    AxisCommand,
    AxisMode,
    Found,
    GimbalFlag,
    GimbalInfo,
    GimbalReport,
    Missed,
    TrackState,
)
from trackerd.engine.axes import Axes, AxesState
from trackerd.engine.track import Step
from trackerd.formats.settings import SteeringSettings
from trackerd.steering.follow import SetPoint

CYCLE_NS = 5_000_000
STEERING = SteeringSettings(az_limits_deg=(-10.0, 10.0), el_limits_deg=(-5.0, 20.0))
GIMBAL = GimbalInfo("left", "1", "1.0", True, ClockKind.DEVICE, (-1.0, 1.0), (-1.0, 0.1), 1.0, 10.0)
READY = GimbalFlag.READY | GimbalFlag.HOMED
STATES = (READY, READY | GimbalFlag.ENABLED, READY | GimbalFlag.ENABLED | GimbalFlag.COMM_LOST, READY | GimbalFlag.COMM_LOST)

FINE = READY | GimbalFlag.ENABLED
flags = st.one_of(st.just(FINE), st.just(FINE), st.sampled_from(STATES), st.integers(0, 2047).map(GimbalFlag))
faults = st.sampled_from((0,) * 20 + (0x0101, 0x0201, 0x0401, 0x0501))
angles = st.floats(-0.15, 0.3)


@dataclass(frozen=True)
class Moment:
    """What happens in one bus cycle."""

    flags: GimbalFlag
    fault: int
    seen: str  # nothing, a target, a target without angles, a loss
    az_rad: float
    el_rad: float
    wish: str
    cycles: int  # that it lasts


moments = st.builds(
    Moment,
    flags,
    faults,
    st.sampled_from(("target", "target", "target", "blind", "lost", "nothing")),
    angles,
    angles,
    st.sampled_from(("",) * 12 + ("arm", "arm", "hold", "restarted", "link")),
    st.integers(1, 30),
)


class World:
    """A controller that is where it was told to be, if its report says that it follows."""

    def __init__(self, automatic: bool, proved: bool = False) -> None:
        self.axes = Axes(STEERING, automatic)
        self.axes.connected(GIMBAL)
        self.proved = proved  # the axis test takes longer than a story
        self.now = HostNs(10**12)
        self.report: GimbalReport | None = None
        self.at = (0.0, 0.0)
        self.number = 0

    def cycle(self, moment: Moment) -> tuple[AxisCommand, bool]:
        """The command, and whether the axes were armed when it was made."""
        self.now = HostNs(self.now + CYCLE_NS)
        self.number += 1
        command, armed = self.axes.command(self.now, None), self.axes.snapshot().armed
        if command.follow:
            self.at = command.az_rad, command.el_rad
        self._say(moment.wish)
        us = ControllerUs(self.now // 1000)
        self.report = GimbalReport(
            self.number & 0xFFFF, moment.flags, moment.fault, command.sequence, 0, *self.at, us, 0, (), self.now, self.now
        )
        self.axes.reported(self.report)
        self.axes._proof.passed |= self.proved
        if moment.seen != "nothing" and self.number % 4 == 0:
            self.axes.seen(self._step(moment))
        return command, armed

    def _say(self, wish: str) -> None:
        if wish == "arm":
            self.axes.arm()
        elif wish == "hold":
            self.axes.hold("a person said so")
        elif wish == "restarted":
            self.axes.restarted("it has restarted")
        elif wish == "link":
            self.axes.link_lost("the link is lost")
            self.axes.connected(GIMBAL)
            self.report = None

    def _step(self, moment: Moment) -> Step:
        found = moment.seen in ("target", "blind")
        q_px = 31_000.0 * np.array(self.at)
        outline = Found(float(q_px[0]), float(q_px[1]), 60.0, np.eye(3), 1.0, 1.0, 0.0)
        at = HostNs(self.now - 10_000_000)
        known = found and moment.seen != "blind"
        return Step(
            frame_id=self.number,
            instant=at,
            state=TrackState.LOCKED if found else TrackState.SEARCHING,
            outline=outline if found else Missed("nothing there"),
            sightline=None,
            set_point=SetPoint(moment.az_rad, moment.el_rad, 0.0, 0.0, self.now) if known else None,
            offset_px=(0.0, 0.0) if found else None,
            angles=AxisAngles(*self.at, 1e-5, 0.0, at, 0.0, "latch") if known else None,
            jacobian=31_000.0 * np.eye(2) if known else None,
            target_selected="itself",
            why="",
        )


def within(value: float, limits_deg: tuple[float, float]) -> bool:
    return radians(limits_deg[0]) - 1e-9 <= value <= radians(limits_deg[1]) + 1e-9


@settings(max_examples=150, deadline=None)
@given(automatic=st.booleans(), proved=st.booleans(), story=st.lists(moments, min_size=1, max_size=40))
def test_whatever_happens_the_rules_hold(automatic: bool, proved: bool, story: list[Moment]) -> None:
    world = World(automatic, proved)
    sequence = 0
    for moment in story:
        for _ in range(moment.cycles):
            known = world.report
            command, armed = world.cycle(moment)
            if known is None:
                assert command == AxisCommand(0)  # its state is not known: no command
                continue
            assert command.sequence == sequence % 0xFFFF + 1
            sequence = command.sequence
            assert command.watchdog_ms == STEERING.watchdog_ms
            enabled = bool(known.flags & GimbalFlag.ENABLED)
            assert command.enable or not enabled  # never switched off: an axis may fall
            assert armed or command.enable == enabled  # nobody enables what is not armed
            assert not command.reset_fault or (armed and known.fault)
            _check_motion(command, known, armed)


def _check_motion(command: AxisCommand, known: GimbalReport, armed: bool) -> None:
    if not command.follow:
        assert command.mode is AxisMode.HOLD
        return
    assert armed
    assert not known.fault
    assert known.flags & GimbalFlag.ENABLED
    assert not known.flags & GimbalFlag.COMM_LOST
    assert within(command.az_rad, STEERING.az_limits_deg)
    assert within(command.el_rad, (STEERING.el_limits_deg[0], np.degrees(GIMBAL.el_limits_rad[1])))
    assert max(abs(command.az_rad_s), abs(command.el_rad_s)) <= radians(STEERING.max_deg_s) + 1e-9


@pytest.mark.parametrize("automatic", [True, False])
def test_a_quiet_story_ends_in_following(automatic: bool) -> None:
    """The stories above are worth something only if this one gets there."""
    world = World(automatic)
    world.axes.arm()
    enabled = Moment(READY | GimbalFlag.ENABLED, 0, "target", 0.05, 0.05, "", 1)
    commands = [world.cycle(enabled)[0] for _ in range(1200)]
    assert world.axes.snapshot().state is AxesState.FOLLOWING
    assert commands[-1].az_rad == pytest.approx(0.05)
