"""The twin's camera: frames arrive through shared memory with a doorbell (`trackerd.formats.framelink`)."""

import asyncio
import mmap
import os
import socket
import sys
from collections import deque
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import Any

import numpy as np

from drivers.camera.mailbox import Mailbox
from trackerd.contract.clock import CameraNs, Clock, ClockKind
from trackerd.contract.errors import DeviceError, DeviceFault, DeviceMissing, DeviceTimeout
from trackerd.contract.model import CameraInfo, CameraStatistics, Frame, Source
from trackerd.formats.framelink import SLOT_HEADER, Doorbell, Offer, pack_message, unpack_doorbell, unpack_message
from trackerd.formats.settings import CameraSettings

REPLY_S = 2.0  # the twin answers between two renders; one that takes longer hangs
MAX_PACKET = 4096
PIXEL_TYPES: dict[int, type[np.uint8 | np.uint16]] = {1: np.uint8, 2: np.uint16}


class Settings(CameraSettings):
    """The twin's own offer rules over exposure, rate and region, so that both sides can never differ."""

    socket: str = ""  # path of the twin's Unix socket; the twin tells it when it starts

    @property
    def source(self) -> Source:
        return Source.TWIN


@asynccontextmanager
async def open_camera(name: str, settings: Settings, clock: Clock) -> AsyncIterator["SyntheticCamera"]:
    device = f"camera {name}"
    if not settings.socket:
        raise DeviceMissing(device, "open", "the twin has not told its socket")
    link = Link(device, settings.socket)
    try:
        offer, memory = await link.open()
        camera = SyntheticCamera(name, link, offer=offer, memory=memory, timeout_s=settings.timeout_s, clock=clock)
        try:
            yield camera
        finally:
            camera.close()
    finally:
        link.close()


class SyntheticCamera:
    """A camera whose every exposure is rendered by the twin."""

    def __init__(self, name: str, link: "Link", *, offer: Offer, memory: mmap.mmap, timeout_s: float, clock: Clock) -> None:
        self.info = _info(name, offer)
        self._device, self._link, self._offer, self._memory, self._clock = link.device, link, offer, memory, clock
        self._pixels = PIXEL_TYPES[offer.bytes_per_pixel]
        self._mailbox = Mailbox(self._device, self.info.image_px, self._pixels, timeout_s)
        link.on_doorbell, link.on_lost = self._copy, self._mailbox.finish

    async def start(self) -> None:
        self._mailbox.restart()
        await self._link.request("start")

    async def stop(self) -> None:
        await self._link.request("stop")
        self._mailbox.restart()

    def frames(self) -> AsyncIterator[Frame]:
        return self._mailbox

    def statistics(self) -> CameraStatistics:
        return self._mailbox.statistics()

    def close(self) -> None:
        self._mailbox.close()
        self._link.close()
        self._memory.close()

    def _copy(self, bell: Doorbell) -> None:
        arrived = self._clock.now()
        if not 0 <= bell.slot < self._offer.slots or (bell.width, bell.height) != self.info.image_px:
            self._mailbox.finish(DeviceFault(self._device, "take a frame", f"not what the twin offered: {bell}"))
            return
        start = bell.slot * self._offer.slot_bytes
        if self._header(start) != bell.frame_id + 1:
            return  # overwritten before it was read: the next frame's id tells the gap
        image = self._mailbox.filling
        slot = np.frombuffer(self._memory, self._pixels, image.size, start + SLOT_HEADER)
        np.copyto(image, slot.reshape(image.shape))
        if self._header(start) != bell.frame_id + 1:
            return
        instant, origin = CameraNs(bell.mid_exposure_ns), (bell.origin_x, bell.origin_y)
        self._mailbox.deliver(Frame(image, bell.frame_id, instant, arrived, bell.exposure_ns, origin))

    def _header(self, start: int) -> int:
        return int.from_bytes(self._memory[start : start + 8], sys.byteorder)


class Link:
    """The socket to the twin: requests with their answers, and doorbells in between."""

    def __init__(self, device: str, path: str) -> None:
        self.device, self._path = device, path
        self._loop = asyncio.get_running_loop()
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET | socket.SOCK_NONBLOCK)
        self._answers: deque[asyncio.Future[dict[str, Any]]] = deque()
        self._descriptors: list[int] = []
        self._lost: DeviceError | None = None
        self.on_doorbell: Callable[[Doorbell], None] = _nobody_rings
        self.on_lost: Callable[[DeviceError], None] = _nobody_minds

    async def open(self) -> tuple[Offer, mmap.mmap]:
        """Connect, and map the memory that comes with the offer."""
        try:
            self._socket.connect(self._path)
        except OSError as err:
            raise DeviceMissing(self.device, f"connect to the twin at {self._path}", str(err)) from err
        self._loop.add_reader(self._socket.fileno(), self._read)
        answer = await self.request("open")
        try:
            offer = Offer(**answer)
            memory = mmap.mmap(self._descriptors[0], 0, prot=mmap.PROT_READ)
        except (TypeError, IndexError, OSError, ValueError) as err:
            raise DeviceFault(self.device, "read the twin's offer", f"{err} ({answer})") from err
        size = len(memory)
        if not _fits(offer, size):
            memory.close()
            raise DeviceFault(self.device, "map the twin's memory", f"{size} bytes do not hold {offer}")
        return offer, memory

    async def request(self, what: str) -> dict[str, Any]:
        """One answer to one request. Raises DeviceMissing, DeviceTimeout or, where the answer is an error, DeviceFault."""
        if self._lost is not None:
            raise self._lost
        answer: asyncio.Future[dict[str, Any]] = self._loop.create_future()
        try:
            self._socket.send(pack_message(do=what))
            self._answers.append(answer)
            async with asyncio.timeout(REPLY_S):
                reply = await answer
        except TimeoutError:
            raise DeviceTimeout(self.device, what, f"the twin did not answer in {REPLY_S:g} s") from None
        except OSError as err:
            raise DeviceMissing(self.device, what, f"the twin is gone: {err}") from err
        if "error" in reply:
            raise DeviceFault(self.device, what, str(reply["error"]))
        return reply

    def close(self) -> None:
        if self._socket.fileno() < 0:
            return
        self._lose("closed")
        self._socket.close()
        for descriptor in self._descriptors:
            os.close(descriptor)

    def _read(self) -> None:
        """All that has come: only the newest frame is wanted."""
        while self._lost is None:
            try:
                packet, descriptors, _, _ = socket.recv_fds(self._socket, MAX_PACKET, 1)
            except BlockingIOError:
                return
            except ConnectionResetError:
                continue  # told once; what the twin said before it hung up is still there, and then the end
            except OSError as err:
                self._lose(str(err))
                return
            self._descriptors += descriptors
            if not packet:
                self._lose("it closed the connection")
            elif bell := unpack_doorbell(packet):
                self.on_doorbell(bell)
            else:
                self._answered(packet)

    def _answered(self, packet: bytes) -> None:
        try:
            message = unpack_message(packet)
        except ValueError as err:
            self._lose(f"it does not speak our language: {err}")
            return
        answer = self._answers.popleft() if self._answers else None
        if answer is not None and not answer.done():
            answer.set_result(message)

    def _lose(self, why: str) -> None:
        if self._lost is not None:
            return
        self._loop.remove_reader(self._socket.fileno())
        self._lost = DeviceMissing(self.device, "talk to the twin", f"the twin is gone: {why}")
        for answer in self._answers:
            if not answer.done():
                answer.set_exception(self._lost)
        self.on_lost(self._lost)


def _nobody_rings(_: Doorbell) -> None:
    """No stream was asked for yet."""


def _nobody_minds(_: DeviceError) -> None:
    """Nobody waits for frames yet."""


def _info(name: str, offer: Offer) -> CameraInfo:
    return CameraInfo(
        name=name,
        model="twin",
        serial=offer.serial,
        sensor_px=(offer.sensor_width, offer.sensor_height),
        image_px=(offer.width, offer.height),
        frame_rate_hz=offer.frame_rate_hz,
        exposure_ns=offer.exposure_ns,
        clock=ClockKind.DEVICE,
        transfer_ns=offer.transfer_ns,
    )


def _fits(offer: Offer, size: int) -> bool:
    image_bytes = offer.width * offer.height * offer.bytes_per_pixel
    return (
        offer.bytes_per_pixel in PIXEL_TYPES
        and min(offer.width, offer.height, offer.slots) > 0
        and offer.slot_bytes >= SLOT_HEADER + image_bytes
        and size >= offer.slots * offer.slot_bytes
    )
