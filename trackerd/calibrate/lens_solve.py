"""The lens and all poses by least squares: Levenberg-Marquardt on the analytic slopes, with the poses eliminated."""

from dataclasses import dataclass

import cv2
import numpy as np

from trackerd.calibrate.lens_model import Estimate, Normal, Views, normal_equations, residuals
from trackerd.contract.errors import Undetermined
from trackerd.contract.model import Array

STEPS = 200
CONVERGED, ROUGHLY = 1e-10, 1e-3  # relative fall of the sum of squares
FIRST_DAMPING, LEAST_DAMPING, MOST_DAMPING = 1e-4, 1e-14, 1e10
FOCAL_TRIES = np.geomspace(0.3, 60.0, 14)  # of the sensor's width: from 120 degrees to 1, in steps of a half
SINGULAR = 1e-13  # of the scaled normal matrix's smallest eigenvalue to its largest
CAUCHY_SIGMAS = 2.4  # where a residual begins to weigh less in the robust rounds (95 % efficiency)
UNTURNED = "turn and tilt the board by 20 to 40 degrees in several directions, and come near and far"


@dataclass(frozen=True, slots=True)
class Solved:
    """The minimum; `rss_px2` is weighted."""

    estimate: Estimate
    rss_px2: float
    normal: Normal


def solve(views: Views, start: Estimate, free: Array, weights: Array | None = None, fall: float = CONVERGED) -> Solved:
    """`free` (9, p): the combinations of intrinsics that are estimated; `fall`, of the sum of squares, ends it."""
    w = np.ones(len(views.q_px)) if weights is None else weights
    estimate, damping = start, FIRST_DAMPING
    rss = _rss(views, estimate, w)
    normal = normal_equations(views, estimate, w)
    for _ in range(STEPS):
        intrinsics, poses = _step(normal, free, damping)
        trial = estimate.moved(free @ intrinsics, poses)
        trial_rss = _rss(views, trial, w)
        if not trial_rss <= rss:
            damping *= 8.0
            if damping > MOST_DAMPING:
                break
            continue
        fell, estimate, rss = rss - trial_rss, trial, trial_rss
        damping = max(damping / 8.0, LEAST_DAMPING)
        normal = normal_equations(views, estimate, w)
        if fell <= fall * rss:
            break
    return Solved(estimate, rss, normal)


def robust(views: Views, start: Estimate, free: Array, rounds: int = 4) -> Estimate:
    """Iteratively reweighted, so that gross errors do not pull (Cauchy's weights)."""
    estimate = start
    for _ in range(rounds):
        distance = np.linalg.norm(residuals(views, estimate), axis=1)
        sigma = max(float(np.median(distance)) / 1.1774, 1e-9)  # of one coordinate: the median of a Rayleigh distribution
        weights = 1.0 / (1.0 + np.square(distance / (CAUCHY_SIGMAS * sigma)))
        estimate = solve(views, estimate, free, weights, ROUGHLY).estimate
    return estimate


def reduced(normal: Normal, free: Array) -> Array:
    """Information of the free intrinsics with all poses unknown, (p, p)."""
    return np.asarray(free.T @ (normal.a - (_gain(normal) @ normal.b.transpose(0, 2, 1)).sum(0)) @ free)


def covariance(normal: Normal, free: Array) -> Array:
    """Of the free intrinsics, (p, p), for a sigma of 1 px. Raises Undetermined where the views do not tell them apart."""
    information = reduced(normal, free)
    scale = np.sqrt(np.maximum(np.diag(free.T @ normal.a @ free), 1e-300))
    values, vectors = np.linalg.eigh(information / np.outer(scale, scale))
    if values[0] <= SINGULAR * values[-1]:
        raise Undetermined(f"the pictures do not tell the focal length from the boards' distances: {UNTURNED}")
    return np.asarray((vectors / values) @ vectors.T / np.outer(scale, scale))


def pose_correlation(normal: Normal, free: Array, cov: Array) -> Array:
    """Largest correlation of each free intrinsic with any pose's parameter, (p,) in [0, 1]."""
    gain = free.T @ _gain(normal)  # (m, p, 6)
    mixed = -cov @ gain
    poses = np.linalg.inv(normal.d) + gain.transpose(0, 2, 1) @ cov @ gain
    sigmas = np.sqrt(np.diag(cov))[:, None] * np.sqrt(np.diagonal(poses, axis1=1, axis2=2))[:, None, :]
    return np.asarray(np.abs(mixed / sigmas).max(axis=(0, 2)))


def start(views: Views, sensor_px: tuple[int, int]) -> Estimate:
    """No guess is needed: of many focal lengths the one whose poses fit best, the principal point in the middle."""
    tries = [_posed(views, sensor_px, f * sensor_px[0]) for f in FOCAL_TRIES]
    return min(tries, key=lambda one: _median_square(views, one))


def _median_square(views: Views, estimate: Estimate) -> float:
    """Median over the views of their mean squares: one wrong board does not choose the focal length."""
    squares = np.square(residuals(views, estimate)).sum(1)
    means = np.bincount(views.view, squares, views.count) / np.maximum(np.bincount(views.view, minlength=views.count), 1)
    return float(np.median(means))


def _posed(views: Views, sensor_px: tuple[int, int], focal_px: float) -> Estimate:
    intrinsics = np.array([focal_px, focal_px, (sensor_px[0] - 1) / 2, (sensor_px[1] - 1) / 2, 0, 0, 0, 0, 0])
    matrix = np.array([[focal_px, 0.0, intrinsics[2]], [0.0, focal_px, intrinsics[3]], [0.0, 0.0, 1.0]])
    rotations, translations = [], []
    for n in range(views.count):
        mine = views.view == n
        rotation, translation = _pose(views.p_mm[mine], views.q_px[mine], matrix)
        rotations.append(rotation)
        translations.append(translation)
    return Estimate(intrinsics, np.array(rotations), np.array(translations))


def _pose(p_mm: Array, q_px: Array, matrix: Array) -> tuple[Array, Array]:
    """The better of the two poses that a plane has (IPPE); EPnP for points that fill space. Where they put a point behind the
    camera, which a wrong board does, one that faces it: the fit tells how wrong it is."""
    flat = bool(np.ptp(p_mm[:, 2]) == 0.0)
    method = cv2.SOLVEPNP_IPPE if flat else cv2.SOLVEPNP_EPNP
    points, pixels = np.ascontiguousarray(p_mm), np.ascontiguousarray(q_px)
    _, vectors, translations, errors = cv2.solvePnPGeneric(points, pixels, matrix, None, flags=method)
    for n in np.argsort(np.ravel(errors)) if vectors else ():
        rotation, translation = np.asarray(cv2.Rodrigues(vectors[n])[0], float), np.ravel(translations[n]).astype(float)
        if (p_mm @ rotation[2] + translation[2] > 0.0).all():
            return rotation, translation
    return np.eye(3), _facing(p_mm, q_px, matrix)


def _facing(p_mm: Array, q_px: Array, matrix: Array) -> Array:
    """Where a board that is not turned would be as large and in the same place."""
    range_mm = matrix[0, 0] * float(np.linalg.norm(p_mm.std(0)) / np.linalg.norm(q_px.std(0)))
    centre = (q_px.mean(0) - matrix[:2, 2]) / matrix[0, 0] * range_mm
    x, y, z = p_mm.mean(0)[0], p_mm.mean(0)[1], min(0.0, float(p_mm[:, 2].min()))
    return np.array((centre[0] - x, centre[1] - y, range_mm - z))


def _step(normal: Normal, free: Array, damping: float) -> tuple[Array, Array]:
    """Intrinsics (p,) and poses (m, 6), Marquardt's damping on both."""
    d = normal.d * (1.0 + damping * np.eye(6))
    gain = np.linalg.solve(d, normal.b.transpose(0, 2, 1)).transpose(0, 2, 1)
    a = free.T @ normal.a @ free
    if not a.size:
        return np.zeros(0), np.asarray(np.linalg.solve(d, normal.gd[:, :, None])[:, :, 0], float)
    left = a * (1.0 + damping * np.eye(len(a))) - free.T @ (gain @ normal.b.transpose(0, 2, 1)).sum(0) @ free
    right = free.T @ (normal.ga - np.einsum("mij,mj->i", gain, normal.gd))
    intrinsics: Array = np.linalg.lstsq(left, right, rcond=None)[0]
    rest = normal.gd - np.einsum("mij,i->mj", normal.b, free @ intrinsics)
    return intrinsics, np.asarray(np.linalg.solve(d, rest[:, :, None])[:, :, 0], float)


def _gain(normal: Normal) -> Array:
    """B D^-1 of each view, (m, 9, 6)."""
    return np.asarray(np.linalg.solve(normal.d, normal.b.transpose(0, 2, 1)).transpose(0, 2, 1), float)


def _rss(views: Views, estimate: Estimate, weights: Array) -> float:
    total = float((weights[:, None] * np.square(residuals(views, estimate))).sum())
    return total if np.isfinite(total) else np.inf
