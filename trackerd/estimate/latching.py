"""Frame to latch: by index, checked by time.

The stream and the latch counter both start at 0, so that latch index = frame id + k with k = 0. Every frame checks that the
interval since the last matched one is the same by the camera's clock and by the controller's; where it is not, the ring is
searched by time, and a new k is believed when three frames in a row agree on it.
"""

from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

from trackerd.contract.clock import CameraNs
from trackerd.contract.model import Latch, NoAngle

RATE_TOLERANCE = 100e-6  # of the interval: two free crystals
LONGEST_NS = 250_000_000  # exposures farther apart tell no speed
CONFIRMATIONS = 3


@dataclass(frozen=True, slots=True)
class Match:
    """The encoders at one frame's mid-exposure."""

    index: int
    az_rad: float
    el_rad: float
    az_rad_s: float  # by this exposure and the two before it; by its edges where there are none, 0 where there is but one edge
    el_rad_s: float
    instant_ns: int  # mid-exposure by the controller's clock, in ns (half a us matters: the edges are whole us)


@dataclass(frozen=True, slots=True)
class Waiting:
    """The frame's latch is not in the ring yet: ask again with the next status."""


LatchAnswer: TypeAlias = Match | Waiting | NoAngle


@dataclass(frozen=True, slots=True)
class _Pair:
    """A matched frame by both clocks."""

    camera_ns: int
    controller_ns: int


@dataclass(frozen=True, slots=True)
class _Ring:
    """The complete exposures of one status, by index and by time."""

    by_index: dict[int, Match]
    by_time: list[Match]

    def moving(self, match: Match) -> Match:
        """With the speed that the exposures before it tell."""
        i = bisect_left(self.by_time, match.instant_ns, key=lambda other: other.instant_ns)
        before = self.by_time[max(0, i - 2) : i][::-1]
        if not before or match.instant_ns - before[-1].instant_ns > LONGEST_NS:
            return match
        points = (match, *before)
        instants = [point.instant_ns for point in points]
        if len(set(instants)) < len(instants):
            return match
        return replace(
            match,
            az_rad_s=_slope([point.az_rad for point in points], instants),
            el_rad_s=_slope([point.el_rad for point in points], instants),
        )

    def at(self, instant_ns: int, tolerance_ns: float) -> Match | None:
        i = bisect_left(self.by_time, instant_ns, key=lambda match: match.instant_ns)
        near = min(self.by_time[max(0, i - 1) : i + 1], key=lambda m: abs(m.instant_ns - instant_ns), default=None)
        return near if near is not None and abs(near.instant_ns - instant_ns) <= tolerance_ns else None


class LatchMatcher:
    """One gimbal's frames and latches. `edges`: 2 where both edges of the exposure are latched, 1 where one entry is enough."""

    def __init__(self, edges: int, tolerance_ns: int = 50_000) -> None:
        if edges not in {1, 2}:
            raise ValueError(f"an exposure has 1 or 2 latched edges, not {edges}")
        self._edges = edges
        self._tolerance_ns = tolerance_ns
        self._latches: Sequence[Latch] | None = None
        self._ring = _Ring({}, [])
        self.reset()

    def reset(self) -> None:
        """Stream and latch counter start again at 0."""
        self._k = 0
        self._last: _Pair | None = None
        self._proposed: list[tuple[int, int]] = []  # (frame id, k), consecutive frames that agree
        self._latches = None

    def match(self, frame_id: int, mid_exposure: CameraNs | None, latches: Sequence[Latch]) -> LatchAnswer:
        """`latches` in any order; the same object again is not indexed again."""
        ring = self._indexed(latches)
        found = ring.by_index.get(frame_id + self._k)
        if mid_exposure is None or self._last is None:
            return self._absent(frame_id, ring) if found is None else self._accept(found, mid_exposure)
        expected = self._last.controller_ns + (mid_exposure - self._last.camera_ns)
        tolerance = self._tolerance_ns + RATE_TOLERANCE * abs(mid_exposure - self._last.camera_ns)
        if found is not None and abs(found.instant_ns - expected) <= tolerance:
            self._proposed.clear()
            return self._accept(found, mid_exposure)
        other = ring.at(expected, tolerance)
        if other is not None:
            return self._other_index(frame_id, mid_exposure, other)
        if found is None:
            return self._absent(frame_id, ring)
        if expected > ring.by_time[-1].instant_ns + tolerance:
            return Waiting()
        return NoAngle(f"latch {found.index} is {(found.instant_ns - expected) / 1e6:.3f} ms off the camera's interval")

    def _accept(self, found: Match, mid_exposure: CameraNs | None) -> Match:
        if mid_exposure is not None:
            self._last = _Pair(mid_exposure, found.instant_ns)
        return self._ring.moving(found)

    def _absent(self, frame_id: int, ring: _Ring) -> Waiting | NoAngle:
        index = frame_id + self._k
        oldest, newest = min(ring.by_index, default=index), max(ring.by_index, default=-1)
        if index < oldest:
            return NoAngle(f"latch {index} is overwritten: the ring begins at {oldest}")
        return Waiting() if index >= newest else NoAngle(f"latch {index} is missing between {oldest} and {newest}")

    def _other_index(self, frame_id: int, mid_exposure: CameraNs, other: Match) -> Match | NoAngle:
        """The time fits another index than expected: believed when frames in a row agree."""
        k = other.index - frame_id
        if self._proposed and self._proposed[-1][0] != frame_id:
            agrees = self._proposed[-1][1] == k
            self._proposed = [*self._proposed, (frame_id, k)] if agrees else [(frame_id, k)]
        else:
            self._proposed = [*self._proposed[:-1], (frame_id, k)]
        if len(self._proposed) < CONFIRMATIONS:
            return NoAngle(f"latch {frame_id + self._k} expected, {other.index} fits by time ({len(self._proposed)} in a row)")
        self._k = k
        self._proposed = []
        return self._accept(other, mid_exposure)

    def _indexed(self, latches: Sequence[Latch]) -> _Ring:
        if latches is not self._latches:
            self._latches = latches
            self._ring = _ring(latches, self._edges)
        return self._ring


def _slope(angles_rad: Sequence[float], instants_ns: Sequence[int]) -> float:
    """Per s at the first of two points, or of three (by the parabola through them)."""
    first = (angles_rad[0] - angles_rad[1]) / (instants_ns[0] - instants_ns[1])
    if len(angles_rad) == 2:
        return first * 1e9
    second = (angles_rad[1] - angles_rad[2]) / (instants_ns[1] - instants_ns[2])
    bend = (first - second) / (instants_ns[0] - instants_ns[2])
    return (first + (instants_ns[0] - instants_ns[1]) * bend) * 1e9


def _ring(latches: Sequence[Latch], edges: int) -> _Ring:
    exposures: dict[int, dict[bool, Latch]] = {}
    for latch in latches:
        exposures.setdefault(latch.index, {})[latch.falling] = latch
    by_index = {index: _match(index, list(pair.values())) for index, pair in exposures.items() if len(pair) >= edges}
    return _Ring(by_index, sorted(by_index.values(), key=lambda match: match.instant_ns))


def _match(index: int, latched: Sequence[Latch]) -> Match:
    """Mid-exposure is the mean of both edges, or the one entry as it stands."""
    a, b = latched[0], latched[-1]
    az_rad, el_rad = (a.az_rad + b.az_rad) / 2, (a.el_rad + b.el_rad) / 2
    instant_ns = (a.instant + b.instant) * 500
    span_s = (b.instant - a.instant) * 1e-6
    if span_s == 0.0:
        return Match(index, az_rad, el_rad, 0.0, 0.0, instant_ns)
    return Match(index, az_rad, el_rad, (b.az_rad - a.az_rad) / span_s, (b.el_rad - a.el_rad) / span_s, instant_ns)
