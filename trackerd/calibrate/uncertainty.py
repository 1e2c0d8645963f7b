"""Covariances of targets in numbers that people compare: expanded uncertainty, k = 2, across the line of view and in depth."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from trackerd.contract.model import Array
from trackerd.geometry.gimbal import Station

K = 2.0  # coverage factor


@dataclass(frozen=True, slots=True)
class Spread:
    """Of m targets, mm."""

    across_mm: Array  # (m,) U along the worst direction across the mean line of view
    depth_mm: Array  # (m,) U along it
    rms_mm: Array  # (m,) root of the trace: 1 sigma, 3D

    def worst(self) -> tuple[float, float]:
        """The largest U of all, across and in depth."""
        return float(self.across_mm.max()), float(self.depth_mm.max())

    def typical_mm(self) -> float:
        """RMS of the 3D error over all targets."""
        return float(np.sqrt((self.rms_mm**2).mean()))


def spread(cov_mm2: Array, p_mm: Array, stations: Mapping[str, Station]) -> Spread:
    """Covariances (m, 3, 3) of targets (m, 3), against the mean direction in which the stations see each."""
    depth = depth_directions(p_mm, stations)
    along = np.einsum("mi,mij,mj->m", depth, cov_mm2, depth)
    across = np.eye(3) - depth[:, :, None] * depth[:, None, :]
    largest = np.linalg.eigvalsh(across @ cov_mm2 @ across)[:, -1]
    return Spread(K * np.sqrt(largest), K * np.sqrt(along), np.sqrt(np.trace(cov_mm2, axis1=1, axis2=2)))


def depth_directions(p_mm: Array, stations: Mapping[str, Station]) -> Array:
    """(m, 3) unit vectors, from the stations to the targets on average."""
    to_target = [p_mm - station.world_from_gimbal.translation_mm for station in stations.values()]
    total = sum(part / np.linalg.norm(part, axis=1)[:, None] for part in to_target)
    return np.asarray(total / np.linalg.norm(total, axis=1)[:, None])
