"""The controller's records that need no state of its own."""

from trackerd.formats.gimbal_map import LATCH_DEPTH, ByteOrder, StaticRecord, counts, counts_per_ms, encode_static, signed
from trackerd.twin.axes import Axes

WATCHDOG_MIN_MS, WATCHDOG_DEFAULT_MS, WATCHDOG_MAX_MS = 5, 50, 1000
FIRMWARE = (1, 1)
CYCLE_US = 0  # no cycle: every status is made when it is asked for
CLOCK_FREE = 0


def static_record(serial: int, axes: Axes) -> bytes:
    """The static block, 96 bytes."""
    (az_low, az_high), (el_low, el_high) = axes.limits_rad
    record = StaticRecord(
        serial=serial,
        firmware=FIRMWARE,
        az_min=_counts_and_turns(az_low),
        az_max=_counts_and_turns(az_high),
        el_min=_counts_and_turns(el_low),
        el_max=_counts_and_turns(el_high),
        max_speed=counts_per_ms(axes.max_rad_s),
        max_acceleration=counts_per_ms(axes.max_rad_s2 / 1000.0),
        latch_delay_ns=0,
        encoder_delay_ns=0,
        cycle_us=CYCLE_US,
        ring_depth=LATCH_DEPTH,
        watchdog_min_ms=WATCHDOG_MIN_MS,
        watchdog_default_ms=WATCHDOG_DEFAULT_MS,
        watchdog_max_ms=WATCHDOG_MAX_MS,
        clock_source=CLOCK_FREE,
        clock_quality_ns=0,
    )
    return encode_static(record, ByteOrder.MODBUS)


def torn(status: bytes) -> bytes:
    """A status record as it reads while it is being written: the guard at its end is still the one before."""
    guard = int.from_bytes(status[-2:], "big")
    return status[:-2] + ((guard - 1) & 0xFFFF).to_bytes(2, "big")


def _counts_and_turns(angle_rad: float) -> tuple[int, int]:
    fraction, turns = counts(angle_rad)
    return signed(fraction), turns
