"""Gimbal controllers over Modbus TCP: one transaction a cycle writes the command record and reads the status record.

Errors come at once and nothing is retried here: the control loop's next cycle is the retry, and the supervisor reconnects by
leaving the context and entering it again.
"""

import logging
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import Field

from drivers.gimbal.records import encode_command, info, report
from trackerd.contract.clock import Clock
from trackerd.contract.errors import DeviceFault, DeviceMissing, DeviceTimeout
from trackerd.contract.model import AxisCommand, GimbalReport
from trackerd.formats import gimbal_map as m
from trackerd.formats.settings import GimbalSettings

if TYPE_CHECKING:
    from pymodbus.client import AsyncModbusTcpClient
    from pymodbus.pdu import ModbusPDU

ILLEGAL_FUNCTION, BUSY, NO_PATH, NO_ANSWER_BEHIND = 1, 6, 10, 11  # Modbus exception codes; 10 and 11 are a gateway's


class Settings(GimbalSettings):
    host: Annotated[str, Field(min_length=1)]
    port: Annotated[int, Field(ge=0, le=65535)] = 502  # 0: the twin tells its own
    unit: Annotated[int, Field(ge=0, le=247)] = 1
    timeout_ms: Annotated[int, Field(ge=20, le=1000)] = 50  # of one request and of the connection


@asynccontextmanager
async def open_gimbal(name: str, settings: Settings, clock: Clock) -> AsyncIterator["ModbusGimbal"]:
    """Connects and reads the static block. Raises DeviceError; DeviceFault where the controller speaks another map."""
    from pymodbus.client import AsyncModbusTcpClient  # noqa: PLC0415 - only a cell with a Modbus gimbal waits for it

    device = f"gimbal {name}"
    if settings.port == 0:
        raise DeviceMissing(device, "connect", "the twin has not told its port")
    logging.getLogger("pymodbus").setLevel(logging.CRITICAL)  # what goes wrong is raised: it need not be told twice
    stamps = Stamps(clock)
    timeout_s = settings.timeout_ms / 1e3
    client = AsyncModbusTcpClient(
        settings.host, port=settings.port, timeout=timeout_s, retries=0, reconnect_delay=0, trace_packet=stamps.take
    )
    link = Link(device, client, settings.unit, timeout_s)
    try:
        if not await client.connect():
            raise DeviceMissing(device, f"connect to {settings.host}:{settings.port}", f"no connection within {timeout_s:g} s")
        yield ModbusGimbal(name, link, stamps, await _read_static(link))
    finally:
        transport = client.ctx.transport
        client.close()
        if transport is not None:
            transport.abort()  # type: ignore[attr-defined]  # does not wait for a peer that no longer reads


class Stamps:
    """When the last packet left and when the last one came, taken beside the socket."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self.sent = self.received = clock.now()

    def take(self, sending: bool, packet: bytes) -> bytes:
        if sending:
            self.sent = self._clock.now()
        else:
            self.received = self._clock.now()
        return packet


class Link:
    """Register requests, with every way to fail sorted by what the caller can do about it."""

    def __init__(self, device: str, client: "AsyncModbusTcpClient", unit: int, timeout_s: float) -> None:
        self.device = device
        self._client, self._unit, self._timeout_s = client, unit, timeout_s
        self._both_at_once = True  # until the controller refuses FC23

    async def read(self, doing: str, register: int, words: int) -> bytes:
        answer = await self._ask(
            doing, lambda: self._client.read_holding_registers(register, count=words, device_id=self._unit)
        )
        return self._words(doing, answer, words)

    async def write_and_read(self, doing: str, command: bytes) -> bytes:
        """FC23; where the controller refuses it, FC16 and FC03 from then on."""
        registers = m.registers_from_bytes(command)
        if self._both_at_once:
            answer = await self._ask(doing, lambda: self._write_and_read(registers))
            if not _refused(answer, ILLEGAL_FUNCTION):
                return self._words(doing, answer, m.STATUS_WORDS)
            self._both_at_once = False
        answer = await self._ask(doing, lambda: self._write(registers))
        self._check(doing, answer)
        return await self.read(doing, m.STATUS_REGISTER, m.STATUS_WORDS)

    def _write_and_read(self, registers: list[int]) -> "Awaitable[ModbusPDU]":
        return self._client.readwrite_registers(
            read_address=m.STATUS_REGISTER,
            read_count=m.STATUS_WORDS,
            write_address=m.COMMAND_REGISTER,
            values=registers,
            device_id=self._unit,
        )

    def _write(self, registers: list[int]) -> "Awaitable[ModbusPDU]":
        return self._client.write_registers(m.COMMAND_REGISTER, registers, device_id=self._unit)

    async def _ask(self, doing: str, request: "Callable[[], Awaitable[ModbusPDU]]") -> "ModbusPDU":
        from pymodbus.exceptions import ModbusException  # noqa: PLC0415 - cached; the module itself loads without pymodbus

        try:
            return await request()
        except ModbusException as err:
            if self._client.connected:
                raise DeviceTimeout(self.device, doing, f"no reply in {self._timeout_s:g} s") from err
            raise DeviceMissing(self.device, doing, "the connection is lost") from err
        except OSError as err:
            raise DeviceMissing(self.device, doing, str(err)) from err

    def _words(self, doing: str, answer: "ModbusPDU", words: int) -> bytes:
        self._check(doing, answer)
        if len(answer.registers) != words:
            raise DeviceFault(self.device, doing, f"{len(answer.registers)} registers instead of {words}")
        return m.bytes_from_registers(list(answer.registers))

    def _check(self, doing: str, answer: "ModbusPDU") -> None:
        if not answer.isError():
            return
        code = getattr(answer, "exception_code", 0)
        text = f"Modbus exception {code} to function {answer.function_code & 0x7F}"
        if code == BUSY:
            raise DeviceTimeout(self.device, doing, f"{text}: busy")
        if code in (NO_PATH, NO_ANSWER_BEHIND):
            raise DeviceMissing(self.device, doing, f"{text}: the gateway does not reach it")
        raise DeviceFault(self.device, doing, text)


class ModbusGimbal:
    """One controller, connected."""

    def __init__(self, name: str, link: Link, stamps: Stamps, static: m.StaticRecord) -> None:
        self.info = info(name, static)
        self._link, self._stamps = link, stamps

    async def exchange(self, command: AxisCommand) -> GimbalReport:
        data = await self._first(command)
        try:
            return self._report(data)
        except m.TornRecord:
            again = await self._link.read("read the status again", m.STATUS_REGISTER, m.STATUS_WORDS)
        try:
            return self._report(again)
        except m.TornRecord as err:
            raise DeviceFault(self._link.device, "exchange", f"torn twice in a row: {err}") from err

    async def _first(self, command: AxisCommand) -> bytes:
        if not command.sequence:
            return await self._link.read("read the status", m.STATUS_REGISTER, m.STATUS_WORDS)
        return await self._link.write_and_read("exchange", encode_command(command, m.ByteOrder.MODBUS))

    def _report(self, data: bytes) -> GimbalReport:
        try:
            status = m.decode_status(data, m.ByteOrder.MODBUS)
        except m.ForeignRecord as err:
            raise DeviceFault(self._link.device, "exchange", str(err)) from err
        return report(status, self._stamps.sent, self._stamps.received)


async def _read_static(link: Link) -> m.StaticRecord:
    doing = "read the static block"
    data = await link.read(doing, m.STATIC_REGISTER, m.STATIC_WORDS)
    try:
        return m.decode_static(data, m.ByteOrder.MODBUS)
    except m.ForeignRecord as err:
        raise DeviceFault(link.device, doing, f"another map: {err}") from err


def _refused(answer: Any, code: int) -> bool:
    return bool(answer.isError()) and getattr(answer, "exception_code", 0) == code
