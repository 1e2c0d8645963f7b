"""What the cell says and hears, over real Zenoh sessions on loopback."""

import asyncio
import json
import socket
from collections.abc import AsyncIterator, Iterator
from contextlib import closing, contextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zenoh

from trackerd.contract.clock import HostNs, ManualClock
from trackerd.contract.errors import ConfigError
from trackerd.contract.model import Fix, FixState, Source
from trackerd.formats import wire
from trackerd.formats.calibration import Calibration, Verification
from trackerd.formats.settings import ZenohSettings
from trackerd.service.commands import Commands
from trackerd.service.outlet import Outlet
from trackerd.service.zenoh_link import ZenohLink, open_link
from trackerd.service.zenoh_session import RefusedStart, open_towards

MS = 1_000_000
PATIENCE_S = 10.0
VALID_NS = 55 * MS


def free_endpoint() -> str:
    with closing(socket.create_server(("127.0.0.1", 0))) as server:
        return f"tcp/127.0.0.1:{server.getsockname()[1]}"


@pytest.fixture
def settings() -> ZenohSettings:
    return ZenohSettings(listen=(free_endpoint(),))


@pytest.fixture
async def link(settings: ZenohSettings) -> AsyncIterator[ZenohLink]:
    with open_link(settings, Source.LIVE) as opened:
        yield opened


@contextmanager
def visitor(settings: ZenohSettings) -> Iterator[zenoh.Session]:
    """An ordinary session that connects to the daemon."""
    session = open_towards(settings)
    try:
        yield session
    finally:
        session.close()


async def ask(session: zenoh.Session, key: str, payload: bytes | None) -> tuple[bool, Any]:
    """(answered, the reply's JSON)."""
    [reply] = await asyncio.to_thread(lambda: list(session.get(key, payload=payload, timeout=PATIENCE_S)))
    good = reply.ok is not None
    return good, json.loads((reply.ok if good else reply.err).payload.to_bytes())


async def until(condition: Any) -> None:
    async with asyncio.timeout(PATIENCE_S):
        while not condition():  # noqa: ASYNC110 - Zenoh's threads set no event of the loop
            await asyncio.sleep(0)


# ---- publications and answers ----------------------------------------------------------------------------------------


async def test_positions_and_status_are_heard_by_an_ordinary_subscriber(link: ZenohLink, settings: ZenohSettings) -> None:
    heard: dict[str, bytes] = {}
    with visitor(settings) as session:
        subscriber = session.declare_subscriber("probe/*", lambda s: heard.update({str(s.key_expr): s.payload.to_bytes()}))
        async with asyncio.timeout(PATIENCE_S):
            while len(heard) < 2:
                link.put_position(b'{"a": 1}')
                link.put_status(b'{"b": 2}')
                await asyncio.sleep(0)
        assert heard == {"probe/position": b'{"a": 1}', "probe/status": b'{"b": 2}'}
        subscriber.undeclare()


async def test_a_query_is_answered_on_the_loop_and_an_error_comes_back_in_words(
    link: ZenohLink, settings: ZenohSettings
) -> None:
    loop = asyncio.get_running_loop()

    def answer(request: dict[str, Any]) -> dict[str, Any]:
        assert asyncio.get_running_loop() is loop
        if request.get("bad"):
            raise ValueError("no gimbal 'middle'")
        return {"heard": request}

    link.answer("probe/command/arm", answer)
    with visitor(settings) as session:
        assert await ask(session, "probe/command/arm", None) == (True, {"heard": {}})
        assert await ask(session, "probe/command/arm", b'{"gimbal": "left"}') == (True, {"heard": {"gimbal": "left"}})
        assert await ask(session, "probe/command/arm", b'{"bad": true}') == (False, {"error": "no gimbal 'middle'"})
        for payload, words in (
            (b"[1]", "must be a JSON object"),
            (b"{", "Expecting"),
            (b"\xff", "decode"),
            (b"[" * 100_000, "recursion"),
        ):
            answered, told = await ask(session, "probe/command/arm", payload)
            assert not answered
            assert words in told["error"]


# ---- one publisher a key ---------------------------------------------------------------------------------------------


async def test_a_second_publisher_on_the_key_is_refused(link: ZenohLink, settings: ZenohSettings) -> None:
    second = ZenohSettings(mode="client", listen=(), connect=settings.listen)
    with (
        pytest.raises(RefusedStart, match=r"\[zenoh\] key = probe/position: another publisher is alive on it"),
        open_link(second, Source.LIVE),
    ):
        pass


async def test_a_twin_beside_a_live_cell_is_not_refused(link: ZenohLink, settings: ZenohSettings) -> None:
    with open_link(ZenohSettings(mode="client", listen=(), connect=settings.listen), Source.TWIN) as twin:
        assert twin.keys.position == "twin/probe/position"
    assert not link.others


async def test_a_publisher_that_appears_later_is_noticed_until_it_is_gone(link: ZenohLink, settings: ZenohSettings) -> None:
    with visitor(settings) as session:
        token = session.liveliness().declare_token(wire.token_key("probe/position", "abc"))
        await until(lambda: link.others == {"probe/position/alive/abc"})
        token.undeclare()
        await until(lambda: not link.others)


async def test_a_closed_link_gives_its_key_and_its_port_back(settings: ZenohSettings) -> None:
    for _ in range(2):
        with open_link(settings, Source.LIVE):
            pass


# ---- a session that cannot be opened ---------------------------------------------------------------------------------


def refused(settings: ZenohSettings, words: str, error: type[Exception]) -> None:
    with pytest.raises(error, match=words) as caught, open_link(settings, Source.LIVE):
        pass
    assert "/src/" not in str(caught.value), "nobody can act on where in Zenoh's sources it arose"
    assert "Message" not in str(caught.value)


async def test_a_port_that_is_taken_is_told_in_words(link: ZenohLink, settings: ZenohSettings) -> None:
    refused(settings, r"\[zenoh\] listen = tcp/127.0.0.1:\d+: the port is taken by another process", RefusedStart)


@pytest.mark.parametrize(
    ("endpoint", "words", "error"),
    [
        ("garbage", "Endpoints must be of the form", ConfigError),
        ("tcp/127.0.0.1:99999", "invalid port value", RefusedStart),
        ("carrier/127.0.0.1:7447", "not supported for carrier", RefusedStart),
        ("tcp/192.0.2.1:7447", "192.0.2.1", RefusedStart),
    ],
)
async def test_an_endpoint_that_cannot_be_is_told_in_words(endpoint: str, words: str, error: type[Exception]) -> None:
    refused(ZenohSettings(listen=(endpoint,)), rf"\[zenoh\] listen = .*{words}", error)


async def test_an_overlay_fills_in_what_has_no_key_and_the_keys_rule(tmp_path: Path) -> None:
    endpoint = free_endpoint()
    overlay = tmp_path / "zenoh.json5"
    overlay.write_text('{mode: "router", id: "a0b", listen: {endpoints: ["tcp/127.0.0.1:1"]}}')
    with open_link(ZenohSettings(listen=(endpoint,), overlay=overlay), Source.LIVE) as opened:
        assert str(opened.session.info.zid()) == "a0b"


@pytest.mark.parametrize("text", [None, "{", '{transport: "none"}'], ids=["missing", "no JSON", "foreign"])
async def test_a_wrong_overlay_names_the_key_and_the_file(tmp_path: Path, text: str | None) -> None:
    overlay = tmp_path / "zenoh.json5"
    if text is not None:
        overlay.write_text(text)
    refused(ZenohSettings(listen=(), overlay=overlay), rf"\[zenoh\] overlay = {overlay}: .+", ConfigError)


def test_a_visitor_finds_nobody_where_no_daemon_listens(settings: ZenohSettings) -> None:
    with pytest.raises(RefusedStart, match=r"nobody answers at tcp/127.0.0.1:\d+: is the daemon"), visitor(settings):
        pass


# ---- positions and their age -----------------------------------------------------------------------------------------

FIX = Fix(
    sequence=1,
    instant=HostNs(1_000 * MS),
    state=FixState.TRACKING,
    position_mm=np.array((1.0, 2.0, 3.0)),
    velocity_mm_s=np.zeros(3),
    cov_mm2=np.eye(3) * 1e-4,
    systematic_cov_mm2=np.zeros((3, 3)),
    miss_mm=0.01,
    stations=("left", "right"),
    received=HostNs(1_008 * MS),
)

EXPIRES = datetime.fromtimestamp(1_700_000_001, UTC) + timedelta(milliseconds=30)
CHECKED = Verification("2023-11-01", points=12, rms_mm=0.04, max_mm=0.09, en_max=0.8, expires=EXPIRES.isoformat())
CALIBRATION = Calibration("c-7", "2023-11-01", "trackerd 0.1.0", "bundle", {}, verification=CHECKED)


@pytest.fixture
def outlet(link: ZenohLink) -> Outlet:
    """10 ms after the exposure."""
    clock = ManualClock(HostNs(1_010 * MS))
    return Outlet(link, clock, Source.LIVE, CALIBRATION, VALID_NS, lambda: {"cell": "demo"})


async def test_the_last_position_is_answered_with_the_age_and_validity_of_now(outlet: Outlet) -> None:
    with pytest.raises(ValueError, match="no position yet"):
        outlet.answer_position({})
    outlet.fix(FIX)
    assert (outlet.answer_position({})["age_ms"], outlet.answer_position({})["valid"]) == (10.0, True)
    outlet.clock.advance(0.050)  # type: ignore[attr-defined]
    late = outlet.answer_position({})
    assert (late["age_ms"], late["valid"], late["reasons"]) == (60.0, False, ["stale"])
    assert (outlet.fixes, outlet.valid_fixes) == (1, 1)
    assert outlet.published.percentiles().p50_ms == 2.0  # type: ignore[union-attr]


async def test_no_fix_is_valid_while_another_publisher_is_alive(outlet: Outlet) -> None:
    outlet.link.others.add("probe/position/alive/abc")
    outlet.fix(FIX)
    assert outlet.last is not None
    assert (outlet.last["valid"], outlet.last["reasons"]) == (False, ["another publisher is alive on probe/position"])
    outlet.link.others.clear()
    outlet.fix(FIX)
    assert outlet.last["valid"]
    assert (outlet.fixes, outlet.valid_fixes) == (2, 1)


async def test_the_status_says_its_schema_its_source_and_what_was_gathered(outlet: Outlet) -> None:
    found = outlet.answer_status({})
    assert (found["schema"], found["source"], found["cell"]) == (wire.STATUS_SCHEMA, "live", "demo")


async def test_a_calibration_that_expires_while_the_cell_runs_is_told_in_every_message_from_then_on(outlet: Outlet) -> None:
    good = {"id": "c-7", "forced": False, "verified": True, "expired": False, "notes": []}
    old = {**good, "verified": False, "expired": True, "notes": [f"expired: {EXPIRES.isoformat()}"]}
    outlet.fix(FIX)
    assert outlet.last is not None
    assert outlet.last["calibration"] == outlet.answer_status({})["calibration"] == good
    outlet.clock.advance(0.020)  # type: ignore[attr-defined]
    assert outlet.answer_position({})["calibration"] == outlet.answer_status({})["calibration"] == old
    assert outlet.answer_position({})["valid"]
    outlet.fix(FIX)
    assert (outlet.last["calibration"], outlet.last["valid"]) == (old, True)


async def test_position_and_status_can_be_asked_for(outlet: Outlet, settings: ZenohSettings) -> None:
    Commands({}, outlet).serve(outlet.link)
    with visitor(settings) as session:
        assert await ask(session, "probe/position", None) == (False, {"error": "no position yet"})
        outlet.fix(FIX)
        answered, told = await ask(session, "probe/position", None)
        assert answered
        assert told["position_mm"] == [1.0, 2.0, 3.0]
        assert (await ask(session, "probe/status", None))[1]["cell"] == "demo"
