"""Rigid transforms, written b_from_a: p_b = R_b_from_a p_a + t_b_from_a. Points are moved, directions only turned."""

from dataclasses import dataclass
from math import atan2, cos, hypot, pi, sin

import numpy as np

from trackerd.contract.model import Array

EULER_LOCKED = 1e-9  # cos(theta): closer to the lock rounding alone would tell psi and phi apart


@dataclass(frozen=True, slots=True)
class Rigid:
    rotation: Array  # (3, 3)
    translation_mm: Array  # (3,)

    @classmethod
    def identity(cls) -> "Rigid":
        return cls(np.eye(3), np.zeros(3))

    @classmethod
    def from_quaternion(cls, q_wxyz: Array, translation_mm: Array) -> "Rigid":
        return cls(matrix_from_quaternion(np.asarray(q_wxyz, float)), np.asarray(translation_mm, float))

    def __matmul__(self, other: "Rigid") -> "Rigid":
        """c_from_b @ b_from_a = c_from_a."""
        return Rigid(self.rotation @ other.rotation, self.rotation @ other.translation_mm + self.translation_mm)

    def inverse(self) -> "Rigid":
        return Rigid(self.rotation.T, -self.rotation.T @ self.translation_mm)

    def move(self, p_mm: Array) -> Array:
        """Points, (3,) or (n, 3)."""
        return p_mm @ self.rotation.T + self.translation_mm

    def rotate(self, direction: Array) -> Array:
        """Directions, (3,) or (n, 3)."""
        return direction @ self.rotation.T


def rotation_about_x(angle_rad: float) -> Array:
    c, s = cos(angle_rad), sin(angle_rad)
    return np.array(((1.0, 0.0, 0.0), (0.0, c, -s), (0.0, s, c)))


def rotation_about_y(angle_rad: float) -> Array:
    c, s = cos(angle_rad), sin(angle_rad)
    return np.array(((c, 0.0, s), (0.0, 1.0, 0.0), (-s, 0.0, c)))


def rotation_about(axis: Array, angle_rad: float) -> Array:
    """Active rotation about a unit axis (Rodrigues)."""
    x, y, z = axis.tolist()
    c, s = cos(angle_rad), sin(angle_rad)
    v = 1.0 - c
    return np.array(
        (
            (c + x * x * v, x * y * v - z * s, x * z * v + y * s),
            (y * x * v + z * s, c + y * y * v, y * z * v - x * s),
            (z * x * v - y * s, z * y * v + x * s, c + z * z * v),
        )
    )


def matrix_from_quaternion(q_wxyz: Array) -> Array:
    """Rotation matrix of a quaternion (w, x, y, z); it is normalised first."""
    w, x, y, z = q_wxyz / np.linalg.norm(q_wxyz)
    return np.array(
        (
            (1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)),
            (2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)),
            (2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)),
        )
    )


def quaternion_from_matrix(rotation: Array) -> Array:
    """(w, x, y, z) with w >= 0. Largest component first (Shepperd 1978), so that it never divides by a small number."""
    r = rotation
    squares = np.array(
        (
            1 + r[0, 0] + r[1, 1] + r[2, 2],
            1 + r[0, 0] - r[1, 1] - r[2, 2],
            1 - r[0, 0] + r[1, 1] - r[2, 2],
            1 - r[0, 0] - r[1, 1] + r[2, 2],
        )
    )
    products = np.array(
        (
            (0.0, r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]),
            (0.0, 0.0, r[1, 0] + r[0, 1], r[0, 2] + r[2, 0]),
            (0.0, 0.0, 0.0, r[2, 1] + r[1, 2]),
            (0.0, 0.0, 0.0, 0.0),
        )
    )
    i = int(np.argmax(squares))
    q = (products + products.T)[i] / (2 * np.sqrt(squares[i]))
    q[i] = np.sqrt(squares[i]) / 2
    q = q / np.linalg.norm(q)
    return np.asarray(-q if q[0] < 0 else q)


def matrix_from_euler_321(psi_rad: float, theta_rad: float, phi_rad: float) -> Array:
    """R = Rz(psi) Ry(theta) Rx(phi): turned about x first, then about the fixed y, then about the fixed z."""
    about_z = rotation_about(np.array((0.0, 0.0, 1.0)), psi_rad)
    return np.asarray(about_z @ rotation_about_y(theta_rad) @ rotation_about_x(phi_rad))


def euler_321_from_matrix(rotation: Array) -> tuple[float, float, float]:
    """psi, theta, phi of R = Rz(psi) Ry(theta) Rx(phi), for printing: psi and phi in (-pi, pi], theta within +-pi/2.

    At theta = +-pi/2 (gimbal lock) only psi -+ phi is determined: phi is 0 there, and the whole turn is psi's. Near it psi and
    phi are uncertain, not the rotation: calculate with matrices and quaternions.
    """
    r = rotation
    across = hypot(r[0, 0], r[1, 0])
    if across < EULER_LOCKED:
        return atan2(-r[0, 1], r[1, 1]), (pi / 2 if r[2, 0] < 0.0 else -pi / 2), 0.0
    return atan2(r[1, 0], r[0, 0]), atan2(-r[2, 0], across), atan2(r[2, 1], r[2, 2])


def cross(a: Array, b: Array) -> Array:
    """a x b of two (3,) vectors; numpy's own costs twenty times as much for one pair."""
    (ax, ay, az), (bx, by, bz) = a.tolist(), b.tolist()
    return np.array((ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx))


def skew(a: Array) -> Array:
    """[a]x, the matrix of the cross product: skew(a) @ b = a x b."""
    return np.array(((0.0, -a[2], a[1]), (a[2], 0.0, -a[0]), (-a[1], a[0], 0.0)))
