"""Encoder angles that show points at pixels, for many points at once; the formulae are those of Station.aim."""

from collections.abc import Sequence

import numpy as np

from trackerd.calibrate.cell.model import linearise
from trackerd.calibrate.cell.state import Indices, State, state_of
from trackerd.calibrate.cell.targets import known_points
from trackerd.contract.errors import Degenerate
from trackerd.contract.model import Array
from trackerd.geometry.gimbal import Station

AIM_STEPS = 25
LARGEST_STEP_RAD = 0.2
TOLERANCE_PX = 1e-6


def aim(
    stations: Sequence[Station], station_of: Indices, p_mm: Array, q_px: Array | None = None, *, second_face: bool = False
) -> Array:
    """Angles (n, 2) az, el of the encoders that show p_mm (n, 3) at q_px (n, 2), default: at the principal points.

    `second_face`: turned over, az + 180 deg and 180 deg - el. Raises Degenerate where no pose does it.
    """
    targets = known_points(p_mm)
    state = state_of(stations, targets)
    at = state.lens[station_of, 2:4] if q_px is None else q_px
    angles = _first(state, station_of, p_mm, -1.0 if second_face else 1.0)
    each = np.arange(len(p_mm))
    for _ in range(AIM_STEPS):
        linear = linearise(state, targets, station_of, angles, each, each)
        error = at - linear.q_px
        if np.nanmax(np.abs(error)) < TOLERANCE_PX or np.isnan(error).any():
            break
        step = np.linalg.solve(linear.encoder, error[:, :, None])[:, :, 0]
        angles = angles + step * np.minimum(1.0, LARGEST_STEP_RAD / np.maximum(np.abs(step).max(axis=1, keepdims=True), 1e-300))
    off = ~(np.abs(error).max(axis=1) < 1e-5)
    if off.any():
        worst = int(off.argmax())
        raise Degenerate(f"station {stations[station_of[worst]].name} cannot be aimed at {np.round(p_mm[worst], 1)} mm")
    return angles


def _first(state: State, station_of: Indices, p_mm: Array, face: float) -> Array:
    """Of the ideal gimbal."""
    rotation = state.r_world_from_gimbal[station_of]
    x, y, z = np.einsum("nij,ni->jn", rotation, p_mm - state.t_world_from_gimbal[station_of])
    lever = state.t_rg_from_camera[station_of]
    az_outer = state.az_outer[station_of]
    across = np.where(az_outer, np.hypot(y, z), np.hypot(x, z))
    share = np.where(az_outer, lever[:, 1], lever[:, 0]) / np.maximum(across, 1e-9)
    turn = face * np.arccos(np.clip(share, -1.0, 1.0))
    az = np.arctan2(z, y) - turn
    el_inner = np.arctan2(x, -y * np.sin(az) + z * np.cos(az))
    el = turn - np.arctan2(z, x)
    az_inner = -np.arctan2(y, x * np.sin(el) + z * np.cos(el))
    angles = np.column_stack([np.where(az_outer, az, az_inner), np.where(az_outer, el_inner, el)])
    return np.asarray(np.remainder(angles + np.pi, 2.0 * np.pi) - np.pi) * state.signs[station_of]
