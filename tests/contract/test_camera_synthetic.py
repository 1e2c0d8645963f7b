"""What is particular to the synthetic camera: the frame link to the twin, and every way in which it can break."""

import os
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
from emulators.framelink_server import EXPOSURE_NS, HEIGHT, WIDTH, FramelinkServer, offer

from drivers.camera import synthetic
from trackerd.contract.clock import ClockKind, HostNs, ManualClock
from trackerd.contract.errors import DeviceFault, DeviceMissing, DeviceTimeout


@pytest.fixture
async def twin(tmp_path: Path) -> AsyncIterator[FramelinkServer]:
    """Exposes when it is told to."""
    async with FramelinkServer(str(tmp_path / "twin"), paced=False) as server:
        yield server


@asynccontextmanager
async def opened(path: str, clock: ManualClock | None = None) -> AsyncIterator[synthetic.SyntheticCamera]:
    settings = synthetic.Settings(driver="synthetic", socket=path, timeout_s=0.5)
    async with synthetic.open_camera("left", settings, clock or ManualClock()) as camera:
        yield camera


async def test_the_offer_becomes_the_info(twin: FramelinkServer) -> None:
    async with opened(twin.path) as camera:
        info = camera.info
    assert (info.name, info.serial, info.clock) == ("left", "T1", ClockKind.DEVICE)
    assert (info.sensor_px, info.image_px, info.exposure_ns) == ((2048, 1536), (WIDTH, HEIGHT), EXPOSURE_NS)
    assert info.transfer_ns == 5_000_000


async def test_a_frame_brings_pixels_and_stamps_of_its_own_exposure(twin: FramelinkServer) -> None:
    clock = ManualClock(HostNs(5))
    async with opened(twin.path, clock) as camera:
        await camera.start()
        frames = camera.frames()
        for frame_id in range(20):
            clock.advance(0.001)
            twin.expose()
            frame = await anext(frames)
            assert (frame.frame_id, frame.mid_exposure) == (frame_id, 1_000_000 * frame_id + 77)
            assert (frame.arrived, frame.origin_px) == (clock.now(), (704, 528))
            assert (frame.image == frame_id).all()


async def test_of_many_doorbells_the_newest_counts(twin: FramelinkServer) -> None:
    async with opened(twin.path) as camera:
        await camera.start()
        for _ in range(6):
            twin.expose()
        frame = await anext(camera.frames())
        assert (frame.frame_id, frame.skipped, frame.dropped) == (5, 5, 0)


async def test_a_slot_that_was_overwritten_is_a_dropped_frame(twin: FramelinkServer) -> None:
    async with opened(twin.path) as camera:
        await camera.start()
        twin.expose(torn=True)
        twin.expose()
        frame = await anext(camera.frames())
        assert (frame.frame_id, frame.dropped) == (1, 1)


async def test_twelve_doorbells_behind_only_the_slots_that_still_hold_are_taken(twin: FramelinkServer) -> None:
    async with opened(twin.path) as camera:
        await camera.start()
        for _ in range(12):
            twin.expose()
        frame = await anext(camera.frames())
        assert (frame.frame_id, frame.skipped, frame.dropped) == (11, 7, 4)
        assert (frame.image == 11).all()


async def test_no_socket_told_is_a_missing_device() -> None:
    with pytest.raises(DeviceMissing, match="camera left: open: the twin has not told its socket"):
        async with opened(""):
            pytest.fail("it must not open")


async def test_nobody_at_the_socket_is_a_missing_device(tmp_path: Path) -> None:
    with pytest.raises(DeviceMissing, match=r"connect to the twin at .*nobody: .*No such file"):
        async with opened(str(tmp_path / "nobody")):
            pytest.fail("it must not open")


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"slots": 1000}, "map the twin's memory"),
        ({"slot_bytes": 100}, "map the twin's memory"),
        ({"bytes_per_pixel": 3}, "map the twin's memory"),
        ({"width": 0}, "map the twin's memory"),
        ({"colour": "green"}, "read the twin's offer"),
    ],
)
async def test_an_offer_that_does_not_fit_is_a_fault(twin: FramelinkServer, change: dict[str, Any], text: str) -> None:
    twin.offered = offer(**change)
    with pytest.raises(DeviceFault, match=text):
        async with opened(twin.path):
            pytest.fail("it must not open")


async def test_an_error_for_an_answer_is_a_fault_with_the_twins_words(twin: FramelinkServer) -> None:
    twin.refuse = "start"
    async with opened(twin.path) as camera:
        with pytest.raises(DeviceFault, match="camera left: start: the lens cap is on"):
            await camera.start()


async def test_being_sent_away_is_a_fault_with_the_twins_words(twin: FramelinkServer) -> None:
    twin.busy = True
    with pytest.raises(DeviceFault, match="camera left: open: camera left has a client already"):
        async with opened(twin.path):
            pytest.fail("it must not open")


async def test_no_answer_is_a_timeout_and_a_late_one_is_not_the_next_ones(
    twin: FramelinkServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(synthetic, "REPLY_S", 0.02)
    async with opened(twin.path) as camera:
        twin.silent = "stop"
        with pytest.raises(DeviceTimeout, match="camera left: stop: the twin did not answer"):
            await camera.stop()
        monkeypatch.setattr(synthetic, "REPLY_S", 2.0)
        twin.send(b'{"error": "late"}')
        await camera.start()


@pytest.mark.parametrize("changes", [{"slot": 8}, {"width": 63}])
async def test_a_doorbell_beyond_the_offer_is_a_fault(twin: FramelinkServer, changes: dict[str, int]) -> None:
    async with opened(twin.path) as camera:
        await camera.start()
        twin.expose(**changes)
        with pytest.raises(DeviceFault, match="not what the twin offered"):
            await anext(camera.frames())


@pytest.mark.parametrize("packet", [b"hello", b"[1]"])
async def test_a_foreign_packet_ends_the_link(twin: FramelinkServer, packet: bytes) -> None:
    async with opened(twin.path) as camera:
        await camera.start()
        twin.send(packet)
        with pytest.raises(DeviceMissing, match="it does not speak our language"):
            await anext(camera.frames())


async def test_a_twin_that_dies_is_missing_for_frames_and_requests(twin: FramelinkServer) -> None:
    async with opened(twin.path) as camera:
        await camera.start()
        twin.hang_up()
        with pytest.raises(DeviceMissing, match="the twin is gone"):
            await anext(camera.frames())
        with pytest.raises(DeviceMissing, match="the twin is gone"):
            await camera.start()


async def test_nothing_stays_open(twin: FramelinkServer) -> None:
    async def cycle() -> None:
        async with opened(twin.path) as camera:
            await camera.start()
            twin.expose()
            await anext(camera.frames())
        twin.hang_up()

    await cycle()
    before = os.listdir("/proc/self/fd")  # noqa: PTH208 - names of descriptors, not files
    for _ in range(3):
        await cycle()
    assert len(os.listdir("/proc/self/fd")) == len(before)  # noqa: PTH208
