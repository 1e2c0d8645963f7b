"""What each cause adds to the uncertainty of a measured target: pixels, encoders, calibration, over a volume."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import sqrt

import numpy as np

from trackerd.budget.settings import Volume
from trackerd.calibrate.cell.predict import fixes, sensitivity_of
from trackerd.contract.model import Array
from trackerd.geometry.gimbal import Station

COVERAGE = 2.0  # k of U
CAUSES = ("pixels", "encoders, white", "encoders, fixed", "calibration")


@dataclass(frozen=True, slots=True)
class CellNoise:
    """1 sigma of one look. The fixed part of the encoders is a function of the angle: averaging does not remove it."""

    pixel_sigma_px: float
    encoder_sigma_rad: float
    encoder_fixed_rad: float = 0.0


@dataclass(frozen=True, slots=True)
class Part:
    """One cause, or all together: root mean squares over the volume."""

    name: str
    sigma_mm: tuple[float, float, float]  # by axis of W
    u_across_mm: float
    u_depth_mm: float
    share: float  # of the whole variance

    @property
    def rms_mm(self) -> float:
        """3D."""
        return sqrt(sum(sigma**2 for sigma in self.sigma_mm))


@dataclass(frozen=True, slots=True)
class Contributions:
    """Of m places. `cov_mm2` has one (m, 3, 3) for each of CAUSES; they add up."""

    p_mm: Array  # (m, 3)
    depth: Array  # (m, 3) unit vectors from the middle of the gimbals to the place
    cov_mm2: Array  # (causes, m, 3, 3)
    parts: tuple[Part, ...]  # the causes, and all together last

    @property
    def total_mm2(self) -> Array:
        return np.asarray(self.cov_mm2.sum(axis=0))


def grid(volume: Volume) -> Array:
    """Places evenly over the box, corners included, (steps^3, 3)."""
    axes = [
        np.linspace(centre - half, centre + half, volume.steps)
        for centre, half in zip(volume.centre_mm, volume.half_size_mm, strict=True)
    ]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def contributions(
    stations: Mapping[str, Station], parameters: Sequence[str], covariance: Array, p_mm: Array, noise: CellNoise
) -> Contributions:
    """At places (m, 3) that every station sees at its principal point; no parameters: the calibration's part is 0.

    The weights are the maximum likelihood's, with both parts of the encoders. Raises Degenerate where a station cannot be aimed
    at a place, or the lines do not determine it.
    """
    cell = list(stations.values())
    encoder_rad = float(np.hypot(noise.encoder_sigma_rad, noise.encoder_fixed_rad))
    found = fixes(cell, p_mm, noise.pixel_sigma_px, encoder_rad)
    sensitivity = sensitivity_of(cell, parameters, found)
    by_pixels = found.gain @ found.gain.transpose(0, 2, 1)
    swing = found.gain @ found.by_encoder
    by_encoders = swing @ swing.transpose(0, 2, 1)
    cov = np.array(
        [
            noise.pixel_sigma_px**2 * by_pixels,
            noise.encoder_sigma_rad**2 * by_encoders,
            noise.encoder_fixed_rad**2 * by_encoders,
            sensitivity @ covariance @ sensitivity.transpose(0, 2, 1),
        ]
    )
    middle = np.mean([station.world_from_gimbal.translation_mm for station in stations.values()], axis=0)
    depth = (p_mm - middle) / np.linalg.norm(p_mm - middle, axis=1, keepdims=True)
    total = cov.sum(axis=0)
    parts = [_part(name, each, depth, total) for name, each in zip(CAUSES, cov, strict=True)]
    return Contributions(p_mm, depth, cov, (*parts, _part("all together", total, depth, total)))


def u_across_mm(cov_mm2: Array, depth: Array) -> Array:
    """U (k = 2) in the worst direction across the view, (m,)."""
    across = np.eye(3) - depth[:, :, None] * depth[:, None, :]
    return np.asarray(COVERAGE * np.sqrt(np.linalg.eigvalsh(across @ cov_mm2 @ across)[:, -1]))


def u_depth_mm(cov_mm2: Array, depth: Array) -> Array:
    """U (k = 2) along the view, (m,)."""
    return np.asarray(COVERAGE * np.sqrt(np.einsum("mi,mij,mj->m", depth, cov_mm2, depth)))


def _part(name: str, cov_mm2: Array, depth: Array, total_mm2: Array) -> Part:
    variances = cov_mm2.diagonal(axis1=1, axis2=2).mean(axis=0)
    x, y, z = np.sqrt(variances).tolist()
    return Part(
        name=name,
        sigma_mm=(x, y, z),
        u_across_mm=_rms(u_across_mm(cov_mm2, depth)),
        u_depth_mm=_rms(u_depth_mm(cov_mm2, depth)),
        share=float(variances.sum() / total_mm2.trace(axis1=1, axis2=2).mean()),
    )


def _rms(values: Array) -> float:
    return sqrt(float((values**2).mean()))
