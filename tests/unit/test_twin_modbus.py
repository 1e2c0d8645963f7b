"""The Modbus codec and the rules of the registers, as bytes."""

from struct import pack, unpack

import pytest
from emulators.twin_rig import MS, Rig
from hypothesis import given
from hypothesis import strategies as st

from trackerd.formats import gimbal_map as gm
from trackerd.formats.gimbal_map import ByteOrder, CommandRecord
from trackerd.twin.modbus import READ_WRITE, Foreign, answer, split
from trackerd.twin.registers import GimbalRegisters

T_NS = 10 * MS


def adu(pdu: bytes, transaction: int = 0x1234, unit: int = 1) -> bytes:
    return pack(">HHHB", transaction, 0, len(pdu) + 1, unit) + pdu


def record(seq: int = 1, control: int = 0) -> bytes:
    return gm.encode_command(CommandRecord(seq, control, 0, 0, 0, 0, 0, 0, 0), ByteOrder.MODBUS)


def write(address: int, data: bytes) -> bytes:
    return pack(">BHHB", 16, address, len(data) // 2, len(data)) + data


def exchange(data: bytes, address: int = 100, count: int = 50) -> bytes:
    return pack(">BHHHHB", 23, address, count, 0, len(data) // 2, len(data)) + data


@pytest.fixture
def registers() -> GimbalRegisters:
    return GimbalRegisters(Rig().controller)


def ask(registers: GimbalRegisters, pdu: bytes, refuse: frozenset[int] = frozenset()) -> bytes:
    """The response's PDU."""
    response = answer(adu(pdu), registers, T_NS, refuse)
    assert unpack(">HHHB", response[:7]) == (0x1234, 0, len(response) - 6, 1)
    return response[7:]


def test_a_read_write_applies_the_command_and_then_reads_one_snapshot(registers: GimbalRegisters) -> None:
    response = ask(registers, exchange(record(seq=42)))
    assert response[:2] == bytes((23, 100))
    assert gm.decode_status(response[2:], ByteOrder.MODBUS).cmd_seq_echo == 42


def test_the_status_is_mirrored_as_input_registers(registers: GimbalRegisters) -> None:
    for function in (3, 4):
        response = ask(registers, pack(">BHH", function, 100, 50))
        assert gm.decode_status(response[2:], ByteOrder.MODBUS).clock_us == 10_000


def test_the_command_is_written_alone_and_reads_back(registers: GimbalRegisters) -> None:
    assert ask(registers, write(0, record(seq=9))) == pack(">BHH", 16, 0, 16)
    assert registers.controller.echo == 9
    assert ask(registers, pack(">BHH", 3, 0, 16))[2:] == record(seq=9)


def test_the_history_is_one_read_of_125_registers(registers: GimbalRegisters) -> None:
    response = ask(registers, pack(">BHH", 3, 300, 125))
    assert len(gm.decode_history(response[2:], ByteOrder.MODBUS)) == 11


@pytest.mark.parametrize(
    ("address", "count"), [(100, 49), (101, 49), (100, 51), (0, 15), (99, 50), (300, 124), (16, 1), (199, 2), (247, 2)]
)
def test_a_part_of_a_record_is_refused(registers: GimbalRegisters, address: int, count: int) -> None:
    assert ask(registers, pack(">BHH", 3, address, count)) == bytes((0x83, 2))
    assert ask(registers, exchange(record(), address, count)) == bytes((0x97, 2))


def test_a_command_split_over_two_writes_is_refused(registers: GimbalRegisters) -> None:
    assert ask(registers, write(0, record()[:16])) == bytes((0x90, 2))
    assert ask(registers, pack(">BHH", 6, 1, 7)) == bytes((0x86, 2))
    assert registers.controller.echo == 0


def test_input_registers_hold_the_status_only(registers: GimbalRegisters) -> None:
    assert ask(registers, pack(">BHH", 4, 200, 48)) == bytes((0x84, 2))


def test_the_static_record_reads_whole_and_in_parts(registers: GimbalRegisters) -> None:
    whole = ask(registers, pack(">BHH", 3, 200, 48))[2:]
    assert gm.decode_static(whole, ByteOrder.MODBUS).serial == 7
    assert ask(registers, pack(">BHH", 3, 200, 2))[2:] == bytes((1, 2, 3, 4))


def test_the_static_record_is_locked_while_enabled() -> None:
    rig = Rig()
    registers = GimbalRegisters(rig.controller)
    static = rig.controller.static()
    assert ask(registers, write(200, static)) == pack(">BHH", 16, 200, 48)
    assert ask(registers, write(200, bytes(96))) == bytes((0x90, 3))
    rig.enable(9)
    assert ask(registers, write(200, static)) == bytes((0x90, 6))


@pytest.mark.parametrize("function", [1, 2, 5, 15, 22, 43, 99])
def test_other_functions_are_refused(registers: GimbalRegisters, function: int) -> None:
    assert ask(registers, bytes((function, 0, 0, 0, 1))) == bytes((function | 0x80, 1))


def test_a_refused_read_write_changes_nothing(registers: GimbalRegisters) -> None:
    assert ask(registers, exchange(record(seq=5)), frozenset((READ_WRITE,))) == bytes((0x97, 1))
    assert registers.controller.echo == 0
    assert ask(registers, write(0, record(seq=5)), frozenset((READ_WRITE,)))[0] == 16


@pytest.mark.parametrize(
    "pdu",
    [
        pack(">BHH", 3, 100, 0),
        pack(">BHH", 3, 100, 126),
        pack(">BHHB", 16, 0, 16, 30) + bytes(30),
        pack(">BHHB", 16, 0, 124, 248) + bytes(248),
        pack(">BHHHHB", 23, 100, 50, 0, 122, 244) + bytes(244),
        pack(">BH", 3, 100),
        bytes((16,)),
        bytes((23, 1)),
    ],
)
def test_wrong_counts_and_lengths_are_refused(registers: GimbalRegisters, pdu: bytes) -> None:
    assert ask(registers, pdu) == bytes((pdu[0] | 0x80, 3))


def test_requests_are_found_in_a_stream_however_it_is_cut() -> None:
    stream = adu(pack(">BHH", 3, 100, 50)) + adu(exchange(record()))
    for cut in range(len(stream) + 1):
        first, rest = split(stream[:cut])
        second, rest = split(rest + stream[cut:])
        assert b"".join(first + second) == stream
        assert rest == b""


@pytest.mark.parametrize("head", [pack(">HHHB", 1, 1, 6, 1), pack(">HHHB", 1, 0, 1, 1), pack(">HHHB", 1, 0, 255, 1)])
def test_what_is_no_modbus_is_told(head: bytes) -> None:
    with pytest.raises(Foreign):
        split(head)


REGISTERS = GimbalRegisters(Rig().controller)


@given(pdu=st.binary(min_size=1, max_size=253))
def test_any_request_has_an_answer(pdu: bytes) -> None:
    response = answer(adu(pdu), REGISTERS, T_NS)
    assert response[7] & 0x7F == pdu[0] & 0x7F
    assert len(response) <= 260
