"""The newest-frame mailbox that every camera driver hands its frames through."""

import asyncio
from dataclasses import replace
from threading import Thread

import numpy as np
import pytest

from drivers.camera.mailbox import BUFFERS, Mailbox
from trackerd.contract.clock import HostNs
from trackerd.contract.errors import DeviceMissing, DeviceTimeout, RecordingEnded
from trackerd.contract.model import CameraStatistics, Frame


@pytest.fixture
async def mailbox() -> Mailbox:
    return Mailbox("camera left", (4, 3), np.uint8, timeout_s=0.5)


def deliver(mailbox: Mailbox, *frame_ids: int) -> None:
    """Frame n shows n all over."""
    for frame_id in frame_ids:
        mailbox.filling[:] = frame_id
        mailbox.deliver(Frame(mailbox.filling, frame_id, None, HostNs(0), 1))


def shows(frame: Frame, frame_id: int) -> bool:
    return bool((frame.image == frame_id).all())


async def test_each_frame_is_handed_out_once_and_in_order(mailbox: Mailbox) -> None:
    for frame_id in range(20):
        deliver(mailbox, frame_id)
        frame = await anext(mailbox)
        assert (frame.frame_id, frame.skipped, frame.dropped) == (frame_id, 0, 0)
        assert shows(frame, frame_id)


async def test_a_newer_frame_overwrites_an_older_one_and_counts_it(mailbox: Mailbox) -> None:
    deliver(mailbox, 0, 1, 2, 3)
    frame = await anext(mailbox)
    assert (frame.frame_id, frame.skipped, frame.dropped) == (3, 3, 0)
    assert mailbox.statistics() == CameraStatistics(delivered=1, skipped=3, dropped=0)


async def test_gaps_in_the_ids_are_dropped_frames_also_behind_an_overwritten_one(mailbox: Mailbox) -> None:
    deliver(mailbox, 2, 5, 6)
    frame = await anext(mailbox)
    assert (frame.frame_id, frame.skipped, frame.dropped) == (6, 2, 4)
    deliver(mailbox, 8)
    frame = await anext(mailbox)
    assert (frame.frame_id, frame.skipped, frame.dropped) == (8, 0, 1)
    assert mailbox.statistics() == CameraStatistics(delivered=2, skipped=2, dropped=5)


async def test_the_last_two_images_survive_any_number_of_newer_frames(mailbox: Mailbox) -> None:
    deliver(mailbox, 0)
    first = await anext(mailbox)
    deliver(mailbox, 1)
    second = await anext(mailbox)
    deliver(mailbox, *range(2, 2 + 5 * BUFFERS))
    assert shows(first, 0)
    assert shows(second, 1)


async def test_no_buffer_is_lost_and_none_is_added(mailbox: Mailbox) -> None:
    images = set()
    for frame_id in range(0, 100, 4):
        deliver(mailbox, *range(frame_id, frame_id + 4))
        images.add(id((await anext(mailbox)).image))
        if frame_id % 12 == 0:
            deliver(mailbox, frame_id + 3)
            mailbox.restart()
            deliver(mailbox, *range(frame_id + 4))
            await anext(mailbox)
    assert len(images) <= BUFFERS


async def test_a_thread_wakes_the_reader(mailbox: Mailbox) -> None:
    reader = asyncio.create_task(mailbox.__anext__())
    await asyncio.wait([reader], timeout=0.01)
    writer = Thread(target=deliver, args=(mailbox, 0))
    writer.start()
    assert (await reader).frame_id == 0
    writer.join()


async def test_a_stream_that_dries_up_is_a_timeout_that_tells_the_last_trouble() -> None:
    mailbox = Mailbox("camera left", (4, 3), np.uint8, timeout_s=0.02)
    with pytest.raises(DeviceTimeout, match=r"camera left: wait for a frame: none for 0\.02 s$"):
        await anext(mailbox)
    mailbox.trouble = "exposure 7: no buffer"
    with pytest.raises(DeviceTimeout, match=r"none for 0\.02 s \(last trouble: exposure 7: no buffer\)"):
        await anext(mailbox)
    deliver(mailbox, 0)
    assert (await anext(mailbox)).frame_id == 0


async def test_a_frame_that_waits_is_handed_out_before_the_end(mailbox: Mailbox) -> None:
    deliver(mailbox, 0)
    mailbox.finish(RecordingEnded("played"))
    mailbox.finish(DeviceMissing("camera left", "grab", "too late to matter"))
    assert (await anext(mailbox)).frame_id == 0
    for _ in range(2):
        with pytest.raises(RecordingEnded, match="played"):
            await anext(mailbox)


async def test_a_restart_forgets_frames_ids_and_the_end(mailbox: Mailbox) -> None:
    deliver(mailbox, 0, 1)
    mailbox.finish(RecordingEnded("played"))
    mailbox.restart()
    deliver(mailbox, 0)
    frame = await anext(mailbox)
    assert (frame.frame_id, frame.skipped, frame.dropped) == (0, 0, 0)


async def test_closing_ends_the_iteration_of_a_waiting_reader(mailbox: Mailbox) -> None:
    async def read() -> list[int]:
        return [frame.frame_id async for frame in mailbox]

    reader = asyncio.create_task(read())
    await asyncio.wait([reader], timeout=0.01)
    mailbox.close()
    assert await reader == []


async def test_what_the_writer_says_of_a_frame_arrives(mailbox: Mailbox) -> None:
    said = Frame(mailbox.filling, 0, None, HostNs(17), 1000, (704, 528))
    mailbox.deliver(said)
    assert replace(await anext(mailbox), image=said.image) == said
