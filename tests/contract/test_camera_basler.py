"""What is particular to the basler driver, on pylon's own emulated cameras."""

import asyncio
import sys
from pathlib import Path
from threading import Event
from typing import Any

import cv2
import numpy as np
import pytest
from emulators.cameras import COMMON, open_emulated, tag, tagged_images, to_the_end
from emulators.framelink_server import HEIGHT, WIDTH
from pydantic import ValidationError

from drivers.camera import basler
from trackerd.contract.clock import ClockKind
from trackerd.contract.errors import ConfigError, DeviceFault, DeviceMissing, DeviceTimeout, RecordingEnded
from trackerd.contract.ports import Camera


async def tags(camera: Camera) -> list[tuple[int, int]]:
    """(frame id, tag in the pixels) up to the end of the folder."""
    await camera.start()
    played = [(frame.frame_id, tag(frame.image)) async for frame in to_the_end(camera)]
    with pytest.raises(RecordingEnded, match="images were played"):
        await anext(camera.frames())
    return played


@pytest.mark.parametrize("suffix", [".bmp", ".tif"])
async def test_a_folder_plays_in_the_order_of_its_names_and_ends(tmp_path: Path, suffix: str) -> None:
    tagged_images(tmp_path, 12, suffix)
    (tmp_path / "angles.csv").write_text("pylon alone would take this for a frame")
    async with open_emulated(folder=tmp_path) as camera:
        played = await tags(camera)
        assert all(frame_id == shown for frame_id, shown in played)
        assert played[-1][0] == 11
        counted = camera.statistics()
        assert counted.delivered + counted.skipped == 12
        assert counted.dropped == 0


async def test_two_cameras_play_their_own_folders_at_once(tmp_path: Path) -> None:
    left, right = tagged_images(tmp_path / "left", 12), tagged_images(tmp_path / "right", 17)
    async with (
        open_emulated("left", "0815-0000", folder=left) as one,
        open_emulated("right", "0815-0001", folder=right) as two,
    ):
        assert (one.info.serial, two.info.serial) == ("0815-0000", "0815-0001")
        played = await asyncio.gather(tags(one), tags(two))
    assert [frames[-1] for frames in played] == [(11, 11), (16, 16)]
    assert all(frame_id == shown for frames in played for frame_id, shown in frames)


async def test_a_restart_plays_the_folder_from_the_beginning(tmp_path: Path) -> None:
    async with open_emulated(folder=tagged_images(tmp_path, 5)) as camera:
        assert [(await tags(camera))[-1] for _ in range(2)] == [(4, 4), (4, 4)]


async def test_an_emulated_camera_says_that_it_has_no_clock(tmp_path: Path) -> None:
    async with open_emulated(folder=tagged_images(tmp_path, 5), offset_x_px=704, offset_y_px=528) as camera:
        info = camera.info
        assert (info.clock, info.image_px, info.exposure_ns) == (ClockKind.NONE, (WIDTH, HEIGHT), 1_000_000)
        await camera.start()
        frame = await anext(camera.frames())
        assert (frame.mid_exposure, frame.origin_px) == (None, (704, 528))


async def test_a_region_is_set_in_the_camera() -> None:
    async with open_emulated(offset_x_px=40, offset_y_px=20) as camera:
        await camera.start()
        frame = await anext(camera.frames())
        assert frame.image.shape == (HEIGHT, WIDTH)
        assert (camera._handle.OffsetX.GetValue(), camera._handle.OffsetY.GetValue()) == (40, 20)


async def test_a_trigger_line_replaces_the_cameras_own_pace() -> None:
    async with open_emulated(trigger="line1", timeout_s=0.05) as camera:
        assert camera._handle.TriggerMode.GetValue() == "On"
        assert camera._handle.TriggerSource.GetValue() == "Line1"
        await camera.start()
        with pytest.raises(DeviceTimeout, match="camera left: wait for a frame"):
            await anext(camera.frames())


async def test_an_unknown_serial_names_what_is_connected() -> None:
    with pytest.raises(DeviceMissing, match="camera left: find camera 0815-9999: connected: 0815-0000, 0815-0001"):
        async with open_emulated(serial="0815-9999"):
            pytest.fail("it must not open")


async def test_several_cameras_and_no_serial_is_an_error_that_lists_them() -> None:
    async with open_emulated():
        with pytest.raises(ConfigError, match=r'serial = "": several cameras .* name one: 0815-0000, 0815-0001'):
            async with open_emulated(serial=""):
                pytest.fail("it must not open")


@pytest.mark.parametrize(
    ("changes", "error"),
    [
        ({"width_px": 5000}, "width_px = 5000: the camera takes 1 to 4096 in steps of 1"),
        ({"offset_x_px": 4090}, f"offset_x_px = 4090: the camera takes 0 to {4096 - WIDTH}"),
        ({"exposure_us": 0.5}, r"exposure_us = 0\.5: the camera takes 1\.0 to"),
        ({"trigger": "line4"}, r"trigger = Line4: the camera does not take it \(TriggerSource\)"),
    ],
)
async def test_what_the_camera_cannot_do_names_key_value_and_range(changes: dict[str, Any], error: str) -> None:
    with pytest.raises(ConfigError, match=f"camera left: {error}"):
        async with open_emulated(**changes):
            pytest.fail("it must not open")


def test_an_exposure_longer_than_the_period_is_refused() -> None:
    with pytest.raises(ValidationError, match="longer than the frame period"):
        basler.Settings(driver="basler", **(COMMON | {"exposure_us": 20_000.0, "frame_rate_hz": 55.0}))


async def test_images_of_another_size_are_a_fault(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "small.bmp"), np.zeros((10, 20), np.uint8))
    async with open_emulated(folder=tmp_path) as camera:
        await camera.start()
        with pytest.raises(DeviceFault, match=f"20 x 10 px instead of {WIDTH} x {HEIGHT} px"):
            await anext(camera.frames())


async def test_a_stream_of_failed_grabs_tells_pylons_reason(tmp_path: Path) -> None:
    for n in range(50):
        (tmp_path / f"{n}.bmp").write_bytes(b"garbage")
    async with open_emulated(folder=tmp_path, timeout_s=0.1) as camera:
        await camera.start()
        with pytest.raises(DeviceTimeout, match=r"last trouble: exposure \d+: Failed to load image file"):
            await anext(camera.frames())


async def test_a_camera_that_is_pulled_out_is_missing_and_can_be_opened_again(tmp_path: Path) -> None:
    tagged_images(tmp_path, 50)
    async with open_emulated(folder=tmp_path) as camera:
        await camera.start()
        await anext(camera.frames())
        camera._handle.FirePnPCallback.Execute()
        with pytest.raises(DeviceMissing, match="camera left: grab: the camera was removed"):
            async for _ in camera.frames():
                pass
    async with open_emulated(folder=tmp_path) as camera:
        await camera.start()
        assert (await anext(camera.frames())).frame_id >= 0


async def test_a_call_that_hangs_inside_pylon_is_left_behind(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(basler, "CLOSE_S", 0.05)
    released = Event()
    async with open_emulated() as camera:
        sdk = camera._sdk
        with pytest.raises(DeviceTimeout, match="camera left: hang: pylon did not return"):
            await sdk.run("hang", basler.CLOSE_S, released.wait)
        released.set()


async def test_a_missing_sdk_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pypylon", None)
    with pytest.raises(DeviceMissing, match=r"pip install 'trackerd\[basler\]'"):
        async with open_emulated():
            pytest.fail("it must not open")


async def test_pgm_is_refused_before_pylon_does(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="holds no image"):
        async with open_emulated(folder=tagged_images(tmp_path, 2, ".pgm")):
            pytest.fail("it must not open")
