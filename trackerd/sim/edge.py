"""How an edge looks: a step, blurred by the lens and integrated over the pixel, as a table over the distance from the edge.

A Gaussian blur and a square pixel together are very nearly one Gaussian of variance psf^2 + 1/12. Blurring a curved edge
moves it inwards; to first order a radial profile f becomes (f * Gauss)(distance + sigma^2 / 2r).
"""

from math import erfc, sqrt

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float32]

CELLS_PER_PX = 512  # of a table: 0.1 DN at the steepest place of a full-scale edge
COARSE_PER_PX = 16  # where a profile is already blurred
REACH = 6.0  # sigmas from the edge beyond which there is none


class Edge:
    """Coverage over signed distance: 1 well inside (negative), 0 well outside."""

    def __init__(self, psf_px: float) -> None:
        self.sigma_px = sqrt(psf_px * psf_px + 1.0 / 12.0)
        self.reach_px = REACH * self.sigma_px
        cells = np.arange(-self.reach_px, self.reach_px, 1.0 / CELLS_PER_PX)
        self._table = np.array([0.5 * erfc(d / (sqrt(2.0) * self.sigma_px)) for d in cells], np.float32)

    def coverage(self, distance_px: Floats) -> Floats:
        return _look_up(self._table, distance_px, -self.reach_px)

    def bend(self, r_px: float) -> float:
        """What to add to the distance from an edge of radius r."""
        return self.sigma_px**2 / (2.0 * r_px)


class Limb:
    """What darkening towards the rim takes from a ball: 1 - cos of the angle of view, blurred; 0 in its middle and outside."""

    STALE_PX = 0.25  # a radius this different makes a new table: 0.2 % of a darkening at r = 60

    def __init__(self, edge: Edge) -> None:
        self._edge = edge
        self._r_px = -np.inf
        self._table: Floats = np.zeros(1, np.float32)

    def loss(self, distance_px: Floats, r_px: float) -> Floats:
        """Over the signed distance from the rim, bend included."""
        if abs(r_px - self._r_px) > self.STALE_PX:
            self._r_px, self._table = r_px, self._blurred(r_px)
        return _look_up(self._table, distance_px, -self._r_px)

    def _blurred(self, r_px: float) -> Floats:
        margin = self._edge.reach_px
        distance = np.arange(-r_px - margin, 2.0 * margin, 1.0 / COARSE_PER_PX)
        share = np.clip(1.0 + distance / r_px, 0.0, 1.0)  # of the radius
        loss = np.where(distance < 0.0, 1.0 - np.sqrt(1.0 - share**2), 0.0)
        taps = np.arange(-round(margin * COARSE_PER_PX), round(margin * COARSE_PER_PX) + 1) / COARSE_PER_PX
        kernel = np.exp(-0.5 * (taps / self._edge.sigma_px) ** 2)
        blurred = np.convolve(loss, kernel / kernel.sum(), mode="same")
        cells = np.arange(-r_px, margin, 1.0 / CELLS_PER_PX)
        return np.asarray(np.interp(cells, distance, blurred), np.float32)


def _look_up(table: Floats, distance_px: Floats, first_px: float) -> Floats:
    """Nearest cell; beyond its ends a table goes on level."""
    cell = (distance_px * np.float32(CELLS_PER_PX) + np.float32(0.5 - first_px * CELLS_PER_PX)).astype(np.int32)
    found: Floats = np.take(table, cell, mode="clip")
    return found
