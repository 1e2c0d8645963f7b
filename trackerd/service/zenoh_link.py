"""What the cell says and hears on Zenoh.

Position and status are plain publications that are dropped rather than waited for: a put never blocks the loop. Zenoh calls
back on its own threads; everything is handed to the event loop at once, and answered from there.
"""

import asyncio
import json
import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import zenoh

from trackerd.contract.model import Source
from trackerd.formats import wire
from trackerd.formats.settings import ZenohSettings
from trackerd.service.zenoh_session import RefusedStart, open_listening

log = logging.getLogger("trackerd.zenoh")
TOKEN_TIMEOUT_S = 0.5
JSON = zenoh.Encoding.APPLICATION_JSON

Answer = Callable[[dict[str, Any]], dict[str, Any]]  # the request's JSON object -> the reply's


@dataclass(slots=True)
class ZenohLink:
    """Built by `open_link`; every method is called on the event loop."""

    session: zenoh.Session
    keys: wire.Keys
    others: set[str] = field(default_factory=set)  # tokens of other publishers on our key
    _position: Any = None
    _status: Any = None
    _held: list[Any] = field(default_factory=list)  # Zenoh undeclares what nobody refers to

    def put_position(self, payload: bytes) -> None:
        self._position.put(payload)

    def put_status(self, payload: bytes) -> None:
        self._status.put(payload)

    def answer(self, key: str, answer: Answer) -> None:
        """Serves queries on a key; `answer` runs on the event loop."""
        loop = asyncio.get_running_loop()

        def asked(query: zenoh.Query) -> None:
            loop.call_soon_threadsafe(_reply, query, key, answer)

        self._held.append(self.session.declare_queryable(key, asked, complete=True))

    def declare(self) -> None:
        self._position = self._publisher(self.keys.position, zenoh.Priority.REAL_TIME)
        self._status = self._publisher(self.keys.status, zenoh.Priority.DATA)
        zid = str(self.session.info.zid())
        mine = wire.token_key(self.keys.position, zid)
        self._held.append(self.session.liveliness().declare_token(mine))
        loop = asyncio.get_running_loop()

        def changed(sample: zenoh.Sample) -> None:
            loop.call_soon_threadsafe(self._token, str(sample.key_expr), sample.kind == zenoh.SampleKind.PUT, mine)

        watch = self.session.liveliness().declare_subscriber(wire.token_pattern(self.keys.position), changed, history=True)
        self._held.append(watch)

    def _publisher(self, key: str, priority: zenoh.Priority) -> zenoh.Publisher:
        drop = zenoh.CongestionControl.DROP
        return self.session.declare_publisher(key, encoding=JSON, congestion_control=drop, priority=priority, express=True)

    def _token(self, token: str, alive: bool, mine: str) -> None:
        if token == mine:
            return
        if alive:
            self.others.add(token)
            log.error("another publisher is alive on %s (%s): no fix is valid until it is gone", self.keys.position, token)
        else:
            self.others.discard(token)


@contextmanager
def open_link(settings: ZenohSettings, source: Source) -> Iterator[ZenohLink]:
    """Opens the session and takes the key, or refuses because somebody else publishes on it. On the event loop's thread."""
    session = open_listening(settings)
    try:
        keys = wire.keys(settings, source)
        _refuse_second(session, keys.position)
        link = ZenohLink(session, keys)
        link.declare()
        yield link
    finally:
        session.close()  # type: ignore[no-untyped-call]


def _refuse_second(session: zenoh.Session, key: str) -> None:
    replies = session.liveliness().get(wire.token_pattern(key), timeout=TOKEN_TIMEOUT_S)
    alive = [str(reply.ok.key_expr) for reply in replies if reply.ok is not None]
    if alive:
        raise RefusedStart(
            f"[zenoh] key = {key}: another publisher is alive on it ({alive[0]}): stop it, or choose another key or prefix"
        )


def _reply(query: zenoh.Query, key: str, answer: Answer) -> None:
    try:
        payload = query.payload
        request = json.loads(payload.to_bytes()) if payload is not None and len(payload) else {}
        if not isinstance(request, dict):
            raise ValueError("the request must be a JSON object")
        query.reply(key, wire.encode(answer(request)), encoding=JSON)
    except (ValueError, RecursionError) as error:
        query.reply_err(wire.encode({"error": str(error)}), encoding=JSON)
    except zenoh.ZError as error:
        log.warning("a query on %s could not be answered: %s", key, error)
    finally:
        query.drop()  # type: ignore[no-untyped-call]
