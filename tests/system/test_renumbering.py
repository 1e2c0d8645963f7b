"""Frames and latches are numbered anew together, also on a link that has only just come up."""

import asyncio
from collections.abc import AsyncGenerator
from contextlib import suppress

import pytest

from trackerd.contract.clock import ClockKind, ControllerUs, HostNs, ManualClock
from trackerd.contract.model import AxisCommand, GimbalFlag, GimbalInfo, GimbalReport
from trackerd.engine.axes import Axes
from trackerd.engine.latched import RecordingTime
from trackerd.formats.settings import GimbalSettings
from trackerd.service.axes_link import AxesLink


class CountingGimbal:
    """A controller that has latched before, and answers its first request only when it is let."""

    def __init__(self) -> None:
        self.info = GimbalInfo("left", "1", "1.0", True, ClockKind.DEVICE, (-1.0, 1.0), (-1.0, 1.0), 1.0, 10.0)
        self.asked, self.let = asyncio.Event(), asyncio.Event()
        self.latch_total = 17
        self.sequence = self.zeros = 0

    async def exchange(self, command: AxisCommand) -> GimbalReport:
        self.asked.set()
        await self.let.wait()
        self.sequence += 1
        if command.latch_zero:
            self.latch_total = 0
            self.zeros += 1
        flags, instant = GimbalFlag.READY | GimbalFlag.HOMED, ControllerUs(self.sequence * 5000)
        stamps = HostNs(0), HostNs(1)
        return GimbalReport(self.sequence, flags, 0, command.sequence, 0, 0.0, 0.0, instant, self.latch_total, (), *stamps)


async def test_latches_are_zeroed_also_where_the_link_has_not_answered_yet() -> None:
    gimbal, settings = CountingGimbal(), GimbalSettings(driver="modbus", camera="left")
    link = AxesLink("left", Axes(settings.steering, False), settings, RecordingTime(), ManualClock())
    running = asyncio.create_task(link.run(gimbal))
    await gimbal.asked.wait()
    zeroing = asyncio.create_task(link.zero_latch())
    gimbal.let.set()
    await zeroing
    assert gimbal.latch_total == 0
    running.cancel()
    with suppress(asyncio.CancelledError):
        await running


async def late(_period_s: float) -> AsyncGenerator[int, None]:
    """Cycles that are due two at a time: nobody else gets to run between them."""
    while True:
        await asyncio.sleep(0)
        yield 1
        yield 1


async def test_a_zero_that_was_confirmed_is_not_sent_again_into_the_new_stream(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("trackerd.service.axes_link.ticks", late)
    gimbal, settings = CountingGimbal(), GimbalSettings(driver="modbus", camera="left")
    gimbal.let.set()
    link = AxesLink("left", Axes(settings.steering, False), settings, RecordingTime(), ManualClock())
    running = asyncio.create_task(link.run(gimbal))
    await gimbal.asked.wait()
    await link.zero_latch()
    assert gimbal.zeros == 1
    running.cancel()
    with suppress(asyncio.CancelledError):
        await running
