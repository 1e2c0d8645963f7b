"""The serving side of formats.framelink: one camera's socket, its memory of frames, and its client. It never blocks.

One client at a time; whoever comes while it lives is told so and sent away. A client that does not read loses doorbells only.
"""

import asyncio
import mmap
import os
import socket
from array import array
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from trackerd.formats.framelink import (
    SLOT_HEADER,
    Doorbell,
    Offer,
    offer_fields,
    pack_doorbell,
    pack_message,
    unpack_message,
)

LONGEST_REQUEST = 4096
Pixels = npt.NDArray[np.uint8]


class FrameMemory:
    """The slots of one camera in a memory file."""

    def __init__(self, offer: Offer) -> None:
        self.fd = os.memfd_create(f"trackerd-{offer.camera}", os.MFD_CLOEXEC)
        os.ftruncate(self.fd, offer.slots * offer.slot_bytes)
        self._map = mmap.mmap(self.fd, offer.slots * offer.slot_bytes)
        slots = np.frombuffer(self._map, np.uint8).reshape(offer.slots, offer.slot_bytes)
        self._headers = slots[:, :8].view("<u8")
        self._images = slots[:, SLOT_HEADER : SLOT_HEADER + offer.width * offer.height]
        self._shape = (offer.height, offer.width)
        self.slots = offer.slots

    def begin(self, slot: int) -> Pixels:
        """The image (height, width) to write into; nobody takes it for a frame until `finish`."""
        self._headers[slot] = 0
        image: Pixels = self._images[slot].reshape(self._shape)
        return image

    def finish(self, slot: int, frame_id: int) -> None:
        self._headers[slot] = frame_id + 1

    def close(self) -> None:
        del self._headers, self._images  # they hold the map open
        with suppress(BufferError):
            self._map.close()
        os.close(self.fd)


class FrameLink:
    """`on_request` is given what is asked ("start" or "stop") and a function that sends the answer, now or later."""

    def __init__(self, path: Path, offer: Offer, memory_fd: int, on_request: Callable[[str, Callable[[], None]], None]) -> None:
        self.missed_doorbells = 0
        self._offer = offer
        self._memory_fd = memory_fd
        self._on_request = on_request
        self._client: socket.socket | None = None
        self._loop = asyncio.get_running_loop()
        self._listener = listen(path)
        self._loop.add_reader(self._listener.fileno(), self._accept)

    def ring(self, doorbell: Doorbell) -> bool:
        """Whether the client was told."""
        if self._client is None:
            return False
        try:
            self._client.send(pack_doorbell(doorbell))
        except BlockingIOError:
            self.missed_doorbells += 1
            return False
        except OSError:
            self._drop_client()
            return False
        return True

    def close(self) -> None:
        self._drop_client()
        self._loop.remove_reader(self._listener.fileno())
        self._listener.close()

    def _accept(self) -> None:
        with suppress(BlockingIOError):
            client, _ = self._listener.accept()
            client.setblocking(False)
            if self._client is not None and not _gone(self._client):
                _send(client, pack_message(error=f"camera {self._offer.camera} has a client already"))
                client.close()
                return
            self._drop_client()
            self._client = client
            self._loop.add_reader(client.fileno(), self._receive, client)

    def _receive(self, client: socket.socket) -> None:
        try:
            packet = client.recv(LONGEST_REQUEST)
        except BlockingIOError:
            return
        except OSError:
            packet = b""
        if packet:
            self._serve(client, packet)
        else:
            self._drop_client()

    def _serve(self, client: socket.socket, packet: bytes) -> None:
        try:
            wish = unpack_message(packet).get("do")
        except ValueError as error:
            wish, reason = None, str(error)
        else:
            reason = f"unknown request {wish!r}"
        if wish == "open":
            _send(client, pack_message(**offer_fields(self._offer)), self._memory_fd)
        elif wish in ("start", "stop"):
            self._on_request(wish, lambda: _send(client, pack_message(done=wish)))
        else:
            _send(client, pack_message(error=reason))

    def _drop_client(self) -> None:
        """A stream without a client ends."""
        if self._client is None:
            return
        client, self._client = self._client, None
        self._loop.remove_reader(client.fileno())
        client.close()
        self._on_request("stop", lambda: None)


def listen(path: Path) -> socket.socket:
    """A listening SOCK_SEQPACKET socket, readable by its owner alone. Raises OSError."""
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET | socket.SOCK_NONBLOCK)
    try:
        listener.bind(str(path))
        path.chmod(0o600)
        listener.listen(8)
    except OSError:
        listener.close()
        raise
    return listener


def _send(client: socket.socket, packet: bytes, fd: int | None = None) -> None:
    """A client that is gone, or that does not read its answers, does without."""
    carried: list[Any] = [] if fd is None else [(socket.SOL_SOCKET, socket.SCM_RIGHTS, array("i", [fd]))]
    with suppress(OSError):
        client.sendmsg([packet], carried)


def _gone(client: socket.socket) -> bool:
    try:
        return client.recv(1, socket.MSG_PEEK | socket.MSG_DONTWAIT) == b""
    except BlockingIOError:
        return False
    except OSError:
        return True
