"""Every camera driver on its bench, ready for the contract suite; and the folders of tagged images that they play."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from emulators.framelink_server import EXPOSURE_NS, HEIGHT, PERIOD_S, WIDTH, FramelinkServer

from drivers.camera import basler, replay, synthetic
from trackerd.contract.clock import SystemClock
from trackerd.contract.errors import RecordingEnded
from trackerd.contract.model import Frame
from trackerd.contract.ports import Camera
from trackerd.testing.camera import CameraBench

COMMON: dict[str, Any] = {
    "exposure_us": EXPOSURE_NS / 1e3,
    "frame_rate_hz": 1 / PERIOD_S,
    "width_px": WIDTH,
    "height_px": HEIGHT,
    "timeout_s": 0.5,
}


def tagged_images(folder: Path, count: int, suffix: str = ".bmp", pixels: type = np.uint8) -> Path:
    """Frame n is n + 1 all over; the names carry no zeros in front."""
    folder.mkdir(exist_ok=True)
    for n in range(count):
        assert cv2.imwrite(str(folder / f"frame_{n}{suffix}"), np.full((HEIGHT, WIDTH), n + 1, pixels))
    return folder


def tag(image: np.ndarray[Any, Any]) -> int:
    """Which frame the pixels show; a mixture of two is an error."""
    assert image.min() == image.max()
    return int(image[0, 0]) - 1


async def to_the_end(camera: Camera) -> AsyncIterator[Frame]:
    """Frames until the recording is over."""
    with suppress(RecordingEnded):
        async for frame in camera.frames():
            yield frame


@asynccontextmanager
async def synthetic_bench(folder: Path) -> AsyncIterator[CameraBench]:
    async with FramelinkServer(str(folder / "twin")) as server:
        settings = synthetic.Settings(driver="synthetic", socket=server.path, **COMMON)

        async def kill() -> None:
            server.hang_up()

        async def lose(count: int) -> None:
            server.lose = count

        async with synthetic.open_camera("left", settings, SystemClock()) as camera:
            yield CameraBench(camera, kill, lose)


@asynccontextmanager
async def replay_bench(folder: Path) -> AsyncIterator[CameraBench]:
    images = tagged_images(folder / "images", 120)
    settings = replay.Settings(driver="replay", folder=images, **COMMON)

    async def kill() -> None:
        for image in images.iterdir():
            image.write_bytes(b"")

    async with replay.open_camera("left", settings, SystemClock()) as camera:
        yield CameraBench(camera, kill)


@asynccontextmanager
async def basler_bench(folder: Path) -> AsyncIterator[CameraBench]:
    images = tagged_images(folder / "images", 60)
    async with open_emulated(folder=images) as camera:

        async def kill() -> None:
            camera._handle.FirePnPCallback.Execute()

        async def lose(count: int) -> None:
            camera._handle.ForceFailedBufferCount.SetValue(count)
            camera._handle.ForceFailedBuffer.Execute()

        yield CameraBench(camera, kill, lose)


@asynccontextmanager
async def open_emulated(name: str = "left", serial: str = "0815-0000", **changes: Any) -> AsyncIterator[basler.BaslerCamera]:
    settings = basler.Settings(driver="basler", serial=serial, **(COMMON | changes))
    async with basler.open_camera(name, settings, SystemClock()) as camera:
        yield camera


BENCHES = {"synthetic": synthetic_bench, "replay": replay_bench, "basler": basler_bench}
