"""Basler cameras through pypylon, real ones and pylon's own emulated ones alike.

Each camera has a grab thread of its own, which copies every image into the mailbox's buffers and releases pylon's at once.
Emulated cameras (serials 0815-0000, 0815-0001, ...) exist where PYLON_CAMEMU was set before pylon was first used;
opening one sets it.
"""

import asyncio
import os
import warnings
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager, contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Event
from typing import Any, Literal, TypeVar

import numpy as np

from drivers.camera.folder import image_files
from drivers.camera.mailbox import Mailbox
from drivers.camera.threads import run_in_thread
from trackerd.contract.clock import CameraNs, Clock, ClockKind
from trackerd.contract.errors import ConfigError, DeviceFault, DeviceMissing, DeviceTimeout, RecordingEnded
from trackerd.contract.model import CameraInfo, CameraStatistics, Frame, Source
from trackerd.formats.settings import CameraSettings

T = TypeVar("T")

EMULATED = "0815-"  # serials of pylon's emulated cameras begin like this
EMULATED_CAMERAS = "8"  # as many as pylon is asked for; each costs nothing until it is opened
EMULATION_CLASS = "BaslerCamEmu"
EMULATION_SUFFIXES = frozenset({".bmp", ".tif", ".tiff", ".png"})  # pylon refuses PGM, and PNG is slow
SDK_BUFFERS = 10  # bridges a grab thread that was not scheduled for 10 frames
POLL_MS = 100  # how soon the grab thread sees that it shall stop, where no frame comes
OPEN_S, CLOSE_S = 10.0, 3.0  # a call that takes longer hangs: it is left behind in its thread


class Settings(CameraSettings):
    serial: str = ""  # as printed on the camera; empty: the only one that is connected; 0815-0000... are emulated by pylon
    trigger: Literal["free", "line1", "line2", "line3", "line4"] = "free"  # free: exposes at frame_rate_hz by itself
    folder: Path | None = None  # emulation only: BMP or TIFF files played once, in the order of their names

    @property
    def source(self) -> Source:
        return Source.LIVE if self.folder is None else Source.REPLAY


@asynccontextmanager
async def open_camera(name: str, settings: Settings, clock: Clock) -> AsyncIterator["BaslerCamera"]:
    """Raises DeviceMissing without SDK or camera, ConfigError where the camera cannot do what the settings ask for."""
    device = f"camera {name}"
    if settings.serial.startswith(EMULATED):
        os.environ.setdefault("PYLON_CAMEMU", EMULATED_CAMERAS)
    sdk = _load(device)
    with _playlist(device, settings.folder) as (folder, count):
        handle = await sdk.run("open", OPEN_S, lambda: _connect(sdk, settings.serial))
        try:
            info = await sdk.run("configure", OPEN_S, lambda: _configure(name, sdk, handle, settings, folder))
            camera = BaslerCamera(sdk, handle, info, settings=settings, images=count, clock=clock)
            try:
                yield camera
            finally:
                await camera.close()
        finally:
            with suppress(DeviceTimeout, DeviceMissing, DeviceFault):  # it may be gone; there is nothing left to lose
                await sdk.run("close", CLOSE_S, handle.DestroyDevice)


class Sdk:
    """pypylon's modules, with its calls moved off the event loop and its exceptions turned into ours."""

    def __init__(self, device: str, pylon: Any, error: type[Exception]) -> None:
        self.device, self.pylon, self._error = device, pylon, error

    async def run(self, doing: str, deadline_s: float, work: Callable[[], T]) -> T:
        try:
            async with asyncio.timeout(deadline_s):
                return await run_in_thread(lambda: self._translated(doing, work), f"{self.device} {doing}")
        except TimeoutError:
            raise DeviceTimeout(self.device, doing, f"pylon did not return within {deadline_s:g} s") from None

    def _translated(self, doing: str, work: Callable[[], T]) -> T:
        try:
            return work()
        except self._error as err:
            raise DeviceMissing(self.device, doing, _first_line(err)) from err


class BaslerCamera:
    """One camera, open and configured."""

    def __init__(
        self, sdk: Sdk, handle: Any, info: CameraInfo, *, settings: Settings, images: int | None, clock: Clock
    ) -> None:
        self.info = info
        self._sdk, self._handle, self._images, self._clock = sdk, handle, images, clock
        self._origin = settings.offset_x_px, settings.offset_y_px
        self._mailbox = Mailbox(sdk.device, info.image_px, np.uint8, settings.timeout_s)
        self._stopping = Event()
        self._grabbing: asyncio.Future[None] | None = None

    async def start(self) -> None:
        await self.stop()
        self._stopping = Event()
        one_by_one = self._sdk.pylon.GrabStrategy_OneByOne
        await self._sdk.run("start the stream", OPEN_S, lambda: self._handle.StartGrabbing(one_by_one))
        self._grabbing = run_in_thread(self._grab, f"{self._sdk.device} grab")

    async def stop(self) -> None:
        self._stopping.set()
        grabbing, self._grabbing = self._grabbing, None
        if grabbing is not None:
            try:
                await self._sdk.run("stop the stream", CLOSE_S, self._handle.StopGrabbing)
            finally:
                await _ended(self._sdk.device, grabbing)
        self._mailbox.restart()

    def frames(self) -> AsyncIterator[Frame]:
        return self._mailbox

    def statistics(self) -> CameraStatistics:
        return self._mailbox.statistics()

    async def close(self) -> None:
        with suppress(DeviceTimeout, DeviceMissing):  # a camera that was pulled out cannot be stopped, and need not be
            await self.stop()
        self._mailbox.close()

    def _grab(self) -> None:
        """The grab thread. It waits inside pylon, without the interpreter's lock."""
        try:
            while not self._stopping.is_set() and self._handle.IsGrabbing():
                self._take(self._handle.RetrieveResult(POLL_MS, self._sdk.pylon.TimeoutHandling_Return))
                if self._handle.IsCameraDeviceRemoved():
                    self._mailbox.finish(DeviceMissing(self._sdk.device, "grab", "the camera was removed"))
                    return
        except Exception as err:  # whatever pylon throws from its depths, the stream is over
            if not self._stopping.is_set():
                self._mailbox.finish(DeviceMissing(self._sdk.device, "grab", _first_line(err)))

    def _take(self, result: Any) -> None:
        if not result.IsValid():
            return
        try:
            if self._images is not None and result.BlockID >= self._images:
                self._stopping.set()
                self._mailbox.finish(RecordingEnded(f"{self._sdk.device}: all {self._images} images were played"))
            elif not result.GrabSucceeded():  # its id is missing from then on, and so it is counted
                self._mailbox.trouble = f"exposure {result.BlockID}: {result.ErrorDescription}"
            else:
                self._copy(result)
        finally:
            result.Release()

    def _copy(self, result: Any) -> None:
        if (result.Width, result.Height) != self.info.image_px:
            size, asked = f"{result.Width} x {result.Height} px", "{} x {} px".format(*self.info.image_px)
            self._mailbox.finish(DeviceFault(self._sdk.device, "take a frame", f"{size} instead of {asked}"))
            return
        image = self._mailbox.filling
        with result.GetArrayZeroCopy() as pixels:
            np.copyto(image, pixels)
        exposure_ns = self.info.exposure_ns
        # The stamp is taken where the exposure starts, in ns (ace USB manual AW00123409, 7.23.3.4).
        middle = CameraNs(result.TimeStamp + exposure_ns // 2) if result.TimeStamp else None
        self._mailbox.deliver(Frame(image, result.BlockID, middle, self._clock.now(), exposure_ns, self._origin))


def _load(device: str) -> Sdk:
    """A cell without Basler cameras starts without pypylon, so it is imported where it is needed."""
    try:
        with warnings.catch_warnings():  # SWIG's deprecation warnings: pypylon crashes where they are made errors
            warnings.simplefilter("ignore", DeprecationWarning)
            from pypylon import genicam, pylon  # noqa: PLC0415
    except ImportError as err:
        raise DeviceMissing(device, "load pypylon", f"{err}: pip install 'trackerd[basler]'") from err
    return Sdk(device, pylon, genicam.GenericException)


def _connect(sdk: Sdk, serial: str) -> Any:
    """The camera, open. Two with the same right to be meant are an error: a station must know its camera."""
    factory = sdk.pylon.TlFactory.GetInstance()
    found = {device.GetSerialNumber(): device for device in factory.EnumerateDevices()}
    there = ", ".join(sorted(found)) or "none"
    if not serial and len(found) > 1:
        raise ConfigError(f'{sdk.device}: serial = "": several cameras are connected, name one: {there}')
    chosen = found.get(serial) if serial else next(iter(found.values()), None)
    if chosen is None:
        raise DeviceMissing(sdk.device, f"find camera {serial or 'without a serial'}", f"connected: {there}")
    handle = sdk.pylon.InstantCamera(factory.CreateDevice(chosen))
    handle.Open()
    return handle


def _configure(name: str, sdk: Sdk, handle: Any, settings: Settings, folder: str | None) -> CameraInfo:
    """Every setting, in the order in which a camera accepts them; then what it made of them."""
    emulated = handle.GetDeviceInfo().GetDeviceClass() == EMULATION_CLASS
    if folder is not None and not emulated:
        raise ConfigError(f'{sdk.device}: folder = "{settings.folder}": only emulated cameras ({EMULATED}...) play a folder')
    _set_region(sdk, handle, settings, played=folder is not None)
    _set(sdk, handle, "PixelFormat", "Mono8")
    _set_trigger(sdk, handle, settings)
    exposure = _first(handle, "ExposureTime", "ExposureTimeAbs")
    _set(sdk, handle, exposure, settings.exposure_us, "exposure_us")
    _set(sdk, handle, "MaxNumBuffer", SDK_BUFFERS)
    if folder is not None:
        for feature, value in (("TestImageSelector", "Off"), ("ImageFilename", folder), ("ImageFileMode", "On")):
            _set(sdk, handle, feature, value)
    rate = handle.ResultingFrameRate
    return CameraInfo(
        name=name,
        model=handle.GetDeviceInfo().GetModelName(),
        serial=handle.GetDeviceInfo().GetSerialNumber(),
        sensor_px=(handle.SensorWidth.GetValue(), handle.SensorHeight.GetValue()),
        image_px=(settings.width_px, settings.height_px),
        frame_rate_hz=rate.GetValue() if rate.IsReadable() else settings.frame_rate_hz,
        exposure_ns=round(getattr(handle, exposure).GetValue() * 1e3),
        clock=ClockKind.NONE if emulated else ClockKind.DEVICE,
        transfer_ns=round(settings.transfer_us * 1e3),
    )


def _set_region(sdk: Sdk, handle: Any, settings: Settings, played: bool) -> None:
    """Offsets last: they bound the size. Recorded images are the region already."""
    _set(sdk, handle, "OffsetX", 0)
    _set(sdk, handle, "OffsetY", 0)
    _set(sdk, handle, "Width", settings.width_px, "width_px")
    _set(sdk, handle, "Height", settings.height_px, "height_px")
    if not played:
        _set(sdk, handle, "OffsetX", settings.offset_x_px, "offset_x_px")
        _set(sdk, handle, "OffsetY", settings.offset_y_px, "offset_y_px")


def _set_trigger(sdk: Sdk, handle: Any, settings: Settings) -> None:
    _set(sdk, handle, "TriggerSelector", "FrameStart")
    if settings.trigger == "free":
        _set(sdk, handle, "TriggerMode", "Off")
        _set(sdk, handle, "AcquisitionFrameRateEnable", True)
        rate = _first(handle, "AcquisitionFrameRate", "AcquisitionFrameRateAbs")
        _set(sdk, handle, rate, settings.frame_rate_hz, "frame_rate_hz")
        return
    handle.AcquisitionFrameRateEnable.TrySetValue(False)  # the line alone sets the pace; not every model has the limit
    _set(sdk, handle, "TriggerSource", settings.trigger.capitalize(), "trigger")
    _set(sdk, handle, "TriggerActivation", "RisingEdge")
    _set(sdk, handle, "TriggerMode", "On")


def _set(sdk: Sdk, handle: Any, feature: str, value: Any, key: str = "") -> None:
    """Raises ConfigError where the value of a key of ours is out of the camera's range, else DeviceFault."""
    parameter = getattr(handle, feature)
    asked = f"{key} = {value}"
    if key and isinstance(value, int | float) and parameter.IsReadable():
        low, high = parameter.GetMin(), parameter.GetMax()
        step = parameter.GetInc() if isinstance(value, int) else None
        if not low <= value <= high or (step and (value - low) % step):
            raise ConfigError(
                f"{sdk.device}: {asked}: the camera takes {low} to {high}" + (f" in steps of {step}" if step else "")
            )
    if not parameter.TrySetValue(value):
        if key:
            raise ConfigError(f"{sdk.device}: {asked}: the camera does not take it ({feature})")
        raise DeviceFault(sdk.device, f"set {feature} = {value}", "the camera does not take it")


def _first(handle: Any, *features: str) -> str:
    """The name that this model gives the feature."""
    return next((name for name in features if getattr(handle, name).IsReadable()), features[0])


@contextmanager
def _playlist(device: str, folder: Path | None) -> Iterator[tuple[str | None, int | None]]:
    """A folder of links for pylon, which would play every file it finds and put 10 before 2; and the number of images."""
    if folder is None:
        yield None, None
        return
    files = image_files(device, folder, EMULATION_SUFFIXES)
    with TemporaryDirectory(prefix="trackerd-") as links:
        for n, file in enumerate(files):
            (Path(links) / f"{n:08d}{file.suffix}").symlink_to(file.resolve())
        yield links, len(files)


async def _ended(device: str, grabbing: "asyncio.Future[None]") -> None:
    try:
        async with asyncio.timeout(CLOSE_S):
            await grabbing
    except TimeoutError:
        raise DeviceTimeout(device, "stop the stream", "the grab thread hangs inside pylon") from None


def _first_line(err: Exception) -> str:
    return str(err).strip().splitlines()[0] if str(err).strip() else type(err).__name__
