"""What the cell tells: fixes as they come, the status at its own rate, and the answers to questions."""

import logging
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

from trackerd.contract.clock import Clock, HostNs
from trackerd.contract.model import Fix, FixState, Source
from trackerd.formats import wire
from trackerd.formats.calibration import Calibration, Standing
from trackerd.service.stages import Stage
from trackerd.service.zenoh_link import ZenohLink

log = logging.getLogger("trackerd.outlet")


@dataclass(slots=True)
class Outlet:
    link: ZenohLink
    clock: Clock
    source: Source
    calibration: Calibration
    valid_ns: int  # a fix is valid this long after its instant
    gather: Callable[[], dict[str, Any]]  # the status of everything, as plain values
    published: Stage = field(default_factory=Stage)
    fixes: int = 0
    valid_fixes: int = 0
    last: dict[str, Any] | None = None
    _state: FixState | None = None

    def fix(self, fix: Fix) -> None:
        if self.link.others:
            reason = f"another publisher is alive on {self.link.keys.position}"
            fix = replace(fix, reasons=(*fix.reasons, reason))
        until = HostNs(fix.instant + self.valid_ns)
        message = wire.fix_message(fix, self.clock, until, self.source, self._standing())
        self.link.put_position(wire.encode(message))
        self.last = message
        self.fixes += 1
        self.valid_fixes += message["valid"]
        if message["position_mm"] is not None:
            self.published.add(self.clock.now() - fix.received)
        self._tell_change(fix)

    def _tell_change(self, fix: Fix) -> None:
        """A frame that comes late is bridged by an extrapolated fix: no news."""
        if fix.state is self._state or fix.state is FixState.COASTING:
            return
        log.info("fix %s%s", fix.state.value, f" ({'; '.join(fix.reasons)})" if fix.reasons else "")
        self._state = fix.state

    def status(self) -> None:
        self.link.put_status(wire.encode(self.answer_status({})))

    def answer_position(self, _request: dict[str, Any]) -> dict[str, Any]:
        """The last fix, with the age and validity of now."""
        if self.last is None:
            raise ValueError("no position yet")
        current = self.last | {"calibration": wire.plain(self._standing())}
        return wire.answer(current, self.clock.unix(self.clock.now()))

    def answer_status(self, _request: dict[str, Any]) -> dict[str, Any]:
        return wire.status_message(self.gather() | {"calibration": self._standing()}, self.clock, self.source)

    def _standing(self) -> Standing:
        """A calibration may expire while the cell runs."""
        return self.calibration.standing(self.clock.unix(self.clock.now()))
