"""Pixels of many points at once, and their derivatives by everything that a cell has: the station's model, batched.

The formulae are those of trackerd.geometry.gimbal and lens; tests hold both against each other.
"""

from dataclasses import dataclass

import numpy as np

from trackerd.calibrate.cell.state import BODY_COLUMNS, STATION_COLUMNS, Indices, State, points_in_world, turns
from trackerd.calibrate.cell.targets import Targets
from trackerd.contract.model import Array

BEHIND_MM = 1.0  # nearer than this is behind the camera: no pixel
X_AXIS, Y_AXIS = np.array((1.0, 0.0, 0.0)), np.array((0.0, 1.0, 0.0))


@dataclass(frozen=True, slots=True)
class Frames:
    """Axes and rotations of v views."""

    outer_axis: Array  # (v, 3) in G
    inner_axis: Array  # (v, 3) carried by the outer one
    world_from_outer: Array  # (v, 3, 3)
    inner: Array  # (v, 3, 3)


@dataclass(frozen=True, slots=True)
class Linear:
    """At a state: pixels of n image points and their derivatives."""

    q_px: Array  # (n, 2); NaN behind the camera
    station: Array  # (n, 2, 23)
    body: Array  # (n, 2, 9)
    point: Array  # (n, 2, 3) by the point in its body
    encoder: Array  # (n, 2, 2) by the encoders' az, el
    world: Array  # (n, 2, 3) by the point in W


def frames_of(state: State, gimbal: Indices, angles_rad: Array) -> Frames:
    """Of views by `gimbal` (v,) at encoder angles (v, 2)."""
    az_outer = state.az_outer[gimbal]
    turned = state.signs[gimbal] * angles_rad
    c, s = np.cos(state.axes[gimbal, 0]), np.sin(state.axes[gimbal, 0])
    zero = np.zeros(len(gimbal))
    inner_axis = np.where(az_outer[:, None], np.column_stack([s, c, zero]), np.column_stack([c, s, zero]))
    outer_axis = np.where(az_outer[:, None], X_AXIS, Y_AXIS)
    outer = turns(outer_axis, np.where(az_outer, turned[:, 0], turned[:, 1]))
    inner = turns(inner_axis, np.where(az_outer, turned[:, 1], turned[:, 0]))
    return Frames(outer_axis, inner_axis, state.r_world_from_gimbal[gimbal] @ outer, inner)


def linearise(state: State, targets: Targets, gimbal: Indices, angles_rad: Array, view: Indices, point: Indices) -> Linear:
    """Image points of `point` (n,) in views `view` (n,); gimbal (v,), angles_rad (v, 2)."""
    frames = frames_of(state, gimbal, angles_rad)
    station_of = gimbal[view]
    p_world, turned = points_in_world(state, targets, point)
    world_from_outer, inner, mount = frames.world_from_outer[view], frames.inner[view], state.r_rg_from_camera[station_of]
    from_gimbal = p_world - state.t_world_from_gimbal[station_of]
    on_outer = _turn_back(world_from_outer, from_gimbal)
    on_inner = on_outer.copy()
    on_inner[:, 2] -= state.axes[station_of, 1]
    on_rg = _turn_back(inner, on_inner)
    from_pupil = on_rg - state.t_rg_from_camera[station_of]
    q_px, lens, by_camera = _project(state.lens[station_of], _turn_back(mount, from_pupil))
    by_rg = _chain(by_camera, mount)  # (n, 2, 3) each: by the point on this floor
    by_inner = _chain(by_rg, inner)
    by_world = _chain(by_inner, world_from_outer)
    station = np.empty((len(view), 2, STATION_COLUMNS))
    _cross(by_world, from_gimbal, station[:, :, 0:3])
    station[:, :, 3:6] = -by_world
    eps_sign = np.where(state.az_outer, -1.0, 1.0)[station_of][:, None]
    station[:, :, 6] = eps_sign * (_swing_z(by_rg, on_rg) - _swing_z(by_inner, on_inner))
    station[:, :, 7] = -by_inner[:, :, 2]
    _cross(by_rg, from_pupil, station[:, :, 8:11])
    station[:, :, 11:14] = -by_rg
    station[:, :, 14:23] = lens
    encoder = _encoder(state, station_of, frames, view, (by_inner, on_outer), (by_rg, on_rg))
    return _with_body(state, targets, point, turned, by_world, (q_px, station, encoder))


def _encoder(
    state: State, station_of: Indices, frames: Frames, view: Indices, outer: tuple[Array, Array], inner: tuple[Array, Array]
) -> Array:
    """By the encoders (n, 2, 2): the point's swing about each axis, backwards."""
    by_outer = np.einsum("nai,ni->na", outer[0], np.cross(outer[1], frames.outer_axis[view]))
    by_inner = np.einsum("nai,ni->na", inner[0], np.cross(inner[1], frames.inner_axis[view]))
    az_outer = state.az_outer[station_of][:, None]
    az, el = np.where(az_outer, by_outer, by_inner), np.where(az_outer, by_inner, by_outer)
    return np.asarray(np.stack([az, el], axis=2) * state.signs[station_of][:, None, :])


def _with_body(
    state: State, targets: Targets, point: Indices, turned: Array, by_world: Array, known: tuple[Array, Array, Array]
) -> Linear:
    q_px, station, encoder = known
    of_body = targets.body[point]
    by_point = by_world @ state.r_world_from_body[of_body]
    body = np.zeros((len(point), 2, BODY_COLUMNS))
    _cross(by_world, turned, body[:, :, 0:3])
    body[:, :, 0:3] *= -1.0
    body[:, :, 3:6] = by_world
    if any(of.ball_mm is not None for of in targets.bodies):
        body[:, :, 6:9] = by_point @ targets.flange[point]
    return Linear(q_px, station, body, by_point, encoder, by_world)


def _turn_back(rotations: Array, points: Array) -> Array:
    """R^T p of (n, 3, 3) and (n, 3)."""
    return np.asarray(np.einsum("nij,ni->nj", rotations, points))


def _chain(by_after: Array, rotations: Array) -> Array:
    """(d q / d (R^T p)) R^T = d q / d p."""
    return np.asarray(by_after @ rotations.transpose(0, 2, 1))


def _cross(rows: Array, vectors: Array, out: Array) -> None:
    """rows (n, 2, 3) x vectors (n, 3): the derivative of row . (v x r) by r."""
    x, y, z = vectors[:, 0, None], vectors[:, 1, None], vectors[:, 2, None]
    out[:, :, 0] = rows[:, :, 1] * z - rows[:, :, 2] * y
    out[:, :, 1] = rows[:, :, 2] * x - rows[:, :, 0] * z
    out[:, :, 2] = rows[:, :, 0] * y - rows[:, :, 1] * x


def _swing_z(rows: Array, points: Array) -> Array:
    """rows . (z x p), (n, 2)."""
    return np.asarray(rows[:, :, 1] * points[:, 0, None] - rows[:, :, 0] * points[:, 1, None])


def _project(lens: Array, p_camera: Array) -> tuple[Array, Array, Array]:
    """Pixels (n, 2), by the lens (n, 2, 9), by the point in C (n, 2, 3)."""
    fx, fy, cx, cy, k1, k2, p1, p2, k3 = lens.T
    z = np.where(p_camera[:, 2] > BEHIND_MM, p_camera[:, 2], np.nan)
    x, y = p_camera[:, 0] / z, p_camera[:, 1] / z
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = 2.0 * (k1 + r2 * (2.0 * k2 + 3.0 * r2 * k3))
    xd = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)
    yd = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y
    mixed = slope * x * y + 2.0 * p1 * x + 2.0 * p2 * y
    by_lens = np.zeros((len(z), 2, 9))
    by_lens[:, 0, 0], by_lens[:, 1, 1] = xd, yd
    by_lens[:, 0, 2] = by_lens[:, 1, 3] = 1.0
    for column, power in ((4, r2), (5, r2 * r2), (8, r2 * r2 * r2)):
        by_lens[:, 0, column], by_lens[:, 1, column] = fx * x * power, fy * y * power
    by_lens[:, 0, 6], by_lens[:, 1, 6] = fx * 2.0 * x * y, fy * (r2 + 2.0 * y * y)
    by_lens[:, 0, 7], by_lens[:, 1, 7] = fx * (r2 + 2.0 * x * x), fy * 2.0 * x * y
    by_point = np.empty((len(z), 2, 3))
    by_point[:, 0, 0] = fx * (radial + slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x) / z
    by_point[:, 0, 1], by_point[:, 1, 0] = fx * mixed / z, fy * mixed / z
    by_point[:, 1, 1] = fy * (radial + slope * y * y + 6.0 * p1 * y + 2.0 * p2 * x) / z
    by_point[:, :, 2] = -by_point[:, :, 0] * x[:, None] - by_point[:, :, 1] * y[:, None]
    return np.column_stack([fx * xd + cx, fy * yd + cy]), by_lens, by_point
