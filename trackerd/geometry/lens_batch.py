"""The lens for many points at once, on the lens' own formulae: what calibrations and simulations need, not one fix."""

import numpy as np

from trackerd.contract.model import Array
from trackerd.geometry.lens import UNDISTORT_STEPS, UNDISTORT_TOLERANCE, Lens


def project_all(lens: Lens, p_camera_mm: Array) -> Array:
    """Pixels (..., 2) of points (..., 3) in C, all in front (z > 0)."""
    x, y = p_camera_mm[..., 0] / p_camera_mm[..., 2], p_camera_mm[..., 1] / p_camera_mm[..., 2]
    xd, yd = lens.distort(x, y)
    return np.stack((lens.fx_px * xd + lens.cx_px, lens.fy_px * yd + lens.cy_px), axis=-1)


def normalise_all(lens: Lens, q_px: Array) -> Array:
    """Undistorted points (..., 2) on the plane at unit distance of pixels (..., 2); Newton on the distortion."""
    xd, yd = (q_px[..., 0] - lens.cx_px) / lens.fx_px, (q_px[..., 1] - lens.cy_px) / lens.fy_px
    x, y = xd, yd
    for _ in range(UNDISTORT_STEPS):
        xe, ye = lens.distort(x, y)
        a, b, c, d = lens.distortion_slopes(x, y)
        ex, ey = xd - xe, yd - ye
        det = a * d - b * c
        step_x, step_y = (d * ex - b * ey) / det, (a * ey - c * ex) / det
        x, y = x + step_x, y + step_y
        if (np.abs(step_x) + np.abs(step_y)).max(initial=0.0) < UNDISTORT_TOLERANCE:
            break
    return np.stack((x, y), axis=-1)


def unproject_all(lens: Lens, q_px: Array) -> Array:
    """Unit directions (..., 3) in C of pixels (..., 2)."""
    x, y = np.moveaxis(normalise_all(lens, q_px), -1, 0)
    n = 1.0 / np.sqrt(1.0 + x * x + y * y)
    return np.stack((x * n, y * n, n), axis=-1)


def jacobian_all(lens: Lens, p_camera_mm: Array) -> Array:
    """d pixel / d point, (..., 2, 3), of points (..., 3)."""
    z = p_camera_mm[..., 2]
    x, y = p_camera_mm[..., 0] / z, p_camera_mm[..., 1] / z
    a, b, c, d = lens.distortion_slopes(x, y)
    a, b, c, d = lens.fx_px * a / z, lens.fx_px * b / z, lens.fy_px * c / z, lens.fy_px * d / z
    rows = (np.stack((a, b, -a * x - b * y), axis=-1), np.stack((c, d, -c * x - d * y), axis=-1))
    return np.stack(rows, axis=-2)
