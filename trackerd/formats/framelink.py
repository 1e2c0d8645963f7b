"""How the twin hands frames to the `synthetic` camera driver: shared memory with a doorbell. Bytes only, no sockets.

Over a Unix socket of type SOCK_SEQPACKET, every packet is one message. The driver sends JSON requests: {"do": "open"}, {"do":
"start"}, {"do": "stop"}; each is answered by one JSON object (an error as {"error": text}); the answer to "open" carries
`Offer` and, as an SCM_RIGHTS descriptor, a memory file with `slots` slots. Between "start" and the answer to "stop" the twin
rings one binary `Doorbell` a frame. A slot is SLOT_HEADER bytes (u64: frame id + 1; 0 while it is being written), then the
image, row by row: a reader compares the header with its doorbell before and after copying, so that an overwritten slot is never
taken for a frame.
"""

import json
from dataclasses import asdict, dataclass
from struct import Struct
from typing import Any

SLOT_HEADER = 64  # one cache line
SLOTS = 8
MAGIC = b"TDFR"
_DOORBELL = Struct("<4sIqqqqIIiiI")


@dataclass(frozen=True, slots=True)
class Offer:
    """What a camera of the twin is, as the answer to "open"."""

    camera: str
    serial: str
    sensor_width: int
    sensor_height: int
    width: int
    height: int
    bytes_per_pixel: int
    exposure_ns: int
    frame_rate_hz: float
    transfer_ns: int  # end of exposure -> frame complete
    slots: int
    slot_bytes: int  # header included


@dataclass(frozen=True, slots=True)
class Doorbell:
    slot: int
    frame_id: int  # exposures since "start", from 0; a dropped frame leaves a gap
    mid_exposure_ns: int  # the simulated camera's own clock
    due_ns: int  # CLOCK_MONOTONIC: when exposure, readout and transfer were over, and the frame was due
    rung_ns: int  # CLOCK_MONOTONIC: when it was handed over; later than due = the render's overrun
    exposure_ns: int
    width: int
    height: int
    origin_x: int
    origin_y: int


def pack_doorbell(d: Doorbell) -> bytes:
    return _DOORBELL.pack(
        MAGIC, d.slot, d.frame_id, d.mid_exposure_ns, d.due_ns, d.rung_ns,
        d.exposure_ns, d.width, d.origin_x, d.origin_y, d.height,
    )  # fmt: skip


def unpack_doorbell(packet: bytes) -> Doorbell | None:
    """None: the packet is not a doorbell."""
    if len(packet) != _DOORBELL.size or packet[:4] != MAGIC:
        return None
    _, slot, frame_id, mid, due, rung, exposure, width, x, y, height = _DOORBELL.unpack(packet)
    return Doorbell(slot, frame_id, mid, due, rung, exposure, width, height, x, y)


def pack_message(**message: Any) -> bytes:
    return json.dumps(message).encode()


def unpack_message(packet: bytes) -> dict[str, Any]:
    """Raises ValueError where the packet is no JSON object."""
    message = json.loads(packet)
    if not isinstance(message, dict):
        raise ValueError(f"not a message: {packet[:40]!r}")
    return message


def offer_fields(offer: Offer) -> dict[str, Any]:
    return asdict(offer)
