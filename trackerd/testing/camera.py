"""What every camera driver must do, as functions that a driver's own tests call; any test runner will do.

    @pytest.mark.parametrize("check", CAMERA_CHECKS, ids=lambda check: check.__name__)
    async def test_my_camera(check): await check(make_my_camera)

A maker is an async context manager that opens a camera, not yet started, which exposes at its own pace for at least EXPOSURES
frames without a gap of its own making. A check that needs a fault passes where the maker offers none.
"""

import asyncio
import threading
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import AbstractAsyncContextManager, suppress
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from trackerd.contract.errors import DeviceError
from trackerd.contract.model import Frame
from trackerd.contract.ports import Camera

EXPOSURES = 12
PATIENCE_S = 10.0  # for exposures that a driver does not count as skipped


@dataclass(frozen=True, slots=True)
class CameraBench:
    """A camera to be checked, and what can be done to it from outside."""

    camera: Camera
    kill: Callable[[], Awaitable[None]] | None = None  # the device dies under a running stream
    lose_exposures: Callable[[int], Awaitable[None]] | None = None  # so many exposures from now on never arrive


CameraMaker: TypeAlias = Callable[[], AbstractAsyncContextManager[CameraBench]]


async def check_stream_starts_at_frame_0(make: CameraMaker) -> None:
    async with make() as bench:
        await bench.camera.start()
        first = await anext(bench.camera.frames())
        assert first.frame_id - first.skipped - first.dropped == 0, f"frame 0 is not accounted for: {_ids(first)}"


async def check_restart_starts_at_frame_0_again(make: CameraMaker) -> None:
    async with make() as bench:
        for _ in range(3):
            await bench.camera.start()
            frames = bench.camera.frames()
            first, second = await anext(frames), await anext(frames)
            assert first.frame_id - first.skipped - first.dropped == 0, f"after a restart: {_ids(first)}"
            assert second.frame_id > first.frame_id
            await bench.camera.stop()


async def check_stop_is_harmless_when_stopped(make: CameraMaker) -> None:
    async with make() as bench:
        await bench.camera.stop()
        await bench.camera.start()
        await anext(bench.camera.frames())
        await bench.camera.stop()
        await bench.camera.stop()


async def check_frames_keep_order_and_count_gaps(make: CameraMaker) -> None:
    async with make() as bench:
        await bench.camera.start()
        previous = -1
        async for frame in _some(bench, EXPOSURES):
            assert frame.frame_id == previous + 1 + frame.skipped + frame.dropped, f"after {previous}: {_ids(frame)}"
            previous = frame.frame_id


async def check_lost_exposures_are_counted_as_dropped(make: CameraMaker) -> None:
    async with make() as bench:
        if bench.lose_exposures is None:
            return
        await bench.camera.start()
        frames = bench.camera.frames()
        await anext(frames)
        await bench.lose_exposures(2)
        dropped = 0
        for _ in range(EXPOSURES):
            dropped += (await anext(frames)).dropped
            if dropped:
                break
        assert dropped == 2, f"{dropped} exposures counted as dropped, 2 were lost"
        assert bench.camera.statistics().dropped == 2


async def check_image_stays_valid_until_the_frame_after_the_next(make: CameraMaker) -> None:
    async with make() as bench:
        await bench.camera.start()
        frames = bench.camera.frames()
        held = [await anext(frames), await anext(frames)]
        copies = [frame.image.copy() for frame in held]
        enough = bench.camera.statistics().skipped + EXPOSURES // 2
        async with asyncio.timeout(PATIENCE_S):
            while bench.camera.statistics().skipped < enough:  # noqa: ASYNC110 - no event tells what is not taken
                await asyncio.sleep(0)
        for frame, copy in zip(held, copies, strict=True):
            assert np.array_equal(frame.image, copy), f"the image of frame {frame.frame_id} changed while it was in use"


async def check_frames_are_what_info_says(make: CameraMaker) -> None:
    async with make() as bench:
        await bench.camera.start()
        info, frame = bench.camera.info, await anext(bench.camera.frames())
        assert frame.image.shape == (info.image_px[1], info.image_px[0])
        assert frame.image.dtype in (np.uint8, np.uint16)
        assert frame.exposure_ns == info.exposure_ns
        assert (frame.mid_exposure is None) == (info.clock == "none")
        assert all(size <= limit for size, limit in zip(info.image_px, info.sensor_px, strict=True))


async def check_instants_rise_from_frame_to_frame(make: CameraMaker) -> None:
    async with make() as bench:
        await bench.camera.start()
        previous: Frame | None = None
        async for frame in _some(bench, EXPOSURES):
            if previous is not None:
                assert frame.arrived >= previous.arrived
                if frame.mid_exposure is not None and previous.mid_exposure is not None:
                    assert frame.mid_exposure > previous.mid_exposure
            previous = frame


async def check_statistics_account_for_every_exposure(make: CameraMaker) -> None:
    async with make() as bench:
        await bench.camera.start()
        last = 0
        async for frame in _some(bench, EXPOSURES):
            last = frame.frame_id
        await bench.camera.stop()
        counted = bench.camera.statistics()
        total = counted.delivered + counted.skipped + counted.dropped
        assert last + 1 <= total, f"{last + 1} exposures, counted {counted}"


async def check_a_stopped_stream_dries_up_with_a_device_error(make: CameraMaker) -> None:
    async with make() as bench:
        await bench.camera.start()
        frames = bench.camera.frames()
        await anext(frames)
        await bench.camera.stop()
        await _expect_device_error(anext(frames))


async def check_closing_mid_stream_leaves_no_task_and_no_thread(make: CameraMaker) -> None:
    tasks, threads = asyncio.all_tasks(), set(threading.enumerate())
    async with make() as bench:
        await bench.camera.start()
        await anext(bench.camera.frames())
    left = [thread for thread in set(threading.enumerate()) - threads if thread.is_alive()]
    assert asyncio.all_tasks() <= tasks, f"tasks left: {asyncio.all_tasks() - tasks}"
    assert not left, f"threads left: {left}"


async def check_a_dead_device_raises_device_errors_only(make: CameraMaker) -> None:
    async with make() as bench:
        if bench.kill is None:
            return
        await bench.camera.start()
        frames = bench.camera.frames()
        await anext(frames)
        await bench.kill()
        await _expect_device_error(_drain(frames))
        for doing in (bench.camera.stop, bench.camera.start):
            with suppress(DeviceError):
                await doing()


async def _drain(frames: AsyncIterator[Frame]) -> None:
    async for _ in frames:
        pass


async def _expect_device_error(doing: Awaitable[object]) -> None:
    came: DeviceError | None = None
    try:
        await doing
    except DeviceError as err:
        came = err
    assert came is not None, "no DeviceError came"
    assert came.device and came.doing and came.answer, f"it does not say who, doing what, what came back: {came}"  # noqa: PT018


async def _some(bench: CameraBench, count: int) -> AsyncIterator[Frame]:
    """Frames until so many exposures have happened."""
    async for frame in bench.camera.frames():
        yield frame
        if frame.frame_id + 1 >= count:
            return


def _ids(frame: Frame) -> str:
    return f"frame {frame.frame_id}, {frame.skipped} skipped, {frame.dropped} dropped"


CAMERA_CHECKS: tuple[Callable[[CameraMaker], Awaitable[None]], ...] = (
    check_stream_starts_at_frame_0,
    check_restart_starts_at_frame_0_again,
    check_stop_is_harmless_when_stopped,
    check_frames_keep_order_and_count_gaps,
    check_lost_exposures_are_counted_as_dropped,
    check_image_stays_valid_until_the_frame_after_the_next,
    check_frames_are_what_info_says,
    check_instants_rise_from_frame_to_frame,
    check_statistics_account_for_every_exposure,
    check_a_stopped_stream_dries_up_with_a_device_error,
    check_closing_mid_stream_leaves_no_task_and_no_thread,
    check_a_dead_device_raises_device_errors_only,
)
