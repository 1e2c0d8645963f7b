"""One question to the running daemon."""

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from trackerd.contract.errors import TrackerdError
from trackerd.formats import wire
from trackerd.service.zenoh_session import open_towards
from trackerd.wiring.cell import load, source_of

TIMEOUT_S = 3.0


def ask(config: Path, overrides: Sequence[str], command: str, request: dict[str, Any]) -> int:
    """Prints each gimbal's answer. Raises TrackerdError where nobody answers, or the answer is a refusal."""
    cell = load(config, overrides)
    keys = wire.keys(cell.zenoh, source_of(cell))
    key = getattr(keys, command)
    session = open_towards(cell.zenoh)
    try:
        replies = list(session.get(key, payload=json.dumps(request).encode(), timeout=TIMEOUT_S))
    finally:
        session.close()  # type: ignore[no-untyped-call]
    if not replies:
        raise TrackerdError(f"{key}: nobody answers (is the daemon of {config} running?)")
    for reply in replies:
        if reply.err is not None:
            told = json.loads(reply.err.payload.to_bytes())
            raise TrackerdError(f"{key}: {told.get('error', told)}")
        assert reply.ok is not None
        for gimbal, answer in json.loads(reply.ok.payload.to_bytes())["gimbals"].items():
            print(f"{gimbal}: {answer}", file=sys.stdout)
    return 0
