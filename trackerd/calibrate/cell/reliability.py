"""Verification, not only adjustment: check points outside it, and what errors would go unseen."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import sqrt

import numpy as np
import numpy.typing as npt
from scipy.stats import binom

from trackerd.calibrate.cell.predict import fixes
from trackerd.contract.errors import ConfigError
from trackerd.contract.model import Array
from trackerd.geometry.gimbal import Station

FEWEST_CHECKS = 8
COVERAGE = 2.833  # k of three coordinates together that covers as much as k = 2 of one: 95.45 %
BEYOND_BY_CHANCE = 0.0455
FAR = 1.5  # En that chance makes once in 3000 points
DETECTED_SIGMAS = 4.132  # Baarda's: found by a two-sided test at 0.1 % with 80 % probability
LEAST_REDUNDANCY = 1e-9  # share of a bias that chi-square sees; less is rounding
ARCSEC = np.pi / 648_000.0


@dataclass(frozen=True, slots=True)
class Verification:
    """Check points: measured minus reference.

    En is the error over its expanded uncertainty, of measured and reference together, all three coordinates at once. Of true
    covariances one En of 22 is above 1: `verified` are at least FEWEST_CHECKS points, with no more of them above 1 than chance
    makes in 99 of 100 calibrations, and none above 1.5.
    """

    error_mm: Array  # (m, 3)
    en: Array  # (m,)
    rms_mm: float  # 3D
    max_mm: float
    allowed_beyond: int  # how many En above 1 are chance
    verified: bool


@dataclass(frozen=True, slots=True)
class Reliability:
    """Of a fix of K stations at m places: what bias of one axis' encoder chi-square would find, and what an unseen one does.

    Smallest bias that a test at 0.1 % finds with 80 % probability (Baarda's 4.13 sigmas); inf where no redundancy sees it.
    """

    names: tuple[str, ...]  # (2 K) left.az, left.el...
    detectable_rad: Array  # (m, 2 K) minimal detectable bias
    external_mm: Array  # (m, 2 K) what it moves the target by; inf where nothing limits it
    invisible_mm_per_arcsec: Array  # (m,) the worst bias that no chi-square sees: target's move for 1 arcsec of all axes (norm)


def verify(
    measured_mm: npt.ArrayLike, measured_cov_mm2: npt.ArrayLike, reference_mm: npt.ArrayLike, reference_cov_mm2: npt.ArrayLike
) -> Verification:
    """Check points (m, 3) and covariances (m, 3, 3) of both; none of them may have been in the adjustment.

    A point that was not measured (NaN) is an error: it would have been left out silently.
    """
    measured, reference = np.asarray(measured_mm, float), np.asarray(reference_mm, float)
    cov = np.asarray(measured_cov_mm2, float) + np.asarray(reference_cov_mm2, float)
    if measured.shape != reference.shape or measured.ndim != 2 or cov.shape != (*measured.shape, 3):
        raise ConfigError(f"check points: {measured.shape} measured, {reference.shape} reference, {cov.shape} covariances")
    error = measured - reference
    if not (np.isfinite(error).all() and np.isfinite(cov).all()):
        raise ConfigError("check points: one of them is not finite, or was not seen by two stations")
    size = np.linalg.norm(error, axis=1)
    try:
        en = np.sqrt(np.einsum("mi,mij,mj->m", error, np.linalg.inv(cov), error)) / COVERAGE
    except np.linalg.LinAlgError as err:
        raise ConfigError("check points: a covariance is singular") from err
    allowed = int(binom.ppf(0.99, len(size), BEYOND_BY_CHANCE))
    return Verification(
        error_mm=error,
        en=en,
        rms_mm=sqrt(float((size**2).mean())),
        max_mm=float(size.max()),
        allowed_beyond=allowed,
        verified=len(size) >= FEWEST_CHECKS and int((en > 1.0).sum()) <= allowed and float(en.max()) <= FAR,
    )


def reliability(
    stations: Mapping[str, Station], p_mm: npt.ArrayLike, *, sigma_px: float, encoder_sigma_rad: float
) -> Reliability:
    """At targets (m, 3) seen at the principal points. Raises Degenerate as `predict`.

    Of K stations 2 K - 3 combinations of the image offsets are redundant; what has no part in them, chi-square cannot see.
    """
    cell = list(stations.values())
    found = fixes(cell, p_mm, sigma_px, encoder_sigma_rad)
    bias = found.by_encoder  # (m, 2 K, 2 K): pixels by each axis' encoder
    residual = np.eye(bias.shape[1]) - found.by_target @ found.gain
    seen = np.einsum("mia,mij,mjk,mka->ma", bias, found.weight, residual, bias)
    whole = np.einsum("mia,mij,mja->ma", bias, found.weight, bias)
    moves = found.gain @ bias  # (m, 3, 2 K)
    visible = seen > LEAST_REDUNDANCY * whole
    detectable = np.where(visible, DETECTED_SIGMAS / np.sqrt(np.where(visible, seen, 1.0)), np.inf)
    reach = np.linalg.norm(moves, axis=1)
    external = np.where(visible, reach * np.where(visible, detectable, 0.0), np.where(reach > 0.0, np.inf, 0.0))
    return Reliability(
        names=tuple(f"{station.name}.{axis}" for station in cell for axis in ("az", "el")),
        detectable_rad=detectable,
        external_mm=external,
        invisible_mm_per_arcsec=_invisible(found.weight, residual, bias, moves) * ARCSEC,
    )


def _invisible(weight: Array, residual: Array, bias: Array, moves: Array) -> Array:
    """(m,) largest |move| per unit norm of a combination of all axes' biases that leaves chi-square as it is, mm / rad."""
    worst = np.zeros(len(bias))
    for i in range(len(bias)):
        shown = bias[i].T @ weight[i] @ residual[i] @ bias[i]
        values, vectors = np.linalg.eigh((shown + shown.T) / 2.0)
        unseen = vectors[:, values <= LEAST_REDUNDANCY * max(float(values[-1]), 1e-300)]
        worst[i] = np.linalg.svd(moves[i] @ unseen, compute_uv=False)[0] if unseen.shape[1] else 0.0
    return worst
