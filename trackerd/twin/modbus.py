"""Modbus TCP, the serving side: the codec as a pure function, and one listening port per gimbal.

Written out instead of pymodbus's own server for three reasons: there a read-write (FC23) reaches the data in two unrelated
calls, so that one request is not one snapshot; it has no place for a controller that is silent, nor for telling who is gone;
and at 2 x 200 requests/s it takes 13 % of a core before it has done anything.
"""

import asyncio
from collections.abc import Callable
from contextlib import suppress
from struct import Struct
from typing import cast

from trackerd.twin.registers import GimbalRegisters, Refusal, Refused

MBAP = Struct(">HHHB")  # transaction, protocol (0), length of what follows it, unit
LONGEST_ADU = 260
READ_HOLDING, READ_INPUT, WRITE_SINGLE, WRITE_MULTIPLE, READ_WRITE = 3, 4, 6, 16, 23
MAX_READ, MAX_WRITE, MAX_READ_WRITE = 125, 123, 121
REOPEN_S = 0.1
_ADDRESS_VALUE = Struct(">HH")
_WRITE_HEAD = Struct(">HHB")
_READ_WRITE_HEAD = Struct(">HHHHB")


class Foreign(ValueError):
    """The bytes are no Modbus TCP: the connection is of no further use."""


def split(buffer: bytes) -> tuple[list[bytes], bytes]:
    """Whole requests (with their header) and the rest. Raises Foreign."""
    requests = []
    while len(buffer) >= MBAP.size:
        _, protocol, length, _ = MBAP.unpack_from(buffer)
        if protocol != 0 or not 2 <= length <= LONGEST_ADU - 6:
            raise Foreign(f"protocol {protocol}, length {length}")
        if len(buffer) < 6 + length:
            break
        requests.append(buffer[: 6 + length])
        buffer = buffer[6 + length :]
    return requests, buffer


def answer(request: bytes, registers: GimbalRegisters, t_ns: int, refuse: frozenset[int] = frozenset()) -> bytes:
    """The response to one whole request."""
    transaction, _, _, unit = MBAP.unpack_from(request)
    function = request[MBAP.size]
    try:
        pdu = bytes((function,)) + _serve(function, request[MBAP.size + 1 :], registers, t_ns, refuse)
    except Refused as refused:
        pdu = bytes((function | 0x80, refused.code))
    return MBAP.pack(transaction, 0, len(pdu) + 1, unit) + pdu


def _serve(function: int, body: bytes, registers: GimbalRegisters, t_ns: int, refuse: frozenset[int]) -> bytes:
    if function in refuse:
        raise Refused(Refusal.ILLEGAL_FUNCTION)
    if function in (READ_HOLDING, READ_INPUT) and len(body) == _ADDRESS_VALUE.size:
        address, count = _ADDRESS_VALUE.unpack(body)
        _check_count(count, MAX_READ)
        read = registers.read if function == READ_HOLDING else registers.read_input
        return bytes((2 * count,)) + read(address, count, t_ns)
    if function == WRITE_SINGLE and len(body) == _ADDRESS_VALUE.size:
        registers.write(_ADDRESS_VALUE.unpack(body)[0], body[2:], t_ns)
        return body
    if function == WRITE_MULTIPLE and len(body) >= _WRITE_HEAD.size:
        address, count, size = _WRITE_HEAD.unpack_from(body)
        registers.write(address, _values(body[_WRITE_HEAD.size :], count, size, MAX_WRITE), t_ns)
        return body[:4]
    if function == READ_WRITE and len(body) >= _READ_WRITE_HEAD.size:
        address, count, write_address, write_count, size = _READ_WRITE_HEAD.unpack_from(body)
        _check_count(count, MAX_READ)
        values = _values(body[_READ_WRITE_HEAD.size :], write_count, size, MAX_READ_WRITE)
        registers.write(write_address, values, t_ns)
        return bytes((2 * count,)) + registers.read(address, count, t_ns)
    known = function in (READ_HOLDING, READ_INPUT, WRITE_SINGLE, WRITE_MULTIPLE, READ_WRITE)
    raise Refused(Refusal.ILLEGAL_VALUE if known else Refusal.ILLEGAL_FUNCTION)


def _check_count(count: int, most: int) -> None:
    if not 1 <= count <= most:
        raise Refused(Refusal.ILLEGAL_VALUE)


def _values(data: bytes, count: int, size: int, most: int) -> bytes:
    _check_count(count, most)
    if size != 2 * count or len(data) != size:
        raise Refused(Refusal.ILLEGAL_VALUE)
    return data


class Connection(asyncio.Protocol):
    """One client."""

    def __init__(self, server: "ModbusServer") -> None:
        self.server = server
        self.transport: asyncio.Transport | None = None
        self.commands = False  # it has written: the controller depends on it
        self._buffer = b""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self.transport = cast(asyncio.Transport, transport)
        self.server.connections.add(self)

    def data_received(self, data: bytes) -> None:
        try:
            requests, self._buffer = split(self._buffer + data)
        except Foreign:
            self.abort()
            return
        for request in requests:
            self.commands = self.commands or request[MBAP.size] in (WRITE_MULTIPLE, READ_WRITE)
            response = self.server.respond(request)
            if response and self.transport is not None:
                self.transport.write(response)

    def abort(self) -> None:
        if self.transport is not None:
            self.transport.abort()

    def connection_lost(self, _: Exception | None) -> None:
        self.server.connections.discard(self)
        if self.commands:
            self.server.lost()


class ModbusServer:
    """A gimbal's port. On request it falls silent, refuses functions, or loses its link for a while."""

    def __init__(self, registers: GimbalRegisters, now: Callable[[], int]) -> None:
        self.registers = registers
        self.connections: set[Connection] = set()
        self.refused_functions: frozenset[int] = frozenset()
        self.host, self.port = "", 0
        self._now = now  # scene time, ns
        self._silent_until_ns = 0
        self._server: asyncio.Server | None = None
        self._reopening: asyncio.Task[None] | None = None

    async def open(self, host: str, port: int) -> None:
        """Listen; port 0 takes a free one. Raises OSError."""
        loop = asyncio.get_running_loop()
        self._server = await loop.create_server(lambda: Connection(self), host, port, reuse_address=True)
        self.host, self.port = self._server.sockets[0].getsockname()[:2]

    def silence(self, duration_s: float) -> None:
        """Take requests and lose them; connections stay."""
        self._silent_until_ns = self._now() + round(duration_s * 1e9)

    def kill_link(self, duration_s: float) -> None:
        """Nobody listens and every connection is gone, then the same port is there again."""
        self._shut()
        if self._reopening is not None:
            self._reopening.cancel()
        self._reopening = asyncio.get_running_loop().create_task(self._reopen(duration_s))

    async def close(self) -> None:
        if self._reopening is not None:
            self._reopening.cancel()
            with suppress(asyncio.CancelledError):
                await self._reopening
        self._shut()

    def respond(self, request: bytes) -> bytes:
        """Nothing while silent."""
        t_ns = self._now()
        if t_ns < self._silent_until_ns:
            return b""
        return answer(request, self.registers, t_ns, self.refused_functions)

    def lost(self) -> None:
        """A client that commanded is gone."""
        self.registers.controller.link_lost(self._now())

    def _shut(self) -> None:
        if self._server is not None:
            self._server.close()
            self._server = None
        for connection in tuple(self.connections):
            connection.abort()

    async def _reopen(self, duration_s: float) -> None:
        await asyncio.sleep(duration_s)
        while True:
            with suppress(OSError):  # somebody took the port meanwhile
                return await self.open(self.host, self.port)
            await asyncio.sleep(REOPEN_S)
