"""What every gimbal driver must do, as functions that a driver's own tests call; any test runner will do.

    @pytest.mark.parametrize("check", GIMBAL_CHECKS, ids=lambda check: check.__name__)
    async def test_my_gimbal(check): await check(make_my_gimbal)

A maker is an async context manager that opens a gimbal. A check that needs a fault passes where the maker offers none.
"""

import asyncio
from collections.abc import Awaitable, Callable
from contextlib import AbstractAsyncContextManager
from dataclasses import dataclass
from math import isfinite, pi
from typing import TypeAlias

from trackerd.contract.errors import DeviceError
from trackerd.contract.model import AxisCommand, GimbalReport
from trackerd.contract.ports import Gimbal

MAX_DIFFERENCE_RAD = pi  # a latch is unwrapped near the live angles, so it is never further away than half a turn


@dataclass(frozen=True, slots=True)
class GimbalBench:
    """A gimbal to be checked, and what can be done to it from outside."""

    gimbal: Gimbal
    kill: Callable[[], Awaitable[None]] | None = None  # the controller dies
    expose: Callable[[int], Awaitable[None]] | None = None  # so many exposures are latched, at least two


GimbalMaker: TypeAlias = Callable[[], AbstractAsyncContextManager[GimbalBench]]


async def check_exchange_echoes_the_sequence(make: GimbalMaker) -> None:
    async with make() as bench:
        for sequence in (1, 2, 3, 65535, 1):
            report = await bench.gimbal.exchange(AxisCommand(sequence))
            assert report.echo == sequence


async def check_every_report_has_a_new_sequence(make: GimbalMaker) -> None:
    async with make() as bench:
        first = await bench.gimbal.exchange(AxisCommand(1))
        second = await bench.gimbal.exchange(AxisCommand(2))
        assert second.sequence != first.sequence
        assert second.instant >= first.instant


async def check_stamps_bracket_the_exchange(make: GimbalMaker) -> None:
    async with make() as bench:
        first = await bench.gimbal.exchange(AxisCommand(1))
        second = await bench.gimbal.exchange(AxisCommand(2))
        assert first.sent <= first.received <= second.sent <= second.received


async def check_angles_are_finite(make: GimbalMaker) -> None:
    async with make() as bench:
        report = await bench.gimbal.exchange(AxisCommand(1))
        assert isfinite(report.az_rad)
        assert isfinite(report.el_rad)
        assert bench.gimbal.info.az_limits_rad[0] <= bench.gimbal.info.az_limits_rad[1]
        assert bench.gimbal.info.el_limits_rad[0] <= bench.gimbal.info.el_limits_rad[1]


async def check_latches_are_newest_first(make: GimbalMaker) -> None:
    report = await _after_exposures(make)
    instants = [latch.instant for latch in report.latches]
    assert instants == sorted(instants, reverse=True), f"latched at {instants}"


async def check_latches_follow_the_edges_that_info_names(make: GimbalMaker) -> None:
    async with make() as bench:
        edges = bench.gimbal.info.edges
        report = await _exposed(bench)
        by_index: dict[int, list[bool]] = {}
        for latch in report.latches:
            assert latch.index >= 0
            by_index.setdefault(latch.index, []).append(latch.falling)
        if edges == 0:
            assert not report.latches
        elif edges == 1:
            assert all(falling == [False] for falling in by_index.values())
        else:
            whole = [falling for falling in by_index.values() if len(falling) == 2]
            assert all(falling == [True, False] for falling in whole), "an exposure rises before it falls"
            assert whole or not report.latches, "both edges of one exposure share an index"


async def check_latches_are_unwrapped_near_the_live_angles(make: GimbalMaker) -> None:
    async with make() as bench:
        report = await _exposed(bench)
        if bench.gimbal.info.edges < 2:
            return  # a recording carries all it has, wherever it went since
        for latch in report.latches:
            assert abs(latch.az_rad - report.az_rad) <= MAX_DIFFERENCE_RAD
            assert abs(latch.el_rad - report.el_rad) <= MAX_DIFFERENCE_RAD


async def check_a_dead_controller_raises_device_errors_only(make: GimbalMaker) -> None:
    async with make() as bench:
        if bench.kill is None:
            return
        await bench.gimbal.exchange(AxisCommand(1))
        await bench.kill()
        for sequence in (2, 3, 4, 5, 6, 7):
            await _expect_device_error(bench.gimbal.exchange(AxisCommand(sequence)))


async def check_closing_leaves_no_task(make: GimbalMaker) -> None:
    tasks = asyncio.all_tasks()
    async with make() as bench:
        await bench.gimbal.exchange(AxisCommand(1))
    assert asyncio.all_tasks() <= tasks, f"tasks left: {asyncio.all_tasks() - tasks}"


async def _after_exposures(make: GimbalMaker) -> GimbalReport:
    async with make() as bench:
        return await _exposed(bench)


async def _exposed(bench: GimbalBench) -> GimbalReport:
    report = await bench.gimbal.exchange(AxisCommand(1))
    if bench.expose is not None:
        await bench.expose(2)
        report = await bench.gimbal.exchange(AxisCommand(2))
        assert report.latches, "two exposures, and no latch"
    return report


async def _expect_device_error(doing: Awaitable[object]) -> None:
    came: DeviceError | None = None
    try:
        await doing
    except DeviceError as err:
        came = err
    assert came is not None, "no DeviceError came"
    assert came.device and came.doing and came.answer, f"it does not say who, doing what, what came back: {came}"  # noqa: PT018


GIMBAL_CHECKS: tuple[Callable[[GimbalMaker], Awaitable[None]], ...] = (
    check_exchange_echoes_the_sequence,
    check_every_report_has_a_new_sequence,
    check_stamps_bracket_the_exchange,
    check_angles_are_finite,
    check_latches_are_newest_first,
    check_latches_follow_the_edges_that_info_names,
    check_latches_are_unwrapped_near_the_live_angles,
    check_a_dead_controller_raises_device_errors_only,
    check_closing_leaves_no_task,
)
