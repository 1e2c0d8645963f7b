"""The latch input of a controller: the last edges of the camera's exposure-active line, with the encoders at each."""

from collections import deque
from dataclasses import dataclass, field

from trackerd.formats.gimbal_map import FALLING_EDGE, INDEX_MASK, LATCH_DEPTH, LatchRecord


@dataclass(slots=True)
class LatchRing:
    """Both edges of one exposure share an index, and the first exposure after a zero has index 1."""

    armed: bool = False
    overrun: bool = False  # an edge was overwritten before any status had carried it
    total: int = 0
    _ring: deque[LatchRecord] = field(default_factory=lambda: deque(maxlen=LATCH_DEPTH))
    _exposing: bool = False
    _unread: int = 0

    def arm(self, armed: bool) -> None:
        self.armed = armed
        self._exposing = self._exposing and armed

    def zero(self) -> None:
        self.total, self.overrun, self._exposing, self._unread = 0, False, False, 0
        self._ring.clear()

    def jump(self, exposures: int) -> None:
        """Count exposures that never were: a fault on request."""
        self.total = (self.total + exposures) & INDEX_MASK

    def edge(self, falling: bool, az: int, el: int, t_us: int) -> None:
        """One edge. A falling edge whose rising one was not latched belongs to no exposure and is ignored."""
        if not self.armed or (falling and not self._exposing):
            return
        if not falling:
            self.total = (self.total + 1) & INDEX_MASK
        self._exposing = not falling
        self._ring.appendleft(LatchRecord(self.total | (FALLING_EDGE if falling else 0), az, el, t_us))
        self._unread += 1
        self.overrun = self.overrun or self._unread > LATCH_DEPTH

    def read(self) -> tuple[LatchRecord, ...]:
        """Newest first."""
        self._unread = 0
        return tuple(self._ring)
