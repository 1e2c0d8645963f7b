"""The outline of a sphere: exact, both ways.

A sphere seen from outside is a cone; its section with the plane at unit distance is an ellipse with centre x_e and semi-axes
a (radial) >= b. With p the projection of the sphere's centre: p = x_e / (1 + b^2),
sin^2(alpha) = b^2 / ((1 + b^2) (1 + |p|^2)), a^2 = b^2 (1 + |x_e|^2 / (1 + b^2)), range = R / sin(alpha).
"""

from dataclasses import dataclass
from math import hypot, sqrt

import numpy as np

from trackerd.contract.model import Array
from trackerd.geometry.lens import Lens


@dataclass(frozen=True, slots=True)
class Ellipse:
    """On the sensor, in px; `angle_rad` is the direction of `a`, from x towards y."""

    x_px: float
    y_px: float
    a_px: float
    b_px: float
    angle_rad: float

    @property
    def r_px(self) -> float:
        return sqrt(self.a_px * self.b_px)


def outline(p_camera_mm: Array, radius_mm: float, lens: Lens) -> Ellipse:
    """The outline of a sphere at a point (3,) of C. Distortion enters through its local scale at the centre of the ellipse:
    exact for a pinhole; with k1 = 0.4 and a radius of 200 px to 0.01 px near the axis and 0.05 px at 500 px from it."""
    px, py = float(p_camera_mm[0] / p_camera_mm[2]), float(p_camera_mm[1] / p_camera_mm[2])
    p2 = px * px + py * py
    sin2 = (radius_mm**2) / float(p_camera_mm @ p_camera_mm)
    k = sin2 * (1.0 + p2)
    b2 = k / (1.0 - k)
    xe, ye = px * (1.0 + b2), py * (1.0 + b2)
    a2 = b2 * (1.0 + (xe * xe + ye * ye) / (1.0 + b2))
    q = lens.project(np.array((xe, ye, 1.0)))
    scale = lens.jacobian(np.array((xe, ye, 1.0)))[:, :2]
    spread = scale @ _shape(xe, ye, a2, b2) @ scale.T
    values, vectors = np.linalg.eigh(spread)
    return Ellipse(
        float(q[0]),
        float(q[1]),
        sqrt(float(values[1])),
        sqrt(float(values[0])),
        float(np.arctan2(vectors[1, 1], vectors[0, 1])),
    )


def centre_and_range(q_px: Array, r_px: float, radius_mm: float, lens: Lens) -> tuple[Array, float]:
    """Unit direction (3,) in C of the sphere's centre, and its range, from the outline's centre and r = sqrt(a b)."""
    xe, ye = lens.normalise(q_px)
    e2 = xe * xe + ye * ye
    r2 = r_px * r_px / lens.area(xe, ye)  # a b on the unit plane
    b2 = r2
    for _ in range(4):  # a b = b^2 sqrt(1 + e^2 / (1 + b^2)) = r^2; converges by a factor of b^2 e^2 a step
        b2 = r2 / sqrt(1.0 + e2 / (1.0 + b2))
    px, py = xe / (1.0 + b2), ye / (1.0 + b2)
    n2 = 1.0 + px * px + py * py
    sin_alpha = sqrt(b2 / ((1.0 + b2) * n2))
    n = sqrt(n2)
    return np.array((px / n, py / n, 1.0 / n)), radius_mm / sin_alpha


def _shape(xe: float, ye: float, a2: float, b2: float) -> Array:
    """The ellipse on the unit plane as a matrix with eigenvalues a^2 (radial) and b^2."""
    e = hypot(xe, ye)
    radial = np.array((xe / e, ye / e)) if e > 0.0 else np.array((1.0, 0.0))
    return np.asarray(b2 * np.eye(2) + (a2 - b2) * np.outer(radial, radial))
