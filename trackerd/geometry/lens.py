"""Pinhole camera with OpenCV's five distortion coefficients, in the order k1, k2, p1, p2, k3."""

from dataclasses import dataclass
from math import sqrt
from typing import TypeVar

import numpy as np

from trackerd.contract.model import Array

Real = TypeVar("Real", float, Array)

UNDISTORT_STEPS = 20
UNDISTORT_TOLERANCE = 1e-13  # of the image plane at unit distance: 3e-9 px at f = 31000 px


@dataclass(frozen=True, slots=True)
class Lens:
    """Intrinsics. Pixel coordinates are the sensor's (not a region's); an integer is a pixel's centre."""

    sensor_px: tuple[int, int]
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)

    def project(self, p_camera_mm: Array) -> Array:
        """Pixel (2,) of a point (3,) in C. The point must be in front (z > 0)."""
        x, y = p_camera_mm[0] / p_camera_mm[2], p_camera_mm[1] / p_camera_mm[2]
        xd, yd = self.distort(x, y)
        return np.array((self.fx_px * xd + self.cx_px, self.fy_px * yd + self.cy_px))

    def normalise(self, q_px: Array) -> tuple[float, float]:
        """Undistorted coordinates on the plane at unit distance; Newton on the distortion."""
        xd, yd = (float(q_px[0]) - self.cx_px) / self.fx_px, (float(q_px[1]) - self.cy_px) / self.fy_px
        x, y = xd, yd
        for _ in range(UNDISTORT_STEPS):
            xe, ye = self.distort(x, y)
            a, b, c, d = self.distortion_slopes(x, y)
            ex, ey = xd - xe, yd - ye
            det = a * d - b * c
            step_x, step_y = (d * ex - b * ey) / det, (a * ey - c * ex) / det
            x, y = x + step_x, y + step_y
            if abs(step_x) + abs(step_y) < UNDISTORT_TOLERANCE:
                break
        return x, y

    def unproject(self, q_px: Array) -> Array:
        """Unit direction (3,) in C."""
        x, y = self.normalise(q_px)
        n = 1.0 / sqrt(1.0 + x * x + y * y)
        return np.array((x * n, y * n, n))

    def jacobian(self, p_camera_mm: Array) -> Array:
        """d pixel / d point, (2, 3)."""
        x, y, z = p_camera_mm.tolist()
        x, y = x / z, y / z
        a, b, c, d = self.distortion_slopes(x, y)
        a, b, c, d = self.fx_px * a / z, self.fx_px * b / z, self.fy_px * c / z, self.fy_px * d / z
        return np.array(((a, b, -a * x - b * y), (c, d, -c * x - d * y)))

    def area(self, x: float, y: float) -> float:
        """Of a small patch of the plane at unit distance, at an undistorted point: px^2 on the sensor."""
        a, b, c, d = self.distortion_slopes(x, y)
        return self.fx_px * self.fy_px * abs(a * d - b * c)

    def distort(self, x: Real, y: Real) -> tuple[Real, Real]:
        """Where points (x, y) of the plane at unit distance are imaged on it: numbers, or arrays of one shape."""
        k1, k2, p1, p2, k3 = self.distortion
        r2 = x * x + y * y
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        return (
            x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
            y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
        )

    def distortion_slopes(self, x: Real, y: Real) -> tuple[Real, Real, Real, Real]:
        """dxd/dx, dxd/dy, dyd/dx, dyd/dy of `distort`."""
        k1, k2, p1, p2, k3 = self.distortion
        r2 = x * x + y * y
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        slope = 2.0 * (k1 + r2 * (2 * k2 + 3 * r2 * k3))  # d radial / d r2, times 2: d radial / dx = slope x
        mixed = slope * x * y + 2 * p1 * x + 2 * p2 * y
        return (
            radial + slope * x * x + 2 * p1 * y + 6 * p2 * x,
            mixed,
            mixed,
            radial + slope * y * y + 6 * p1 * y + 2 * p2 * x,
        )
