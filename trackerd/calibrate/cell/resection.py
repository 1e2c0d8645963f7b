"""Where something is, without a guess, from directions to points of it: SQPnP, or IPPE for a plane, which has two answers."""

from collections.abc import Iterator

import cv2
import numpy as np

from trackerd.calibrate.cell.state import Indices
from trackerd.contract.model import Array
from trackerd.geometry.rigid import Rigid

FLAT = 1e-3  # third singular value over the first: points in a plane
SAMPLES = 60  # of six points: with 20 % outliers, one of four is clean
SAMPLE_POINTS = 6
NOMINAL_RAD = 0.05  # what a nominal mount and lens may be off
ALIKE = 0.05  # in an element of the rotation
OFF_THE_MIDDLE = 0.2  # cosine: rays further from the mean direction have no place on a virtual camera's image
REFINEMENTS = 3  # of the ranges: each turns the rays of an eccentric camera nearer to one centre


def poses(origins_mm: Array, directions: Array, p_mm: Array, seed: int) -> list[Rigid]:
    """Frame of the rays from frame of the points: candidates, the best first, at most two; none where no pose fits.

    Rays (n, 3) each, whose origins are near one another; up to about a third of them may be wrong.
    """
    found = [pose for pose in _solutions(origins_mm, directions, p_mm) if _fits(pose, origins_mm, directions, p_mm)]
    found.sort(key=lambda pose: _median_miss(pose, origins_mm, directions, p_mm))
    if found and _clean(_misses(found[0], origins_mm, directions, p_mm)):
        return found[:2]
    rng = np.random.default_rng(seed)
    points, of_point = np.unique(p_mm, axis=0, return_inverse=True)
    for sample in _samples(rng, of_point.ravel(), len(points)):
        found += _solutions(origins_mm[sample], directions[sample], p_mm[sample])
    found.sort(key=lambda pose: _median_miss(pose, origins_mm, directions, p_mm))
    best: list[Rigid] = []
    for pose in found[:3]:
        misses = _misses(pose, origins_mm, directions, p_mm)
        kept = np.flatnonzero(misses <= 3.0 * max(float(np.median(misses)), 1e-9))
        refined = _solutions(origins_mm[kept], directions[kept], p_mm[kept]) if len(kept) >= SAMPLE_POINTS else []
        best += refined or [pose]
    best.sort(key=lambda pose: _median_miss(pose, origins_mm, directions, p_mm))
    return distinct(best)[:2]


def flat(p_mm: Array) -> bool:
    """All points (n, 3) are in one plane."""
    spread = np.linalg.svd(p_mm - p_mm.mean(axis=0), compute_uv=False)
    return bool(len(spread) < 3 or spread[2] < FLAT * spread[0])


def _samples(rng: np.random.Generator, of_point: Indices, points: int) -> Iterator[Indices]:
    """Rows of six different points each."""
    if points <= SAMPLE_POINTS:
        return
    for _ in range(SAMPLES):
        chosen = rng.choice(points, SAMPLE_POINTS, replace=False)
        yield np.array([rng.choice(np.flatnonzero(of_point == point)) for point in chosen])


def _solutions(origins: Array, directions: Array, p_mm: Array) -> list[Rigid]:
    middle = directions.mean(axis=0)
    middle /= np.linalg.norm(middle)
    turn = _to_z(middle)
    centre = origins.mean(axis=0)
    plane = flat(p_mm)
    found = []
    for first in _central(directions @ turn.T, p_mm, plane):
        pose: Rigid | None = first
        for _ in range(REFINEMENTS):
            if pose is None:
                break
            pose = _nearest(_central(_from_centre(pose, origins - centre, directions, p_mm, turn), p_mm, plane), pose)
        if pose is not None:
            found.append(Rigid(turn.T @ pose.rotation, turn.T @ pose.translation_mm + centre))
    return found


def _from_centre(pose: Rigid, origins: Array, directions: Array, p_mm: Array, turn: Array) -> Array:
    """Directions from the mean origin to where the rays are at the points' ranges."""
    offsets = pose.move(p_mm) - origins @ turn.T
    ranges = np.maximum((offsets * (directions @ turn.T)).sum(axis=1), 1.0)
    return np.asarray((origins + ranges[:, None] * directions) @ turn.T)


def _central(directions: Array, p_mm: Array, plane: bool) -> list[Rigid]:
    """Rays through the origin, along z roughly."""
    front = directions[:, 2] > OFF_THE_MIDDLE * np.linalg.norm(directions, axis=1)
    if front.sum() < 4:
        return []
    image = directions[front, :2] / directions[front, 2:]
    flag = cv2.SOLVEPNP_IPPE if plane else cv2.SOLVEPNP_SQPNP
    try:
        _, turns, shifts, _ = cv2.solvePnPGeneric(p_mm[front].copy(), image.copy(), np.eye(3), None, flags=flag)
    except cv2.error:
        return []
    found = [
        Rigid(np.asarray(cv2.Rodrigues(r)[0], float), np.asarray(t, float).ravel()) for r, t in zip(turns, shifts, strict=True)
    ]
    return [pose for pose in found if np.isfinite(pose.rotation).all() and np.isfinite(pose.translation_mm).all()]


def _nearest(candidates: list[Rigid], pose: Rigid) -> Rigid | None:
    return min(candidates, key=lambda other: float(np.abs(other.rotation - pose.rotation).max()), default=None)


def _misses(pose: Rigid, origins: Array, directions: Array, p_mm: Array) -> Array:
    """Angles (n,) between the rays and the points."""
    offsets = pose.move(p_mm) - origins
    offsets /= np.linalg.norm(offsets, axis=1, keepdims=True)
    return np.asarray(np.linalg.norm(offsets - directions, axis=1))


def _median_miss(pose: Rigid, origins: Array, directions: Array, p_mm: Array) -> float:
    return float(np.median(_misses(pose, origins, directions, p_mm)))


def _fits(pose: Rigid, origins: Array, directions: Array, p_mm: Array) -> bool:
    return _median_miss(pose, origins, directions, p_mm) < 1.0


def _clean(misses: Array) -> bool:
    """No ray is far off the others: nothing to be robust against."""
    median = float(np.median(misses))
    return bool(misses.max() < 5.0 * median and median < NOMINAL_RAD)


def distinct(candidates: list[Rigid]) -> list[Rigid]:
    """Those that are turned away from every better one (a plane's other answer)."""
    kept: list[Rigid] = []
    for pose in candidates:
        if all(np.abs(pose.rotation - other.rotation).max() > ALIKE for other in kept):
            kept.append(pose)
    return kept


def _to_z(direction: Array) -> Array:
    """A rotation that turns a unit direction to z."""
    side = np.cross(np.eye(3)[int(np.abs(direction).argmin())], direction)
    side /= np.linalg.norm(side)
    return np.array((side, np.cross(direction, side), direction))
