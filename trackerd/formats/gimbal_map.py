"""The gimbal controller's map, version 1.1, as data: fields, registers and bytes, no sockets; for drivers and twin alike.

One record each way, the same field order on both buses: EtherNet/IP little-endian, Modbus big-endian bytes with the high word
first (so a Modbus record is the plain big-endian packing of its registers).
"""

from dataclasses import dataclass
from enum import StrEnum
from math import pi
from struct import Struct, pack, unpack

MAP_ID = 0x0101
WORD_ORDER_PROBE = 0x01020304
COUNTS_PER_TURN = 1 << 32
RAD_PER_COUNT = 2.0 * pi / COUNTS_PER_TURN

COMMAND_REGISTER, COMMAND_WORDS = 0, 16
STATUS_REGISTER, STATUS_WORDS = 100, 50
STATIC_REGISTER, STATIC_WORDS = 200, 48
HISTORY_REGISTER, HISTORY_WORDS = 300, 125
COMMAND_ASSEMBLY, STATUS_ASSEMBLY, HISTORY_ASSEMBLY, STATIC_ASSEMBLY = 150, 100, 101, 102

LATCH_DEPTH = 4
HISTORY_DEPTH = 20
FALLING_EDGE = 1 << 31
INDEX_MASK = FALLING_EDGE - 1
LOW_WORD = 0xFFFF_FFFF

# Control bits of the command record.
ENABLE, FOLLOW, HALT, FAULT_RESET, LATCH_ENABLE, LATCH_ZERO, VELOCITY_VALID, TIME_VALID = (1 << n for n in range(8))

# Fault classes (the high byte) and the protocol faults.
FAULT_PROTOCOL, FAULT_AZ_DRIVE, FAULT_EL_DRIVE, FAULT_LIMITS, FAULT_SAFETY = 0x0100, 0x0200, 0x0300, 0x0400, 0x0500
FAULT_MAP_ID = 0x0101
FAULT_CLASS = 0xFF00


class ByteOrder(StrEnum):
    MODBUS = ">"
    ETHERNET_IP = "<"


COMMAND_FORMAT = "HHHHIIiiIHH"
STATUS_FORMAT = "HHHHHHIIQI" + "IIII" * LATCH_DEPTH + "bbH"
STATIC_FORMAT = "IIHHihihihihiiIIHHHHHHI"
HISTORY_HEADER = "HHHI"
HISTORY_SAMPLE = "III"

_COMMAND = {order: Struct(order + COMMAND_FORMAT) for order in ByteOrder}
_STATUS = {order: Struct(order + STATUS_FORMAT) for order in ByteOrder}
_STATIC = {order: Struct(order + STATIC_FORMAT) for order in ByteOrder}


class TornRecord(ValueError):
    """The guards at both ends of a record differ: it was read while it was written. Discard it and read again."""


class ForeignRecord(ValueError):
    """The record is of another map."""


@dataclass(frozen=True, slots=True)
class CommandRecord:
    """32 bytes, O->T assembly 150, holding registers 0-15."""

    cmd_seq: int
    control: int
    mode: int
    az_cmd: int  # u32 fraction of a turn
    el_cmd: int
    az_vel: int  # i32 counts/ms
    el_vel: int
    cmd_time_us: int  # low word of the controller's clock
    watchdog_ms: int
    map_id: int = MAP_ID


@dataclass(frozen=True, slots=True)
class LatchRecord:
    """One edge: bits 0-30 of `index` count exposures, bit 31 is the falling edge."""

    index: int
    az: int
    el: int
    t_us: int


@dataclass(frozen=True, slots=True)
class StatusRecord:
    """100 bytes, T->O assembly 100, holding and input registers 100-149."""

    status_seq: int
    status: int
    fault: int
    cmd_seq_echo: int
    cmd_age_ms: int
    az_live: int
    el_live: int
    clock_us: int
    latch_total: int
    latches: tuple[LatchRecord, ...]  # newest first, at most LATCH_DEPTH; an empty place has t_us = index = 0
    az_turns: int
    el_turns: int
    map_id: int = MAP_ID


@dataclass(frozen=True, slots=True)
class StaticRecord:
    """What does not change while enabled: assembly 102, holding registers 200-247 (the rest of them is 0)."""

    serial: int
    firmware: tuple[int, int]
    az_min: tuple[int, int]  # (i32 counts, whole turns)
    az_max: tuple[int, int]
    el_min: tuple[int, int]
    el_max: tuple[int, int]
    max_speed: int  # i32 counts/ms
    max_acceleration: int  # i32 counts/ms^2
    latch_delay_ns: int
    encoder_delay_ns: int
    cycle_us: int
    ring_depth: int
    watchdog_min_ms: int
    watchdog_default_ms: int
    watchdog_max_ms: int
    clock_source: int  # 0 free, 1 PTP, 2 CIP Sync
    clock_quality_ns: int
    word_order: int = WORD_ORDER_PROBE


def counts(angle_rad: float) -> tuple[int, int]:
    """(u32 fraction, whole turns) of an angle; the fraction read as int32 is -180..+180 deg."""
    total = round(angle_rad / RAD_PER_COUNT)
    turns = (total + (1 << 31)) >> 32
    return total & LOW_WORD, turns


def angle(fraction: int, turns: int = 0) -> float:
    """Radians of a u32 fraction and whole turns."""
    return (signed(fraction) + turns * COUNTS_PER_TURN) * RAD_PER_COUNT


def signed(word: int) -> int:
    """A u32 read as int32."""
    return ((word + (1 << 31)) & LOW_WORD) - (1 << 31)


def nearest_angle(fraction: int, near_rad: float) -> float:
    """The angle with this fraction that is nearest to a known one (differences are modulo a turn)."""
    reference = round(near_rad / RAD_PER_COUNT)
    return (reference + signed((fraction - reference) & LOW_WORD)) * RAD_PER_COUNT


def counts_per_ms(rad_s: float) -> int:
    """i32 speed, clamped to its range."""
    value = round(rad_s / RAD_PER_COUNT / 1000.0)
    return max(-(1 << 31), min((1 << 31) - 1, value))


def rad_per_s(counts_ms: int) -> float:
    return counts_ms * RAD_PER_COUNT * 1000.0


def unwrap(low_word: int, near: int) -> int:
    """The value with this low word (32 bits) that is nearest to a known one."""
    return near + signed((low_word - near) & LOW_WORD)


def encode_command(r: CommandRecord, order: ByteOrder) -> bytes:
    return _COMMAND[order].pack(
        r.map_id, r.cmd_seq, r.control, r.mode, r.az_cmd, r.el_cmd, r.az_vel, r.el_vel,
        r.cmd_time_us, r.watchdog_ms, r.cmd_seq,
    )  # fmt: skip


def decode_command(data: bytes, order: ByteOrder) -> CommandRecord:
    """Raises TornRecord. A foreign map id is the controller's to refuse with fault 0x0101, so it is passed on."""
    map_id, seq, control, mode, az, el, az_vel, el_vel, t_us, watchdog, guard = _COMMAND[order].unpack(data)
    if seq != guard:
        raise TornRecord(f"command record: cmd_seq {seq}, copy {guard}")
    return CommandRecord(seq, control, mode, az, el, az_vel, el_vel, t_us, watchdog, map_id)


def encode_status(r: StatusRecord, order: ByteOrder) -> bytes:
    ring = (*r.latches, *(LatchRecord(0, 0, 0, 0),) * LATCH_DEPTH)[:LATCH_DEPTH]
    words = [word for latch in ring for word in (latch.index, latch.az, latch.el, latch.t_us)]
    return _STATUS[order].pack(
        r.map_id, r.status_seq, r.status, r.fault, r.cmd_seq_echo, r.cmd_age_ms, r.az_live, r.el_live,
        r.clock_us, r.latch_total, *words, r.az_turns, r.el_turns, r.status_seq,
    )  # fmt: skip


def decode_status(data: bytes, order: ByteOrder) -> StatusRecord:
    """Raises TornRecord or ForeignRecord. Places of the ring that were never written are left out."""
    map_id, seq, status, fault, echo, age, az, el, clock_us, total, *rest = _STATUS[order].unpack(data)
    *words, az_turns, el_turns, guard = rest
    if map_id != MAP_ID:
        raise ForeignRecord(f"status record: map id 0x{map_id:04x}, expected 0x{MAP_ID:04x}")
    if seq != guard:
        raise TornRecord(f"status record: status_seq {seq}, copy {guard}")
    ring = (LatchRecord(*words[4 * n : 4 * n + 4]) for n in range(LATCH_DEPTH))
    latches = tuple(latch for latch in ring if latch.index or latch.t_us)
    return StatusRecord(seq, status, fault, echo, age, az, el, clock_us, total, latches, az_turns, el_turns)


def encode_static(r: StaticRecord, order: ByteOrder) -> bytes:
    packed = _STATIC[order].pack(
        r.word_order, r.serial, *r.firmware, *r.az_min, *r.az_max, *r.el_min, *r.el_max,
        r.max_speed, r.max_acceleration, r.latch_delay_ns, r.encoder_delay_ns, r.cycle_us, r.ring_depth,
        r.watchdog_min_ms, r.watchdog_default_ms, r.watchdog_max_ms, r.clock_source, r.clock_quality_ns,
    )  # fmt: skip
    return packed.ljust(2 * STATIC_WORDS, b"\0")


def decode_static(data: bytes, order: ByteOrder) -> StaticRecord:
    """Raises ForeignRecord where the word-order probe does not read as it should."""
    f = _STATIC[order].unpack_from(data)
    if f[0] != WORD_ORDER_PROBE:
        raise ForeignRecord(f"static record: word-order probe 0x{f[0]:08x}, expected 0x{WORD_ORDER_PROBE:08x}")
    return StaticRecord(f[1], (f[2], f[3]), (f[4], f[5]), (f[6], f[7]), (f[8], f[9]), (f[10], f[11]), *f[12:])


def encode_history(sequence: int, period_us: int, samples: list[tuple[int, int, int]], order: ByteOrder) -> bytes:
    """Encoder history: header (map_id, count, sequence, u32 period_us), then up to 20 samples (t_us, az, el), newest first."""
    head = pack(order + HISTORY_HEADER, MAP_ID, len(samples), sequence & 0xFFFF, period_us)
    body = b"".join(pack(order + HISTORY_SAMPLE, *sample) for sample in samples[:HISTORY_DEPTH])
    return (head + body).ljust(2 * HISTORY_WORDS, b"\0")


def decode_history(data: bytes, order: ByteOrder) -> list[tuple[int, int, int]]:
    """Samples (t_us, az, el), newest first. Raises ForeignRecord."""
    map_id, count, _, _ = unpack(order + HISTORY_HEADER, data[:10])
    if map_id != MAP_ID or count > HISTORY_DEPTH:
        raise ForeignRecord(f"history record: map id 0x{map_id:04x}, {count} samples")
    return [unpack(order + HISTORY_SAMPLE, data[10 + 12 * n : 22 + 12 * n]) for n in range(count)]


def registers_from_bytes(data: bytes) -> list[int]:
    """Modbus registers of a big-endian record."""
    return list(unpack(f">{len(data) // 2}H", data))


def bytes_from_registers(registers: list[int]) -> bytes:
    return pack(f">{len(registers)}H", *registers)
