"""The axes' link over a gimbal in memory: the heartbeat, latches that are late, numbering anew, and every way out."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import replace

import numpy as np
import pytest
from made_devices import GIMBAL, MemoryGimbal

from trackerd.contract.clock import CameraNs, ClockKind, HostNs, ManualClock
from trackerd.contract.errors import DeviceTimeout
from trackerd.contract.model import AxisAngles, AxisMode, Frame, GimbalInfo, NoAngle
from trackerd.engine.axes import Axes, AxesState
from trackerd.engine.latched import RecordingTime
from trackerd.formats.settings import GimbalSettings
from trackerd.service.axes_link import FAREWELL_CYCLES, LATCH_CYCLES, OUT_OF_STEP_FRAMES, ZERO_CYCLES, AxesLink

SETTINGS = GimbalSettings(driver="memory", camera="left", cycle_ms=1.0, stale_ms=20.0)
KNOWN = 10  # exchanges after which the controller's clock is known
LOST = DeviceTimeout("gimbal left", "exchange", "no reply in 0.05 s")


class Bench:
    def __init__(self, info: GimbalInfo = GIMBAL) -> None:
        self.clock = ManualClock(HostNs(10**9))
        self.gimbal = MemoryGimbal(self.clock, info)
        self.link = AxesLink("left", Axes(SETTINGS.steering, automatic=False), SETTINGS, RecordingTime(), self.clock)
        self.task: asyncio.Task[None] | None = None

    def open(self) -> None:
        self.task = asyncio.create_task(self.link.run(self.gimbal))

    async def close(self) -> None:
        assert self.task is not None
        self.task.cancel()
        await asyncio.wait([self.task])

    def frame(self, frame_id: int) -> Frame:
        """Exposed 2 ms ago, in a camera whose clock is the host's."""
        now = self.clock.now()
        return Frame(np.zeros((4, 4), np.uint8), frame_id, CameraNs(now - 2_000_000), now, 2_000_000)

    def exposed(self, frame_id: int) -> Frame:
        """A frame whose latch is there."""
        frame = self.frame(frame_id)
        assert frame.mid_exposure is not None
        self.gimbal.expose(frame_id, frame.mid_exposure)
        return frame


@asynccontextmanager
async def linked(info: GimbalInfo = GIMBAL) -> AsyncIterator[Bench]:
    """A link that knows the controller's clock."""
    bench = Bench(info)
    bench.open()
    await bench.gimbal.exchanged(KNOWN)
    yield bench
    await bench.close()


# ---- the heartbeat ---------------------------------------------------------------------------------------------------


async def test_the_heartbeat_counts_up_and_nothing_moves_before_it_is_armed() -> None:
    async with linked() as bench:
        commands = bench.gimbal.commands
        sequences = [command.sequence for command in commands if command.sequence]
        assert sequences == list(range(sequences[0], sequences[0] + len(sequences)))
        assert {(c.mode, c.follow, c.enable) for c in commands} == {(AxisMode.HOLD, False, False)}
        assert bench.link.snapshot().state is AxesState.HELD
        assert bench.link.exchanges[0] == len(commands)
        assert bench.link.clock_fit is not None


async def test_arming_and_holding_answer_in_words() -> None:
    async with linked() as bench:
        assert bench.link.arm() == "waiting for the target"
        bench.link.hold("held by the operator")
        assert (bench.link.snapshot().armed, bench.link.snapshot().reason) == (False, "held by the operator")


# ---- a frame asks for its angles -------------------------------------------------------------------------------------


async def test_a_latch_that_is_there_is_answered_at_once_in_the_hosts_time() -> None:
    async with linked() as bench:
        frame = bench.exposed(0)
        await bench.gimbal.exchanged(1)
        done = len(bench.gimbal.commands)
        angles = await bench.link.latched_at(frame)
        assert len(bench.gimbal.commands) == done
        assert isinstance(angles, AxisAngles)
        assert (angles.az_rad, angles.el_rad, angles.source) == (0.1, 0.2, "latch")
        assert angles.instant == pytest.approx(frame.mid_exposure, abs=1e6)


async def test_a_frame_waits_for_the_status_that_holds_its_latch() -> None:
    async with linked() as bench:
        asked = asyncio.create_task(bench.link.latched_at(bench.frame(0)))
        await bench.gimbal.exchanged(1)
        bench.exposed(0)
        assert isinstance(await asked, AxisAngles)


async def test_a_frame_waits_two_cycles_and_no_longer() -> None:
    async with linked() as bench:
        done = len(bench.gimbal.commands)
        assert await bench.link.latched_at(bench.frame(0)) == NoAngle("its latch did not come within 2 bus cycles")
        assert len(bench.gimbal.commands) - done == LATCH_CYCLES


async def test_frames_whose_latches_never_come_make_both_be_numbered_anew() -> None:
    async with linked() as bench:
        epoch = bench.link.epoch
        for n in range(OUT_OF_STEP_FRAMES):
            assert bench.link.epoch == epoch
            await bench.link.latched_at(bench.frame(n))
        assert bench.link.epoch == epoch + 1


async def test_one_matched_frame_starts_that_count_again() -> None:
    async with linked() as bench:
        epoch = bench.link.epoch
        for n in range(1, OUT_OF_STEP_FRAMES):
            await bench.link.latched_at(bench.frame(n))
        frame = bench.exposed(OUT_OF_STEP_FRAMES)
        await bench.gimbal.exchanged(1)
        assert isinstance(await bench.link.latched_at(frame), AxisAngles)
        await bench.link.latched_at(bench.frame(OUT_OF_STEP_FRAMES + 1))
        assert bench.link.epoch == epoch


async def test_without_a_link_there_are_no_angles() -> None:
    bench = Bench()
    assert await bench.link.latched_at(bench.frame(0)) == NoAngle("no link to the controller")
    assert bench.link.stale() == "no link to the controller"
    assert bench.link.clock_fit is None


async def test_a_link_that_breaks_answers_the_frame_that_waits() -> None:
    async with linked() as bench:
        asked = asyncio.create_task(bench.link.latched_at(bench.frame(0)))
        await asyncio.sleep(0)
        bench.gimbal.error = LOST
        assert await asked == NoAngle("no link to the controller")
        with pytest.raises(DeviceTimeout):
            await bench.task


async def test_a_status_that_is_old_gives_no_angles() -> None:
    async with linked() as bench:
        bench.exposed(0)
        await bench.gimbal.exchanged(1)
        frame = bench.frame(0)
        bench.clock.advance(0.03)
        answer = await bench.link.latched_at(frame)
        assert isinstance(answer, NoAngle)
        assert "status is 30 ms old" in answer.reason
        assert bench.link.stale() == answer.reason


async def test_a_mount_without_latches_answers_with_its_live_angles() -> None:
    async with linked(replace(GIMBAL, steerable=False, clock=ClockKind.NONE, edges=0)) as bench:
        angles = await bench.link.latched_at(bench.frame(7))
        assert isinstance(angles, AxisAngles)
        assert (angles.instant, angles.source) == (None, "fixed")
        assert bench.link.arm() == "nothing to arm: this gimbal is not steered"


# ---- numbering anew --------------------------------------------------------------------------------------------------


async def test_zeroing_asks_until_the_controller_has_done_it_and_then_no_more() -> None:
    async with linked() as bench:
        bench.gimbal.zeroes, bench.gimbal.latch_total = False, 12_345
        zeroed = asyncio.create_task(bench.link.zero_latch())
        await bench.gimbal.exchanged(5)
        assert not zeroed.done()
        bench.gimbal.zeroes = True
        await zeroed
        assert bench.gimbal.latch_total == 0
        await bench.gimbal.exchanged(2)
        assert not bench.gimbal.commands[-1].latch_zero


async def test_a_counter_that_is_0_already_is_zeroed_nevertheless() -> None:
    async with linked() as bench:
        await bench.link.zero_latch()
        assert bench.gimbal.commands[-1].latch_zero


async def test_zeroing_right_after_the_link_came_up_is_done_too() -> None:
    bench = Bench()
    bench.gimbal.latch_total = 12_345
    bench.open()
    await asyncio.sleep(0)  # connected, and not yet one exchange
    await bench.link.zero_latch()
    assert bench.gimbal.latch_total == 0
    await bench.close()


async def test_a_controller_that_does_not_zero_is_a_device_error() -> None:
    async with linked() as bench:
        bench.gimbal.zeroes, bench.gimbal.latch_total = False, 12_345
        done = len(bench.gimbal.commands)
        with pytest.raises(DeviceTimeout, match=f"set the latch counter to zero: not done in {ZERO_CYCLES} cycles"):
            await bench.link.zero_latch()
        assert len(bench.gimbal.commands) - done == ZERO_CYCLES


async def test_zeroing_does_not_wait_for_a_link_that_is_not_there_or_breaks() -> None:
    bench = Bench()
    await bench.link.zero_latch()
    async with linked() as bench:
        bench.gimbal.zeroes, bench.gimbal.latch_total = False, 1
        zeroed = asyncio.create_task(bench.link.zero_latch())
        await bench.gimbal.exchanged(1)
        bench.gimbal.error = LOST
        await zeroed


async def test_every_link_is_an_epoch_and_so_is_a_restart_of_the_controller() -> None:
    async with linked() as bench:
        assert bench.link.epoch == 1
        bench.gimbal.restart()
        await bench.gimbal.exchanged(2)
        assert bench.link.epoch == 2
        bench.gimbal.error = LOST
        with pytest.raises(DeviceTimeout):
            await bench.task
        bench.gimbal.error = None
        bench.open()
        await bench.gimbal.exchanged(1)
        assert bench.link.epoch == 3


# ---- every way out ---------------------------------------------------------------------------------------------------


async def armed(bench: Bench) -> int:
    """The drives are on, as while following; how many commands were sent until now."""
    bench.gimbal.enabled = True
    await bench.gimbal.exchanged(2)
    return len(bench.gimbal.commands)


def assert_held(bench: Bench, since: int) -> None:
    farewell = bench.gimbal.commands[since:][-FAREWELL_CYCLES:]
    assert len(farewell) == FAREWELL_CYCLES
    assert {(c.mode, c.follow, c.enable) for c in farewell} == {(AxisMode.HOLD, False, True)}, "held, and not disabled"
    assert bench.link.snapshot().state is AxesState.OFFLINE


async def test_a_cancelled_link_tells_the_axes_to_hold_and_does_not_disable_them() -> None:
    async with linked() as bench:
        since = await armed(bench)
        await bench.close()
        assert_held(bench, since)


async def test_a_cancellation_that_the_bus_swallows_ends_the_link_too() -> None:
    async with linked() as bench:
        since = await armed(bench)
        bench.gimbal.swallow = True
        assert bench.task is not None
        await bench.close()
        assert bench.task.cancelled()
        assert_held(bench, since)


async def test_a_cancellation_that_comes_out_as_a_device_error_still_says_farewell(monkeypatch: pytest.MonkeyPatch) -> None:
    async with linked() as bench:
        since = await armed(bench)
        exchange = bench.gimbal.exchange

        async def translated(command):
            try:
                return await exchange(command)
            except asyncio.CancelledError:
                raise LOST from None

        monkeypatch.setattr(bench.gimbal, "exchange", translated)
        assert bench.task is not None
        bench.task.cancel()
        with pytest.raises((DeviceTimeout, asyncio.CancelledError)):
            await bench.task
        assert_held(bench, since)


async def test_a_defect_in_the_loop_says_farewell_and_is_not_hidden(monkeypatch: pytest.MonkeyPatch) -> None:
    async with linked() as bench:
        since = await armed(bench)

        def defect(_: object) -> None:
            raise ZeroDivisionError

        monkeypatch.setattr(Axes, "reported", defect)
        with pytest.raises(TypeError):
            await bench.task
        assert_held(bench, since)


async def test_a_controller_that_is_gone_is_not_waited_for_at_the_end() -> None:
    async with linked() as bench:
        await armed(bench)
        bench.gimbal.swallow, bench.gimbal.error = True, LOST
        await bench.close()
        assert bench.link.snapshot().state is AxesState.OFFLINE


async def test_a_broken_link_says_why_and_disarms() -> None:
    async with linked() as bench:
        bench.link.arm()
        bench.gimbal.error = LOST
        with pytest.raises(DeviceTimeout):
            await bench.task
        snapshot = bench.link.snapshot()
        assert (snapshot.state, snapshot.armed) == (AxesState.OFFLINE, False)
        assert "no reply in 0.05 s" in snapshot.reason
