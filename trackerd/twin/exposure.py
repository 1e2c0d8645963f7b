"""The exposure-active line of a camera: it tells the camera and the latch input of each exposure.

Times are scene ns. Nothing here waits: the past is worked off when somebody asks for it.
"""

from collections import deque
from dataclasses import dataclass

from trackerd.sim.trigger import Trigger


@dataclass(frozen=True, slots=True)
class Exposure:
    number: int  # exposures since the twin's start, from 0
    frame_id: int  # exposures since the stream was started, from 0
    rising_ns: int
    falling_ns: int

    @property
    def mid_ns(self) -> int:
        return (self.rising_ns + self.falling_ns) // 2


@dataclass(frozen=True, slots=True)
class Edge:
    t_ns: int
    falling: bool
    exposure_ns: int  # when its exposure began


class ExposureLine:
    """Exposures happen while the stream is started and not held up; one that has begun is completed."""

    def __init__(self, trigger: Trigger) -> None:
        self.trigger = trigger
        self.started = False
        self.held_up = False
        self.exposed = 0  # since the twin's start
        self._frame_id = 0
        self._k = 0
        self._edges: deque[Edge] = deque(maxlen=1024)  # a latch input that nobody reads forgets the oldest
        self._exposures: deque[Exposure] = deque(maxlen=256)

    def start(self, t_ns: int) -> None:
        self.advance(t_ns)
        self._exposures.clear()
        self.started, self._frame_id = True, 0

    def stop(self, t_ns: int) -> int:
        """The instant from which on no exposure is in progress."""
        self.advance(t_ns)
        self.started = False
        return max(t_ns, self._exposures[-1].falling_ns if self._exposures else t_ns)

    def hold_up(self, t_ns: int, held_up: bool) -> None:
        """The stream stops, or returns, whatever the host asked for."""
        self.advance(t_ns)
        self.held_up = held_up

    def next_end(self) -> int | None:
        """When the next exposure that is not yet taken is over, if one is to come."""
        if self._exposures:
            return self._exposures[0].falling_ns
        if not self.started or self.held_up:
            return None
        return self.trigger.begin_ns(self._k) + self.trigger.exposure_ns

    def advance(self, t_ns: int) -> None:
        """Work off the triggers up to and including t_ns."""
        if not self.started or self.held_up:
            self._k = max(self._k, self.trigger.first_from(t_ns + 1))
            return
        while (rising := self.trigger.begin_ns(self._k)) <= t_ns:
            self._expose(rising)

    def edges(self, t_ns: int) -> list[Edge]:
        """The edges up to and including t_ns, each told once."""
        self.advance(t_ns)
        told = []
        while self._edges and self._edges[0].t_ns <= t_ns:
            told.append(self._edges.popleft())
        return told

    def finished(self, t_ns: int) -> list[Exposure]:
        """The exposures that are over at t_ns, each told once."""
        self.advance(t_ns)
        told = []
        while self._exposures and self._exposures[0].falling_ns <= t_ns:
            told.append(self._exposures.popleft())
        return told

    def _expose(self, rising_ns: int) -> None:
        falling_ns = rising_ns + self.trigger.exposure_ns
        self._edges.extend((Edge(rising_ns, False, rising_ns), Edge(falling_ns, True, rising_ns)))
        self._exposures.append(Exposure(self.exposed, self._frame_id, rising_ns, falling_ns))
        self._frame_id += 1
        self._k += 1
        self.exposed += 1
