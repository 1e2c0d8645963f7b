"""All views of one lens as one system: pixels of all points, their slopes, and the normal equations with the poses set apart.

Parameters: nine intrinsics in the order of INTRINSICS, and for each view a pose camera_from_board, perturbed from the left:
R = exp([r]x) R0, t = t0 + dt.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np
import numpy.typing as npt

from trackerd.calibrate.board_kinds import Indices
from trackerd.contract.model import Array

INTRINSICS = ("fx_px", "fy_px", "cx_px", "cy_px", "k1", "k2", "p1", "p2", "k3")


@dataclass(frozen=True, slots=True)
class Views:
    """Points of all views, one after the other: board coordinates (n, 3), pixels (n, 2), number of the view (n,) ascending.

    No view is empty.
    """

    p_mm: Array
    q_px: Array
    view: Indices
    count: int

    def only(self, kept: npt.NDArray[np.bool_]) -> "Views":
        """Without the points that are not `kept` (n,) bool; views keep their numbers."""
        return replace(self, p_mm=self.p_mm[kept], q_px=self.q_px[kept], view=self.view[kept])


@dataclass(frozen=True, slots=True)
class Estimate:
    """Intrinsics (9,), and of each view the rotation (m, 3, 3) and translation (m, 3), mm, of camera_from_board."""

    intrinsics: Array
    rotation: Array
    translation_mm: Array

    def moved(self, intrinsics: Array, poses: Array) -> "Estimate":
        """Steps (9,) and (m, 6): rotation first."""
        turned = np.array([cv2.Rodrigues(step[:3])[0] @ r for step, r in zip(poses, self.rotation, strict=True)])
        return Estimate(self.intrinsics + intrinsics, turned, self.translation_mm + poses[:, 3:])


@dataclass(frozen=True, slots=True)
class Normal:
    """J^T W J and J^T W r in blocks: intrinsics a (9, 9), ga (9,); poses d (m, 6, 6), gd (m, 6); mixed b (m, 9, 6)."""

    a: Array
    ga: Array
    d: Array
    gd: Array
    b: Array


def residuals(views: Views, estimate: Estimate) -> Array:
    """Measured minus projected, px, (n, 2). NaN behind the camera."""
    xd, yd = _distorted(estimate.intrinsics, *_plane(_in_camera(views, estimate)))
    fx, fy, cx, cy = estimate.intrinsics[:4]
    return np.asarray(views.q_px - np.stack((fx * xd + cx, fy * yd + cy), axis=-1))


def jacobian(views: Views, estimate: Estimate) -> tuple[Array, Array]:
    """d pixel / d intrinsics (n, 2, 9) and / d pose of the point's own view (n, 2, 6)."""
    p = _in_camera(views, estimate)
    x, y = _plane(p)
    fx, fy = estimate.intrinsics[:2]
    xd, yd = _distorted(estimate.intrinsics, x, y)
    r2, zero, one = x * x + y * y, np.zeros_like(x), np.ones_like(x)
    by_k = [np.stack((fx * x * r2**n, fy * y * r2**n), axis=-1) for n in (1, 2, 3)]
    by_p1 = np.stack((2 * fx * x * y, fy * (r2 + 2 * y * y)), axis=-1)
    by_p2 = np.stack((fx * (r2 + 2 * x * x), 2 * fy * x * y), axis=-1)
    pinhole = [np.stack(pair, axis=-1) for pair in ((xd, zero), (zero, yd), (one, zero), (zero, one))]
    intrinsics = np.stack((*pinhole, by_k[0], by_k[1], by_p1, by_p2, by_k[2]), axis=-1)
    by_point = _slopes(estimate.intrinsics, x, y, p[:, 2])
    turned = p - estimate.translation_mm[views.view]  # R p_board, which a rotation from the left turns
    by_rotation = np.cross(turned[:, None, :], by_point)  # r -> r x turned: s . (r x p) = r . (p x s)
    return intrinsics, np.concatenate((by_rotation, by_point), axis=-1)


def normal_equations(views: Views, estimate: Estimate, weights: Array) -> Normal:
    """`weights` (n,), of both coordinates of a point."""
    by_intrinsics, by_pose = jacobian(views, estimate)
    r = residuals(views, estimate)
    weighted = weights[:, None, None] * by_pose
    flat, flat_r = by_intrinsics.reshape(-1, 9), r.ravel()
    flat_weighted = np.repeat(weights, 2)[:, None] * flat
    return Normal(
        a=flat_weighted.T @ flat,
        ga=flat_weighted.T @ flat_r,
        d=_by_view(weighted.transpose(0, 2, 1) @ by_pose, views),
        gd=_by_view((weighted.transpose(0, 2, 1) @ r[:, :, None])[:, :, 0], views),
        b=_by_view(by_intrinsics.transpose(0, 2, 1) @ weighted, views),
    )


def _by_view(values: Array, views: Views) -> Array:
    return np.add.reduceat(values, np.searchsorted(views.view, np.arange(views.count)), axis=0)


def _in_camera(views: Views, estimate: Estimate) -> Array:
    turned = np.einsum("nij,nj->ni", estimate.rotation[views.view], views.p_mm)
    return np.asarray(turned + estimate.translation_mm[views.view])


def _plane(p: Array) -> tuple[Array, Array]:
    z = np.where(p[:, 2] > 0.0, p[:, 2], np.nan)
    return p[:, 0] / z, p[:, 1] / z


def _distorted(intrinsics: Array, x: Array, y: Array) -> tuple[Array, Array]:
    k1, k2, p1, p2, k3 = intrinsics[4:]
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    return x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x), y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y


def _slopes(intrinsics: Array, x: Array, y: Array, z: Array) -> Array:
    """d pixel / d point in the camera's frame, (n, 2, 3)."""
    fx, fy = intrinsics[:2]
    k1, k2, p1, p2, k3 = intrinsics[4:]
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = 2.0 * (k1 + r2 * (2 * k2 + 3 * r2 * k3))
    mixed = slope * x * y + 2 * p1 * x + 2 * p2 * y
    a, d = radial + slope * x * x + 2 * p1 * y + 6 * p2 * x, radial + slope * y * y + 6 * p1 * y + 2 * p2 * x
    rows = np.stack((fx * a, fx * mixed, -fx * (a * x + mixed * y))), np.stack((fy * mixed, fy * d, -fy * (mixed * x + d * y)))
    return np.asarray(np.stack([(row / z).T for row in rows], axis=1))
