"""Cells of K stations round a work volume with white angular noise, drawn in bulk: what triangulation is judged with."""

from dataclasses import dataclass
from math import cos, pi, sin

import numpy as np

from trackerd.contract.clock import HostNs
from trackerd.contract.model import Array, Sightline

ARCSEC = pi / 648_000.0
COMPACT = {
    2: ((-550.0, 0.0, -1920.0), (550.0, 0.0, -1920.0)),
    3: ((-550.0, 0.0, -1920.0), (550.0, 0.0, -1920.0), (0.0, -900.0, -1800.0)),
    4: ((-550.0, 350.0, -1920.0), (550.0, 350.0, -1920.0), (-550.0, -350.0, -1920.0), (550.0, -350.0, -1920.0)),
    6: tuple((1000.0 * cos(a), 1000.0 * sin(a), -1700.0) for a in np.linspace(0.0, 2 * pi, 6, endpoint=False)),
}
HALL = {  # 5 m x 5 m, stations along the walls at different heights; the target is far from the middle
    2: ((-2500.0, -2500.0, 1500.0), (2500.0, -2500.0, 1500.0)),
    3: ((-2500.0, -2500.0, 1500.0), (2500.0, -2500.0, 1800.0), (0.0, 2500.0, 1200.0)),
    4: ((-2500.0, -2500.0, 1500.0), (2500.0, -2500.0, 1800.0), (2500.0, 2500.0, 1200.0), (-2500.0, 2500.0, 2000.0)),
    6: (
        *((-2500.0, -2500.0, 1500.0), (2500.0, -2500.0, 1800.0), (2500.0, 2500.0, 1200.0), (-2500.0, 2500.0, 2000.0)),
        *((2500.0, 0.0, 900.0), (-2500.0, 0.0, 2100.0)),
    ),
}
TARGETS = {"compact": (60.0, -40.0, 30.0), "5 x 5 m": (-1500.0, -1200.0, 600.0)}
CELLS = {"compact": COMPACT, "5 x 5 m": HALL}


@dataclass(frozen=True, slots=True)
class Cell:
    """K stations that look at one target; every line has a covariance of its own shape, about 2 arcsec."""

    origins_mm: Array  # (K, 3)
    target_mm: Array  # (3,)
    cov_rad2: Array  # (K, 3, 3), across the true lines

    @property
    def bound(self) -> Array:
        """Cramér-Rao bound of a position from one look, (3, 3) mm^2."""
        offsets = self.target_mm - self.origins_mm
        squares = (offsets**2).sum(axis=1)
        information = np.linalg.pinv(self.cov_rad2, rcond=1e-9, hermitian=True) / squares[:, None, None]
        return np.asarray(np.linalg.inv(information.sum(axis=0)))

    def draws(self, rng: np.random.Generator, count: int) -> list[list[Sightline]]:
        """`count` independent looks of all stations."""
        offsets = self.target_mm - self.origins_mm
        ranges = np.sqrt((offsets**2).sum(axis=1))
        true = offsets / ranges[:, None]
        values, vectors = np.linalg.eigh(self.cov_rad2)
        roots = vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]
        seen = true + (roots @ rng.standard_normal((count, len(true), 3, 1)))[..., 0]
        seen /= np.sqrt((seen**2).sum(axis=2))[..., None]
        across = np.eye(3) - seen[..., :, None] * seen[..., None, :]
        covs = across @ self.cov_rad2 @ across
        return [
            [
                Sightline(
                    str(k),
                    HostNs(0),
                    0.0,
                    self.origins_mm[k],
                    seen[n, k],
                    covs[n, k],
                    0.0 * covs[n, k],
                    ranges[k],
                    1.0,
                    HostNs(0),
                )
                for k in range(len(true))
            ]
            for n in range(count)
        ]


def cell(kind: str, stations: int) -> Cell:
    """`kind` is compact or 5 x 5 m. Encoder 2 arcsec about both axes and 0.1 px of 6.6 arcsec; EL shortens AZ's share."""
    origins = np.array(CELLS[kind][stations])
    target = np.array(TARGETS[kind])
    covs = []
    for k, origin in enumerate(origins):
        d = (target - origin) / np.linalg.norm(target - origin)
        across = np.eye(3) - np.outer(d, d)
        upright = np.array((0.0, 0.0, 1.0)) if kind == "5 x 5 m" else np.array((1.0, 0.0, 0.0))
        level = np.cross(upright, d)
        shape = (2.0**2) * np.outer(level, level) + (1.6 + 0.2 * k) ** 2 * np.eye(3)
        covs.append(ARCSEC**2 * across @ shape @ across)
    return Cell(origins, target, np.array(covs))
