"""The twin's truth, between its samples: for showing and judging errors at a fix's own stamp."""

from bisect import bisect_left
from collections import deque
from typing import Any

import numpy as np

from trackerd.contract.model import Array

KEPT = 2000  # samples: ten seconds at 200 Hz


class TruthTrack:
    """Cubic (Hermite) between neighbouring samples: at 5 ms and 1 m/s^2 exact to a nanometre."""

    def __init__(self) -> None:
        self._times: deque[int] = deque(maxlen=KEPT)
        self._samples: deque[tuple[Array, Array]] = deque(maxlen=KEPT)

    def add(self, message: dict[str, Any]) -> None:
        """One message of the twin: t_unix_ns, position_mm, velocity_mm_s. One out of order is left out."""
        if self._times and message["t_unix_ns"] <= self._times[-1]:
            return
        self._times.append(message["t_unix_ns"])
        self._samples.append((np.array(message["position_mm"]), np.array(message["velocity_mm_s"])))

    def began(self) -> int | None:
        """The first instant that is known, ns Unix time."""
        return self._times[0] if self._times else None

    def at(self, t_unix_ns: int) -> tuple[Array, Array] | None:
        """Position (3,) mm and velocity (3,) mm/s, or None outside of the samples."""
        n = bisect_left(self._times, t_unix_ns)
        if n == 0 or n == len(self._times):
            return None
        t0, t1 = self._times[n - 1], self._times[n]
        (p0, v0), (p1, v1) = self._samples[n - 1], self._samples[n]
        span_s = (t1 - t0) * 1e-9
        u = (t_unix_ns - t0) / (t1 - t0)
        p = (
            (1 + 2 * u) * (1 - u) ** 2 * p0
            + u * (1 - u) ** 2 * span_s * v0
            + u * u * (3 - 2 * u) * p1
            + u * u * (u - 1) * span_s * v1
        )
        return p, (1 - u) * v0 + u * v1
