"""The best fit of two sets of points: Kabsch (1976) to begin with, then Gauss-Newton, each error weighed by its covariance.

Refuses what no datum can come from: too few points, one line, a mirror image, other units.
"""

from dataclasses import dataclass

import numpy as np

from trackerd.contract.errors import ConfigError, Undetermined
from trackerd.contract.model import Array
from trackerd.formats.points import Points
from trackerd.geometry.rigid import Rigid, rotation_about, skew

FEWEST_POINTS = 3
STEPS = 50
STEP_DONE = 1e-13  # rad, and of the size of the points
FLATTEST = 1e-4  # width of the points over their length: below it they lie in one line
SCALE_SPAN = (0.9, 1.1)  # of nominal over measured distances: outside, the units differ, or the points do
MIRROR_GAIN = 5.0  # how much better the mirror image must fit before it is believed
ROUNDING = 1e-9  # of the size of the points: an error below it is none
UNITS = {25.4: "inches are taken for mm", 1000.0: "metres are taken for mm", 10.0: "centimetres are taken for mm"}
DISTANCES_OF = 200  # points: their mutual distances tell the scale; more would tell no more


@dataclass(frozen=True, slots=True)
class Fit:
    """The best fit, with what it says of the points: weights belong to it."""

    pose: Rigid
    cov: Array  # (6, 6), for covariances as given (unit ones where none are)
    errors_mm: Array
    weights: Array  # (n, 3, 3)
    jacobian: Array  # (n, 3, 6)
    chi2: float


def fit_of(measured: Points, nominal: Points) -> Fit:
    _refuse(measured, nominal)
    pose = _kabsch(measured.p_mm, nominal.p_mm)
    size = size_of(nominal.p_mm)
    for _ in range(STEPS):
        errors, jacobian, weights = _linear(measured, nominal, pose)
        turned = jacobian.transpose(0, 2, 1) @ weights
        cov = np.linalg.inv((turned @ jacobian).sum(axis=0))
        step = -cov @ (turned @ errors[:, :, None]).sum(axis=0)[:, 0]
        pose = stepped(pose, step)
        if np.abs(step).max() < STEP_DONE * size:
            break
    errors, jacobian, weights = _linear(measured, nominal, pose)
    chi2 = float((errors[:, None, :] @ weights @ errors[:, :, None]).sum())
    return Fit(pose, (cov + cov.T) / 2.0, errors, weights, jacobian, chi2)


def _linear(measured: Points, nominal: Points, pose: Rigid) -> tuple[Array, Array, Array]:
    """Errors (n, 3), their derivative by (r, t) (n, 3, 6), and the inverses of their covariances (n, 3, 3)."""
    turned = measured.p_mm @ pose.rotation.T
    jacobian = np.array([np.hstack((-skew(p), np.eye(3))) for p in turned])
    weights = np.asarray(np.linalg.inv(noise_of(measured, nominal, pose.rotation)))
    return turned + pose.translation_mm - nominal.p_mm, jacobian, weights


def noise_of(measured: Points, nominal: Points, rotation: Array) -> Array:
    """Covariances of the errors, (n, 3, 3), mm^2: 1 where no file tells any."""
    parts = [] if measured.cov_mm2 is None else [rotation @ measured.cov_mm2 @ rotation.T]
    parts += [] if nominal.cov_mm2 is None else [nominal.cov_mm2]
    return np.sum(parts, axis=0) if parts else np.broadcast_to(np.eye(3), (len(measured), 3, 3))


def _kabsch(measured_mm: Array, nominal_mm: Array) -> Rigid:
    """The unweighted best fit. Raises ConfigError where only the mirror image fits."""
    a, b = measured_mm - measured_mm.mean(axis=0), nominal_mm - nominal_mm.mean(axis=0)
    u, _, vt = np.linalg.svd(b.T @ a)
    rotation = u @ np.diag((1.0, 1.0, np.linalg.det(u @ vt))) @ vt
    proper_mm, mirrored_mm = (float(np.sqrt(((a @ r.T - b) ** 2).sum(axis=1).mean())) for r in (rotation, u @ vt))
    if proper_mm > MIRROR_GAIN * mirrored_mm and proper_mm > ROUNDING * size_of(b):
        raise ConfigError(
            "the nominal points are a mirror image of the measured ones"
            f" (rms {mirrored_mm:.3g} mm mirrored, {proper_mm:.3g} mm not):"
            " an axis has the wrong sign, or two are exchanged"
        )
    return Rigid(rotation, nominal_mm.mean(axis=0) - rotation @ measured_mm.mean(axis=0))


def stepped(pose: Rigid, step: Array) -> Rigid:
    angle = float(np.linalg.norm(step[:3]))
    turn = rotation_about(step[:3] / angle, angle) if angle > 0.0 else np.eye(3)
    u, _, vt = np.linalg.svd(turn @ pose.rotation)  # rounding must not add up
    return Rigid(u @ vt, pose.translation_mm + step[3:])


# ---- what no datum can come from --------------------------------------------------------------------------------------


def _refuse(measured: Points, nominal: Points) -> None:
    if measured.ids != nominal.ids:
        raise Undetermined("the measured and the nominal points are not the same ones in the same order")
    if len(measured) < FEWEST_POINTS:
        raise Undetermined(f"a datum needs {FEWEST_POINTS} points, there are {len(measured)}")
    for points, kind in ((measured, "measured"), (nominal, "nominal")):
        length, width, _ = np.linalg.svd(points.p_mm - points.p_mm.mean(axis=0), compute_uv=False)
        if not width > FLATTEST * length:
            raise Undetermined(
                f"the {kind} points {', '.join(points.ids)} lie in one line ({length:.3g} mm long, {width:.2g} mm wide):"
                " the rotation about it is not determined: add a point off the line"
            )
    ratio = _distance_ratio(measured.p_mm, nominal.p_mm)
    if not SCALE_SPAN[0] < ratio < SCALE_SPAN[1]:
        likely = [words for unit, words in UNITS.items() if 0.9 < max(ratio, 1.0 / ratio) / unit < 1.1]
        raise ConfigError(
            f"the nominal points are {ratio:.4g} times as far apart as the measured ones:"
            f" {likely[0] if likely else 'other units, or other points'}"
        )


def _distance_ratio(measured_mm: Array, nominal_mm: Array) -> float:
    """The median over pairs of points, so that one bad point does not speak for all."""
    i, j = np.triu_indices(min(len(measured_mm), DISTANCES_OF), 1)
    a, b = (np.linalg.norm(p[i] - p[j], axis=1) for p in (measured_mm, nominal_mm))
    apart = a > FLATTEST * a.max()
    return max(float(np.median(b[apart] / a[apart])), 1e-9)


def size_of(p_mm: Array) -> float:
    return max(1.0, float(np.abs(p_mm - p_mm.mean(axis=0)).max()))
