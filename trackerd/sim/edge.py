"""How an edge looks: a step, blurred by the lens and integrated over the pixel, as a table over the distance from the edge.

A Gaussian blur and a square pixel together are very nearly one Gaussian of variance psf^2 + 1/12; a term of fourth order says
that the pixel has no tails. Blurring a curved edge moves it inwards; to first order a radial profile f becomes
(f * Gauss)(distance + sigma^2 / 2r).
"""

from math import ceil, erfc, exp, pi, sqrt

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float32]

CELLS_PER_PX = 512  # of a table: 0.1 DN at the steepest place of a full-scale edge
COARSE_PER_PX = 16  # where a profile is already blurred
PIXEL_CUMULANT = -1.0 / 160.0  # the fourth, -(cos^4 + sin^4) / 120, averaged over the directions of the edge
REACH = 6.0  # sigmas from the edge beyond which there is none


class Edge:
    """Coverage over signed distance: 1 well inside (negative), 0 well outside."""

    def __init__(self, psf_px: float) -> None:
        self.sigma_px = sqrt(psf_px * psf_px + 1.0 / 12.0)
        self.reach_px = REACH * self.sigma_px
        cells = np.arange(-self.reach_px, self.reach_px, 1.0 / CELLS_PER_PX)
        self._table = np.array([_coverage(d / self.sigma_px, self.sigma_px) for d in cells], np.float32)

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
        inner, outer = ceil((r_px + margin) * COARSE_PER_PX), ceil(2.0 * margin * COARSE_PER_PX)
        distance = (np.arange(-inner, outer) + 0.5) / COARSE_PER_PX  # the rim is half-way between two samples
        share = np.clip(1.0 + distance / r_px, 0.0, 1.0)  # of the radius
        loss = np.where(distance < 0.0, 1.0 - np.sqrt(1.0 - share**2), 0.0)
        taps = np.arange(-round(margin * COARSE_PER_PX), round(margin * COARSE_PER_PX) + 1) / COARSE_PER_PX
        kernel = np.exp(-0.5 * (taps / self._edge.sigma_px) ** 2)
        blurred = np.convolve(loss, kernel / kernel.sum(), mode="same")
        cells = np.arange(-r_px, margin, 1.0 / CELLS_PER_PX)
        return np.asarray(np.interp(cells, distance, blurred), np.float32)


def _coverage(z: float, sigma_px: float) -> float:
    """Of a straight edge z sigmas away: the normal integral and its Edgeworth term."""
    tails = PIXEL_CUMULANT / sigma_px**4 / 24.0
    return 0.5 * erfc(z / sqrt(2.0)) + tails * (z**3 - 3.0 * z) * exp(-0.5 * z * z) / sqrt(2.0 * pi)


def _look_up(table: Floats, distance_px: Floats, first_px: float) -> Floats:
    """Nearest cell; beyond its ends a table goes on level."""
    cell = (distance_px * np.float32(CELLS_PER_PX) + np.float32(0.5 - first_px * CELLS_PER_PX)).astype(np.int32)
    found: Floats = np.take(table, cell, mode="clip")
    return found
