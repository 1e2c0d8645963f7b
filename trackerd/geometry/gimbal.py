"""A station: a two-axis gimbal that carries a camera, off its axes. Conventions of the frames W, G, RG and C are in the README.

Every angle here is the encoder's; the axis angle is sign x encoder angle.
"""

from dataclasses import dataclass
from enum import StrEnum
from math import acos, atan2, cos, hypot, remainder, sin, tau
from typing import Literal

import numpy as np

from trackerd.contract.errors import Degenerate
from trackerd.contract.model import Array
from trackerd.geometry.lens import Lens
from trackerd.geometry.rigid import Rigid, cross, rotation_about, rotation_about_x, rotation_about_y

AIM_STEPS = 25
AIM_TOLERANCE_PX = 1e-9


class AxisOrder(StrEnum):
    AZ_OUTER = "az_outer"  # the EL axis is carried by AZ
    EL_OUTER = "el_outer"


@dataclass(frozen=True, slots=True)
class Axes:
    """Both axes in W at one pose: unit direction of a positive *encoder* step, and a point on each."""

    az: Array
    el: Array
    p_az_mm: Array
    p_el_mm: Array

    def swing(self, p_world_mm: Array) -> Array:
        """How a point that the camera's body carried would move, (3, 2): d p / d (az, el)."""
        return np.array((cross(self.az, p_world_mm - self.p_az_mm), cross(self.el, p_world_mm - self.p_el_mm))).T


@dataclass(frozen=True, slots=True)
class Pose:
    """A station at one pair of angles: where its camera and its axes are in W."""

    world_from_camera: Rigid
    axes: Axes


@dataclass(frozen=True, slots=True)
class Station:
    """Kinematics and lens of one gimbal.

    az_outer: p_g = Rx(az) ([0, 0, d] + R(e, el) p_rg), e = (sin eps, cos eps, 0);
    el_outer: p_g = Ry(el) ([0, 0, d] + R(e, az) p_rg), e = (cos eps, sin eps, 0).
    A camera at the rotation centre is a lever arm (rg_from_camera.translation_mm) of 0.
    """

    name: str
    world_from_gimbal: Rigid
    rg_from_camera: Rigid
    lens: Lens
    order: AxisOrder = AxisOrder.AZ_OUTER
    az_sign: int = 1
    el_sign: int = 1
    eps_rad: float = 0.0
    d_mm: float = 0.0

    def pose(self, az_rad: float, el_rad: float) -> Pose:
        outer, inner = self._turns(az_rad, el_rad)
        w = self.world_from_gimbal
        world_from_outer = w.rotation @ outer
        d_inner = world_from_outer @ self._inner_axis()
        p_outer_mm = w.translation_mm
        p_inner_mm = p_outer_mm + world_from_outer[:, 2] * self.d_mm
        if self.order is AxisOrder.AZ_OUTER:
            axes = Axes(self.az_sign * w.rotation[:, 0], self.el_sign * d_inner, p_outer_mm, p_inner_mm)
        else:
            axes = Axes(self.az_sign * d_inner, self.el_sign * w.rotation[:, 1], p_inner_mm, p_outer_mm)
        return Pose(Rigid(world_from_outer @ inner, p_inner_mm) @ self.rg_from_camera, axes)

    def world_from_camera(self, az_rad: float, el_rad: float) -> Rigid:
        return self.pose(az_rad, el_rad).world_from_camera

    def axes(self, az_rad: float, el_rad: float) -> Axes:
        return self.pose(az_rad, el_rad).axes

    def pixel(self, p_world_mm: Array, az_rad: float, el_rad: float) -> Array:
        """Where a point of W is seen, (2,). The point must be in front of the camera."""
        return self.lens.project(self.world_from_camera(az_rad, el_rad).inverse().move(p_world_mm))

    def pixel_jacobian(self, p_world_mm: Array, az_rad: float, el_rad: float) -> Array:
        """d pixel / d (az, el) of a point fixed in W, (2, 2)."""
        pose = self.pose(az_rad, el_rad)
        camera_from_world = pose.world_from_camera.inverse()
        px_per_mm = self.lens.jacobian(camera_from_world.move(p_world_mm)) @ camera_from_world.rotation
        return np.asarray(-px_per_mm @ pose.axes.swing(p_world_mm))

    def point_at(self, q_px: Array, az_rad: float, el_rad: float, range_mm: float) -> Array:
        """The point of W at `range_mm` from the entrance pupil that is seen at a pixel."""
        return self.world_from_camera(az_rad, el_rad).move(self.lens.unproject(q_px) * range_mm)

    def aim(self, p_world_mm: Array, q_px: Array | None = None, face: Literal[1, 2] = 1) -> tuple[float, float]:
        """Encoder angles that show a point of W at a pixel (default: the principal point).

        Face 2 is the other way to look there: the outer axis half a turn on, the inner one over the top (az + 180 deg,
        180 deg - el for az_outer without lever arm and errors). Angles are within half a turn of 0; adding whole turns to suit
        the travel is the caller's. Closed form for the ideal gimbal, then Newton on the full model. Raises Degenerate where no
        pose does it.
        """
        aim_px = np.array((self.lens.cx_px, self.lens.cy_px)) if q_px is None else q_px
        az, el = self._first_aim(p_world_mm, face)
        for _ in range(AIM_STEPS):
            error = aim_px - self._pixel_in_front(p_world_mm, az, el)
            if np.abs(error).max() < AIM_TOLERANCE_PX:
                return az, el
            try:
                step = np.linalg.solve(self.pixel_jacobian(p_world_mm, az, el), error)
            except np.linalg.LinAlgError:
                break
            step *= min(1.0, 0.2 / float(np.abs(step).max()))
            az, el = az + float(step[0]), el + float(step[1])
        if np.abs(error).max() < 1e-5:
            return az, el
        raise Degenerate(f"station {self.name} cannot be aimed at {np.round(p_world_mm, 1)} mm")

    def _pixel_in_front(self, p_world_mm: Array, az_rad: float, el_rad: float) -> Array:
        p_camera = self.world_from_camera(az_rad, el_rad).inverse().move(p_world_mm)
        if p_camera[2] <= 0.0:
            raise Degenerate(f"station {self.name}: {np.round(p_world_mm, 1)} mm is behind the camera")
        return self.lens.project(p_camera)

    def _first_aim(self, p_world_mm: Array, face: Literal[1, 2]) -> tuple[float, float]:
        """Of the ideal gimbal, which turns the lever arm to either side of the target."""
        x, y, z = self.world_from_gimbal.inverse().move(p_world_mm)
        lever_x, lever_y, _ = self.rg_from_camera.translation_mm
        side = 1.0 if face == 1 else -1.0
        if self.order is AxisOrder.AZ_OUTER:
            az = atan2(z, y) - side * acos(_reachable(lever_y, hypot(y, z)))
            el = atan2(x, -y * sin(az) + z * cos(az))
        else:
            el = side * acos(_reachable(lever_x, hypot(x, z))) - atan2(z, x)
            az = -atan2(y, x * sin(el) + z * cos(el))
        return self.az_sign * remainder(az, tau), self.el_sign * remainder(el, tau)

    def _turns(self, az_rad: float, el_rad: float) -> tuple[Array, Array]:
        """Rotation of the outer axis and of the inner one."""
        az, el = self.az_sign * az_rad, self.el_sign * el_rad
        if self.order is AxisOrder.AZ_OUTER:
            return rotation_about_x(az), rotation_about(self._inner_axis(), el)
        return rotation_about_y(el), rotation_about(self._inner_axis(), az)

    def _inner_axis(self) -> Array:
        c, s = cos(self.eps_rad), sin(self.eps_rad)
        return np.array((s, c, 0.0) if self.order is AxisOrder.AZ_OUTER else (c, s, 0.0))


def _reachable(lever_mm: float, distance_mm: float) -> float:
    if distance_mm <= abs(lever_mm):
        raise Degenerate(f"a point {distance_mm:.1f} mm from the axis is inside the lever arm of {abs(lever_mm):.1f} mm")
    return lever_mm / distance_mm
