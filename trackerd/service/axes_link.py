"""The axes of one station on the bus: one object for the station's life, whatever happens to its controller."""

import asyncio
import logging
from contextlib import aclosing, suppress
from dataclasses import replace
from typing import Protocol

from trackerd.contract.clock import Clock, ControllerUs, HostNs
from trackerd.contract.errors import DeviceError, DeviceTimeout
from trackerd.contract.model import AxisAngles, AxisCommand, Frame, GimbalInfo, GimbalReport, NoAngle
from trackerd.contract.ports import Gimbal
from trackerd.engine.axes import AxesSnapshot
from trackerd.engine.latched import LatchedAngles, RecordingTime
from trackerd.engine.track import Step
from trackerd.estimate.clockfit import FitStatistics
from trackerd.estimate.latching import Waiting
from trackerd.formats.settings import GimbalSettings
from trackerd.service.cancellation import end_if_cancelled, is_cancelled
from trackerd.service.pacer import ticks

log = logging.getLogger("trackerd.axes")
LATCH_CYCLES = 2  # a frame waits this many bus cycles for the status that holds its latch
ZERO_CYCLES = 40
SEQUENCES = 0x10000
OUT_OF_STEP_FRAMES = 25  # about half a second
FAREWELL_CYCLES = 3  # 'hold' is sent this often before the link is closed


class Axes(Protocol):
    """What a link steers: axes that follow the target, or that look where a calibration wants them to."""

    def arm(self) -> str: ...

    def hold(self, reason: str) -> None: ...

    def connected(self, info: GimbalInfo) -> None: ...

    def link_lost(self, reason: str) -> None: ...

    def restarted(self, reason: str) -> None: ...

    def reported(self, report: GimbalReport) -> None: ...

    def seen(self, step: Step) -> None: ...

    def unseen(self) -> None: ...

    def command(self, now: HostNs, controller_now: ControllerUs | None) -> AxisCommand: ...

    def snapshot(self) -> AxesSnapshot: ...


class AxesLink:
    """Exchanges records on the bus' own clock; the newest set-point rides along; frames ask it for their angles."""

    def __init__(self, name: str, axes: Axes, settings: GimbalSettings, recording: RecordingTime, clock: Clock) -> None:
        self.name = name
        self.epoch = 0  # counts up whenever frames and latches have to be numbered anew
        self._axes = axes
        self._settings = settings
        self._recording = recording
        self._clock = clock
        self._latched: LatchedAngles | None = None
        self._news = asyncio.Event()
        self._zeroing = False
        self._first_zero: int | None = None  # sequence of the first command that asked for it
        self._unmatched = 0  # frames in a row whose latch never came
        self._late_cycles = 0
        self._exchanges = 0

    async def run(self, gimbal: Gimbal) -> None:
        """Until it is cancelled, or the link breaks with a DeviceError. The axes are told to hold on every way out."""
        cycle_s = self._settings.cycle_ms * 1e-3
        self._axes.connected(gimbal.info)
        self._latched = LatchedAngles(gimbal.info, self._settings, self._recording, round(self._settings.stale_ms * 1e6))
        self.epoch += 1
        try:
            async with aclosing(ticks(cycle_s)) as due:
                async for periods in due:
                    self._late_cycles += periods - 1
                    await self._exchange(gimbal)
                    end_if_cancelled()
        except asyncio.CancelledError:
            await self._farewell(gimbal)
            self._down("closed")
            raise
        except Exception as error:
            if is_cancelled() or not isinstance(error, DeviceError):  # the link still works
                await self._farewell(gimbal)
            self._down(str(error))
            raise

    def _down(self, reason: str) -> None:
        self._axes.link_lost(reason)
        self._latched = None
        self._tell()

    async def latched_at(self, frame: Frame) -> AxisAngles | NoAngle:
        """The angles at the frame's mid-exposure; at most two bus cycles late, else NoAngle."""
        for cycle in range(LATCH_CYCLES + 1):
            if self._latched is None:
                return NoAngle("no link to the controller")
            angles = self._latched.match(frame, self._clock.now())
            if not isinstance(angles, Waiting):
                self._unmatched = 0
                return angles
            if cycle < LATCH_CYCLES:
                await self._next_report()
        self._not_matched()
        return NoAngle(f"its latch did not come within {LATCH_CYCLES} bus cycles")

    async def zero_latch(self) -> None:
        """Makes the next exposure's latch number 0; the camera is stopped. Without a link there is nothing to do: the next one
        begins an epoch of its own."""
        if self._latched is None:
            return
        self._zeroing, self._first_zero = True, None
        try:
            for _ in range(ZERO_CYCLES):
                await self._next_report()
                if not self._zeroing or self._latched is None:
                    break
            else:
                raise DeviceTimeout(f"gimbal {self.name}", "set the latch counter to zero", f"not done in {ZERO_CYCLES} cycles")
        finally:
            self._zeroing = False
        if self._latched is not None:
            self._latched.renumbered()
        self._unmatched = 0

    def out_of_step(self, reason: str) -> None:
        """Frames and latches have to be numbered anew."""
        log.warning("frames and latches of %s are out of step, and numbered anew: %s", self.name, reason)
        self._unmatched = 0
        self.epoch += 1

    def seen(self, step: Step) -> None:
        self._axes.seen(step)

    def unseen(self) -> None:
        self._axes.unseen()

    def arm(self) -> str:
        answer = self._axes.arm()
        log.info("axes of %s armed by the operator: %s", self.name, answer)
        return answer

    def hold(self, reason: str) -> None:
        self._axes.hold(reason)

    def snapshot(self) -> AxesSnapshot:
        return self._axes.snapshot()

    def stale(self) -> str:
        return "no link to the controller" if self._latched is None else self._latched.stale(self._clock.now())

    @property
    def clock_fit(self) -> FitStatistics | None:
        return None if self._latched is None else self._latched.clock_fit

    @property
    def exchanges(self) -> tuple[int, int]:
        """Exchanges done, cycles that were missed."""
        return self._exchanges, self._late_cycles

    async def _exchange(self, gimbal: Gimbal) -> None:
        assert self._latched is not None
        now = self._clock.now()
        command = self._axes.command(now, self._latched.controller_time(now))
        if self._zeroing:
            command = replace(command, latch_zero=True)
        report = await gimbal.exchange(command)
        if command.latch_zero and report.latch_total == 0 and self._zero_accepted(command.sequence, report.echo):
            # At once: a late cycle sends the next command before `zero_latch` wakes up, and its zero would meet the new stream.
            self._zeroing = False
        self._exchanges += 1
        if self._latched.reported(report):
            log.warning("the controller of %s has restarted", self.name)
            self._axes.restarted("the controller has restarted")
            self.epoch += 1
        self._axes.reported(report)
        self._tell()

    def _zero_accepted(self, sequence: int, echo: int) -> bool:
        """The controller has taken this command, or an earlier one that asked for the same (its status may be a cycle old)."""
        if self._first_zero is None:
            self._first_zero = sequence
        return (echo - self._first_zero) % SEQUENCES <= (sequence - self._first_zero) % SEQUENCES

    def _not_matched(self) -> None:
        """Latches come, but never the one that is asked for."""
        self._unmatched += 1
        if self._unmatched >= OUT_OF_STEP_FRAMES:
            self.out_of_step("latches come, but not the frames'")

    async def _farewell(self, gimbal: Gimbal) -> None:
        """Held, not disabled: an EL axis that carries an eccentric camera falls when it is disabled."""
        self._axes.hold("the daemon stops")
        with suppress(DeviceError):  # a controller that is gone holds by its own watchdog
            for _ in range(FAREWELL_CYCLES):
                await gimbal.exchange(self._axes.command(self._clock.now(), None))

    def _tell(self) -> None:
        """Wakes everybody who waits for the next status."""
        self._news.set()
        self._news = asyncio.Event()

    async def _next_report(self) -> None:
        await self._news.wait()
