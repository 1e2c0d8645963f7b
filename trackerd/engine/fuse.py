"""Lines of sight of all stations to fixes: pairing, triangulation, plausibility, motion filter. Time is passed in.

A target counts from `confirm_pairs` agreeing pairs in a row on, and again after each loss: before, its fixes are unconfirmed.
A pair that disagrees never enters the filter; it makes the fix an extrapolated one that says why.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from math import sqrt

import numpy as np

from trackerd.contract.clock import HostNs
from trackerd.contract.errors import Degenerate
from trackerd.contract.model import Array, Fix, FixState, Sightline
from trackerd.estimate.kalman import Motion, MotionFilter, MotionModel
from trackerd.estimate.pairing import Pairing
from trackerd.formats.settings import FusionSettings
from trackerd.geometry.triangulate import Point, triangulate

MISS_SIGMAS = 5.0
RANGE_SIGMAS = 4.0
JUMP_SIGMAS = 5.0
PATIENCE = 0.5  # of a frame period that a pair may come later than the one before it, before it is made up
NOWHERE = np.full(3, np.nan)


@dataclass(frozen=True, slots=True)
class FusionStatistics:
    lines: int  # taken by the pairing
    pairs: int  # sets of lines at a common instant
    fixes: int  # from a pair that agreed
    coasted: int
    losses: int
    refused: tuple[tuple[str, int], ...]  # lines and pairs, by reason


@dataclass(frozen=True, slots=True)
class _Anchor:
    """The last pair that agreed: what follows is judged by it and extrapolated from it."""

    instant: HostNs
    point: Point
    stations: tuple[str, ...]
    received: HostNs
    latency_ns: int  # from exposure to the fix


@dataclass(frozen=True, slots=True)
class _Objection:
    kind: str
    words: str


class Fuser:
    """All stations of a cell, one target."""

    def __init__(
        self,
        stations: Sequence[str],
        settings: FusionSettings,
        radius_mm: float,
        radius_tolerance: float,
        frame_period_ns: int,
    ) -> None:
        """`radius_tolerance`: apparent against triangulated radius, relative; `radius_mm` is the calibrated one."""
        self._settings = settings
        self._radius_mm = radius_mm
        self._radius_tolerance = radius_tolerance
        self._period_ns = frame_period_ns
        self._coast_ns = round(settings.coast_ms * 1e6)
        self._pairing = Pairing(stations, round(settings.simultaneous_us * 1e3), round(settings.wait_ms * 1e6))
        self._motion = MotionFilter(MotionModel(settings.model), settings.process_noise, settings.gate_chi2)
        self._heard: dict[str, HostNs] = {}
        self._silent: dict[str, str] = {}  # station -> why it gives no lines
        self._refused: Counter[str] = Counter()
        self._sequence = self._fixes = self._coasted = self._losses = 0
        self._anchor: _Anchor | None = None
        self._agreed = 0
        self._published = HostNs(0)  # the instant of the last fix

    @property
    def confirmed(self) -> bool:
        return self._agreed >= self._settings.confirm_pairs

    def add(self, line: Sightline, now: HostNs) -> list[Fix]:
        """One line of sight; the fixes that it completes, oldest first."""
        self._silent.pop(line.station, None)
        sets = self._pairing.add(line)
        self._heard[line.station] = max(line.instant, self._heard.get(line.station, line.instant))
        return self._fuse_all(sets, now)

    def lost(self, station: str, reason: str, now: HostNs) -> list[Fix]:
        """A station does not see the target: it is not waited for, and extrapolated fixes say why."""
        self._silent[station] = reason
        return self._fuse_all(self._pairing.absent(station), now)

    def tick(self, now: HostNs) -> Fix | None:
        """To be called at the frame rate when nothing came: an extrapolated fix, later one that says 'lost', then nothing."""
        if self._anchor is None:
            return None
        due = now - self._anchor.latency_ns - round(PATIENCE * self._period_ns)
        periods = (due - self._anchor.instant) // self._period_ns
        instant = HostNs(self._anchor.instant + periods * self._period_ns)
        if instant - self._anchor.instant > self._coast_ns:
            return self._lose(instant)
        if periods < 1 or instant <= self._published or not self.confirmed:
            return None
        return self._coast(self._anchor, instant, now, self._absence(self._anchor))

    def statistics(self) -> FusionStatistics:
        pairing = self._pairing.statistics()
        refused = tuple(sorted((self._refused + Counter(dict(pairing.refused))).items()))
        return FusionStatistics(pairing.lines, pairing.sets, self._fixes, self._coasted, self._losses, refused)

    def _fuse_all(self, sets: Sequence[tuple[Sightline, ...]], now: HostNs) -> list[Fix]:
        fixes = [self._fuse(lines, now) for lines in sets]
        return [fix for fix in fixes if fix is not None]

    def _fuse(self, lines: tuple[Sightline, ...], now: HostNs) -> Fix | None:
        instant = lines[0].instant
        if self._anchor is not None and instant - self._anchor.instant > max(self._coast_ns, self._period_ns):
            self._losses += 1
            self._forget()
        try:
            point = triangulate(lines)
        except Degenerate as err:
            self._refused["degenerate"] += 1
            return self._coast(self._anchor, instant, now, (str(err),)) if self._anchor and self.confirmed else None
        objections = self._objections(lines, point)
        if not objections:
            innovation = self._motion.update(instant, point.p_mm, point.cov_mm2)
            if not innovation.accepted:
                words = f"innovation: chi2 {innovation.chi2:.0f} above {self._settings.gate_chi2:g}"
                objections = (_Objection("innovation", words),)
        if objections:
            return self._disagree(lines, point, now, objections)
        return self._agree(lines, point, now)

    def _objections(self, lines: tuple[Sightline, ...], point: Point) -> tuple[_Objection, ...]:
        """What speaks against the pair being the target."""
        found = []
        allowed = max(self._settings.max_miss_mm, MISS_SIGMAS * point.miss_sigma_mm)
        if point.miss_mm > allowed:
            found.append(_Objection("miss distance", f"miss distance {point.miss_mm:.2g} mm above {allowed:.2g} mm"))
        for line, range_mm in zip(lines, point.ranges_mm.tolist(), strict=True):
            off = abs(line.range_mm - range_mm)
            if off > self._radius_tolerance * range_mm + RANGE_SIGMAS * line.range_sigma_mm:
                seen = 2.0 * self._radius_mm * range_mm / line.range_mm
                words = f"{line.station}: apparent diameter disagrees (as of {seen:.1f} mm, set {2.0 * self._radius_mm:.1f} mm)"
                found.append(_Objection("apparent diameter", words))
        if self._anchor is not None:
            found.extend(self._jump(self._anchor, lines[0].instant, point))
        return tuple(found)

    def _jump(self, anchor: _Anchor, instant: HostNs, point: Point) -> tuple[_Objection, ...]:
        duration_s = (instant - anchor.instant) * 1e-9
        distance_mm = float(np.linalg.norm(point.p_mm - anchor.point.p_mm))
        noise_mm = sqrt(float(point.cov_mm2.trace() + anchor.point.cov_mm2.trace()))
        if distance_mm <= self._settings.max_speed_mm_s * duration_s + JUMP_SIGMAS * noise_mm:
            return ()
        return (_Objection("jump", f"jump of {distance_mm:.0f} mm in {duration_s * 1e3:.0f} ms"),)

    def _agree(self, lines: tuple[Sightline, ...], point: Point, now: HostNs) -> Fix:
        instant = lines[0].instant
        received = max(line.received for line in lines)
        anchor = _Anchor(instant, point, tuple(line.station for line in lines), received, now - instant)
        self._anchor = anchor
        self._agreed = min(self._agreed + 1, self._settings.confirm_pairs)
        self._fixes += 1
        state, reasons = (FixState.TRACKING, ()) if self.confirmed else (FixState.UNCONFIRMED, (self._doubt(),))
        return self._fix(anchor, self._motion.predict(instant), instant, state, reasons + self._age(instant, now))

    def _disagree(self, lines: tuple[Sightline, ...], point: Point, now: HostNs, objections: tuple[_Objection, ...]) -> Fix:
        instant = lines[0].instant
        self._refused.update(objection.kind for objection in objections)
        words = tuple(objection.words for objection in objections)
        if self._anchor is not None and self.confirmed:
            return self._coast(self._anchor, instant, now, words)
        self._forget()
        received = max(line.received for line in lines)
        seen = _Anchor(instant, point, tuple(line.station for line in lines), received, now - instant)
        motion = Motion(point.p_mm, np.zeros(3), point.cov_mm2)
        return self._fix(seen, motion, instant, FixState.UNCONFIRMED, (self._doubt(), *words, *self._age(instant, now)))

    def _coast(self, anchor: _Anchor, instant: HostNs, now: HostNs, why: tuple[str, ...]) -> Fix:
        self._coasted += 1
        state = FixState.COASTING if self.confirmed else FixState.UNCONFIRMED
        words = (f"extrapolated for {(instant - anchor.instant) * 1e-6:.0f} ms", *why, *self._age(instant, now))
        return self._fix(anchor, self._motion.predict(instant), instant, state, words)

    def _lose(self, instant: HostNs) -> Fix:
        assert self._anchor is not None
        anchor = self._anchor
        absence = self._absence(anchor)
        self._losses += 1
        self._forget()
        motion = Motion(NOWHERE, NOWHERE, np.full((3, 3), np.nan))
        words = f"lost: no agreeing pair for {(instant - anchor.instant) * 1e-6:.0f} ms"
        return self._fix(anchor, motion, instant, FixState.SEARCHING, (words, *absence))

    def _forget(self) -> None:
        """The target is unconfirmed again."""
        self._anchor = None
        self._agreed = 0
        self._motion.reset()

    def _absence(self, anchor: _Anchor) -> tuple[str, ...]:
        """Why there is no pair."""
        reporting = [station for station, instant in self._heard.items() if instant > anchor.instant]
        count = f"only one station: {reporting[0]}" if len(reporting) == 1 else None
        silent = (f"{station}: {reason}" for station, reason in sorted(self._silent.items()))
        return (*((count,) if count else ()), *silent)

    def _doubt(self) -> str:
        return f"unconfirmed: {self._agreed} of {self._settings.confirm_pairs} agreeing pairs"

    def _age(self, instant: HostNs, now: HostNs) -> tuple[str, ...]:
        age_ms = (now - instant) * 1e-6
        return (f"too old: exposed {age_ms:.0f} ms ago",) if age_ms > self._settings.max_age_ms else ()

    def _fix(self, anchor: _Anchor, motion: Motion, instant: HostNs, state: FixState, reasons: tuple[str, ...]) -> Fix:
        systematic: Array = anchor.point.systematic_cov_mm2
        self._sequence += 1
        self._published = instant
        return Fix(
            sequence=self._sequence,
            instant=instant,
            state=state,
            position_mm=motion.p_mm,
            velocity_mm_s=motion.v_mm_s,
            cov_mm2=motion.cov_mm2 + systematic,
            systematic_cov_mm2=systematic,
            miss_mm=anchor.point.miss_mm,
            stations=anchor.stations,
            received=anchor.received,
            reasons=reasons,
        )
