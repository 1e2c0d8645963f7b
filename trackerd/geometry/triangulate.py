"""Lines of sight to a point, with its covariance."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from math import cos, radians, sqrt

import numpy as np

from trackerd.contract.errors import Degenerate
from trackerd.contract.model import Array, Sightline
from trackerd.geometry.rigid import cross

COS_PARALLEL = cos(radians(1.0))
STEPS = 2  # ranges follow from the point; after the first solution they are right to the noise, so that one more converges


class Method(StrEnum):
    """How much a line counts. All are refused alike, and each states the covariance that it really has."""

    UNWEIGHTED = "unweighted"  # all alike, Eqs 3.14-3.17 of the source thesis: best at equal ranges only
    RANGE_WEIGHTED = "range_weighted"  # 1 / (range x sigma)^2, sigma the rms of both directions across the line
    MAXIMUM_LIKELIHOOD = "maximum_likelihood"  # the whole angular covariance over the range: best to first order


@dataclass(frozen=True, slots=True)
class Point:
    """In W. `cov_mm2` is the random part; miss is the distance of the skew lines (K = 2), else the rms distance.

    `chi2` is that of the lines, the same by every method: how far they are from meeting anywhere, by both parts' covariance.
    """

    p_mm: Array  # (3,)
    cov_mm2: Array  # (3, 3)
    systematic_cov_mm2: Array  # (3, 3), from the lines' fixed parts
    miss_mm: float
    miss_sigma_mm: float  # 1 sigma of the miss distance, both parts
    chi2: float
    dof: int
    ranges_mm: Array  # (K,) from each entrance pupil


@dataclass(frozen=True, slots=True)
class _Bundle:
    origins_mm: Array  # (K, 3)
    directions: Array  # (K, 3)
    information: Array  # (K, 3, 3) per rad^2, rank 2: the pseudo-inverse of both parts' covariance
    random_cov_rad2: Array  # (K, 3, 3)
    fixed_cov_rad2: Array  # (K, 3, 3)


def triangulate(lines: Sequence[Sightline], method: Method = Method.MAXIMUM_LIKELIHOOD) -> Point:
    """Point nearest to all lines of sight, by default each weighted by its angular covariance times its range squared.

    Both parts of the covariance weigh: by the random part alone, a line that is sharp in one direction only would be believed
    there beyond what its encoders know, and the geometry would blow the fixed part up.

    Generalises Eqs 3.14-3.17 of the source thesis, which weigh all lines alike; reweighted with the ranges of its own
    solution it is the maximum-likelihood point to first order in the angular noise. Raises Degenerate below two lines, where
    all are within 1 deg of parallel, where the point is behind a camera (Eq 3.13 needs t > 0), and for covariances or vectors
    that are no such.
    """
    method = Method(method)  # its name will do; another word is a ValueError, not another method
    bundle = _bundle(lines)
    shapes = _shapes(bundle, method)
    counted = np.ones(len(lines))  # the ranges that divide the weights
    for _ in range(STEPS):
        p_mm = _solve(bundle, shapes, counted)[0]
        ranges = np.sqrt(((p_mm - bundle.origins_mm) ** 2).sum(axis=1))
        counted = counted if method is Method.UNWEIGHTED else ranges
    p_mm, total, weights = _solve(bundle, shapes, counted)
    offsets = p_mm - bundle.origins_mm
    along = (offsets * bundle.directions).sum(axis=1)
    if not along.min() > 0.0:  # also where it is not a number
        raise Degenerate(f"the lines meet behind the camera of station {lines[int(np.argmin(along))].station}")
    gains = total @ weights  # (K, 3, 3): d point / d offset of line k
    gains *= ranges[:, None, None]
    turned = gains.transpose(0, 2, 1)
    cov = (gains @ bundle.random_cov_rad2 @ turned).sum(axis=0)
    systematic = (gains @ bundle.fixed_cov_rad2 @ turned).sum(axis=0)
    chi2 = _chi2(bundle, offsets, ranges) if shapes is not bundle.information else _squares(offsets, weights)
    miss, sigma = _miss(bundle, offsets, along, ranges)
    return Point(p_mm, cov, systematic, miss, sigma, chi2, 2 * len(lines) - 3, ranges)


def _shapes(bundle: _Bundle, method: Method) -> Array:
    """What each line weighs but for its range, (K, 3, 3)."""
    if method is Method.MAXIMUM_LIKELIHOOD:
        return bundle.information
    across = np.eye(3) - bundle.directions[:, :, None] * bundle.directions[:, None, :]
    if method is Method.UNWEIGHTED:
        return across
    variance = (bundle.random_cov_rad2 + bundle.fixed_cov_rad2).trace(axis1=1, axis2=2) / 2.0
    return np.asarray(across / variance[:, None, None])


def _squares(offsets: Array, weights: Array) -> float:
    return float((offsets[:, None, :] @ weights @ offsets[:, :, None]).sum())


def _chi2(bundle: _Bundle, offsets: Array, ranges_mm: Array) -> float:
    """Of the residuals of any method, by their own covariance: what is left of their squares at the best point."""
    weights = bundle.information / (ranges_mm**2)[:, None, None]
    slope = (weights @ offsets[:, :, None]).sum(axis=0)[:, 0]
    return max(0.0, _squares(offsets, weights) - float(slope @ np.linalg.solve(weights.sum(axis=0), slope)))


def _bundle(lines: Sequence[Sightline]) -> _Bundle:
    if len(lines) < 2:
        raise Degenerate(f"a point needs two lines of sight, here {len(lines)}")
    origins = np.array([line.origin_mm for line in lines])
    directions = np.array([line.direction for line in lines])
    random = np.array([line.cov_rad2 for line in lines])
    fixed = np.array([line.fixed_cov_rad2 for line in lines])
    if not np.isfinite(origins.sum() + directions.sum() + random.sum() + fixed.sum()):
        raise Degenerate("a line of sight is not finite")
    if np.abs(directions @ directions.T).min() > COS_PARALLEL:
        raise Degenerate("all lines of sight are within 1 deg of parallel")
    return _Bundle(origins, directions, _information(random + fixed, directions), random, fixed)


def _information(cov_rad2: Array, directions: Array) -> Array:
    """Pseudo-inverses of the covariances across the directions, (K, 3, 3).

    Projected on both sides: over a range of metres a share of 1e-6 along the line would already pull the point.
    """
    scale = cov_rad2.trace(axis1=1, axis2=2)[:, None, None] / 2.0
    along = directions[:, :, None] * directions[:, None, :]
    across = np.eye(3) - along
    try:
        information = across @ np.linalg.inv(across @ cov_rad2 @ across + scale * along) @ across
    except (np.linalg.LinAlgError, FloatingPointError) as err:
        raise Degenerate("a line of sight has a singular covariance") from err
    if not (scale.min() > 0.0 and np.isfinite(information.sum())):
        raise Degenerate("a line of sight has a covariance that is not positive")
    return np.asarray(information)


def _solve(bundle: _Bundle, shapes: Array, ranges_mm: Array) -> tuple[Array, Array, Array]:
    """Point, the inverse of the sum of the weights, and these, (K, 3, 3)."""
    weights = shapes / (ranges_mm**2)[:, None, None]
    try:
        cov = np.linalg.inv(weights.sum(axis=0))
    except np.linalg.LinAlgError as err:
        raise Degenerate("the lines of sight do not determine a point") from err
    return cov @ (weights @ bundle.origins_mm[:, :, None]).sum(axis=0)[:, 0], cov, weights


def _miss(bundle: _Bundle, offsets: Array, along: Array, ranges_mm: Array) -> tuple[float, float]:
    """Miss distance and its sigma: along the common normal for two lines, rms over the lines for more."""
    if len(offsets) == 2:
        normal = cross(bundle.directions[0], bundle.directions[1])
        normal /= sqrt(float(normal @ normal))
        variance = float((ranges_mm**2 * (normal @ (bundle.random_cov_rad2 + bundle.fixed_cov_rad2) @ normal)).sum())
        return abs(float(normal @ (bundle.origins_mm[1] - bundle.origins_mm[0]))), sqrt(variance)
    across = offsets - along[:, None] * bundle.directions
    spread = ranges_mm**2 * (bundle.random_cov_rad2 + bundle.fixed_cov_rad2).trace(axis1=1, axis2=2)
    return sqrt(float((across**2).sum()) / len(offsets)), sqrt(float(spread.mean()))
