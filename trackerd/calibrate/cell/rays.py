"""Image points as rays, with the nominal lens and mount: where a start comes from."""

import numpy as np

from trackerd.calibrate.cell.model import Frames, frames_of
from trackerd.calibrate.cell.observations import Observations
from trackerd.calibrate.cell.state import Indices, State
from trackerd.contract.model import Array

UNDISTORT_STEPS = 10


def rays(state: State, observations: Observations, rows: Indices, *, in_world: bool) -> tuple[Array, Array]:
    """Origins and unit directions (r, 3) of some image points, in W or in the frame G of each one's gimbal."""
    o = observations
    gimbal = o.gimbal[o.view[rows]]
    frames = frames_of(state, gimbal, o.angles_rad[o.view[rows]])
    direction = _normalised(state.lens[gimbal], o.q_px[rows])
    on_rg = np.einsum("nij,nj->ni", state.r_rg_from_camera[gimbal], direction)
    origins = _carried(frames, state.t_rg_from_camera[gimbal], state.axes[gimbal, 1])
    directions = _carried(frames, on_rg, np.zeros(len(rows)))
    if in_world:
        return origins + state.t_world_from_gimbal[gimbal], directions
    turn = state.r_world_from_gimbal[gimbal]
    return np.einsum("nij,ni->nj", turn, origins), np.einsum("nij,ni->nj", turn, directions)


def _carried(frames: Frames, on_rg: Array, offset_mm: Array) -> Array:
    """From the inner body to W's directions."""
    on_inner = np.einsum("nij,nj->ni", frames.inner, on_rg)
    on_inner[:, 2] += offset_mm
    return np.asarray(np.einsum("nij,nj->ni", frames.world_from_outer, on_inner))


def _normalised(lens: Array, q_px: Array) -> Array:
    """Unit directions in C; fixed-point iteration of the distortion, good enough for a start."""
    fx, fy, cx, cy, k1, k2, p1, p2, k3 = lens.T
    xd, yd = (q_px[:, 0] - cx) / fx, (q_px[:, 1] - cy) / fy
    x, y = xd, yd
    for _ in range(UNDISTORT_STEPS):
        r2 = x * x + y * y
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        x, y = (
            (xd - 2.0 * p1 * x * y - p2 * (r2 + 2.0 * x * x)) / radial,
            (yd - p1 * (r2 + 2.0 * y * y) - 2.0 * p2 * x * y) / radial,
        )
    direction = np.column_stack([x, y, np.ones(len(x))])
    return np.asarray(direction / np.linalg.norm(direction, axis=1, keepdims=True))


def nearest_point(origins: Array, directions: Array) -> Array:
    """The point (3,) nearest to some rays, unweighted (Eqs 3.14-3.17 of the source thesis)."""
    across = np.eye(3) - directions[:, :, None] * directions[:, None, :]
    return np.asarray(np.linalg.solve(across.sum(axis=0), (across @ origins[:, :, None]).sum(axis=0)[:, 0]))
