"""`trackerd watch`: an ordinary subscriber of the published position."""

import json
import queue
import sys
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import zenoh
from rich.console import Console
from rich.live import Live
from rich.table import Table

from trackerd.cli.truth import TruthTrack
from trackerd.formats import wire
from trackerd.formats.config import CellConfig
from trackerd.service.zenoh_session import open_towards
from trackerd.wiring.cell import load, source_of

WINDOW_NS = 2_000_000_000  # rate and error are over the last two seconds
SILENCE_S = 0.5
REFRESH_S = 0.2
TRUTH_LAG_NS = 30_000_000  # the truth of an instant is there once the samples around it have come


@dataclass(slots=True)
class View:
    """What is known now; fed from messages, drawn from time to time."""

    last: dict[str, Any] | None = None
    heard: float = 0.0
    truth: TruthTrack = field(default_factory=TruthTrack)
    arrivals: deque[int] = field(default_factory=deque)
    pending: deque[dict[str, Any]] = field(default_factory=lambda: deque(maxlen=1000))
    errors: deque[tuple[int, float]] = field(default_factory=deque)

    def position(self, message: dict[str, Any]) -> None:
        self.last, self.heard = message, time.monotonic()
        self.arrivals.append(message["t_published_unix_ns"])
        self.pending.append(message)

    def settle(self) -> None:
        """Compares what the truth has caught up with; forgets what is older than the window."""
        began = self.truth.began()
        while self.pending and began is not None and self.pending[0]["t_unix_ns"] <= began:
            self.pending.popleft()
        while self.pending and (at := self.truth.at(self.pending[0]["t_unix_ns"])) is not None:
            message = self.pending.popleft()
            if message["valid"]:
                error = float(np.linalg.norm(np.array(message["position_mm"]) - at[0]))
                self.errors.append((message["t_unix_ns"], error))
        for row in (self.arrivals, self.errors):
            while row and time.time_ns() - (row[0] if isinstance(row[0], int) else row[0][0]) > WINDOW_NS:
                row.popleft()

    def rows(self) -> list[tuple[str, str]]:
        self.settle()
        m = self.last
        if m is None:
            return [("state", "nothing heard yet")]
        silent_s = time.monotonic() - self.heard
        state = m["state"] if silent_s < SILENCE_S else f"silent for {silent_s:.1f} s"
        rows = [("state", f"{state}, {'valid' if m['valid'] and silent_s < SILENCE_S else 'NOT VALID'}")]
        if m["position_mm"] is not None:
            rows.append(("position mm", "  ".join(f"{v:+10.3f}" for v in m["position_mm"])))
            rows.append(("sigma mm", "  ".join(f"{v:10.3f}" for v in m["sigma_mm"] or ())))
            rows.append(("speed mm/s", f"{float(np.linalg.norm(m['velocity_mm_s'])):10.1f}"))
        rows.append(("rate", f"{len(self.arrivals) / (WINDOW_NS * 1e-9):.1f} Hz"))
        rows.append(("age", f"{m['age_ms']:.1f} ms when published"))
        if self.errors:
            squares = np.array([error for _, error in self.errors])
            rows.append(
                ("error", f"{np.sqrt((squares**2).mean()):.3f} mm rms, {squares.max():.3f} mm largest (against the twin)")
            )
        rows.append(
            ("source", f"{m['source']}, calibration {m['calibration_id']}, stations {', '.join(m['stations']) or 'none'}")
        )
        if notes := m.get("calibration", {}).get("notes"):  # who publishes may be older than this
            rows.append(("calibration", "; ".join(notes)))
        rows.append(("reasons", "; ".join(m["reasons"]) or "-"))
        return rows


def watch(config: Path, overrides: Sequence[str], duration_s: float | None, plain: bool) -> int:
    cell = load(config, overrides)
    keys = wire.keys(cell.zenoh, source_of(cell))
    inbox: queue.SimpleQueue[tuple[str, bytes]] = queue.SimpleQueue()
    session = open_towards(cell.zenoh)
    try:
        wanted = [(keys.position, "position"), *([(truth_key(cell), "truth")] if cell.twin is not None else [])]
        held = [_subscribe(session, key, kind, inbox) for key, kind in wanted]
        _show(inbox, keys.position, duration_s, plain or not sys.stdout.isatty())
        del held
    finally:
        session.close()  # type: ignore[no-untyped-call]
    return 0


def _subscribe(session: zenoh.Session, key: str, kind: str, inbox: "queue.SimpleQueue[tuple[str, bytes]]") -> object:
    def heard(sample: zenoh.Sample) -> None:
        inbox.put((kind, sample.payload.to_bytes()))

    return session.declare_subscriber(key, heard)


def truth_key(cell: CellConfig) -> str:
    return f"{cell.zenoh.twin_prefix}/truth"


def _show(inbox: "queue.SimpleQueue[tuple[str, bytes]]", key: str, duration_s: float | None, plain: bool) -> None:
    view, end = View(), time.monotonic() + (duration_s or float("inf"))
    if plain:
        while time.monotonic() < end:
            _listen(inbox, view, min(end, time.monotonic() + 1.0))
            print("  ".join(f"{name}: {' '.join(text.split())}" for name, text in view.rows()), flush=True)
        return
    with Live(console=Console(), auto_refresh=False) as live:
        while time.monotonic() < end:
            _listen(inbox, view, min(end, time.monotonic() + REFRESH_S))
            live.update(_table(key, view), refresh=True)


def _listen(inbox: "queue.SimpleQueue[tuple[str, bytes]]", view: View, until: float) -> None:
    while (left := until - time.monotonic()) > 0:
        try:
            kind, payload = inbox.get(timeout=left)
        except queue.Empty:
            return
        if kind == "truth":
            view.truth.add(json.loads(payload))
        else:
            view.position(wire.decode(payload))


def _table(key: str, view: View) -> Table:
    table = Table(title=key, show_header=False, title_justify="left", min_width=78)
    table.add_column(style="dim", width=12)
    table.add_column()
    good = view.last is not None and view.last["valid"]
    for name, text in view.rows():
        table.add_row(name, text, style="" if name != "state" else ("green" if good else "red"))
    return table
