"""The unknowns of a cell as arrays, where each one's column is, and how a step moves them.

Columns: 23 of each station, then 9 of each body (pose, ball in the flange), then 3 of each point that is not exact.
Rotations are perturbed from the left, R = exp([r]x) R, as the calibration file's covariance has them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from trackerd.calibrate.cell.targets import Targets
from trackerd.contract.model import Array
from trackerd.geometry.gimbal import AxisOrder, Station
from trackerd.geometry.lens import Lens
from trackerd.geometry.rigid import Rigid

Indices = npt.NDArray[np.intp]
POSE = ("rx_rad", "ry_rad", "rz_rad", "x_mm", "y_mm", "z_mm")
LENS = ("fx_px", "fy_px", "cx_px", "cy_px", "k1", "k2", "p1", "p2", "k3")
STATION_NAMES = (
    *(f"world_from_gimbal.{name}" for name in POSE),
    "eps_rad",
    "d_mm",
    *(f"rg_from_camera.{name}" for name in POSE),
    *(f"lens.{name}" for name in LENS),
)
STATION_COLUMNS = len(STATION_NAMES)
BODY_COLUMNS = 9
POSE_AT, AXES_AT, MOUNT_AT, LENS_AT = slice(0, 6), slice(6, 8), slice(8, 14), slice(14, 23)
FX, FY, CX, K1 = 14, 15, 16, 18


@dataclass(frozen=True, slots=True)
class State:
    """K stations, B bodies, m points."""

    r_world_from_gimbal: Array  # (K, 3, 3)
    t_world_from_gimbal: Array  # (K, 3)
    axes: Array  # (K, 2) eps, d
    r_rg_from_camera: Array  # (K, 3, 3)
    t_rg_from_camera: Array  # (K, 3)
    lens: Array  # (K, 9) in the order of LENS
    az_outer: npt.NDArray[np.bool_]  # (K,)
    signs: Array  # (K, 2) az, el
    r_world_from_body: Array  # (B, 3, 3)
    t_world_from_body: Array  # (B, 3)
    ball_mm: Array  # (B, 3)
    delta_mm: Array  # (m, 3) error of a point in its body


@dataclass(frozen=True, slots=True)
class Layout:
    """Where the columns are. `slot` numbers the points that have columns; -1: exact."""

    stations: int
    bodies: int
    slot: Indices  # (m,)

    @property
    def bodies_at(self) -> int:
        return STATION_COLUMNS * self.stations

    @property
    def points_at(self) -> int:
        return self.bodies_at + BODY_COLUMNS * self.bodies

    @property
    def columns(self) -> int:
        return self.points_at + 3 * (int(self.slot.max(initial=-1)) + 1)


def layout_of(stations: int, targets: Targets, seen: Indices) -> Layout:
    """`seen`: the points that any view or bar touches; only they have columns."""
    inexact = targets.free | (np.abs(targets.cov_mm2).max(axis=(1, 2), initial=0.0) > 0.0)
    touched = np.zeros(len(targets), bool)
    touched[seen] = True
    slot = np.full(len(targets), -1, np.intp)
    slot[inexact & touched] = np.arange(int((inexact & touched).sum()))
    return Layout(stations, len(targets.bodies), slot)


def state_of(stations: Sequence[Station], targets: Targets) -> State:
    """Start values; what has none (a body's pose, a free point) is at the origin."""
    poses = [body.world_from_body or Rigid.identity() for body in targets.bodies]
    return State(
        r_world_from_gimbal=np.array([s.world_from_gimbal.rotation for s in stations]),
        t_world_from_gimbal=np.array([s.world_from_gimbal.translation_mm for s in stations], float),
        axes=np.array([(s.eps_rad, s.d_mm) for s in stations]),
        r_rg_from_camera=np.array([s.rg_from_camera.rotation for s in stations]),
        t_rg_from_camera=np.array([s.rg_from_camera.translation_mm for s in stations], float),
        lens=np.array([(s.lens.fx_px, s.lens.fy_px, s.lens.cx_px, s.lens.cy_px, *s.lens.distortion) for s in stations]),
        az_outer=np.array([s.order is AxisOrder.AZ_OUTER for s in stations]),
        signs=np.array([(s.az_sign, s.el_sign) for s in stations], float),
        r_world_from_body=np.array([pose.rotation for pose in poses]).reshape(-1, 3, 3),
        t_world_from_body=np.array([pose.translation_mm for pose in poses], float).reshape(-1, 3),
        ball_mm=np.array([np.zeros(3) if body.ball_mm is None else body.ball_mm for body in targets.bodies], float).reshape(
            -1, 3
        ),
        delta_mm=np.zeros((len(targets), 3)),
    )


def stations_of(state: State, nominal: Sequence[Station]) -> dict[str, Station]:
    """The stations that a state describes; names and sensors are those of the nominal ones."""
    found = {}
    for k, station in enumerate(nominal):
        fx, fy, cx, cy, *distortion = state.lens[k].tolist()
        k1, k2, p1, p2, k3 = distortion
        found[station.name] = Station(
            name=station.name,
            world_from_gimbal=Rigid(state.r_world_from_gimbal[k], state.t_world_from_gimbal[k]),
            rg_from_camera=Rigid(state.r_rg_from_camera[k], state.t_rg_from_camera[k]),
            lens=Lens(station.lens.sensor_px, fx, fy, cx, cy, (k1, k2, p1, p2, k3)),
            order=AxisOrder.AZ_OUTER if state.az_outer[k] else AxisOrder.EL_OUTER,
            az_sign=int(state.signs[k, 0]),
            el_sign=int(state.signs[k, 1]),
            eps_rad=float(state.axes[k, 0]),
            d_mm=float(state.axes[k, 1]),
        )
    return found


def with_poses(state: State, bodies: Mapping[int, Rigid]) -> State:
    rotations, translations = state.r_world_from_body.copy(), state.t_world_from_body.copy()
    for b, pose in bodies.items():
        rotations[b], translations[b] = pose.rotation, pose.translation_mm
    return replace(state, r_world_from_body=rotations, t_world_from_body=translations)


def moved(state: State, step: Array, layout: Layout) -> State:
    """A step (columns,) from the state."""
    s = step[: layout.bodies_at].reshape(-1, STATION_COLUMNS)
    b = step[layout.bodies_at : layout.points_at].reshape(-1, BODY_COLUMNS)
    delta = state.delta_mm
    if layout.columns > layout.points_at:
        delta = delta.copy()
        delta[layout.slot >= 0] += step[layout.points_at :].reshape(-1, 3)
    return replace(
        state,
        r_world_from_gimbal=exponentials(s[:, 0:3]) @ state.r_world_from_gimbal,
        t_world_from_gimbal=state.t_world_from_gimbal + s[:, 3:6],
        axes=state.axes + s[:, AXES_AT],
        r_rg_from_camera=exponentials(s[:, 8:11]) @ state.r_rg_from_camera,
        t_rg_from_camera=state.t_rg_from_camera + s[:, 11:14],
        lens=state.lens + s[:, LENS_AT],
        r_world_from_body=exponentials(b[:, 0:3]) @ state.r_world_from_body,
        t_world_from_body=state.t_world_from_body + b[:, 3:6],
        ball_mm=state.ball_mm + b[:, 6:9],
        delta_mm=delta,
    )


def difference(state: State, other: State) -> Array:
    """The step of the stations' columns, (K, 23), that leads from `other` to `state`."""
    return np.concatenate(
        [
            logarithms(state.r_world_from_gimbal @ other.r_world_from_gimbal.transpose(0, 2, 1)),
            state.t_world_from_gimbal - other.t_world_from_gimbal,
            state.axes - other.axes,
            logarithms(state.r_rg_from_camera @ other.r_rg_from_camera.transpose(0, 2, 1)),
            state.t_rg_from_camera - other.t_rg_from_camera,
            state.lens - other.lens,
        ],
        axis=1,
    )


def points_in_world(state: State, targets: Targets, points: Indices) -> tuple[Array, Array]:
    """Of some points, (n, 3) each: their places in W, and turned to W from their body's origin."""
    body = targets.body[points]
    start = np.where(targets.free[points, None] & np.isnan(targets.p_mm[points]), 0.0, targets.p_mm[points])
    in_body = start + np.einsum("nij,nj->ni", targets.flange[points], state.ball_mm[body]) + state.delta_mm[points]
    turned = np.einsum("nij,nj->ni", state.r_world_from_body[body], in_body)
    return turned + state.t_world_from_body[body], turned


def cross_matrices(a: Array) -> Array:
    """[a]x of vectors (..., 3)."""
    zero = np.zeros(a.shape[:-1])
    x, y, z = a[..., 0], a[..., 1], a[..., 2]
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape(*a.shape[:-1], 3, 3)


def turns(axes: Array, angles: Array) -> Array:
    """Rotations (..., 3, 3) about unit axes (..., 3) (Rodrigues)."""
    k = cross_matrices(axes)
    s, c = np.sin(angles)[..., None, None], np.cos(angles)[..., None, None]
    return np.asarray(np.eye(3) + s * k + (1.0 - c) * (k @ k))


def exponentials(vectors: Array) -> Array:
    """exp([r]x) of rotation vectors (..., 3)."""
    angles = np.sqrt((vectors**2).sum(axis=-1))
    return turns(vectors / np.where(angles > 0.0, angles, 1.0)[..., None], angles)


def logarithms(rotations: Array) -> Array:
    """Rotation vectors of (..., 3, 3); exact up to half a turn."""
    r = rotations
    twice = np.stack([r[..., 2, 1] - r[..., 1, 2], r[..., 0, 2] - r[..., 2, 0], r[..., 1, 0] - r[..., 0, 1]], axis=-1)
    sine = np.sqrt((twice**2).sum(axis=-1)) / 2.0
    angle = np.arctan2(sine, (r[..., 0, 0] + r[..., 1, 1] + r[..., 2, 2] - 1.0) / 2.0)
    return np.asarray(twice / 2.0 * np.where(sine > 1e-12, angle / np.where(sine > 1e-12, sine, 1.0), 1.0)[..., None])


def inverse_2(matrices: Array) -> Array:
    """Of (..., 2, 2)."""
    a, b, c, d = matrices[..., 0, 0], matrices[..., 0, 1], matrices[..., 1, 0], matrices[..., 1, 1]
    return np.asarray(np.stack([d, -b, -c, a], axis=-1).reshape(matrices.shape) / (a * d - b * c)[..., None, None])
