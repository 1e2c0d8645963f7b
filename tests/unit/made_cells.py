"""Simulated cells for the calibration: true stations, nominal ones, and what they see of targets."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import atan2

import numpy as np

from trackerd.calibrate.cell.aiming import aim
from trackerd.calibrate.cell.measure import measure
from trackerd.calibrate.cell.model import Linear, linearise
from trackerd.calibrate.cell.observations import Observations
from trackerd.calibrate.cell.options import ARCSEC, Priors
from trackerd.calibrate.cell.predict import predict
from trackerd.calibrate.cell.result import CellResult
from trackerd.calibrate.cell.state import exponentials, points_in_world, state_of, with_poses
from trackerd.calibrate.cell.targets import Targets, board, join, known_points
from trackerd.contract.model import Array
from trackerd.geometry.gimbal import AxisOrder, Station
from trackerd.geometry.lens import Lens
from trackerd.geometry.rigid import Rigid, rotation_about_y

SENSOR = (2048, 1536)
FIVE = np.array(
    [(0.0, 0.0), (700.0, 500.0), (-700.0, 500.0), (-350.0, -250.0), (350.0, -250.0)]
)  # px off the middle, two radii
VOLUME_MM = np.array((200.0, 200.0, 150.0))


@dataclass(frozen=True)
class Cell:
    true: tuple[Station, ...]
    nominal: dict[str, Station]


def turned(vector_rad: Sequence[float] | Array) -> Array:
    return np.asarray(exponentials(np.asarray(vector_rad, float)[None])[0])


def nominal_station(
    name: str, x_mm: float, f_px: float = 31000.0, range_mm: float = 1920.0, lever_mm: float = -124.5
) -> Station:
    base = Rigid(rotation_about_y(atan2(-x_mm, range_mm)), np.array((x_mm, 0.0, -range_mm)))
    lens = Lens(SENSOR, f_px, f_px, 1023.5, 767.5)
    return Station(name, base, Rigid(np.eye(3), np.array((0.0, lever_mm, 0.0))), lens)


def imperfect(nominal: Station, rng: np.random.Generator, priors: Priors, order: AxisOrder, signs: tuple[int, int]) -> Station:
    """A station that the nominal one describes within the priors; its pose is far off the nominal one."""
    mount = Rigid(
        turned(rng.normal(0.0, priors.mount_rotation_rad / 3.0, 3)) @ nominal.rg_from_camera.rotation,
        nominal.rg_from_camera.translation_mm
        + rng.normal(0.0, (priors.mount_xy_mm, priors.mount_xy_mm, priors.mount_z_mm / 2.5)),
    )
    base = Rigid(
        turned(rng.normal(0.0, 0.02, 3)) @ nominal.world_from_gimbal.rotation,
        nominal.world_from_gimbal.translation_mm + rng.normal(0.0, 20.0, 3),
    )
    f = nominal.lens.fx_px * (1.0 + rng.normal(0.0, priors.f_relative / 2.0))
    cx, cy = np.array((nominal.lens.cx_px, nominal.lens.cy_px)) + rng.normal(0.0, priors.centre_px / 2.0, 2)
    lens = Lens(nominal.lens.sensor_px, f, f, float(cx), float(cy), (float(rng.normal(-0.05, 0.1)), 0.0, 0.0, 0.0, 0.0))
    eps, d = float(rng.normal(0.0, priors.eps_rad)), float(rng.normal(0.0, priors.d_mm))
    return Station(nominal.name, base, mount, lens, order, signs[0], signs[1], eps, d)


def cell(
    rng: np.random.Generator,
    f_px: float = 31000.0,
    order: AxisOrder = AxisOrder.AZ_OUTER,
    signs: tuple[int, int] = (1, 1),
    lever_mm: float = -124.5,
) -> Cell:
    """Two stations, 2 m range, 1.1 m baseline."""
    nominal = {name: nominal_station(name, x, f_px, lever_mm=lever_mm) for name, x in (("left", -550.0), ("right", 550.0))}
    priors = Priors()
    if lever_mm == 0.0:
        priors = replace(priors, mount_xy_mm=1e-9, mount_z_mm=1e-9)
    return Cell(tuple(imperfect(s, rng, priors, order, signs) for s in nominal.values()), nominal)


@dataclass(frozen=True)
class Noise:
    px: float = 0.1
    encoder_rad: float = 2.0 * ARCSEC
    fixed_rad: float = 0.0  # rms over the turn of a function of the angle
    none: bool = False  # the sigmas are claimed, but nothing is added


Effect = Callable[[Linear, Array, Array, Array], Array]  # (derivatives, stations, angles, points in W) of n image points -> px
CYCLES = np.array((1.0, 2.0, 36.0, 360.0))
NOT_ABSORBED = float(np.sqrt((CYCLES > 2.0).mean()))  # 1 and 2 cycles a turn go into axes, mount and pose


def encoder_maps(rng: np.random.Generator, stations: int, rms_rad: float) -> Array:
    """Phases and sizes (2, K, 2, 4) of the functions of the angle that the encoders of K stations are off by."""
    phases = rng.uniform(0.0, 2.0 * np.pi, (stations, 2, len(CYCLES)))
    return np.stack([phases, np.full_like(phases, rms_rad / np.sqrt(len(CYCLES) / 2.0))])


def fixed_errors(maps: Array | None, station_of: Array, angles_rad: Array) -> Array:
    assert maps is not None
    phases, sizes = maps[0][station_of], maps[1][station_of]
    return np.asarray((sizes * np.cos(CYCLES * angles_rad[:, :, None] + phases)).sum(axis=2))


def shoot(
    stations: Sequence[Station],
    targets: Targets,
    station_of: Array,
    angles_rad: Array,
    shown: Sequence[Array],
    noise: Noise,
    rng: np.random.Generator,
    poses: dict[str, Rigid] | None = None,
    clip: bool = True,
    maps: Array | None = None,
    effect: Effect | None = None,
) -> Observations:
    """Views at true angles: which of the points `shown` (indices) are inside the sensor, at pixels and angles as measured."""
    state = state_of(stations, targets)
    names = [body.name for body in targets.bodies]
    state = with_poses(state, {names.index(name): pose for name, pose in (poses or {}).items()})
    view = np.repeat(np.arange(len(shown)), [len(points) for points in shown])
    point = np.concatenate([np.asarray(points, np.intp) for points in shown])
    station_of = np.asarray(station_of, np.intp)
    linear = linearise(state, targets, station_of, angles_rad, view, point)
    q = linear.q_px
    if effect is not None:
        q = q + effect(linear, station_of[view], angles_rad[view], points_in_world(state, targets, point)[0])
    inside = np.isfinite(q).all(axis=1)
    if clip:
        inside &= ((q > 0.0) & (q < np.array(SENSOR) - 1.0)).all(axis=1)
    size = 0.0 if noise.none else 1.0
    q = q + size * rng.normal(0.0, noise.px, q.shape)
    angles = angles_rad + size * rng.normal(0.0, noise.encoder_rad, angles_rad.shape)
    if noise.fixed_rad > 0.0:
        angles = angles + size * fixed_errors(maps, station_of, angles_rad)
    return Observations(
        gimbals=tuple(s.name for s in stations),
        views=tuple(f"{stations[k].name}/{i}" for i, k in enumerate(station_of)),
        gimbal=station_of,
        angles_rad=angles,
        encoder_sigma_rad=np.full(len(shown), noise.encoder_rad),
        encoder_fixed_rad=np.full(len(shown), NOT_ABSORBED * noise.fixed_rad),
        view=view[inside],
        point=point[inside],
        q_px=q[inside],
        sigma_px=np.full(int(inside.sum()), noise.px),
    )


def probe_views(
    stations: Sequence[Station], p_mm: Array, offsets_px: Array = FIVE, faces: Sequence[bool] = (False,)
) -> tuple[Array, Array, list[Array]]:
    """Every station sees every point at every image position: stations (v,), angles (v, 2), shown points."""
    k, m, r = len(stations), len(p_mm), len(offsets_px)
    station_of = np.repeat(np.arange(k), m * r)
    which = np.tile(np.repeat(np.arange(m), r), k)
    centres = np.array([(s.lens.cx_px, s.lens.cy_px) for s in stations])
    q = centres[station_of] + np.tile(offsets_px, (k * m, 1))
    angles = [aim(stations, station_of, p_mm[which], q, second_face=face) for face in faces]
    return np.tile(station_of, len(faces)), np.concatenate(angles), [np.array([i]) for i in which] * len(faces)


def volume(rng: np.random.Generator, count: int) -> Array:
    return rng.uniform(-1.0, 1.0, (count, 3)) * VOLUME_MM


def probe_data(
    made: Cell,
    rng: np.random.Generator,
    count: int = 40,
    noise: Noise | None = None,
    targets: Targets | None = None,
    faces: Sequence[bool] = (False,),
    maps: Array | None = None,
    effect: Effect | None = None,
) -> tuple[Observations, Targets]:
    """A probe at `count` known points x 5 image positions x 2 gimbals."""
    targets = known_points(volume(rng, count)) if targets is None else targets
    station_of, angles, shown = probe_views(made.true, targets.p_mm, faces=faces)
    return shoot(made.true, targets, station_of, angles, shown, noise or Noise(), rng, maps=maps, effect=effect), targets


def looks(
    made: Cell,
    rng: np.random.Generator,
    p_mm: Array,
    noise: Noise | None = None,
    maps: Array | None = None,
    effect: Effect | None = None,
) -> Observations:
    """One look of every station at each of some targets, in the middle of its image."""
    views = probe_views(made.true, p_mm, np.zeros((1, 2)))
    return shoot(made.true, known_points(p_mm), *views, noise or Noise(), rng, maps=maps, effect=effect)


BOARD_MM = np.array([(10.0 * x, 10.0 * y, 0.0) for y in range(6) for x in range(9)]) - (40.0, 25.0, 0.0)  # 9 x 6 corners


def board_pose(rng: np.random.Generator, at_mm: Array, tilt_rad: float = 0.5) -> Rigid:
    """A board that faces the cameras more or less."""
    tilt = rng.normal(0.0, tilt_rad / 2.0, 2)
    return Rigid(turned((*np.clip(tilt, -tilt_rad, tilt_rad), rng.uniform(-0.3, 0.3))), at_mm)


def board_data(
    made: Cell,
    rng: np.random.Generator,
    fixed: int = 50,
    loose: int = 18,
    each: int = 10,
    noise: Noise | None = None,
    maps: Array | None = None,
) -> tuple[Observations, Targets, dict[str, Rigid]]:
    """`fixed` views of a board in W, and `loose` placements of it in the volume with `each` views, of every gimbal."""
    poses = {f"board{i}": board_pose(rng, volume(rng, 1)[0]) for i in range(loose)}
    first = known_points(board_pose(rng, np.zeros(3), 0.3).move(BOARD_MM), [f"fixed:{i}" for i in range(54)])
    targets = join(first, *(board(name, BOARD_MM) for name in poses))
    station_of, centres, shown = [], [], []
    for k in range(len(made.true)):
        for place in range(loose + 1):
            middle = np.zeros(3) if place == 0 else poses[f"board{place - 1}"].translation_mm
            for _ in range(fixed if place == 0 else each):
                station_of.append(k)
                centres.append(middle)
                shown.append(np.arange(54) + 54 * place)
    q = np.array([(s.lens.cx_px, s.lens.cy_px) for s in made.true])[station_of] + rng.uniform(-1, 1, (len(shown), 2)) * (
        380.0,
        330.0,
    )
    angles = aim(made.true, np.array(station_of), np.array(centres), q)
    seen = shoot(made.true, targets, np.array(station_of), angles, shown, noise or Noise(px=0.3), rng, poses, maps=maps)
    return seen, targets, poses


def calibration_error_mm(made: Cell, result: CellResult, count: int = 30) -> float:
    """RMS of what the calibration alone adds to targets in the volume: they are looked at without any noise."""
    p_mm = volume(np.random.default_rng(77), count)
    seen = looks(made, np.random.default_rng(78), p_mm, Noise(none=True))
    found = measure(seen, count, result.stations, result.parameters, result.covariance)
    return float(np.sqrt(((found.p_mm - p_mm) ** 2).sum(axis=1).mean()))


def predicted_mm(result: CellResult, count: int = 30) -> float:
    """What the calibration says of the same."""
    p_mm = volume(np.random.default_rng(77), count)
    at = predict(result.stations, result.parameters, result.covariance, p_mm, sigma_px=0.1, encoder_sigma_rad=2.0 * ARCSEC)
    return float(np.sqrt(np.trace(at.calibration_mm2, axis1=1, axis2=2).mean()))
