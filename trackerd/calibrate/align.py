"""Datum transfer: from points that the cell measured and their nominal coordinates to `world_from_cell`.

Two ways. The best fit weighs every point by its covariance. 3-2-1 takes a plane from three points, a direction in it from two,
and the place along that from one, as a machinist would: those six errors are 0, the others show what is left. An error is the
measured point, moved, minus the nominal one. A scale is estimated and reported, never applied: a cell whose scale is wrong
needs another calibration, not another datum.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import sqrt

import numpy as np
from scipy import stats

from trackerd.calibrate.align_fit import (
    FEWEST_POINTS,
    FLATTEST,
    ROUNDING,
    STEP_DONE,
    STEPS,
    Fit,
    fit_of,
    noise_of,
    size_of,
    stepped,
)
from trackerd.contract.errors import ConfigError, Undetermined
from trackerd.contract.model import Array
from trackerd.formats.points import Points
from trackerd.geometry.rigid import Rigid

WIDEST_RAD = 0.02  # of a rotation's sigma: beyond, it is not determined (and the linear covariance no longer holds)
UNLIKELY = 1e-3  # to be chance: an outlier, all points together, or a chi-square


@dataclass(frozen=True, slots=True)
class Suspect:
    """The point that fits worst, where chance does not explain it."""

    id: str
    error_mm: float
    probability: float  # of an error as large by chance


@dataclass(frozen=True, slots=True)
class Alignment:
    """`cov` is (6, 6) of rx, ry, rz (rad) and x, y, z (mm), R = exp([r]x) R_found, as in the calibration file."""

    ids: tuple[str, ...]
    world_from_cell: Rigid
    cov: Array
    errors_mm: Array  # (n, 3), in the world
    chi2: float | None  # of 3 n - 6 degrees of freedom; None: without sigmas it has no meaning
    dof: int
    beyond_chance: bool  # chi-square: the errors are larger than the sigmas say, and `cov` was multiplied by it per freedom
    sigma_mm: float | None  # of one coordinate, from the scatter, where the files tell none
    scale: float  # nominal over measured distances, not applied
    scale_sigma: float
    suspect: Suspect | None

    @property
    def rms_mm(self) -> float:
        """Of the points' distances."""
        return sqrt(float((self.errors_mm**2).sum(axis=1).mean()))

    @property
    def max_mm(self) -> float:
        return float(np.linalg.norm(self.errors_mm, axis=1).max())


@dataclass(frozen=True, slots=True)
class ThreeTwoOne:
    """Names of points: three that make the plane, two in its direction, one along that. A point may serve several times."""

    plane: tuple[str, str, str]
    line: tuple[str, str]
    origin: str


def best_fit(measured: Points, nominal: Points) -> Alignment:
    """Of points with the same ids in the same order (`in_common` makes such).

    Raises Undetermined below three points or where they lie in one line, ConfigError where they are a mirror image or differ in
    scale by more than a tenth: those are errors of the files.
    """
    fit = fit_of(measured, nominal)
    return _judged(measured, nominal, fit, fit.pose, fit.cov)


def three_two_one(measured: Points, nominal: Points, roles: ThreeTwoOne) -> Alignment:
    """As `best_fit`, from six coordinates; raises ConfigError for a role that is no point, or that two points cannot play."""
    fit = fit_of(measured, nominal)
    rows, normals = _roles(nominal, roles)
    pose = fit.pose
    for _ in range(STEPS):
        moved = measured.p_mm[rows] @ pose.rotation.T
        matrix = np.hstack((np.cross(moved, normals), normals))
        misses = ((moved + pose.translation_mm - nominal.p_mm[rows]) * normals).sum(axis=1)
        if np.linalg.cond(matrix / np.maximum(1.0, np.abs(matrix).max(axis=0))) > 1e8:
            raise Undetermined("3-2-1: the six coordinates do not determine the datum: choose points further apart")
        step = np.linalg.solve(matrix, -misses)
        pose = stepped(pose, step)
        if np.abs(step).max() < STEP_DONE * size_of(nominal.p_mm):
            break
    noise = noise_of(measured, nominal, pose.rotation)
    same = np.array(rows)[:, None] == np.array(rows)
    scatter = np.einsum("ki,kij,lj->kl", normals, noise[rows], normals) * same
    gain = np.linalg.inv(matrix)
    return _judged(measured, nominal, fit, pose, gain @ scatter @ gain.T)


def in_common(measured: Points, nominal: Points) -> tuple[Points, Points, tuple[str, ...]]:
    """The points that both have, in the order of the measured ones, and a note for those that only one has."""
    ids = [name for name in measured.ids if name in set(nominal.ids)]
    lone = [name for name in measured.ids if name not in ids]
    unmeasured = [name for name in nominal.ids if name not in set(measured.ids)]
    notes = [f"measured, but not nominal: {', '.join(lone)}"] if lone else []
    notes += [f"nominal, but not measured: {', '.join(unmeasured)}"] if unmeasured else []
    if len(ids) < FEWEST_POINTS:
        raise Undetermined("; ".join((f"needs {FEWEST_POINTS} points in common, there are {len(ids)}", *notes)))
    return measured.only(ids), nominal.only(ids), tuple(notes)


# ---- what speaks against it ------------------------------------------------------------------------------------------


def _judged(measured: Points, nominal: Points, fit: Fit, pose: Rigid, cov: Array) -> Alignment:
    """Whichever six coordinates 3-2-1 chooses: chi-square, scale and outliers are the best fit's."""
    known = measured.cov_mm2 is not None or nominal.cov_mm2 is not None
    dof = 3 * len(measured) - 6
    beyond_chance = known and float(stats.chi2.sf(fit.chi2, dof)) < UNLIKELY
    variance = fit.chi2 / dof if beyond_chance or not known else 1.0
    cov = (cov + cov.T) / 2.0 * variance
    sigma_rad = sqrt(float(np.linalg.eigvalsh(cov[:3, :3]).max()))
    suspect = _suspect(measured.ids, fit, known and not beyond_chance, dof)
    if sigma_rad > WIDEST_RAD:
        worst = "" if suspect is None else f" ({suspect.id} is off by {suspect.error_mm:.3g} mm)"
        raise Undetermined(
            f"a rotation is only determined to {np.degrees(sigma_rad):.2g} deg (1 sigma):"
            f" the points lie nearly in one line, or scatter too much{worst}"
        )
    scale, scale_sigma = _scale(measured, fit, dof, known)
    return Alignment(
        ids=measured.ids,
        world_from_cell=pose,
        cov=cov,
        errors_mm=pose.move(measured.p_mm) - nominal.p_mm,
        chi2=fit.chi2 if known else None,
        dof=dof,
        beyond_chance=beyond_chance,
        sigma_mm=None if known else sqrt(variance),
        scale=scale,
        scale_sigma=scale_sigma,
        suspect=suspect,
    )


def _scale(measured: Points, fit: Fit, dof: int, known: bool) -> tuple[float, float]:
    """Of nominal over measured distances, with sigma: a seventh parameter, free beside the six.

    Its sigma is by the scatter that is left with it: what a scale explains does not speak against the scale.
    """
    along = (measured.p_mm - measured.p_mm.mean(axis=0)) @ fit.pose.rotation.T
    jacobian = np.concatenate((fit.jacobian, along[:, :, None]), axis=2)
    turned = jacobian.transpose(0, 2, 1) @ fit.weights
    cov = np.linalg.inv((turned @ jacobian).sum(axis=0))
    step = -cov @ (turned @ fit.errors_mm[:, :, None]).sum(axis=0)[:, 0]
    scale, variance = float(step[6]), float(cov[6, 6])
    left = max(fit.chi2 - scale**2 / variance, 0.0)
    chance = known and float(stats.chi2.sf(left, dof - 1)) > UNLIKELY
    return 1.0 + scale, sqrt(variance * (1.0 if chance else left / (dof - 1)))


def _suspect(ids: Sequence[str], fit: Fit, trusted: bool, dof: int) -> Suspect | None:
    """The worst point by its error over that error's own covariance (Baarda 1968); where the sigmas are not to be trusted, by
    Pope's ratio against the scatter of the others. None below four points, which cannot tell, or where chance explains it."""
    if len(ids) <= FEWEST_POINTS:
        return None
    noise = np.linalg.inv(fit.weights) - fit.jacobian @ fit.cov @ fit.jacobian.transpose(0, 2, 1)
    squares = np.einsum("ni,nij,nj->n", fit.errors_mm, np.linalg.pinv(noise, rcond=1e-9, hermitian=True), fit.errors_mm)
    if trusted:
        probabilities = stats.chi2.sf(squares, 3)
    else:
        others = np.maximum(fit.chi2 - squares, 1e-12 * fit.chi2) / (dof - 3)
        probabilities = stats.f.sf(squares / 3.0 / np.maximum(others, np.finfo(float).tiny), 3, dof - 3)
    worst = int(np.argmax(squares))
    error_mm = float(np.linalg.norm(fit.errors_mm[worst]))
    if float(probabilities[worst]) * len(ids) > UNLIKELY or error_mm < ROUNDING * float(np.abs(fit.jacobian).max()):
        return None
    return Suspect(ids[worst], error_mm, float(probabilities[worst]))


# ---- 3-2-1 -----------------------------------------------------------------------------------------------------------


def _roles(nominal: Points, roles: ThreeTwoOne) -> tuple[list[int], Array]:
    """Rows (6,) of the points and directions (6, 3) in which each is held to its nominal place."""
    index = {name: row for row, name in enumerate(nominal.ids)}
    names = (*roles.plane, *roles.line, roles.origin)
    for name in names:
        if name not in index:
            raise ConfigError(f"3-2-1: there is no point {name} in both files (there are: {', '.join(nominal.ids)})")
    if len(set(roles.plane)) < 3 or len(set(roles.line)) < 2:
        raise ConfigError("3-2-1: the plane needs three different points, the direction two")
    p1, p2, p3 = (nominal.p_mm[index[name]] for name in roles.plane)
    q1, q2 = (nominal.p_mm[index[name]] for name in roles.line)
    normal = np.cross(p2 - p1, p3 - p1)
    if not np.linalg.norm(normal) > FLATTEST * np.linalg.norm(p2 - p1) * np.linalg.norm(p3 - p1):
        raise Undetermined(f"3-2-1: {', '.join(roles.plane)} lie in one line, and make no plane")
    normal /= np.linalg.norm(normal)
    along = (q2 - q1) - normal * float((q2 - q1) @ normal)
    if not np.linalg.norm(along) > FLATTEST * np.linalg.norm(q2 - q1):
        raise Undetermined(f"3-2-1: {', '.join(roles.line)} lie across the plane, and give no direction in it")
    along /= np.linalg.norm(along)
    across = np.cross(normal, along)
    return [index[name] for name in names], np.array((normal, normal, normal, across, across, along))
