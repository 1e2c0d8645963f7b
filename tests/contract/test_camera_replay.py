"""What is particular to the replay camera: folders, tables, pace, and the end."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from emulators.cameras import COMMON, tag, tagged_images, to_the_end
from emulators.framelink_server import HEIGHT, WIDTH

from drivers.camera import replay
from trackerd.contract.clock import ClockKind, SystemClock
from trackerd.contract.errors import ConfigError, DeviceFault, RecordingEnded
from trackerd.contract.model import Frame

FAST = {"frame_rate_hz": 500.0}


@asynccontextmanager
async def opened(folder: Path, **changes: Any) -> AsyncIterator[replay.ReplayCamera]:
    settings = replay.Settings(driver="replay", folder=folder, **(COMMON | changes))
    async with replay.open_camera("left", settings, SystemClock()) as camera:
        yield camera


async def play(camera: replay.ReplayCamera) -> list[tuple[Frame, int]]:
    """Frames with their tags, up to the end of the recording."""
    await camera.start()
    played = [(frame, tag(frame.image)) async for frame in to_the_end(camera)]
    with pytest.raises(RecordingEnded, match="frames were played"):
        await anext(camera.frames())
    return played


@pytest.mark.parametrize("suffix", [".bmp", ".tif", ".png", ".pgm"])
async def test_the_nth_image_by_name_is_frame_n_and_the_last_ends_the_run(tmp_path: Path, suffix: str) -> None:
    tagged_images(tmp_path, 12, suffix)
    (tmp_path / "frame_3.csv").write_text("no image")
    async with opened(tmp_path, **FAST) as camera:
        played = await play(camera)
        assert [frame.frame_id for frame, _ in played] == [shown for _, shown in played]
        assert played[-1][0].frame_id == 11
        counted = camera.statistics()
        assert counted.delivered + counted.skipped == 12


async def test_sixteen_bits_stay_sixteen_bits(tmp_path: Path) -> None:
    async with opened(tagged_images(tmp_path, 3, ".tif", np.uint16), **FAST) as camera:
        played = await play(camera)
    assert {frame.image.dtype.type for frame, _ in played} == {np.uint16}


async def test_a_table_gives_the_instants_and_without_one_the_rate_does(tmp_path: Path) -> None:
    images = tagged_images(tmp_path / "images", 3)
    csv = tmp_path / "left.csv"
    csv.write_text("frame,t_ns\n0,5000000\n1,9000001\n2,20000000\n")
    async with opened(images, csv=csv) as camera:
        assert camera.info.clock == ClockKind.RECORDING
        assert {f.frame_id: f.mid_exposure for f, _ in await play(camera)}.items() <= {
            0: 5_000_000,
            1: 9_000_001,
            2: 20_000_000,
        }.items()
    async with opened(images, frame_rate_hz=300.0) as camera:
        assert all(f.mid_exposure == round(f.frame_id * 1e9 / 300) for f, _ in await play(camera))


async def test_no_frame_comes_before_its_recorded_time(tmp_path: Path) -> None:
    async with opened(tagged_images(tmp_path, 10), frame_rate_hz=100.0) as camera:
        played = [frame for frame, _ in await play(camera)]
    first = played[0]
    assert first.mid_exposure == 0
    for frame in played:
        assert frame.mid_exposure is not None
        assert frame.arrived - first.arrived >= frame.mid_exposure


async def test_the_origin_of_the_region_is_told(tmp_path: Path) -> None:
    async with opened(tagged_images(tmp_path, 2), offset_x_px=704, offset_y_px=528, **FAST) as camera:
        assert camera.info.sensor_px == (704 + WIDTH, 528 + HEIGHT)
        assert {frame.origin_px for frame, _ in await play(camera)} == {(704, 528)}


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("n,t_ns\n0,1\n", "line 1: no column frame: needs frame,t_ns, has 'n,t_ns'"),
        ("", "line 1: no column frame, t_ns"),
        ("frame,t_ns\n0,1\n7,2\n", "line 3: frame = '7': unknown: the folder .* holds 3 images"),
        ("frame,t_ns\n0,1\n0,2\n", "line 3: frame = '0': must increase"),
        ("frame,t_ns\n0,5\n1,4\n2,6\n", "line 3: t_ns = '4': must increase"),
        ("frame,t_ns\n0,x\n", "line 2: t_ns = 'x': must be a whole number"),
        ("frame,t_ns\n0,1\n2,3\n", "no row for frame 1: the folder .* holds 3 images"),
    ],
)
async def test_a_bad_table_names_file_line_and_value(tmp_path: Path, text: str, error: str) -> None:
    images = tagged_images(tmp_path / "images", 3)
    csv = tmp_path / "left.csv"
    csv.write_text(text)
    with pytest.raises(ConfigError, match=rf"left\.csv.*{error}"):
        async with opened(images, csv=csv):
            pytest.fail("it must not open")


async def test_images_of_another_size_name_both_sizes(tmp_path: Path) -> None:
    tagged_images(tmp_path, 1)
    with pytest.raises(ConfigError, match=rf"width_px = 640, height_px = 480: .*frame_0\.bmp is {WIDTH} x {HEIGHT} px"):
        async with opened(tmp_path, width_px=640, height_px=480):
            pytest.fail("it must not open")


async def test_a_folder_without_images_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r'camera left: folder = ".*nowhere": there is no such folder'):
        async with opened(tmp_path / "nowhere"):
            pytest.fail("it must not open")
    (tmp_path / "notes.txt").write_text("no image")
    with pytest.raises(ConfigError, match="holds no image"):
        async with opened(tmp_path):
            pytest.fail("it must not open")


@pytest.mark.parametrize("broken", ["garbage", "size"])
async def test_a_broken_image_on_the_way_is_a_fault_that_names_it(tmp_path: Path, broken: str) -> None:
    tagged_images(tmp_path, 5)
    if broken == "garbage":
        (tmp_path / "frame_2.bmp").write_bytes(b"garbage")
    else:
        cv2.imwrite(str(tmp_path / "frame_2.bmp"), np.zeros((10, 10), np.uint8))
    async with opened(tmp_path, **FAST) as camera:
        await camera.start()
        with pytest.raises(DeviceFault, match=r"camera left: play the recording: .*frame_2\.bmp: "):
            assert [frame.frame_id async for frame in camera.frames()] == "no frame after the broken one"
