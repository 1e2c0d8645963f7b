"""Are a frame and its latch of the same exposure? Neither their numbers nor their intervals can tell: both run on alike when an
exposure was missed at the very start. The way from exposure to host can: it takes as long as it always takes."""

from collections import deque

TOLERANCE_NS = 1_000_000  # of the clock fit, early in its life
FRAMES = 25  # the least delay of so many is free of the host's own stalls


class DelayWatch:
    """For one camera's stream. `transfer_ns`, end of exposure to frame complete, is 0 where nobody knows it."""

    def __init__(self, exposure_ns: int, transfer_ns: int, period_ns: int) -> None:
        self._least_ns = exposure_ns // 2
        self._usual_ns = self._least_ns + transfer_ns if transfer_ns else None
        self._period_ns = period_ns
        self._delays: deque[int] = deque(maxlen=FRAMES)

    def reset(self) -> None:
        self._delays.clear()

    def objection(self, delay_ns: int) -> str:
        """Why a frame, complete `delay_ns` after its latched mid-exposure, cannot be that exposure's; or nothing."""
        if delay_ns < self._least_ns - TOLERANCE_NS:
            early_ms = (self._least_ns - delay_ns) * 1e-6
            return f"complete {early_ms:.1f} ms before the end of its exposure: its latch is a later one's"
        self._delays.append(delay_ns)
        if self._usual_ns is None or len(self._delays) < FRAMES:
            return ""
        fastest_ns = min(self._delays)
        if abs(fastest_ns - self._usual_ns) <= self._period_ns // 2:
            return ""
        return (
            f"complete {fastest_ns * 1e-6:.1f} ms after mid-exposure, where {self._usual_ns * 1e-6:.1f} ms are usual"
            " (transfer_us): its latch is another exposure's"
        )
