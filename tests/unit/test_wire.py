"""Keys and payloads on Zenoh."""

import json
import re
from dataclasses import dataclass, replace
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trackerd.contract.clock import HostNs, ManualClock
from trackerd.contract.model import AxisMode, Fix, FixState, GimbalFlag, Source
from trackerd.formats import wire
from trackerd.formats.calibration import Standing
from trackerd.formats.settings import ZenohSettings
from trackerd.formats.wire import (
    POSITION_SCHEMA,
    STATUS_SCHEMA,
    answer,
    decode,
    encode,
    fix_message,
    keys,
    plain,
    status_message,
    token_key,
    token_pattern,
)

MS = 1_000_000
EXPOSED = HostNs(5_000 * MS)
UNTIL = HostNs(EXPOSED + 55 * MS)
DOCUMENTED = re.findall(r"^\| (\w+(?:, \w+)*) \|", wire.__doc__ or "", re.MULTILINE)[1:]

GOOD = Fix(
    sequence=7,
    instant=EXPOSED,
    state=FixState.TRACKING,
    position_mm=np.array((1.0, -2.0, 0.1)),
    velocity_mm_s=np.array((250.0, 0.0, 1e-3)),
    cov_mm2=np.diag((0.0004, 0.0009, 0.0025)),
    systematic_cov_mm2=np.diag((0.0001, 0.0, 0.0)),
    miss_mm=0.012,
    stations=("left", "right"),
    received=HostNs(EXPOSED + 10 * MS),
)
NOWHERE = replace(
    GOOD,
    state=FixState.SEARCHING,
    position_mm=np.full(3, np.nan),
    velocity_mm_s=np.full(3, np.nan),
    cov_mm2=np.full((3, 3), np.inf),
    systematic_cov_mm2=np.full((3, 3), np.nan),
    miss_mm=float("nan"),
    stations=(),
)


VERIFIED = Standing("demo-1", forced=False, verified=True, expired=False, notes=())


def message(fix: Fix = GOOD, after_ms: int = 14, source: Source = Source.LIVE, standing: Standing = VERIFIED) -> dict[str, Any]:
    return fix_message(fix, ManualClock(HostNs(fix.instant + after_ms * MS)), UNTIL, source, standing)


def test_a_live_cell_uses_the_configured_key() -> None:
    found = keys(ZenohSettings(key="/probe/position"), Source.LIVE)
    assert (found.position, found.status) == ("probe/position", "probe/status")
    assert (found.arm, found.select) == ("probe/command/arm", "probe/command/select")


@pytest.mark.parametrize(("source", "prefix"), [(Source.TWIN, "twin"), (Source.REPLAY, "replay")])
def test_a_twin_and_a_replay_stay_below_their_prefix(source: Source, prefix: str) -> None:
    found = keys(ZenohSettings(), source)
    assert (found.position, found.status) == (f"{prefix}/probe/position", f"{prefix}/probe/status")
    assert (found.arm, found.select) == (f"{prefix}/probe/command/arm", f"{prefix}/probe/command/select")


@pytest.mark.parametrize("source", Source)
def test_any_source_may_use_the_key_where_that_is_allowed(source: Source) -> None:
    assert keys(ZenohSettings(allow_live_key=True), source).position == "probe/position"


def test_a_key_of_one_chunk_has_siblings_too() -> None:
    assert keys(ZenohSettings(key="position"), Source.LIVE).status == "status"


def test_the_pattern_finds_every_publishers_token() -> None:
    zenoh = pytest.importorskip("zenoh")
    pattern = zenoh.KeyExpr(token_pattern("probe/position"))
    assert pattern.intersects(zenoh.KeyExpr(token_key("probe/position", "1a2b")))
    assert not pattern.intersects(zenoh.KeyExpr(token_key("twin/probe/position", "1a2b")))
    assert not pattern.intersects(zenoh.KeyExpr("probe/position"))


def test_a_position_has_the_documented_keys_in_their_order() -> None:
    documented = [key for row in DOCUMENTED for key in row.split(", ")]
    assert list(message()) == documented
    assert list(message(NOWHERE)) == documented


def test_a_position_says_when_it_was_where() -> None:
    found = decode(encode(message()))
    assert found["schema"] == POSITION_SCHEMA
    assert found["t_unix_ns"] == 1_700_000_000_000_000_000 + EXPOSED
    assert found["t_published_unix_ns"] - found["t_unix_ns"] == 14 * MS
    assert found["valid_until_unix_ns"] - found["t_unix_ns"] == 55 * MS
    assert found["age_ms"] == 14.0
    assert found["position_mm"] == [1.0, -2.0, 0.1]
    assert found["sigma_mm"] == pytest.approx([0.02, 0.03, 0.05])
    assert (found["frame"], found["unit"], found["point"]) == ("W", "mm", "sphere_centre")
    assert (found["valid"], found["reasons"], found["state"]) == (True, [], "tracking")
    assert found["stations"] == ["left", "right"]


@pytest.mark.parametrize("source", Source)
def test_every_position_says_its_source(source: Source) -> None:
    assert message(source=source)["source"] == source.value


def test_every_position_says_how_far_its_calibration_may_be_trusted_and_stays_valid() -> None:
    doubtful = Standing("c-7", forced=True, verified=False, expired=True, notes=("forced: haste", "expired: 2025-06-01"))
    for fix in (GOOD, NOWHERE):
        found = decode(encode(message(fix, standing=doubtful)))
        assert (found["calibration_id"], found["calibration"]) == (
            "c-7",
            {
                "id": "c-7",
                "forced": True,
                "verified": False,
                "expired": True,
                "notes": ["forced: haste", "expired: 2025-06-01"],
            },
        )
    assert message(standing=doubtful)["valid"]
    assert message()["calibration"] == {"id": "demo-1", "forced": False, "verified": True, "expired": False, "notes": []}


def test_a_fix_with_reasons_is_not_valid() -> None:
    found = message(replace(GOOD, reasons=("unconfirmed",)))
    assert (found["valid"], found["reasons"]) == (False, ["unconfirmed"])
    assert found["position_mm"] is not None


def test_without_a_position_everything_measured_is_null() -> None:
    found = decode(encode(message(NOWHERE)))
    measured = ("position_mm", "velocity_mm_s", "covariance_mm2", "systematic_covariance_mm2", "sigma_mm", "miss_mm")
    assert [found[key] for key in measured] == [None] * 6
    assert (found["valid"], found["reasons"]) == (False, ["no position"])


def test_the_reasons_of_a_lost_target_are_kept() -> None:
    assert message(replace(NOWHERE, reasons=("left: clipped at the left edge",)))["reasons"] == [
        "left: clipped at the left edge"
    ]


def test_a_fix_published_too_late_is_stale() -> None:
    assert (message(after_ms=55)["valid"], message(after_ms=56)["valid"]) == (True, False)
    assert message(after_ms=56)["reasons"] == ["stale"]


def test_an_answer_has_its_own_age_and_validity() -> None:
    last = message()
    fresh = answer(last, last["t_unix_ns"] + 55 * MS)
    old = answer(last, last["t_unix_ns"] + 2_000 * MS)
    assert (fresh["age_ms"], fresh["valid"], fresh["reasons"]) == (55.0, True, [])
    assert (old["age_ms"], old["valid"], old["reasons"]) == (2000.0, False, ["stale"])
    assert answer(old, last["t_unix_ns"] + 3_000 * MS)["reasons"] == ["stale"]
    assert last == message(), "the kept message must not change"


@given(st.lists(st.floats(), min_size=12, max_size=12), st.floats())
def test_no_position_ever_holds_what_json_cannot_write(values: list[float], miss: float) -> None:
    fix = replace(
        GOOD,
        position_mm=np.array(values[:3]),
        velocity_mm_s=np.array(values[3:6]),
        cov_mm2=np.diag(values[6:9]),
        systematic_cov_mm2=np.diag(values[9:]),
        miss_mm=miss,
    )
    found = decode(encode(message(fix)))
    assert found["position_mm"] == (values[:3] if np.isfinite(values[:3]).all() else None)
    assert found["valid"] == bool(np.isfinite(values[:3]).all())


FOREIGN = [
    b"",
    b"\xff\xfe",
    b"null",
    b"[1, 2]",
    b"{}",
    b'{"schema": "trackerd/position/2"}',
    b'{"schema": ["trackerd/position/1"]}',
    b'{"schema": "trackerd/position/1", "age_ms": NaN}',
    b'{"schema": "trackerd/position/1"',
    b"[" * 100_000,
]


@pytest.mark.parametrize("payload", FOREIGN, ids=range(len(FOREIGN)))
def test_foreign_bytes_are_refused(payload: bytes) -> None:
    with pytest.raises(ValueError, match=r"\w"):
        decode(payload)


@given(st.binary(max_size=300))
def test_any_bytes_are_decoded_or_refused(payload: bytes) -> None:
    with pytest.raises(ValueError, match=r"\w"):
        decode(payload)


class Colour(Enum):
    RED = 1


@dataclass(frozen=True, slots=True)
class Device:
    state: FixState
    flags: GimbalFlag
    mode: AxisMode
    rate_hz: float
    angles: np.ndarray[Any, Any]
    reasons: tuple[str, ...]
    path: Path


def test_a_status_is_made_of_whatever_its_devices_tell() -> None:
    device = Device(
        FixState.COASTING,
        GimbalFlag.READY | GimbalFlag.HOMED,
        AxisMode.HOLD,
        float("nan"),
        np.array((1.0, np.inf)),
        ("late",),
        Path("/tmp/x"),
    )
    status = {"gimbals": {"left": device}, "count": np.int64(3), "names": {"b", "a"}, "none": None, Colour.RED: np.float64(0.5)}
    found = decode(encode(status_message(status, ManualClock(EXPOSED), Source.TWIN)))
    assert (found["schema"], found["source"]) == (STATUS_SCHEMA, "twin")
    assert found["t_published_unix_ns"] == 1_700_000_000_000_000_000 + EXPOSED
    assert found["gimbals"]["left"] == {
        "state": "coasting",
        "flags": ["ready", "homed"],
        "mode": "hold",
        "rate_hz": None,
        "angles": [1.0, None],
        "reasons": ["late"],
        "path": "/tmp/x",
    }
    assert (found["count"], found["names"], found["none"], found["1"]) == (3, ["a", "b"], None, 0.5)


def test_what_has_no_form_in_json_is_refused_when_it_is_made_not_on_the_wire() -> None:
    with pytest.raises(TypeError, match="a object has no form in JSON"):
        plain(object())


def test_encoded_messages_are_plain_json() -> None:
    assert json.loads(encode(message())) == message()
