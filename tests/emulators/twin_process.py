"""The twin as its clients see it: run in the test's own event loop, with raw clients for its sockets."""

import asyncio
import json
import mmap
import os
import socket
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any, Self

import numpy as np
import numpy.typing as npt
from pymodbus.client import AsyncModbusTcpClient

import drivers
from trackerd.contract.model import AxisMode
from trackerd.formats import gimbal_map as gm
from trackerd.formats.cell import CellConfig
from trackerd.formats.config import load_cell
from trackerd.formats.framelink import SLOT_HEADER, Doorbell, pack_message, unpack_doorbell, unpack_message
from trackerd.formats.gimbal_map import ByteOrder, CommandRecord, StatusRecord
from trackerd.formats.settings import Settings
from trackerd.twin.server import run_twin

DEMO = Path(__file__).parents[2] / "config" / "demo.toml"
SMALL = [f"camera.{name}.{key}={value}" for name in ("left", "right") for key, value in (
    ("width_px", 320), ("height_px", 240), ("offset_x_px", 864), ("offset_y_px", 648))]  # fmt: skip


def demo_cell(*overrides: str) -> CellConfig:
    def settings_of(role: str, name: str) -> type[Settings]:
        model: type[Settings] = drivers.load(role, name).Settings
        return model

    zenoh = 'zenoh.listen=["tcp/127.0.0.1:1"]'  # nobody is there
    return load_cell(DEMO, [*SMALL, zenoh, *overrides], settings_of=settings_of)


@asynccontextmanager
async def running_twin(*overrides: str, **options: Any) -> AsyncIterator[dict[str, Any]]:
    """What the twin announces; it is ended on the way out."""
    announced: asyncio.Future[dict[str, Any]] = asyncio.get_running_loop().create_future()
    task = asyncio.create_task(run_twin(demo_cell(*overrides), announced.set_result, **options))
    await asyncio.wait({task, announced}, return_when=asyncio.FIRST_COMPLETED)
    if task.done():
        task.result()
    try:
        yield {**await announced, "task": task}
    finally:
        if not task.done():
            task.cancel()
            with suppress(asyncio.CancelledError):
                await task


class Packets:
    """A SOCK_SEQPACKET client."""

    def __init__(self, path: str) -> None:
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET | socket.SOCK_NONBLOCK)
        self.socket.connect(path)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.socket.close()

    async def receive(self) -> bytes:
        return await asyncio.get_running_loop().sock_recv(self.socket, 1 << 16)

    async def ask(self, **message: Any) -> dict[str, Any]:
        self.socket.send(pack_message(**message))
        while unpack_doorbell(packet := await self.receive()) is not None:
            pass
        return unpack_message(packet)


async def control(twin: dict[str, Any], **request: Any) -> dict[str, Any]:
    with Packets(twin["control"]) as client:
        return await client.ask(**request)


class Eye(Packets):
    """A camera's client."""

    async def open(self) -> dict[str, Any]:
        self.socket.send(pack_message(do="open"))
        packet, fds = await self._receive_with_fd()
        offer: dict[str, Any] = json.loads(packet)
        if fds:
            self.memory = mmap.mmap(fds[0], 0, prot=mmap.PROT_READ)
            os.close(fds[0])
        self.offer = offer
        return offer

    async def _receive_with_fd(self) -> tuple[bytes, list[int]]:
        loop, readable = asyncio.get_running_loop(), asyncio.Event()
        loop.add_reader(self.socket, readable.set)
        await readable.wait()
        loop.remove_reader(self.socket)
        packet, fds, _, _ = socket.recv_fds(self.socket, 4096, 1)
        return packet, fds

    async def doorbell(self) -> Doorbell:
        while (bell := unpack_doorbell(await self.receive())) is None:
            pass
        return bell

    def frame(self, bell: Doorbell) -> npt.NDArray[np.uint8]:
        """A copy of the image; its header is checked."""
        start = bell.slot * self.offer["slot_bytes"]
        assert int.from_bytes(self.memory[start : start + 8], "little") == bell.frame_id + 1
        data = self.memory[start + SLOT_HEADER : start + SLOT_HEADER + bell.width * bell.height]
        return np.frombuffer(data, np.uint8).reshape(bell.height, bell.width)


class Wheel:
    """A gimbal's client, on pymodbus."""

    def __init__(self, client: AsyncModbusTcpClient) -> None:
        self.client = client
        self.seq = 0

    async def exchange(self, bits: int = 0, mode: AxisMode = AxisMode.HOLD, **fields: int) -> StatusRecord:
        self.seq += 1
        record = CommandRecord(self.seq, bits, mode, **{**dict.fromkeys(FIELDS, 0), **fields})
        values = gm.registers_from_bytes(gm.encode_command(record, ByteOrder.MODBUS))
        answer = await self.client.readwrite_registers(
            read_address=gm.STATUS_REGISTER, read_count=gm.STATUS_WORDS, write_address=gm.COMMAND_REGISTER, values=values
        )
        assert not answer.isError(), answer
        return gm.decode_status(gm.bytes_from_registers(answer.registers), ByteOrder.MODBUS)


FIELDS = ("az_cmd", "el_cmd", "az_vel", "el_vel", "cmd_time_us", "watchdog_ms")


@asynccontextmanager
async def connected(twin: dict[str, Any], name: str = "left", timeout_s: float = 5.0) -> AsyncIterator[Wheel]:
    where = twin["gimbals"][name]
    client = AsyncModbusTcpClient(where["host"], port=where["port"], timeout=timeout_s, retries=0)
    assert await client.connect()
    try:
        yield Wheel(client)
    finally:
        client.close()


async def until_listening(twin: dict[str, Any], name: str) -> None:
    where = twin["gimbals"][name]
    while True:
        with suppress(OSError):
            _, writer = await asyncio.open_connection(where["host"], where["port"])
            writer.close()
            await writer.wait_closed()
            return
