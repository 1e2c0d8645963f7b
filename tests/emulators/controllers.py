"""Gimbal controllers for the modbus driver: pymodbus's own server, and Debian's libmodbus behind a C helper of ours."""

import asyncio
import shutil
import subprocess
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import pytest
from pymodbus.constants import ExcCodes
from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from drivers.gimbal import fixed, modbus
from drivers.gimbal import replay as replay_gimbal
from trackerd.contract.clock import Clock, SystemClock
from trackerd.formats import gimbal_map as m
from trackerd.testing.gimbal import GimbalBench

BIG = m.ByteOrder.MODBUS


def limit(angle_rad: float) -> tuple[int, int]:
    """i32 counts and whole turns."""
    fraction, turns = m.counts(angle_rad)
    return m.signed(fraction), turns


STATIC = m.StaticRecord(
    serial=4711,
    firmware=(2, 7),
    az_min=limit(-1.0),
    az_max=limit(1.0),
    el_min=limit(-0.5),
    el_max=limit(0.75),
    max_speed=m.counts_per_ms(2.0),
    max_acceleration=1_000,
    latch_delay_ns=150,
    encoder_delay_ns=250,
    cycle_us=1000,
    ring_depth=4,
    watchdog_min_ms=5,
    watchdog_default_ms=50,
    watchdog_max_ms=1000,
    clock_source=0,
    clock_quality_ns=0,
)


def edges(index: int, t_us: int) -> tuple[m.LatchRecord, m.LatchRecord]:
    """Falling, then rising: the order of the ring. `index` is the controller's, from 1."""
    return (
        m.LatchRecord(index | m.FALLING_EDGE, 1000, 2000, (t_us + 2000) & m.LOW_WORD),
        m.LatchRecord(index, 900, 1900, t_us & m.LOW_WORD),
    )


STATUS = m.StatusRecord(
    status_seq=65_530,
    status=0b11,
    fault=0,
    cmd_seq_echo=0,
    cmd_age_ms=0,
    az_live=1100,
    el_live=2100,
    clock_us=5_000_000_000,
    latch_total=2,
    latches=(*edges(2, 4_999_990_000), *edges(1, 4_999_970_000)),
    az_turns=0,
    el_turns=0,
)


@dataclass
class SimController:
    """The map on pymodbus's server. Each read of the status counts its guards on."""

    status: m.StatusRecord = STATUS
    static: bytes = field(default_factory=lambda: m.encode_static(STATIC, BIG))
    refuse_23: bool = False
    refuse_with: ExcCodes | None = None  # the answer to every request that reads the status
    tear: int = 0  # so many of the next status records are torn
    map_id: int = m.MAP_ID
    functions: list[int] = field(default_factory=list)  # one entry for each part of a request
    command: m.CommandRecord | None = None
    gate: asyncio.Event | None = None  # requests wait here before they are worked on

    async def __aenter__(self) -> "SimController":
        registers = [
            SimData(m.COMMAND_REGISTER, values=[0] * m.COMMAND_WORDS, datatype=DataType.REGISTERS),
            SimData(m.STATUS_REGISTER, values=[0] * m.STATUS_WORDS, datatype=DataType.REGISTERS),
            SimData(m.STATIC_REGISTER, values=m.registers_from_bytes(self.static), datatype=DataType.REGISTERS),
        ]
        self._server = ModbusTcpServer(SimDevice(1, simdata=registers, action=self._act), address=("127.0.0.1", 0))
        await self._server.serve_forever(background=True)
        self.port: int = self._server.transport.sockets[0].getsockname()[1]  # type: ignore[attr-defined]
        return self

    async def __aexit__(self, *_: object) -> None:
        await self._server.shutdown()

    def expose(self, count: int) -> None:
        for _ in range(count):
            index = self.status.latch_total + 1
            now_us = self.status.clock_us + 18_000
            ring = (*edges(index, now_us - 5000), *self.status.latches)[: m.LATCH_DEPTH]
            self.status = replace(self.status, clock_us=now_us, latch_total=index, latches=ring)

    async def _act(
        self, function: int, start: int, address: int, count: int, registers: list[int], written: Any
    ) -> ExcCodes | None:
        if self.gate is not None:
            await self.gate.wait()
        self.functions.append(function)
        if function == 23 and self.refuse_23:
            return ExcCodes.ILLEGAL_FUNCTION
        if written is not None:
            self.command = m.decode_command(m.bytes_from_registers(written), BIG)
            self.status = replace(self.status, cmd_seq_echo=self.command.cmd_seq)
        elif address == m.STATUS_REGISTER:
            if self.refuse_with is not None:
                return self.refuse_with
            at = address - start
            registers[at : at + count] = self._next_status()
        return None

    def _next_status(self) -> list[int]:
        self.status = replace(self.status, status_seq=(self.status.status_seq + 1) & 0xFFFF, map_id=self.map_id)
        words = m.registers_from_bytes(m.encode_status(self.status, BIG))
        if self.tear:
            self.tear -= 1
            words[-1] ^= 1
        return words


class LibmodbusController:
    """The C helper in a process of its own."""

    def __init__(self, folder: Path, no_fc23: bool = False) -> None:
        self._folder, self._options = folder, ["no23"] * no_fc23

    async def __aenter__(self) -> "LibmodbusController":
        records = [m.encode_static(STATIC, BIG).hex(), m.encode_status(STATUS, BIG).hex()]
        self._process = await asyncio.create_subprocess_exec(
            *[str(_compiled(self._folder)), *records, *self._options],
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
        )
        assert self._process.stdout is not None
        self.port = int(await self._process.stdout.readline())
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.kill()

    async def kill(self) -> None:
        if self._process.returncode is None:
            self._process.kill()
        await self._process.communicate()


def _compiled(folder: Path) -> Path:
    """Skips, by name, where a package is missing."""
    for tool, package in (("gcc", "gcc"), ("pkg-config", "pkg-config")):
        if shutil.which(tool) is None:
            pytest.skip(f"needs the Debian package {package}")
    flags = subprocess.run(["pkg-config", "--cflags", "--libs", "libmodbus"], capture_output=True, text=True, check=False)
    if flags.returncode:
        pytest.skip("needs the Debian package libmodbus-dev")
    program, source = folder / "modbus_peer", Path(__file__).with_name("modbus_peer.c")
    if not program.exists():
        subprocess.run(["gcc", "-Wall", "-O1", "-o", program, source, *flags.stdout.split()], check=True)
    return program


@asynccontextmanager
async def open_modbus(
    port: int, clock: Clock | None = None, name: str = "left", **changes: Any
) -> AsyncIterator[modbus.ModbusGimbal]:
    keys = {"driver": "modbus", "camera": name, "host": "127.0.0.1", "port": port, "timeout_ms": 200} | changes
    async with modbus.open_gimbal(name, modbus.Settings(**keys), clock or SystemClock()) as gimbal:
        yield gimbal


@asynccontextmanager
async def pymodbus_bench(folder: Path, refuse_23: bool = False) -> AsyncIterator[GimbalBench]:
    async with SimController(refuse_23=refuse_23) as controller, open_modbus(controller.port) as gimbal:

        async def kill() -> None:
            await controller.__aexit__()

        async def expose(count: int) -> None:
            controller.expose(count)

        yield GimbalBench(gimbal, kill, expose)


@asynccontextmanager
async def pymodbus_without_23_bench(folder: Path) -> AsyncIterator[GimbalBench]:
    async with pymodbus_bench(folder, refuse_23=True) as bench:
        yield bench


@asynccontextmanager
async def libmodbus_bench(folder: Path, no_fc23: bool = False) -> AsyncIterator[GimbalBench]:
    async with LibmodbusController(folder, no_fc23) as controller, open_modbus(controller.port) as gimbal:
        yield GimbalBench(gimbal, controller.kill)


@asynccontextmanager
async def libmodbus_without_23_bench(folder: Path) -> AsyncIterator[GimbalBench]:
    async with libmodbus_bench(folder, no_fc23=True) as bench:
        yield bench


@asynccontextmanager
async def replay_bench(folder: Path) -> AsyncIterator[GimbalBench]:
    csv = folder / "angles.csv"
    csv.write_text("gimbal,frame,t_ns,az_rad,el_rad\nleft,0,1000,0.1,0.2\nright,0,1000,1,2\nleft,1,2501,0.11,0.21\n")
    settings = replay_gimbal.Settings(driver="replay", camera="left", csv=csv)
    async with replay_gimbal.open_gimbal("left", settings, SystemClock()) as gimbal:
        yield GimbalBench(gimbal)


@asynccontextmanager
async def fixed_bench(folder: Path) -> AsyncIterator[GimbalBench]:
    settings = fixed.Settings(driver="fixed", camera="left", az_deg=90.0, el_deg=-45.0)
    async with fixed.open_gimbal("left", settings, SystemClock()) as gimbal:
        yield GimbalBench(gimbal)


BENCHES = {
    "modbus on pymodbus": pymodbus_bench,
    "modbus on pymodbus without FC23": pymodbus_without_23_bench,
    "modbus on libmodbus": libmodbus_bench,
    "modbus on libmodbus without FC23": libmodbus_without_23_bench,
    "replay": replay_bench,
    "fixed": fixed_bench,
}
