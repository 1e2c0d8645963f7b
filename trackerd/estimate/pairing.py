"""Lines of sight brought to common instants, whatever order they arrive in.

The slowest station that is alive gives the instants. Another station's line that is nearly simultaneous is moved by the
station's own motion; otherwise the lines that bracket the instant are interpolated, one frame late.
"""

from bisect import bisect_left
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from itertools import pairwise
from math import isfinite

import numpy as np

from trackerd.contract.clock import HostNs
from trackerd.contract.model import Array, Sightline

MAX_INTERVAL_NS = 60_000_000  # lines further apart are not joined by a straight motion
AS_IS_NS = 20_000  # 0.02 mm at 1 m/s: a line without a predecessor may stand for an instant this near
FUTURE_NS = 1_000_000_000
SLOWEST = 0.8  # stations within this share of the longest period count as alike; the first of them leads
PERIODS = 8
CAPACITY = 512  # lines a station; the window holds fewer unless stamps are absurd


@dataclass(frozen=True, slots=True)
class PairingStatistics:
    lines: int
    sets: int
    alone: int  # instants that only one station had a line for
    refused: tuple[tuple[str, int], ...]  # reason, count


class _Gap(Enum):
    """Why a station has no line at an instant."""

    NOT_YET = 1
    NEVER = 2


class _Track:
    """The recent lines of one station, in the order of their instants."""

    def __init__(self) -> None:
        self.lines: list[Sightline] = []
        self.instants: list[int] = []

    def insert(self, line: Sightline) -> None:
        i = bisect_left(self.instants, line.instant)
        self.lines.insert(i, line)
        self.instants.insert(i, line.instant)

    def holds(self, instant: int) -> bool:
        i = bisect_left(self.instants, instant)
        return i < len(self.instants) and self.instants[i] == instant

    def forget(self, before: int) -> None:
        i = max(bisect_left(self.instants, before), len(self.lines) - CAPACITY)
        del self.lines[:i], self.instants[:i]

    def period_ns(self) -> int:
        """The shortest of the recent intervals (a dropped frame lengthens one); 0, not known, with fewer than two lines."""
        recent = self.instants[-PERIODS - 1 :]
        return min((b - a for a, b in pairwise(recent)), default=0)

    def after(self, instant: int | None) -> Sightline | None:
        i = 0 if instant is None else bisect_left(self.instants, instant + 1)
        return self.lines[i] if i < len(self.lines) else None

    def at(self, instant: int, simultaneous_ns: int) -> Sightline | _Gap:
        """The station's line at an instant, moved or interpolated."""
        i = bisect_left(self.instants, instant)  # lines[i - 1] is before the instant, lines[i] at it or after it
        if i < len(self.lines) and self.instants[i] - instant <= (AS_IS_NS if i == 0 else 0):
            return _combined(self._joined_until(i), instant)
        if i == 0:
            return _Gap.NEVER if self.lines else _Gap.NOT_YET
        lateness = instant - self.instants[i - 1]
        if lateness <= simultaneous_ns:
            moving = self._joined_until(i - 1)
            if len(moving) > 1 or lateness <= AS_IS_NS:
                return _combined(moving, instant)
        if i == len(self.lines):
            return _Gap.NOT_YET
        bracket = self._joined_until(i)
        return _combined(bracket, instant) if len(bracket) > 1 else _Gap.NEVER

    def _joined_until(self, i: int) -> list[Sightline]:
        """Up to three lines that end with line i, none too far from the next."""
        joined = [self.lines[i]]
        for line in self.lines[max(0, i - 2) : i][::-1]:
            if joined[0].instant - line.instant > MAX_INTERVAL_NS:
                break
            joined.insert(0, line)
        return joined


class Pairing:
    """Sets of lines of sight at common instants, one line a station."""

    def __init__(self, stations: Sequence[str], simultaneous_ns: int, wait_ns: int) -> None:
        self._tracks = {station: _Track() for station in stations}
        self._simultaneous_ns = simultaneous_ns
        self._wait_ns = wait_ns
        self._lines = self._sets = self._alone = 0
        self._refused: Counter[str] = Counter()
        self.reset()

    def reset(self) -> None:
        """Forget all lines (the clocks have changed); the statistics go on."""
        for track in self._tracks.values():
            track.forget(before=2**63)
        self._last: int | None = None  # the newest instant that was emitted or given up
        self._newest = -(2**63)
        self._absent: dict[str, int] = {}  # station -> it has nothing up to this instant

    def add(self, line: Sightline) -> list[tuple[Sightline, ...]]:
        """Take a line; give the sets that it completes, oldest first, each in the order of the stations."""
        refusal = self._refusal(line)
        if refusal is not None:
            self._refused[refusal] += 1
            return []
        self._lines += 1
        self._tracks[line.station].insert(line)
        self._newest = max(self._newest, line.instant)
        return self._drain()

    def absent(self, station: str) -> list[tuple[Sightline, ...]]:
        """The station has nothing at all instants so far: it is not waited for there. Gives the sets that this frees."""
        self._absent[station] = self._newest
        return self._drain()

    def statistics(self) -> PairingStatistics:
        return PairingStatistics(self._lines, self._sets, self._alone, tuple(sorted(self._refused.items())))

    def _refusal(self, line: Sightline) -> str | None:
        if line.station not in self._tracks:
            return "unknown station"
        flaw = _flaw(line)
        if flaw is not None:
            return flaw
        if line.instant - line.received > FUTURE_NS:
            return "from the future"
        if line.instant < self._newest - self._wait_ns - MAX_INTERVAL_NS:
            return "older than the window"
        return "duplicate" if self._tracks[line.station].holds(line.instant) else None

    def _drain(self) -> list[tuple[Sightline, ...]]:
        sets = []
        while (instant := self._candidate()) is not None:
            members = self._gather(instant)
            if members is None:
                break
            self._last = instant
            if len(members) >= 2:
                sets.append(members)
            else:
                self._alone += 1
        self._sets += len(sets)
        for track in self._tracks.values():
            track.forget(before=self._newest - self._wait_ns - 2 * MAX_INTERVAL_NS)
        return sets

    def _candidate(self) -> int | None:
        """The next instant of the station that leads."""
        alive = [track for name, track in self._tracks.items() if self._alive(name)]
        periods = [track.period_ns() for track in alive]
        enough = SLOWEST * max(periods) if periods and min(periods) > 0 else 0.0  # not all known yet: the first leads
        leader = next((t for t, period in zip(alive, periods, strict=True) if period >= enough), None)
        if leader is None:
            return None
        line = leader.after(None if self._last is None else self._last + self._simultaneous_ns)
        return None if line is None else line.instant

    def _alive(self, station: str) -> bool:
        instants = self._tracks[station].instants
        if not instants or instants[-1] < self._newest == self._absent.get(station):
            return False
        return self._newest - instants[-1] <= self._wait_ns

    def _gather(self, instant: int) -> tuple[Sightline, ...] | None:
        """One line a station at the instant; None while one may still come."""
        members = []
        for station, track in self._tracks.items():
            line = track.at(instant, self._simultaneous_ns)
            if isinstance(line, Sightline):
                members.append(line)
            elif line is _Gap.NOT_YET and self._awaited(station, instant):
                return None
        return tuple(members)

    def _awaited(self, station: str, instant: int) -> bool:
        """Silence counts from the first line that another station has since given."""
        if self._newest - instant > self._wait_ns or instant <= self._absent.get(station, instant - 1):
            return False
        instants = self._tracks[station].instants
        heard = instants[-1] if instants else None
        since = (track.after(heard) for track in self._tracks.values())
        return all(line is None or self._newest - line.instant <= self._wait_ns for line in since)


def _flaw(line: Sightline) -> str | None:
    """Why a line is no measurement."""
    total = line.origin_mm.sum() + line.direction.sum() + line.cov_rad2.sum() + line.fixed_cov_rad2.sum()
    if not (isfinite(total) and isfinite(line.range_mm + line.range_sigma_mm + line.instant_sigma_ns)):
        return "not finite"
    if abs(float(line.direction @ line.direction) - 1.0) > 1e-6 or line.range_mm <= 0.0:
        return "no direction"
    scale = float(line.cov_rad2.trace())
    if not scale > 0.0:
        return "covariance not positive"
    try:
        np.linalg.cholesky(line.cov_rad2 / scale + np.outer(line.direction, line.direction))
    except np.linalg.LinAlgError:
        return "covariance not positive"
    return None


def _combined(lines: Sequence[Sightline], instant: int) -> Sightline:
    """The motion through up to three lines of a station, at an instant between the last two or a little beyond the last.

    Two lines are a straight motion, three a parabola (at 1 m/s^2 and 55 fps the straight one cuts the corner by 0.04 mm).
    The instant's own sigma enters as the swing that it stands for.
    """
    last = lines[-1]
    near = min(lines, key=lambda line: abs(line.instant - instant))
    weights = _lagrange([line.instant - instant for line in lines])
    swing = np.zeros(3)
    direction, origin_mm, cov = np.zeros(3), np.zeros(3), np.zeros((3, 3))
    for weight, line in zip(weights, lines, strict=True):
        direction = direction + weight * line.direction
        origin_mm = origin_mm + weight * line.origin_mm
        cov = cov + weight**2 * line.cov_rad2
    direction /= np.sqrt(direction @ direction)
    across = np.eye(3) - direction[:, None] * direction
    if len(lines) > 1:
        swing = _swing(lines[-2], last) * near.instant_sigma_ns
    return Sightline(
        station=last.station,
        instant=HostNs(instant),
        instant_sigma_ns=near.instant_sigma_ns,
        origin_mm=origin_mm,
        direction=direction,
        cov_rad2=across @ (cov + swing[:, None] * swing) @ across,
        fixed_cov_rad2=across @ near.fixed_cov_rad2 @ across,  # common to neighbours: it neither averages nor grows
        range_mm=sum(weight * line.range_mm for weight, line in zip(weights, lines, strict=True)),
        range_sigma_mm=near.range_sigma_mm,
        received=max(line.received for line in lines),
    )


def _lagrange(at: Sequence[int]) -> list[float]:
    """Weights of values at these places for the value at 0 of the polynomial through them."""
    weights = []
    for i, here in enumerate(at):
        weight = 1.0
        for there in (*at[:i], *at[i + 1 :]):
            weight *= there / (there - here)
        weights.append(weight)
    return weights


def _swing(a: Sightline, b: Sightline) -> Array:
    """How the line turns per ns, as seen at its target."""
    return np.asarray(((b.origin_mm - a.origin_mm) / b.range_mm + b.direction - a.direction) / (b.instant - a.instant))
