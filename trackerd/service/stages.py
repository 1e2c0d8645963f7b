"""Where a frame's time goes: the age of a measurement at each stage since its frame was complete in the driver."""

from dataclasses import dataclass, field

import numpy as np

from trackerd.contract.model import Array

KEPT = 2048  # frames; about 20 s of two stations at 55 fps


@dataclass(frozen=True, slots=True)
class Percentiles:
    n: int
    p50_ms: float
    p99_ms: float
    max_ms: float


@dataclass(slots=True)
class Stage:
    """A ring of durations that is allocated once."""

    _ring: Array = field(default_factory=lambda: np.zeros(KEPT))
    _n: int = 0

    def add(self, duration_ns: int) -> None:
        self._ring[self._n % KEPT] = duration_ns * 1e-6
        self._n += 1

    def percentiles(self) -> Percentiles | None:
        if self._n == 0:
            return None
        p50, p99, top = np.percentile(self._ring[: min(self._n, KEPT)], (50, 99, 100))
        return Percentiles(self._n, float(p50), float(p99), float(top))


@dataclass(slots=True)
class Stages:
    """Cumulative ages, but for `work`: the tracker's own duration."""

    angles: Stage = field(default_factory=Stage)  # frame complete -> its angles are known
    work: Stage = field(default_factory=Stage)  # tracker begins -> tracker has ended, in the worker
    tracked: Stage = field(default_factory=Stage)  # frame complete -> back in the loop

    def percentiles(self) -> dict[str, Percentiles | None]:
        return {name: getattr(self, name).percentiles() for name in ("angles", "work", "tracked")}
