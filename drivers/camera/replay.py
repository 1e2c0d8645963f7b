"""A recorded camera: a folder of images in the order of their names, the n-th being frame n.

One thread decodes a frame ahead of its time and delivers it once as much time has passed as was recorded since the first.
"""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from threading import Event

import numpy as np

from drivers.camera.folder import image_files
from drivers.camera.mailbox import Mailbox
from drivers.camera.threads import run_in_thread
from drivers.table import read_rows
from trackerd.contract.clock import CameraNs, Clock, ClockKind
from trackerd.contract.errors import ConfigError, DeviceFault, RecordingEnded
from trackerd.contract.model import CameraInfo, CameraStatistics, Frame, Image, Source
from trackerd.formats.settings import CameraSettings

SUFFIXES = frozenset({".bmp", ".tif", ".tiff", ".png", ".pgm"})


class Settings(CameraSettings):
    folder: Path  # BMP, TIFF, PNG or PGM files, 8 or 16 bits, all of width_px x height_px
    csv: Path | None = None  # columns frame,t_ns: the recorded mid-exposure; default: n / frame_rate_hz

    @property
    def source(self) -> Source:
        return Source.REPLAY


@asynccontextmanager
async def open_camera(name: str, settings: Settings, clock: Clock) -> AsyncIterator["ReplayCamera"]:
    """Raises ConfigError where folder, images or table are not a recording."""
    device = f"camera {name}"
    files = image_files(device, settings.folder, SUFFIXES)
    instants_ns = _instants(settings, len(files))
    first = await run_in_thread(lambda: decode(files[0]), f"{device} decode")
    _check_region(device, files[0], first, settings)
    camera = ReplayCamera(name, files, instants_ns, pixels=first.dtype.type, settings=settings, clock=clock)
    try:
        yield camera
    finally:
        await camera.stop()
        camera.close()


class ReplayCamera:
    """Plays once from frame 0 at every start."""

    def __init__(
        self,
        name: str,
        files: list[Path],
        instants_ns: list[int],
        *,
        pixels: type[np.uint8 | np.uint16],
        settings: Settings,
        clock: Clock,
    ) -> None:
        size = settings.width_px, settings.height_px
        self._exposure_ns = round(settings.exposure_us * 1e3)
        self._origin = settings.offset_x_px, settings.offset_y_px
        sensor = size[0] + self._origin[0], size[1] + self._origin[1]
        rate = settings.frame_rate_hz
        self.info = CameraInfo(name, "replay", "", sensor, size, rate, self._exposure_ns, ClockKind.RECORDING)
        self._device, self._files, self._instants_ns, self._clock = f"camera {name}", files, instants_ns, clock
        self._mailbox = Mailbox(self._device, size, pixels, settings.timeout_s)
        self._stopping = Event()
        self._player: asyncio.Future[None] | None = None

    async def start(self) -> None:
        await self.stop()
        self._stopping = Event()
        self._player = run_in_thread(self._play, f"{self._device} replay")

    async def stop(self) -> None:
        if self._player is not None:
            self._stopping.set()
            await self._player
            self._player = None
        self._mailbox.restart()

    def frames(self) -> AsyncIterator[Frame]:
        return self._mailbox

    def statistics(self) -> CameraStatistics:
        return self._mailbox.statistics()

    def close(self) -> None:
        self._mailbox.close()

    def _play(self) -> None:
        try:
            if self._reach_the_end():
                self._mailbox.finish(RecordingEnded(f"{self._device}: all {len(self._files)} frames were played"))
        except ConfigError as err:
            self._mailbox.finish(DeviceFault(self._device, "play the recording", str(err)))

    def _reach_the_end(self) -> bool:
        """False: stopped on the way."""
        began = self._clock.now()
        for frame_id, (file, instant_ns) in enumerate(zip(self._files, self._instants_ns, strict=True)):
            self._load(file)
            if frame_id == 0:
                began = self._clock.now()
            due_ns = began + instant_ns - self._instants_ns[0]
            if self._stopping.wait(max(0, due_ns - self._clock.now()) / 1e9):
                return False
            image, instant, arrived = self._mailbox.filling, CameraNs(instant_ns), self._clock.now()
            self._mailbox.deliver(Frame(image, frame_id, instant, arrived, self._exposure_ns, self._origin))
        return True

    def _load(self, file: Path) -> None:
        image, filling = decode(file), self._mailbox.filling
        if (image.shape, image.dtype) != (filling.shape, filling.dtype):
            raise ConfigError(f"{file}: {_size(image)}, the first image was {_size(filling)}")
        np.copyto(filling, image)


def decode(file: Path) -> Image:
    """A grey image of 8 or 16 bits. Raises ConfigError."""
    import cv2  # noqa: PLC0415 - a cell without recordings starts without it

    try:
        image = cv2.imread(str(file), cv2.IMREAD_ANYDEPTH)
    except cv2.error as err:
        raise ConfigError(f"{file}: {err}") from err
    if image is None or image.dtype.type not in (np.uint8, np.uint16):
        raise ConfigError(f"{file}: not an image of 8 or 16 bits")
    return image


def _instants(settings: Settings, count: int) -> list[int]:
    """Recorded mid-exposure of every frame, ns, rising. Raises ConfigError."""
    if settings.csv is None:
        return [round(n * 1e9 / settings.frame_rate_hz) for n in range(count)]
    instants: dict[int, int] = {}
    last_frame = last_ns = -1
    for row in read_rows(settings.csv, ("frame", "t_ns")):
        frame, instant_ns = row.whole("frame"), row.whole("t_ns")
        if frame >= count:
            raise row.error("frame", f"unknown: the folder {settings.folder} holds {count} images")
        if frame <= last_frame:
            raise row.error("frame", "must increase from row to row")
        if instant_ns <= last_ns:
            raise row.error("t_ns", "must increase from row to row")
        instants[frame] = last_ns = instant_ns
        last_frame = frame
    absent = next((n for n in range(count) if n not in instants), None)
    if absent is not None:
        raise ConfigError(f"{settings.csv}: no row for frame {absent}: the folder {settings.folder} holds {count} images")
    return list(instants.values())


def _check_region(device: str, file: Path, image: Image, settings: Settings) -> None:
    if image.shape != (settings.height_px, settings.width_px):
        wanted = f"width_px = {settings.width_px}, height_px = {settings.height_px}"
        raise ConfigError(f"{device}: {wanted}: {file} is {_size(image)}")


def _size(image: Image) -> str:
    return f"{image.shape[1]} x {image.shape[0]} px of {image.dtype.name}"
