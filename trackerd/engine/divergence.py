"""While following: does the pixel error grow although the axes, by their encoders, move so as to reduce it?"""

from dataclasses import dataclass
from math import hypot

import numpy as np

from trackerd.contract.model import Array
from trackerd.engine.track import Step

DIVERGING_PX = 15.0  # below this a growing error is noise or the start of a motion
GROWTH_PX = 0.5  # a frame, at least


@dataclass(frozen=True, slots=True)
class _Look:
    offset_px: Array  # (2,) from the pixel that is aimed at
    angles_rad: Array  # (2,) latched


@dataclass(slots=True)
class DivergenceWatch:
    """Counts the frames in a row on which it does; one on which the error shrinks starts the count again."""

    frames: int  # that it takes
    _last: _Look | None = None
    _growing: int = 0

    def reset(self) -> None:
        self._last, self._growing = None, 0

    def diverges(self, step: Step) -> bool:
        if step.offset_px is None or step.angles is None or step.jacobian is None:
            self.reset()
            return False
        look = _Look(np.array(step.offset_px), np.array((step.angles.az_rad, step.angles.el_rad)))
        last, self._last = self._last, look
        if last is None:
            return False
        before, after = hypot(*last.offset_px), hypot(*look.offset_px)
        moved_px = step.jacobian @ (look.angles_rad - last.angles_rad)  # what the axes did to a target that stands still
        reducing = float(moved_px @ last.offset_px) < -GROWTH_PX * before
        if reducing and after > max(DIVERGING_PX, before + GROWTH_PX):
            self._growing += 1
        elif after < before:
            self._growing = 0
        return self._growing >= self.frames
