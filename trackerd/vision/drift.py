"""The ball's movement in the image, where the axes' angles are not known: constant velocity from the last sightings.

A single leap is no velocity: it is believed when the next movement is like it, and till then the ball is expected where it was.
"""

from math import hypot

from trackerd.contract.clock import HostNs

LONGEST_GAP_S = 0.2
SMOOTHING = 0.6  # share of the newest velocity
LIKE = 0.5  # of the greater of two movements: how far they may differ and be one motion
SMALL_PX = 20.0  # a movement of less is believed at once


class Drift:
    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        self._seen: tuple[HostNs, float, float] | None = None
        self._velocity_px_s: tuple[float, float] | None = None
        self._newest_px_s = (0.0, 0.0)

    def update(self, instant: HostNs, x_px: float, y_px: float) -> None:
        """A sighting; stamps that do not move on are ignored."""
        if self._seen is not None:
            since, x, y = self._seen
            dt_s = (instant - since) * 1e-9
            if dt_s <= 0.0:
                return
            newest = ((x_px - x) / dt_s, (y_px - y) / dt_s)
            last = newest if self._velocity_px_s is None else self._velocity_px_s
            share = SMOOTHING if dt_s < LONGEST_GAP_S else 1.0
            vx, vy = (share * new + (1.0 - share) * old for new, old in zip(newest, last, strict=True))
            believed = self._is_like_the_last(newest, dt_s)
            self._velocity_px_s, self._newest_px_s = (vx, vy) if believed else None, newest
        self._seen = (instant, x_px, y_px)

    def _is_like_the_last(self, newest: tuple[float, float], dt_s: float) -> bool:
        last = self._newest_px_s
        greater = max(hypot(*newest), hypot(*last))
        return hypot(newest[0] - last[0], newest[1] - last[1]) <= max(LIKE * greater, SMALL_PX / dt_s)

    def predict(self, instant: HostNs) -> tuple[float, float] | None:
        """Pixel (x, y) at an instant. None: never seen."""
        if self._seen is None:
            return None
        since, x, y = self._seen
        vx, vy = self._velocity_px_s or (0.0, 0.0)
        ahead_s = min((instant - since) * 1e-9, LONGEST_GAP_S)
        return x + vx * ahead_s, y + vy * ahead_s
