"""Gimbal controllers over Modbus TCP: one transaction a cycle writes the command record and reads the status record.

Errors come at once and nothing is retried here: the control loop's next cycle is the retry, and the supervisor reconnects by
leaving the context and entering it again.
"""

import logging
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import Field

from trackerd.contract.clock import Clock, ClockKind, ControllerUs
from trackerd.contract.errors import DeviceFault, DeviceMissing, DeviceTimeout
from trackerd.contract.model import AxisCommand, GimbalFlag, GimbalInfo, GimbalReport, Latch
from trackerd.formats import gimbal_map as m
from trackerd.formats.settings import GimbalSettings

if TYPE_CHECKING:
    from pymodbus.client import AsyncModbusTcpClient
    from pymodbus.pdu import ModbusPDU

ILLEGAL_FUNCTION, BUSY, NO_PATH, NO_ANSWER_BEHIND = 1, 6, 10, 11  # Modbus exception codes; 10 and 11 are a gateway's
ALL_FLAGS = sum(flag.value for flag in GimbalFlag)


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
        self.info = _info(name, static)
        self._link, self._stamps = link, stamps

    async def exchange(self, command: AxisCommand) -> GimbalReport:
        data = await self._link.write_and_read("exchange", encode(command))
        try:
            return self._report(data)
        except m.TornRecord:
            again = await self._link.read("read the status again", m.STATUS_REGISTER, m.STATUS_WORDS)
        try:
            return self._report(again)
        except m.TornRecord as err:
            raise DeviceFault(self._link.device, "exchange", f"torn twice in a row: {err}") from err

    def _report(self, data: bytes) -> GimbalReport:
        try:
            status = m.decode_status(data, m.ByteOrder.MODBUS)
        except m.ForeignRecord as err:
            raise DeviceFault(self._link.device, "exchange", str(err)) from err
        return report(status, self._stamps)


def encode(command: AxisCommand) -> bytes:
    """The command record on the wire. Angles wrap, speeds are clamped to their range."""
    bits = (
        (command.enable, m.ENABLE),
        (command.follow, m.FOLLOW),
        (command.halt, m.HALT),
        (command.reset_fault, m.FAULT_RESET),
        (command.latch, m.LATCH_ENABLE),
        (command.latch_zero, m.LATCH_ZERO),
        (command.velocity_valid, m.VELOCITY_VALID),
        (command.at is not None, m.TIME_VALID),
    )
    record = m.CommandRecord(
        cmd_seq=command.sequence,
        control=sum(bit for is_set, bit in bits if is_set),
        mode=int(command.mode),
        az_cmd=m.counts(command.az_rad)[0],
        el_cmd=m.counts(command.el_rad)[0],
        az_vel=m.counts_per_ms(command.az_rad_s),
        el_vel=m.counts_per_ms(command.el_rad_s),
        cmd_time_us=(command.at or 0) & m.LOW_WORD,
        watchdog_ms=command.watchdog_ms,
    )
    return m.encode_command(record, m.ByteOrder.MODBUS)


def report(status: m.StatusRecord, stamps: Stamps) -> GimbalReport:
    """Fractions and low words unwrapped: live angles by the whole turns, latches near the live sample."""
    az_rad, el_rad = m.angle(status.az_live, status.az_turns), m.angle(status.el_live, status.el_turns)
    latches = tuple(
        Latch(
            index=(latch.index - 1) & m.INDEX_MASK,  # the controller counts from 1
            falling=bool(latch.index & m.FALLING_EDGE),
            az_rad=m.nearest_angle(latch.az, az_rad),
            el_rad=m.nearest_angle(latch.el, el_rad),
            instant=ControllerUs(m.unwrap(latch.t_us, status.clock_us)),
        )
        for latch in status.latches
    )
    return GimbalReport(
        sequence=status.status_seq,
        flags=GimbalFlag(status.status & ALL_FLAGS),
        fault=status.fault,
        echo=status.cmd_seq_echo,
        command_age_ms=status.cmd_age_ms,
        az_rad=az_rad,
        el_rad=el_rad,
        instant=ControllerUs(status.clock_us),
        latch_total=status.latch_total,
        latches=latches,
        sent=stamps.sent,
        received=stamps.received,
    )


async def _read_static(link: Link) -> m.StaticRecord:
    doing = "read the static block"
    data = await link.read(doing, m.STATIC_REGISTER, m.STATIC_WORDS)
    try:
        return m.decode_static(data, m.ByteOrder.MODBUS)
    except m.ForeignRecord as err:
        raise DeviceFault(link.device, doing, f"another map: {err}") from err


def _info(name: str, static: m.StaticRecord) -> GimbalInfo:
    return GimbalInfo(
        name=name,
        serial=str(static.serial),
        firmware="{}.{}".format(*static.firmware),
        steerable=True,
        clock=ClockKind.DEVICE,
        az_limits_rad=(m.angle(*static.az_min), m.angle(*static.az_max)),
        el_limits_rad=(m.angle(*static.el_min), m.angle(*static.el_max)),
        max_rad_s=m.rad_per_s(static.max_speed),
        max_rad_s2=m.rad_per_s(static.max_acceleration) * 1e3,
        latch_delay_ns=static.latch_delay_ns,
        encoder_delay_ns=static.encoder_delay_ns,
    )


def _refused(answer: Any, code: int) -> bool:
    return bool(answer.isError()) and getattr(answer, "exception_code", 0) == code
