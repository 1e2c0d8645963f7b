"""The axes of one station as a synchronous state machine: arming, the axis test, following, and every reason to stop.

It is asked for one command each bus cycle and told each status record and each step of the tracker. Nothing moves before the
axes were armed, referenced, fault-free and tested; on every doubt the command is 'hold', and the heartbeat goes on.
"""

from dataclasses import dataclass
from enum import StrEnum
from math import degrees, hypot

import numpy as np

from trackerd.contract.clock import ControllerUs, HostNs
from trackerd.contract.model import (
    AxisCommand,
    AxisMode,
    Found,
    GimbalFlag,
    GimbalInfo,
    GimbalReport,
    TrackState,
)
from trackerd.engine.axis_test import AxisTest, Verdict
from trackerd.engine.divergence import DivergenceWatch
from trackerd.engine.track import Step
from trackerd.formats.settings import SteeringSettings
from trackerd.steering.follow import SetPoint
from trackerd.steering.limits import SetPointLimiter

SAFETY_FAULT = 0x0500
FAULT_CLASS = 0xFF00
SET_POINT_LIFE_NS = 100_000_000  # a set-point older than this is followed no longer: the axes ramp to rest
DISABLED_CYCLES = 2  # 'enable 0' is sent at least this often before 'enable 1'
UNCLEAR_TESTS = 20  # attempts, while the target keeps moving, before a person is asked


class AxesState(StrEnum):
    OFFLINE = "offline"  # no status from the controller
    FIXED = "fixed"  # nothing to steer
    HELD = "held"
    ENABLING = "enabling"
    TESTING = "testing"
    FOLLOWING = "following"


@dataclass(frozen=True, slots=True)
class AxesSnapshot:
    state: AxesState
    reason: str
    armed: bool
    tested: bool
    fault: int
    az_deg: float | None
    el_deg: float | None
    offset_px: float | None


class Axes:
    """`automatic`: armed by itself after start and after every loss but a safety fault, a diverged loop and a failed test."""

    def __init__(self, steering: SteeringSettings, automatic: bool) -> None:
        self._steering = steering
        self._automatic = automatic
        self._info: GimbalInfo | None = None
        self._limiter, self._test_limiter = _limiters(steering)
        self._armed = automatic
        self._state = AxesState.OFFLINE
        self._reason = "" if automatic else "not armed"
        self._sequence = 0
        self._report: GimbalReport | None = None
        self._test: AxisTest | None = None
        self._tested = False
        self._proved = ("", ControllerUs(0))  # serial and last instant of the controller that was tested
        self._unclear = 0
        self._disabled = 0
        self._set_point: SetPoint | None = None
        self._commanded: HostNs | None = None
        self._step: Step | None = None
        self._divergence = DivergenceWatch(steering.diverge_frames)

    # ---- what people and the supervisor say --------------------------------------------------------------------------

    def arm(self) -> str:
        """An operator's word. The answer says what is still missing."""
        if self._info is not None and not self._info.steerable:
            return "nothing to arm: this gimbal is not steered"
        self._armed, self._unclear, self._reason = True, 0, ""
        return self._missing() or "armed"

    def hold(self, reason: str) -> None:
        """Stop following until an operator arms again."""
        self._armed = False
        self._stop(reason)

    def connected(self, info: GimbalInfo) -> None:
        """A link is up. Set-points keep inside the controller's travel as well as the configured one."""
        self._info = info
        self._limiter, self._test_limiter = _limiters(_within(self._steering, info))

    def link_lost(self, reason: str) -> None:
        """No status any more: the controller's watchdog holds the axes. What the test has proved stays proved, as long as it
        is the same controller that answers again, and it has not restarted."""
        if self._info is not None and self._report is not None:
            self._proved = (self._info.serial, self._report.instant)
        self._disarm(reason)
        self._report, self._info, self._state = None, None, AxesState.OFFLINE

    def restarted(self, reason: str) -> None:
        """The controller is not the one that was armed and tested."""
        self._tested = False
        self._disarm(reason)

    # ---- every status record -----------------------------------------------------------------------------------------

    def reported(self, report: GimbalReport) -> None:
        self._report = report
        if self._state is AxesState.OFFLINE:
            self._state = AxesState.HELD if self._steerable else AxesState.FIXED
            if self._info is not None and (self._info.serial != self._proved[0] or report.instant < self._proved[1]):
                self._tested = False
        if self._safety_fault() and self._armed:
            self.hold(f"safety input (fault 0x{report.fault:04x}): arm again once it is cleared")
        if self._state in (AxesState.TESTING, AxesState.FOLLOWING):
            trouble = self._trouble(report)
            if trouble and self._automatic:
                self._stop(trouble)
            elif trouble:
                self.hold(f"{trouble}; not armed")

    # ---- every frame -------------------------------------------------------------------------------------------------

    def seen(self, step: Step) -> None:
        self._step = step
        if self._state is AxesState.TESTING:
            self._try_axes(step)
        elif self._state is AxesState.FOLLOWING:
            self._set_point = step.set_point or self._set_point
            if self._divergence.diverges(step):
                self.hold("loop diverges: the pixel error grows although the axes move against it")

    # ---- every bus cycle ---------------------------------------------------------------------------------------------

    def command(self, now: HostNs, controller_now: ControllerUs | None) -> AxisCommand:
        dt_s = 0.0 if self._commanded is None else (now - self._commanded) * 1e-9
        self._commanded = now
        self._sequence = self._sequence % 0xFFFF + 1
        report = self._report
        if report is None or not self._steerable:
            return AxisCommand(self._sequence, watchdog_ms=self._steering.watchdog_ms)
        if self._state is AxesState.HELD and not self._missing():
            self._state, self._disabled = AxesState.ENABLING, 0
        if self._state is AxesState.ENABLING:
            return self._enable(report)
        if self._state is AxesState.TESTING and self._test is not None:
            return self._follow(self._test_limiter, (*self._test.target, 0.0, 0.0), dt_s, controller_now)
        if self._state is AxesState.FOLLOWING:
            return self._follow_target(now, dt_s, controller_now)
        return self._hold_command(report)

    def snapshot(self) -> AxesSnapshot:
        report, step = self._report, self._step
        return AxesSnapshot(
            state=self._state,
            reason=self._reason or (self._missing() if self._state is AxesState.HELD else ""),
            armed=self._armed,
            tested=self._tested,
            fault=0 if report is None else report.fault,
            az_deg=None if report is None else float(np.degrees(report.az_rad)),
            el_deg=None if report is None else float(np.degrees(report.el_rad)),
            offset_px=None if step is None or step.offset_px is None else hypot(*step.offset_px),
        )

    # ---- inside ------------------------------------------------------------------------------------------------------

    @property
    def _steerable(self) -> bool:
        return self._info is not None and self._info.steerable

    def _missing(self) -> str:
        """What keeps the axes from following, in words; empty: nothing."""
        if self._report is None:
            return "no status from the controller"
        if not self._armed:
            return self._reason or "not armed"
        if not self._report.flags & GimbalFlag.READY:
            return "the controller is not ready"
        if not self._report.flags & GimbalFlag.HOMED:
            return "the axes are not referenced"
        if self._step is None or self._step.state is not TrackState.LOCKED or self._step.angles is None:
            return "waiting for the target"
        return ""

    @staticmethod
    def _trouble(report: GimbalReport) -> str:
        if report.fault:
            return f"controller fault 0x{report.fault:04x}"
        if report.flags & GimbalFlag.COMM_LOST:
            return "the controller's watchdog took over (comm lost)"
        if not report.flags & GimbalFlag.ENABLED:
            return "the controller disabled the axes"
        return ""

    def _safety_fault(self) -> bool:
        return self._report is not None and self._report.fault & FAULT_CLASS == SAFETY_FAULT

    def _disarm(self, reason: str) -> None:
        """Stop; an operator has to arm again, unless that is automatic and no safety input was tripped."""
        if self._armed and (not self._automatic or self._safety_fault()):
            self._armed, reason = False, f"{reason}; not armed"
        self._stop(reason if self._armed else self._reason or reason)

    def _stop(self, reason: str) -> None:
        self._reason, self._test, self._set_point = reason, None, None
        self._divergence.reset()
        if self._steerable:
            self._state = AxesState.HELD

    def _hold_command(self, report: GimbalReport) -> AxisCommand:
        """Heartbeat and hold. The drive stays as it is: enabling and disabling are moves (a brake, a falling EL axis)."""
        return AxisCommand(
            self._sequence, enable=bool(report.flags & GimbalFlag.ENABLED), watchdog_ms=self._steering.watchdog_ms
        )

    def _enable(self, report: GimbalReport) -> AxisCommand:
        """Enable, by the rules: out of 'comm lost' only by enable 0 then 1, and 0 only once the controller itself has
        disabled and braked; a fault (not of a safety input) is reset on the way."""
        enabled = bool(report.flags & GimbalFlag.ENABLED)
        lost = bool(report.flags & GimbalFlag.COMM_LOST)
        if enabled and not lost and not report.fault:
            self._begin(report)
            return self._hold_command(report)
        if enabled and lost:
            return self._hold_command(report)
        if self._disabled < DISABLED_CYCLES:
            self._disabled += 1
            return AxisCommand(self._sequence, reset_fault=report.fault != 0, watchdog_ms=self._steering.watchdog_ms)
        if lost or report.fault:
            self._disabled += 1
            if self._disabled > 10 * DISABLED_CYCLES:
                self._disabled = 0
        return AxisCommand(self._sequence, enable=True, watchdog_ms=self._steering.watchdog_ms)

    def _begin(self, report: GimbalReport) -> None:
        self._reason = ""
        if self._tested:
            self._state = AxesState.FOLLOWING
            self._limiter.reset(report.az_rad, report.el_rad, 0.0, 0.0)
        else:
            self._state = AxesState.TESTING
            self._begin_test(report)

    def _begin_test(self, report: GimbalReport) -> None:
        self._test = AxisTest(np.array((report.az_rad, report.el_rad)), self._steering)
        self._test_limiter.reset(report.az_rad, report.el_rad, 0.0, 0.0)

    def _try_axes(self, step: Step) -> None:
        report = self._report
        if step.state is TrackState.SEARCHING:
            self._stop("axis test: the target was lost")
        if self._test is None or report is None or not isinstance(step.outline, Found):
            return
        if step.angles is None or step.jacobian is None:
            return
        q_px = np.array((step.outline.x_px, step.outline.y_px))
        verdict = self._test.seen(q_px, step.angles, step.jacobian, step.instant)
        self._reason = self._test.reason
        if verdict is Verdict.PASSED:
            self._tested, self._unclear = True, 0
            self._begin(report)
        elif verdict is Verdict.FAILED:
            self.hold(self._test.reason)
        elif verdict is Verdict.UNCLEAR:
            self._unclear += 1
            if self._unclear >= UNCLEAR_TESTS:
                self.hold(f"{self._test.reason}, {UNCLEAR_TESTS} times: let it stand still, then arm")
            else:
                self._begin_test(report)

    def _follow_target(self, now: HostNs, dt_s: float, controller_now: ControllerUs | None) -> AxisCommand:
        point = self._set_point
        if point is None or now - point.at > SET_POINT_LIFE_NS:
            self._set_point = None
            return self._position(self._limiter.stop_step(dt_s), controller_now)
        target = point.moved_to(now)
        way = target.az_rad, target.el_rad, target.az_rad_s, target.el_rad_s
        return self._follow(self._limiter, way, dt_s, controller_now)

    def _follow(
        self,
        limiter: SetPointLimiter,
        target: tuple[float, float, float, float],
        dt_s: float,
        controller_now: ControllerUs | None,
    ) -> AxisCommand:
        return self._position(limiter.step(*target, dt_s), controller_now)

    def _position(self, point: tuple[float, float, float, float], controller_now: ControllerUs | None) -> AxisCommand:
        az, el, az_rate, el_rate = point
        return AxisCommand(
            sequence=self._sequence,
            mode=AxisMode.POSITION,
            az_rad=az,
            el_rad=el,
            az_rad_s=az_rate,
            el_rad_s=el_rate,
            at=controller_now,
            enable=True,
            follow=True,
            velocity_valid=True,
            watchdog_ms=self._steering.watchdog_ms,
        )


def _limiters(steering: SteeringSettings) -> tuple[SetPointLimiter, SetPointLimiter]:
    """For following, and for the slow test."""
    return SetPointLimiter(steering), SetPointLimiter(steering.model_copy(update={"max_deg_s": steering.test_deg_s}))


def _within(steering: SteeringSettings, info: GimbalInfo) -> SteeringSettings:
    """The settings with the controller's own limits, where those are narrower."""
    travel = {
        name: (max(wanted[0], degrees(own[0])), min(wanted[1], degrees(own[1])))
        for name, wanted, own in (
            ("az_limits_deg", steering.az_limits_deg, info.az_limits_rad),
            ("el_limits_deg", steering.el_limits_deg, info.el_limits_rad),
        )
    }
    speed = {
        "max_deg_s": min(steering.max_deg_s, degrees(info.max_rad_s)),
        "max_deg_s2": min(steering.max_deg_s2, degrees(info.max_rad_s2)),
    }
    return steering.model_copy(update=travel | speed)
