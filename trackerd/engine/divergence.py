"""While following: do the axes still do in the image what the test has proved?

Two questions. Does the pixel error grow, frame after frame, although the axes by their encoders move so as to reduce it? And,
within two frames, because a target that is fed forward the wrong way is out of the view in three: does the image move as if an
axis turned the other way, or both were exchanged?
"""

from dataclasses import dataclass, field
from math import hypot

import numpy as np

from trackerd.contract.clock import HostNs
from trackerd.contract.model import Array
from trackerd.engine.track import Step

DIVERGING_PX = 15.0  # below this a growing error is noise or the start of a motion
GROWTH_PX = 0.5  # a frame, at least
SURPRISING_PX = 15.0  # in one frame: an honest target does that from 3 m/s^2 on (2 m, f 31000 px, 55 fps)
EXPLAINED_SHARE = 0.4  # of the surprise that a wrong wiring may leave over to be believed
LEAST_SHARE = 0.25  # of a move on which the wiring may have changed
BELIEVED = 2  # surprises in a row that a wrong wiring explains; one is enough where the target is lost next
LONGEST_GAP_NS = 100_000_000

WIRINGS = {
    "az turned the other way": np.diag((-1.0, 1.0)),
    "el turned the other way": np.diag((1.0, -1.0)),
    "both axes turned the other way": np.diag((-1.0, -1.0)),
    "az and el were exchanged": np.array(((0.0, 1.0), (1.0, 0.0))),
    "az and el were exchanged and turned the other way": np.array(((0.0, -1.0), (-1.0, 0.0))),
    "az and el were exchanged, az turned the other way": np.array(((0.0, -1.0), (1.0, 0.0))),
    "az and el were exchanged, el turned the other way": np.array(((0.0, 1.0), (-1.0, 0.0))),
}


@dataclass(frozen=True, slots=True)
class _Look:
    instant: HostNs
    offset_px: Array  # (2,) from the pixel that is aimed at
    angles_rad: Array  # (2,) latched


@dataclass(frozen=True, slots=True)
class _Move:
    """From one look to the next."""

    before: _Look
    after: _Look
    jacobian: Array  # (2, 2) d px / d encoder rad of a target that stands still
    seconds: float

    def by_axes_px(self, wiring: Array | None = None) -> Array:
        turned_rad = self.after.angles_rad - self.before.angles_rad
        return self.jacobian @ (turned_rad if wiring is None else wiring @ turned_rad)

    def by_target_px(self) -> Array:
        """What the target must have done itself, where the axes do what the calibration says."""
        return self.after.offset_px - self.before.offset_px - self.by_axes_px()


@dataclass(slots=True)
class _Wiring:
    """Compares each move with the target's motion so far."""

    _velocity_px_s: Array | None = None
    _suspected: list[str] = field(default_factory=list)  # one entry for each surprise in a row that a wiring explains
    _unexplained: int = 0

    @property
    def suspected(self) -> str:
        return self._suspected[-1] if self._suspected else ""

    @property
    def believed(self) -> str:
        return self.suspected if len(self._suspected) >= BELIEVED else ""

    def take(self, move: _Move) -> None:
        own_px = move.by_target_px()
        if self._velocity_px_s is None:
            self._accept(move, own_px)
            return
        surprise = own_px - self._velocity_px_s * move.seconds
        surprise_px = hypot(*surprise)
        if surprise_px < SURPRISING_PX:
            self._accept(move, own_px)
            return
        left_px = {name: self._left_px(move, surprise, wiring) for name, wiring in WIRINGS.items()}
        name = min(left_px, key=left_px.__getitem__)
        if left_px[name] < EXPLAINED_SHARE * surprise_px:
            self._suspected.append(name)
        elif self._unexplained or self._suspected:
            self._accept(move, own_px)  # it is the target that moves so
        else:
            self._unexplained += 1  # once: it may have been a single bad outline

    def _left_px(self, move: _Move, surprise: Array, wiring: Array) -> float:
        """Of the surprise, if the axes are wired so; the first time they may be so since the middle of the move only."""
        other_way = move.by_axes_px(wiring) - move.by_axes_px()
        length = float(other_way @ other_way)
        if length == 0.0:
            return hypot(*surprise)
        latest = 1.0 if self._suspected else LEAST_SHARE
        share = min(max(float(surprise @ other_way) / length, latest), 1.0)
        return hypot(*(surprise - share * other_way))

    def _accept(self, move: _Move, own_px: Array) -> None:
        self._velocity_px_s = own_px / move.seconds
        self._suspected.clear()
        self._unexplained = 0


@dataclass(slots=True)
class DivergenceWatch:
    frames: int  # of growth in a row that it takes; one on which the error shrinks starts the count again
    _last: _Look | None = None
    _growing: int = 0
    _wiring: _Wiring = field(default_factory=_Wiring)

    def reset(self) -> None:
        self._last, self._growing, self._wiring = None, 0, _Wiring()

    def diverges(self, step: Step) -> str:
        """Why, in words; empty: it does not."""
        if step.offset_px is None:
            suspected = self._wiring.suspected
            return f"the target was driven out of sight, as if {suspected}" if suspected else ""
        if step.angles is None or step.jacobian is None:
            return ""
        look = _Look(step.instant, np.array(step.offset_px), np.array((step.angles.az_rad, step.angles.el_rad)))
        last, self._last = self._last, look
        if last is None or not 0 < look.instant - last.instant <= LONGEST_GAP_NS:
            self._growing, self._wiring = 0, _Wiring()
            return ""
        move = _Move(last, look, step.jacobian, (look.instant - last.instant) * 1e-9)
        self._wiring.take(move)
        self._count(move)
        if self._wiring.believed:
            return f"the image moves as if {self._wiring.believed}"
        return "the pixel error grows although the axes move against it" if self._growing >= self.frames else ""

    def _count(self, move: _Move) -> None:
        before, after = hypot(*move.before.offset_px), hypot(*move.after.offset_px)
        reducing = float(move.by_axes_px() @ move.before.offset_px) < -GROWTH_PX * before
        if reducing and after > max(DIVERGING_PX, before + GROWTH_PX):
            self._growing += 1
        elif after < before:
            self._growing = 0
