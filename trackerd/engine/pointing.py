"""The axes of one station while a calibration says where they look: as Axes, but to angles instead of after the target.

Nothing moves before an operator has armed them, the controller is ready, referenced and free of faults; every trouble, a lost
link or a restarted controller disarms them for good, and the command is 'hold'.
"""

from math import degrees

from trackerd.contract.clock import ControllerUs, HostNs
from trackerd.contract.model import AxisCommand, GimbalFlag, GimbalInfo, GimbalReport
from trackerd.engine.axes import AxesSnapshot, AxesState
from trackerd.engine.enabling import Enabling, is_enabled
from trackerd.engine.records import position, still
from trackerd.engine.track import Step
from trackerd.engine.trouble import trouble_of
from trackerd.formats.settings import SteeringSettings
from trackerd.steering.limits import SetPointLimiter, within

REST_RAD_S = 1e-6  # of the set-point: 0.2"/s
THERE_RAD = 5e-4  # 100": encoders and servo are off by far less, and no look is nearer to the next than ten times that


class Pointing:
    """`go` to angles; `arrived` tells when the encoders are there and the set-point has come to rest."""

    def __init__(self, steering: SteeringSettings) -> None:
        self._steering = steering
        self._limiter = SetPointLimiter(steering)
        self._info: GimbalInfo | None = None
        self._report: GimbalReport | None = None
        self._state = AxesState.OFFLINE
        self._armed = False
        self._reason = "not armed"
        self._sequence = 0
        self._enabling = Enabling()
        self._commanded: HostNs | None = None
        self._target: tuple[float, float] | None = None
        self._at_rest = False

    # ---- what people and the capture say -----------------------------------------------------------------------------

    def arm(self) -> str:
        """An operator's word. The answer says what is still missing."""
        if self._info is not None and not self._info.steerable:
            return "nothing to arm: this gimbal is not steered"
        self._armed, self._reason = True, ""
        return self.missing() or "armed"

    def hold(self, reason: str) -> None:
        """Stop, and stay until an operator arms again."""
        self._armed, self._reason, self._target = False, reason, None
        if self._state in (AxesState.ENABLING, AxesState.POINTING):
            self._state = AxesState.HELD

    def go(self, az_rad: float, el_rad: float) -> None:
        """Look there as soon as nothing is missing; beyond the travel, as far as it goes."""
        self._target, self._at_rest = (az_rad, el_rad), False

    @property
    def arrived(self) -> bool:
        report = self._report
        if self._state is not AxesState.POINTING or self._target is None or report is None or not self._at_rest:
            return False
        return max(abs(report.az_rad - self._target[0]), abs(report.el_rad - self._target[1])) < THERE_RAD

    @property
    def off_words(self) -> str:
        """How far the axes are from where they should be."""
        if self._target is None or self._report is None:
            return "nowhere to go"
        off = degrees(self._report.az_rad - self._target[0]), degrees(self._report.el_rad - self._target[1])
        return f"az {off[0]:+.3f}, el {off[1]:+.3f} deg away, {self._state}, at rest: {self._at_rest}"

    def missing(self) -> str:
        """What keeps the axes from moving, in words; empty: nothing."""
        report = self._report
        if self._info is not None and not self._info.steerable:
            return "this gimbal is not steered"
        if report is None:
            return "no status from the controller"
        if not self._armed:
            return self._reason
        if not report.flags & GimbalFlag.READY and not report.fault:
            return "the controller is not ready"
        return "" if report.flags & GimbalFlag.HOMED else "the axes are not referenced"

    # ---- what the link says ------------------------------------------------------------------------------------------

    def connected(self, info: GimbalInfo) -> None:
        """A link is up. The axes keep inside the controller's travel as well as the configured one."""
        self._info = info
        self._limiter = SetPointLimiter(within(self._steering, info))

    def link_lost(self, reason: str) -> None:
        if self._armed:
            self.hold(f"{reason}; not armed")
        self._report, self._info, self._state = None, None, AxesState.OFFLINE

    def restarted(self, reason: str) -> None:
        if self._armed:
            self.hold(f"{reason}; not armed")

    def reported(self, report: GimbalReport) -> None:
        self._report = report
        if self._state is AxesState.OFFLINE:
            self._state = AxesState.HELD
        elif self._state is AxesState.POINTING and (trouble := trouble_of(report)):
            self.hold(f"{trouble}; not armed")

    def seen(self, step: Step) -> None:
        """Where the target is in the image does not steer these axes."""

    def unseen(self) -> None:
        """Nor does a camera that has gone."""

    def command(self, now: HostNs, controller_now: ControllerUs | None) -> AxisCommand:
        dt_s = 0.0 if self._commanded is None else (now - self._commanded) * 1e-9
        self._commanded = now
        report = self._report
        if report is None:
            return AxisCommand(0)  # listen first
        self._sequence = self._sequence % 0xFFFF + 1
        self._proceed(report)
        watchdog_ms = self._steering.watchdog_ms
        if self._state is AxesState.POINTING and self._target is not None:
            point = self._limiter.step(*self._target, 0.0, 0.0, dt_s)
            self._at_rest = max(abs(point[2]), abs(point[3])) < REST_RAD_S
            return position(self._sequence, watchdog_ms, point, controller_now)
        if self._state is AxesState.ENABLING:
            wish = self._enabling.wish(report)
            return still(self._sequence, watchdog_ms, wish.enable, wish.reset_fault)
        return still(self._sequence, watchdog_ms, enable=bool(report.flags & GimbalFlag.ENABLED))

    def snapshot(self) -> AxesSnapshot:
        report = self._report
        return AxesSnapshot(
            state=self._state,
            reason=self.missing(),
            armed=self._armed,
            tested=False,
            fault=0 if report is None else report.fault,
            az_deg=None if report is None else degrees(report.az_rad),
            el_deg=None if report is None else degrees(report.el_rad),
            offset_px=None,
        )

    def _proceed(self, report: GimbalReport) -> None:
        """From held to pointing, once there is somewhere to look and nothing is missing."""
        if self._state is AxesState.HELD and self._target is not None and not self.missing():
            self._state, self._enabling = AxesState.ENABLING, Enabling()
        if self._state is not AxesState.ENABLING:
            return
        if is_enabled(report):
            self._state = AxesState.POINTING
            self._limiter.reset(report.az_rad, report.el_rad, 0.0, 0.0)
        elif self._enabling.hopeless(report):
            self.hold(f"controller fault 0x{report.fault:04x} does not clear")
