"""The angles of a frame: latches matched by index and checked by time, in the host's time. Synchronous; time is passed in."""

from dataclasses import dataclass
from itertools import takewhile
from math import hypot
from typing import Protocol

from trackerd.contract.clock import ClockKind, ControllerUs, HostNs
from trackerd.contract.model import AxisAngles, Frame, GimbalInfo, GimbalReport, Latch, NoAngle
from trackerd.estimate.clockfit import ClockFit, FitStatistics
from trackerd.estimate.latching import LatchMatcher, Match, Waiting

REMEMBERED = 32  # edges: 16 exposures, 0.3 s at 55 fps
STILL_CYCLES = 3  # a status_seq that stands still for so many exchanges is a dead controller behind a live bus


@dataclass(slots=True)
class RecordingTime:
    """Recorded instants mapped to now by one offset, common to all devices of the cell: set by the first that is asked for."""

    offset_ns: int | None = None

    def host(self, recorded_ns: int, now: HostNs) -> HostNs:
        if self.offset_ns is None:
            self.offset_ns = now - recorded_ns
        return HostNs(recorded_ns + self.offset_ns)


class Encoders(Protocol):
    """The sigmas of the encoders, and how late their angles are (az, el); GimbalSettings has them."""

    @property
    def encoder_sigma_rad(self) -> float: ...

    @property
    def encoder_fixed_rad(self) -> float: ...

    @property
    def latch_offset_s(self) -> tuple[float, float]: ...

    @property
    def latch_offset_sigma_s(self) -> tuple[float, float]: ...


class LatchedAngles:
    """One link's worth of status records, and the question: where were the axes at mid-exposure of this frame?"""

    def __init__(self, info: GimbalInfo, encoders: Encoders, recording: RecordingTime, stale_ns: int) -> None:
        self._info = info
        self._encoders = encoders
        self._recording = recording
        self._stale_ns = stale_ns
        self._matcher = LatchMatcher(info.edges or 1)  # without latches it is never asked
        self._fit = ClockFit()
        self._report: GimbalReport | None = None
        self._changed: HostNs | None = None
        self._still = 0  # exchanges in a row without a new status
        self._latches: tuple[Latch, ...] = ()  # newest first; the controller's own ring is too short for a frame that is late

    def reported(self, report: GimbalReport) -> bool:
        """Takes a status record. True: the controller has restarted, frames and latches must be numbered anew."""
        last, self._report = self._report, report
        if last is None or report.sequence != last.sequence:
            self._changed, self._still = report.received, 0
        else:
            self._still += 1
        restarted = last is not None and report.instant < last.instant
        if restarted:
            self._fit.reset()
            self.renumbered()
        self._remember(report.latches)
        if self._info.clock is ClockKind.DEVICE:
            self._fit.add(report.instant * 1000, HostNs(report.sent - self._info.snapshot_ns), report.received)
        return restarted

    def renumbered(self) -> None:
        """Latches and frames both begin at 0 again."""
        self._matcher.reset()
        self._latches = ()

    def stale(self, now: HostNs) -> str:
        """Why the controller's status is not to be trusted, or nothing."""
        if self._changed is None:
            return "no status from the controller"
        if self._still >= STILL_CYCLES:
            return f"the controller's status stands still since {self._still} exchanges"
        age_ns = now - self._changed
        return f"the controller's status is {age_ns * 1e-6:.0f} ms old" if age_ns > self._stale_ns else ""

    def match(self, frame: Frame, now: HostNs) -> AxisAngles | NoAngle | Waiting:
        report = self._report
        reason = self.stale(now)
        if report is None or reason:
            return NoAngle(reason)
        if self._info.edges == 0:
            still = Match(0, report.az_rad, report.el_rad, 0.0, 0.0, 0)
            return self._angles(still, None, 0.0, "fixed")
        found = self._matcher.match(frame.frame_id, frame.mid_exposure, self._latches)
        if not isinstance(found, Match):
            return found
        if self._info.clock is ClockKind.RECORDING:
            host = self._recording.host(found.instant_ns, now)
            return self._angles(found, host, 0.0, "recording")
        instant = self._fit.host(found.instant_ns)
        if instant is None:
            return NoAngle("the controller's clock is not known yet")
        return self._angles(found, *instant, "latch")

    def _remember(self, latches: tuple[Latch, ...]) -> None:
        """The same tuple as long as nothing new is in it: the matcher indexes it once."""
        if self._info.edges == 1 or not self._latches:
            self._latches = latches
            return
        newest = self._latches[0]
        new = tuple(takewhile(lambda latch: latch != newest, latches))
        if new:
            self._latches = (new + self._latches)[:REMEMBERED]

    def controller_time(self, now: HostNs) -> ControllerUs | None:
        """What the controller's clock shows now."""
        reported = None if self._report is None else self._fit.host(self._report.instant * 1000)
        if self._report is None or reported is None:
            return None
        return ControllerUs(self._report.instant + (now - reported[0]) // 1000)

    @property
    def clock_fit(self) -> FitStatistics | None:
        """How well the controller's clock is known."""
        return self._fit.statistics() if self._fit.ready else None

    def _angles(self, found: Match, instant: HostNs | None, sigma_ns: float, source: str) -> AxisAngles:
        """At mid-exposure: what was latched later or earlier is taken back by the speed. What is not known of the lateness is
        the same error in every frame at that speed, and so no noise."""
        (late_az, late_el), (sigma_az, sigma_el) = self._encoders.latch_offset_s, self._encoders.latch_offset_sigma_s
        return AxisAngles(
            az_rad=found.az_rad - found.az_rad_s * late_az,
            el_rad=found.el_rad - found.el_rad_s * late_el,
            sigma_rad=hypot(self._encoders.encoder_sigma_rad, self._info.latch_sigma_rad),
            fixed_sigma_rad=hypot(
                self._encoders.encoder_fixed_rad, max(abs(found.az_rad_s) * sigma_az, abs(found.el_rad_s) * sigma_el)
            ),
            instant=instant,
            instant_sigma_ns=sigma_ns,
            source=source,
        )
