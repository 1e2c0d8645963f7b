"""What the cell says on Zenoh: keys and JSON payloads, as pure functions.

A position, schema "trackerd/position/1", is UTF-8 JSON. Keys may be added; none changes its meaning within a schema. NaN never
appears: what is not known is null.

| key | value |
|---|---|
| schema | "trackerd/position/1" |
| sequence | counts the fixes of this run, from 0; a gap is a message that was dropped on its way |
| t_unix_ns | Unix time of the exposure that the position refers to, ns |
| t_received_unix_ns | Unix time at which the last frame behind it was complete in the driver, ns |
| t_published_unix_ns | Unix time of publication, ns |
| age_ms | publication (or the answer to a query) minus exposure |
| state | "searching", "unconfirmed", "tracking" or "coasting" |
| valid | true: may be acted upon, until valid_until_unix_ns. Always check both |
| reasons | why it is not valid, in words; empty when it is |
| frame, unit, point | "W" (the world of the calibration), "mm", "sphere_centre" |
| position_mm | [x, y, z], or null without a position |
| velocity_mm_s | [x, y, z], or null |
| covariance_mm2 | of the position: 3 rows of 3, random and systematic part together, or null |
| systematic_covariance_mm2 | the part that averaging does not reduce, or null |
| sigma_mm | roots of the covariance's diagonal, or null |
| miss_mm | distance of the two lines of sight (more: their rms distance from the position), or null |
| stations | the stations whose lines of sight it stands on |
| valid_until_unix_ns | Unix time after which it is stale whatever `valid` says, ns |
| source | "live", "twin" or "replay": where the photons came from |
| calibration_id | the calibration's id |
| calibration | its standing: id; forced, past its own chi-square; verified, by check points; expired; notes, in words |

A position on a calibration that was forced, was never verified or has expired is not refused for it: it says so, and whoever
acts upon it decides. `verified` is false where it has expired.

A status, schema "trackerd/status/1", holds schema, source, t_published_unix_ns, and what each device and task tells of itself.
"""

import json
from collections.abc import Mapping, Set
from dataclasses import dataclass, fields, is_dataclass
from enum import Enum, Flag, IntEnum
from math import isfinite, sqrt
from pathlib import PurePath
from typing import Any, NoReturn, TypeAlias

import numpy as np
from pydantic_core import to_json

from trackerd.contract.clock import Clock, HostNs
from trackerd.contract.model import Array, Fix, Source
from trackerd.formats.calibration import Standing
from trackerd.formats.settings import ZenohSettings

POSITION_SCHEMA = "trackerd/position/1"
STATUS_SCHEMA = "trackerd/status/1"
SCHEMAS = (POSITION_SCHEMA, STATUS_SCHEMA)
STALE = "stale"

Message: TypeAlias = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Keys:
    """Where one cell talks: siblings of its position's key."""

    position: str
    status: str
    arm: str
    select: str


def keys(zenoh: ZenohSettings, source: Source) -> Keys:
    """The configured keys for a live cell; a twin and a replay stay below their prefix unless they are allowed out."""
    position = live_key(zenoh, source)
    parent = position.rpartition("/")[0]
    base = f"{parent}/" if parent else ""
    return Keys(position, f"{base}status", f"{base}command/arm", f"{base}command/select")


def live_key(zenoh: ZenohSettings, source: Source) -> str:
    """The key of the position."""
    if source is Source.LIVE or zenoh.allow_live_key:
        return zenoh.key
    prefix = zenoh.twin_prefix if source is Source.TWIN else zenoh.replay_prefix
    return f"{prefix}/{zenoh.key}"


def token_key(key: str, zid: str) -> str:
    """The liveliness token of the session that publishes on a key."""
    return f"{key}/alive/{zid}"


def token_pattern(key: str) -> str:
    """Matches the token of every publisher on a key."""
    return f"{key}/alive/*"


def fix_message(fix: Fix, clock: Clock, valid_until: HostNs, source: Source, calibration: Standing) -> Message:
    """The message for a fix that is published now. Past `valid_until` it is stale already."""
    now = clock.now()
    exposed, until = clock.unix(fix.instant), clock.unix(valid_until)
    known = bool(np.isfinite(fix.position_mm).all())
    message: Message = {
        "schema": POSITION_SCHEMA,
        "sequence": fix.sequence,
        "t_unix_ns": exposed,
        "t_received_unix_ns": clock.unix(fix.received),
        "t_published_unix_ns": clock.unix(now),
        "age_ms": (now - fix.instant) / 1e6,
        "state": fix.state.value,
        "valid": fix.valid and known,
        "reasons": list(fix.reasons) if fix.reasons or known else ["no position"],
        "frame": "W",
        "unit": "mm",
        "point": "sphere_centre",
        "position_mm": fix.position_mm.tolist() if known else None,
        "velocity_mm_s": _numbers(fix.velocity_mm_s) if known else None,
        "covariance_mm2": _numbers(fix.cov_mm2) if known else None,
        "systematic_covariance_mm2": _numbers(fix.systematic_cov_mm2) if known else None,
        "sigma_mm": _sigmas(fix.cov_mm2) if known else None,
        "miss_mm": float(fix.miss_mm) if isfinite(fix.miss_mm) else None,
        "stations": list(fix.stations),
        "valid_until_unix_ns": until,
        "source": source.value,
        "calibration_id": calibration.id,
        "calibration": plain(calibration),
    }
    if now > valid_until:
        _mark_stale(message)
    return message


def answer(message: Message, now_unix_ns: int) -> Message:
    """The message as it is true now, for a query: its age has grown, and past valid_until_unix_ns it is stale."""
    current = message | {"age_ms": (now_unix_ns - message["t_unix_ns"]) / 1e6, "reasons": list(message["reasons"])}
    if now_unix_ns > message["valid_until_unix_ns"]:
        _mark_stale(current)
    return current


def status_message(status: Any, clock: Clock, source: Source) -> Message:
    """The message for a status: a mapping or a dataclass, nested as it likes."""
    head = {"schema": STATUS_SCHEMA, "source": source.value, "t_published_unix_ns": clock.unix(clock.now())}
    return head | dict(plain(status))


def encode(message: Mapping[str, Any]) -> bytes:
    """UTF-8 JSON; a number that JSON cannot write becomes null."""
    return to_json(message, inf_nan_mode="null")


def decode(payload: bytes) -> Message:
    """A position or a status. Raises ValueError for anything else, in words."""
    try:
        message = json.loads(payload.decode(), parse_constant=_refuse_constant)
    except RecursionError:
        raise ValueError("nested too deeply for a message of trackerd") from None
    if not isinstance(message, dict) or message.get("schema") not in SCHEMAS:
        found = message.get("schema") if isinstance(message, dict) else type(message).__name__
        raise ValueError(f"no message of trackerd: schema {found!r}, expected one of {', '.join(SCHEMAS)}")
    return message


def plain(value: Any) -> Any:
    """Dataclasses, enums, arrays and paths as JSON has them. Raises TypeError for what has no such form."""
    if is_dataclass(value):
        return {field.name: plain(getattr(value, field.name)) for field in fields(value)}
    match value:
        case Mapping():
            return {str(plain(key)): plain(item) for key, item in value.items()}
        case list() | tuple():
            return [plain(item) for item in value]
        case Set():
            return sorted(plain(item) for item in value)
        case np.ndarray() | np.generic():
            return plain(value.tolist())
    return _plain_scalar(value)


def _plain_scalar(value: Any) -> Any:
    match value:
        case Flag():
            return [member.name.lower() for member in value if member.name]
        case IntEnum():
            return value.name.lower()
        case Enum():
            return plain(value.value)
        case None | bool() | int() | str():
            return value
        case float():
            return value if isfinite(value) else None
        case PurePath():
            return str(value)
    raise TypeError(f"a {type(value).__name__} has no form in JSON")


def _mark_stale(message: Message) -> None:
    message["valid"] = False
    if STALE not in message["reasons"]:
        message["reasons"].append(STALE)


def _numbers(values: Array) -> Any:
    """Nested lists, or None where a number is missing."""
    return values.tolist() if np.isfinite(values).all() else None


def _sigmas(cov: Array) -> list[float] | None:
    variances = cov.diagonal().tolist()
    return [sqrt(v) for v in variances] if all(isfinite(v) and v >= 0.0 for v in variances) else None


def _refuse_constant(name: str) -> NoReturn:
    raise ValueError(f"{name} is not JSON")
