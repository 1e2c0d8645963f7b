"""What the benches share: a listener in a process of its own, errors against the twin's truth, and figures beside their limits.

As a command it is the listener: `judge.py PORT FILE KEY...` hears until its standard input ends, and writes one JSON array
[arrival in Unix ns, key, message] a line.
"""

import json
import subprocess
import sys
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

sys.path.insert(0, str(Path(__file__).parents[1]))

from system.cell import zenoh_client

from trackerd.cli.truth import TruthTrack
from trackerd.contract.clock import SystemClock

Message = dict[str, Any]
Array = npt.NDArray[np.float64]


# ---- hearing ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Heard:
    arrived_unix_ns: int
    key: str
    message: Message


@contextmanager
def listening(port: int, file: Path, *keys: str) -> Iterator[None]:
    """Hears these keys until the way out; then the file is written."""
    command = [sys.executable, __file__, str(port), str(file), *keys]
    with subprocess.Popen(command, stdin=subprocess.PIPE) as listener:
        yield
        assert listener.stdin is not None
        listener.stdin.close()
        listener.wait()


def read(file: Path, ending: str) -> list[Heard]:
    """What was heard on the keys that end like this, in the order of arrival."""
    lines = (json.loads(line) for line in file.read_text().splitlines())
    return [Heard(arrived, key, message) for arrived, key, message in lines if key.endswith(ending)]


def listen(port: int, file: Path, keys: Sequence[str]) -> None:
    """A callback only notes the instant and the bytes; everything else waits until the end."""
    clock, heard = SystemClock(), deque[tuple[int, str, bytes]]()
    with zenoh_client(port) as session, ExitStack() as held:
        for key in keys:
            subscriber = session.declare_subscriber(
                key, lambda sample: heard.append((clock.unix(clock.now()), str(sample.key_expr), sample.payload.to_bytes()))
            )
            held.callback(subscriber.undeclare)
        sys.stdin.read()
    with file.open("w") as out:
        out.writelines(json.dumps([arrived, key, json.loads(payload)]) + "\n" for arrived, key, payload in heard)


# ---- judging ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Judged:
    """A position beside the truth of its own stamp."""

    fix: Heard
    error_mm: Array
    velocity_mm_s: Array  # the true one

    @property
    def speed_mm_s(self) -> float:
        return float(np.linalg.norm(self.velocity_mm_s))


def against_truth(fixes: Iterable[Heard], truths: Iterable[Heard]) -> list[Judged]:
    """Both in the order of their stamps; positions outside of the truth that was heard are left out."""
    track, judged = TruthTrack(), []
    pending = deque(sorted(fixes, key=lambda fix: fix.message["t_unix_ns"]))
    for truth in truths:
        track.add(truth.message)
        while pending and pending[0].message["t_unix_ns"] <= truth.message["t_unix_ns"]:
            fix = pending.popleft()
            at = track.at(fix.message["t_unix_ns"])
            if at is not None:
                judged.append(Judged(fix, np.array(fix.message["position_mm"]) - at[0], at[1]))
    return judged


def lengths(judged: Sequence[Judged]) -> Array:
    return np.array([np.linalg.norm(one.error_mm) for one in judged])


def along_and_across(judged: Sequence[Judged]) -> tuple[Array, Array]:
    """Of the path: signed, positive in front of the truth; and the distance from it."""
    tangents = np.array([one.velocity_mm_s / one.speed_mm_s for one in judged])
    errors = np.array([one.error_mm for one in judged])
    along = (errors * tangents).sum(axis=1)
    return along, np.linalg.norm(errors - along[:, None] * tangents, axis=1)


def rms(values: Array) -> float:
    return float(np.sqrt((values**2).mean()))


# ---- figures ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Row:
    """Some values of one thing; a limit is that of the first value."""

    what: str
    values: tuple[float, ...]
    unit: str
    most: float | None
    least: float | None

    def verdict(self) -> str:
        if self.most is not None:
            return f"<= {self.most:<7g} {'ok' if self.values[0] <= self.most else 'MISSED'}"
        if self.least is not None:
            return f">= {self.least:<7g} {'ok' if self.values[0] >= self.least else 'MISSED'}"
        return ""


@dataclass(slots=True)
class Figures:
    """A table."""

    title: str
    columns: tuple[str, ...]
    rows: list[Row] = field(default_factory=list)

    def add(self, what: str, *values: float, unit: str = "", most: float | None = None, least: float | None = None) -> None:
        self.rows.append(Row(what, values, unit, most, least))

    def print(self) -> None:
        print(f"\n{self.title:52}" + "".join(f"{column:>11}" for column in self.columns) + "    limit")
        for row in self.rows:
            numbers = "".join(f"{value:11.4g}" for value in row.values).ljust(11 * len(self.columns))
            print(f"  {row.what + (f', {row.unit}' if row.unit else ''):50}{numbers} {row.verdict()}".rstrip())

    def plain(self) -> dict[str, Any]:
        return {row.what: asdict(row) for row in self.rows}


def spread(values: Array) -> tuple[float, float, float]:
    """RMS, 95 %, maximum of magnitudes; NaN without values."""
    sizes = np.abs(values)
    return (rms(sizes), float(np.quantile(sizes, 0.95)), float(sizes.max())) if sizes.size else (np.nan, np.nan, np.nan)


def delays(values: Array) -> tuple[float, float, float]:
    """p50, p99, maximum; NaN without values."""
    if not values.size:
        return np.nan, np.nan, np.nan
    p50, p99, top = np.quantile(values, (0.5, 0.99, 1.0)).tolist()
    return p50, p99, top


if __name__ == "__main__":
    listen(int(sys.argv[1]), Path(sys.argv[2]), sys.argv[3:])
