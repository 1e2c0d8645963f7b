"""The axes of one station as a synchronous state machine: arming, the axis test, following, and every reason to stop.

It is asked for one command each bus cycle and told each status record and each step of the tracker. Nothing moves before the
axes were armed, referenced, fault-free and tested; on every doubt the command is 'hold', and the heartbeat goes on.
"""

from dataclasses import dataclass
from enum import StrEnum
from math import degrees, hypot

from trackerd.contract.clock import ControllerUs, HostNs
from trackerd.contract.model import AxisCommand, GimbalFlag, GimbalInfo, GimbalReport, TrackState
from trackerd.engine.axis_test import Verdict
from trackerd.engine.divergence import DivergenceWatch
from trackerd.engine.enabling import Enabling, is_enabled
from trackerd.engine.proof import Proof
from trackerd.engine.records import position, still
from trackerd.engine.track import Step
from trackerd.engine.trouble import is_safety_input, news_of, trouble_of
from trackerd.formats.settings import SteeringSettings
from trackerd.steering.follow import SetPoint
from trackerd.steering.limits import Point, SetPointLimiter, within

SET_POINT_LIFE_NS = 100_000_000  # a set-point older than this is followed no longer: the axes ramp to rest
FRAME_LIFE_NS = 500_000_000  # what a frame older than this has shown is no reason to begin, or to go on with the test
CLOCK_RAN_ON_US = 100_000  # behind the host by no more than this, and 1 %: it has not restarted in between
MOST_FAULTS = 5  # that are reset without a person, from one arming to the next


class AxesState(StrEnum):
    OFFLINE = "offline"  # no status from the controller
    FIXED = "fixed"  # nothing to steer
    HELD = "held"
    ENABLING = "enabling"
    TESTING = "testing"
    FOLLOWING = "following"
    POINTING = "pointing"  # to where a calibration wants to look


MOVING = (AxesState.TESTING, AxesState.FOLLOWING)


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
        self._limiter = SetPointLimiter(steering)
        self._armed = automatic
        self._faults = 0
        self._state = AxesState.OFFLINE
        self._reason = "" if automatic else "not armed"
        self._sequence = 0
        self._report: GimbalReport | None = None
        self._enabling = Enabling()
        self._proof = Proof(steering)
        self._proved: tuple[str, GimbalReport] | None = None  # serial and last word of a controller that went away
        self._set_point: SetPoint | None = None
        self._last_sight: tuple[float, float] | None = None  # the axes when they last saw the target, while following
        self._commanded: HostNs | None = None
        self._step: Step | None = None
        self._divergence = DivergenceWatch(steering.diverge_frames)

    # ---- what people and the supervisor say --------------------------------------------------------------------------

    def arm(self) -> str:
        """An operator's word, which also has a fault reset. The answer says what is still missing."""
        if self._info is not None and not self._info.steerable:
            return "nothing to arm: this gimbal is not steered"
        self._armed, self._faults, self._reason = True, 0, ""
        if self._state not in MOVING:
            self._proof.renew()
        return self._missing() or "armed"

    def hold(self, reason: str) -> None:
        """Stop following until an operator arms again."""
        self._armed = False
        self._stop(reason)

    def connected(self, info: GimbalInfo) -> None:
        """A link is up. Set-points keep inside the controller's travel as well as the configured one."""
        self._info = info
        steering = within(self._steering, info)
        self._limiter = SetPointLimiter(steering)
        self._proof.limit(steering)

    def link_lost(self, reason: str) -> None:
        """No status any more: the controller's watchdog holds the axes. What the test has proved stays proved, as long as it
        is the same controller that answers again, and it has not restarted."""
        if self._info is not None and self._report is not None:
            self._proved = (self._info.serial, self._report)
        self._disarm(reason)
        self._report, self._info, self._state = None, None, AxesState.OFFLINE

    def restarted(self, reason: str) -> None:
        """The controller is not the one that was armed and tested."""
        self._proof.forget()
        self._disarm(reason)

    # ---- every status record -----------------------------------------------------------------------------------------

    def reported(self, report: GimbalReport) -> None:
        before, self._report = self._report, report
        if self._state is AxesState.OFFLINE:
            self._state = AxesState.HELD if self._steerable else AxesState.FIXED
            if not self._same_as_before(report):
                self._proof.forget()
        if not self._armed:
            return
        if is_safety_input(report) and not (before is not None and is_safety_input(before)):
            self.hold(f"safety input (fault 0x{report.fault:04x}): arm again once it is cleared")
        elif self._state in MOVING:
            self._lose(trouble_of(report))
        elif not self._automatic and before is not None:
            self._lose(news_of(before, report))

    # ---- every frame -------------------------------------------------------------------------------------------------

    def seen(self, step: Step) -> None:
        self._step = step
        if self._state is AxesState.TESTING:
            self._judge(self._proof.seen(step))
        elif self._state is AxesState.FOLLOWING:
            self._set_point = step.set_point or self._set_point
            if step.state is TrackState.LOCKED and step.angles is not None:
                self._last_sight = (step.angles.az_rad, step.angles.el_rad)
            diverges = self._divergence.diverges(step)
            if diverges:
                self._proof.forget()
                self.hold(f"loop diverges: {diverges}")

    def unseen(self) -> None:
        """There are no frames any more: what was seen last counts for nothing."""
        self._step = None
        if self._state is AxesState.TESTING:
            self._stop("axis test: there are no frames")

    # ---- every bus cycle ---------------------------------------------------------------------------------------------

    def command(self, now: HostNs, controller_now: ControllerUs | None) -> AxisCommand:
        dt_s = 0.0 if self._commanded is None else (now - self._commanded) * 1e-9
        self._commanded = now
        report = self._report
        if report is None:
            return AxisCommand(0)  # listen first: any command would enable or disable axes whose state is not known
        self._sequence = self._sequence % 0xFFFF + 1
        self._proceed(report)
        watchdog_ms = self._steering.watchdog_ms
        if self._state is AxesState.TESTING:
            return position(self._sequence, watchdog_ms, self._proof.set_point(dt_s), controller_now)
        if self._state is AxesState.FOLLOWING:
            return position(self._sequence, watchdog_ms, self._next_point(now, dt_s), controller_now)
        if self._state is AxesState.ENABLING:
            wish = self._enabling.wish(report)
            return still(self._sequence, watchdog_ms, wish.enable, wish.reset_fault)
        return still(self._sequence, watchdog_ms, enable=bool(report.flags & GimbalFlag.ENABLED))

    def snapshot(self) -> AxesSnapshot:
        report, step = self._report, self._step
        held = self._missing() if self._state is AxesState.HELD else ""
        return AxesSnapshot(
            state=self._state,
            reason="" if self._state is AxesState.FIXED else self._reason or held,
            armed=self._armed,
            tested=self._proof.passed,
            fault=0 if report is None else report.fault,
            az_deg=None if report is None else degrees(report.az_rad),
            el_deg=None if report is None else degrees(report.el_rad),
            offset_px=None if step is None or step.offset_px is None else hypot(*step.offset_px),
        )

    # ---- inside ------------------------------------------------------------------------------------------------------

    @property
    def _steerable(self) -> bool:
        return self._info is not None and self._info.steerable

    def _same_as_before(self, report: GimbalReport) -> bool:
        """The controller that the link was lost to, with a clock that has run on."""
        if self._proved is None or self._info is None or self._proved[0] != self._info.serial:
            return False
        last = self._proved[1]
        elapsed_us = (report.received - last.received) // 1000
        return report.instant - last.instant > 0.99 * elapsed_us - CLOCK_RAN_ON_US

    def _missing(self) -> str:
        """What keeps the axes from following, in words; empty: nothing."""
        report, step = self._report, self._step
        if report is None:
            return "no status from the controller"
        if not self._armed:
            return self._reason or "not armed"
        if not report.flags & GimbalFlag.READY and not report.fault:
            return "the controller is not ready"
        if not report.flags & GimbalFlag.HOMED:
            return "the axes are not referenced"
        if step is None or step.state is not TrackState.LOCKED or not self._is_fresh(step):
            return "waiting for the target"
        return "" if step.angles is not None else f"waiting for angles: {step.why}"

    def _is_fresh(self, step: Step) -> bool:
        return self._commanded is not None and self._commanded - step.instant <= FRAME_LIFE_NS

    def _disarm(self, reason: str) -> None:
        """Stop; an operator has to arm again, unless that is automatic and no safety input was tripped. What was seen before
        counts no more."""
        self._step = None
        if self._armed and (not self._automatic or (self._report is not None and is_safety_input(self._report))):
            self.hold(f"{reason}; not armed")
        else:
            self._stop(reason if self._armed else self._reason or reason)

    def _lose(self, trouble: str) -> None:
        """Stop for a trouble of the controller's, if there is one."""
        if not trouble:
            return
        self._faults += self._report is not None and self._report.fault != 0
        if not self._automatic:
            self.hold(f"{trouble}; not armed")
        elif self._faults >= MOST_FAULTS:
            self.hold(f"{trouble}, {self._faults} faults since it was armed; not armed")
        else:
            self._stop(trouble)

    def _stop(self, reason: str) -> None:
        self._reason, self._set_point, self._last_sight = reason, None, None
        self._divergence.reset()
        if self._steerable:
            self._state = AxesState.HELD

    def _proceed(self, report: GimbalReport) -> None:
        """From held to following, as far as nothing is missing."""
        if self._state is AxesState.HELD and self._steerable and not self._missing():
            self._state, self._enabling = AxesState.ENABLING, Enabling()
        if self._state is AxesState.ENABLING:
            if is_enabled(report):
                self._begin(report)
            elif self._enabling.hopeless(report):
                self.hold(f"controller fault 0x{report.fault:04x} does not clear: arm again once its cause is gone")
        elif self._state is AxesState.TESTING and self._step is not None and not self._is_fresh(self._step):
            self._judge(self._proof.spoilt("no frames came"))

    def _begin(self, report: GimbalReport) -> None:
        if self._proof.passed:
            self._state, self._reason = AxesState.FOLLOWING, ""
            self._limiter.reset(report.az_rad, report.el_rad, 0.0, 0.0)
        else:
            self._state, self._reason = AxesState.TESTING, self._proof.reason
            self._proof.begin(report)

    def _judge(self, verdict: Verdict) -> None:
        """What the proof says of the axes. The next attempt begins from being held, as soon as nothing is missing."""
        if verdict is Verdict.PASSED and self._report is not None:
            self._begin(self._report)
        elif verdict is Verdict.UNCLEAR:
            self._stop(self._proof.reason)
        elif verdict is Verdict.FAILED:
            self.hold(self._proof.reason)

    def _next_point(self, now: HostNs, dt_s: float) -> Point:
        """After the set-point; without one back to where the target was last seen, which it may pass again: a target that is
        lost while it moves leaves the axes ahead on a tangent of its path. Without frames they just stop."""
        point = self._set_point
        if point is None or now - point.at > SET_POINT_LIFE_NS:
            self._set_point = None
            searching = self._step is not None and self._step.state is TrackState.SEARCHING and self._is_fresh(self._step)
            if searching and self._last_sight is not None:
                return self._limiter.step(*self._last_sight, 0.0, 0.0, dt_s)
            return self._limiter.stop_step(dt_s)
        target = point.moved_to(now)
        return self._limiter.step(target.az_rad, target.el_rad, target.az_rad_s, target.el_rad_s, dt_s)
