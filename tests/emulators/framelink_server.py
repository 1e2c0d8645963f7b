"""A camera of the twin, reduced to the frame link: it renders nothing and exposes when a test says so, or at its own pace."""

import asyncio
import mmap
import os
import socket
import struct
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from trackerd.formats.framelink import (
    SLOT_HEADER,
    SLOTS,
    Doorbell,
    Offer,
    offer_fields,
    pack_doorbell,
    pack_message,
    unpack_message,
)

WIDTH, HEIGHT, EXPOSURE_NS, PERIOD_S = 64, 48, 1_000_000, 0.004
SLOT_BYTES = SLOT_HEADER + WIDTH * HEIGHT


def offer(**changes: Any) -> dict[str, Any]:
    whole = Offer("left", "T1", 2048, 1536, WIDTH, HEIGHT, 1, EXPOSURE_NS, 1 / PERIOD_S, 5_000_000, SLOTS, SLOT_BYTES)
    return offer_fields(whole) | changes


@dataclass
class FramelinkServer:
    """`paced` exposes by itself after every start; else `expose` does. Pixels of frame n are all n % 251."""

    path: str
    paced: bool = True
    offered: dict[str, Any] = field(default_factory=offer)
    refuse: str = ""  # this request is answered by an error
    busy: bool = False  # who comes is told so and sent away
    silent: str = ""  # this request is not answered
    lose: int = 0  # so many of the next exposures never arrive
    frame_id: int = 0
    requests: list[str] = field(default_factory=list)

    async def __aenter__(self) -> "FramelinkServer":
        self._loop = asyncio.get_running_loop()
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET | socket.SOCK_NONBLOCK)
        self._listener.bind(self.path)
        self._listener.listen(1)
        self._memory_fd = os.memfd_create("frames")
        os.ftruncate(self._memory_fd, SLOTS * SLOT_BYTES)
        self._memory = mmap.mmap(self._memory_fd, 0)
        self._peer: socket.socket | None = None
        self._timer: asyncio.TimerHandle | None = None
        self._loop.add_reader(self._listener.fileno(), self._accept)
        return self

    async def __aexit__(self, *_: object) -> None:
        self.hang_up()
        self._loop.remove_reader(self._listener.fileno())
        self._listener.close()
        self._memory.close()
        os.close(self._memory_fd)

    def hang_up(self) -> None:
        self._halt()
        if self._peer is not None:
            self._loop.remove_reader(self._peer.fileno())
            self._peer.close()
            self._peer = None

    def expose(self, torn: bool = False, **changes: Any) -> None:
        frame_id, self.frame_id = self.frame_id, self.frame_id + 1
        if self.lose:
            self.lose -= 1
            return
        slot = frame_id % SLOTS
        start = slot * SLOT_BYTES
        pixels = np.frombuffer(self._memory, np.uint8, WIDTH * HEIGHT, start + SLOT_HEADER)
        pixels[:] = frame_id % 251
        struct.pack_into("=Q", self._memory, start, 0 if torn else frame_id + 1)
        fields = {
            "slot": slot,
            "frame_id": frame_id,
            "mid_exposure_ns": 1_000_000 * frame_id + 77,
            "due_ns": 0,
            "rung_ns": 0,
            "exposure_ns": EXPOSURE_NS,
            "width": WIDTH,
            "height": HEIGHT,
            "origin_x": 704,
            "origin_y": 528,
        }
        self.send(pack_doorbell(Doorbell(**(fields | changes))))

    def send(self, packet: bytes) -> None:
        assert self._peer is not None
        self._peer.send(packet)

    def _accept(self) -> None:
        self._peer, _ = self._listener.accept()
        if self.busy:
            self.send(pack_message(error="camera left has a client already"))
            self._peer.close()
            self._peer = None
            return
        self._peer.setblocking(False)
        self._loop.add_reader(self._peer.fileno(), self._read)

    def _read(self) -> None:
        assert self._peer is not None
        packet = self._peer.recv(4096)
        if not packet:
            self.hang_up()
            return
        self._obey(unpack_message(packet)["do"])

    def _obey(self, what: str) -> None:
        assert self._peer is not None
        self.requests.append(what)
        if what == self.silent:
            return
        if what == self.refuse:
            self.send(pack_message(error="the lens cap is on"))
            return
        self._halt()
        if what == "open":
            socket.send_fds(self._peer, [pack_message(**self.offered)], [self._memory_fd])
            return
        self.send(pack_message(ok=True))
        if what == "start":
            self.frame_id = 0
            if self.paced:
                self._tick()

    def _tick(self) -> None:
        self.expose()
        self._timer = self._loop.call_later(PERIOD_S, self._tick)

    def _halt(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
