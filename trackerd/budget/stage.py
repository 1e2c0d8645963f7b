"""A layout as stations and points, and what the cameras would see without noise."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import cos, pi, sin

import numpy as np

from trackerd.budget.settings import BudgetSettings, CameraModel, GimbalPlace
from trackerd.contract.errors import ConfigError, Degenerate
from trackerd.contract.model import Array
from trackerd.geometry.gimbal import Station
from trackerd.geometry.lens import Lens
from trackerd.geometry.rigid import Rigid


@dataclass(frozen=True, slots=True)
class Sight:
    """What one station sees, exactly. P points, L looks at each; angles are az, el in rad."""

    view_rad: Array  # (2,) of the one view of all points
    view_px: Array  # (P, 2)
    looks_rad: Array  # (L, P, 2) aimed at the points, for the adjustment
    looks_px: Array  # (L, P, 2)
    targets_rad: Array  # (P, 2) aimed at the points once more, to measure them
    targets_px: Array  # (P, 2)


@dataclass(frozen=True, slots=True)
class Stage:
    """One layout with one set of points. The stations are the truth, and their lens and lever arm the nominal values."""

    layout: str
    draw: int
    stations: Mapping[str, Station]
    points_mm: Array  # (P, 3) in W
    sights: Mapping[str, Sight]


def make_stage(settings: BudgetSettings, layout: str, draw: int) -> Stage:
    """Raises ConfigError where a gimbal cannot be aimed at a point, or a point leaves the image of the view."""
    points_mm = draw_points(settings, draw)
    stations = stations_of(settings, layout)
    sights = {}
    for name, station in stations.items():
        place = settings.layout[layout].gimbal[name]
        aim_mm = points_mm.mean(axis=0) if place.aim_mm is None else np.array(place.aim_mm)
        try:
            sights[name] = _sight(station, points_mm, aim_mm, settings)
        except Degenerate as error:
            raise ConfigError(f"budget [layout.{layout}.gimbal.{name}]: {error}") from error
    return Stage(layout, draw, stations, points_mm, sights)


def draw_points(settings: BudgetSettings, draw: int) -> Array:
    """Uniform in the box, (P, 3). The draw alone decides: noise and layout have no part in it."""
    box = settings.points
    offsets = np.random.default_rng(draw).uniform(-1.0, 1.0, (box.count, 3))
    return np.asarray(np.array(box.centre_mm) + offsets * np.array(box.half_size_mm))


def stations_of(settings: BudgetSettings, layout: str) -> dict[str, Station]:
    return {name: _station(name, place, settings.camera) for name, place in settings.layout[layout].gimbal.items()}


def _station(name: str, place: GimbalPlace, camera: CameraModel) -> Station:
    width, height = camera.sensor_px
    lens = Lens(camera.sensor_px, camera.focal_px, camera.focal_px, (width - 1) / 2.0, (height - 1) / 2.0)
    base = Rigid(_orientation(place), np.array(place.position_mm))
    return Station(name, base, Rigid(np.eye(3), np.array(camera.lever_arm_mm)), lens, place.axis_order)


def _orientation(place: GimbalPlace) -> Array:
    """world_from_gimbal: z_G along the facing, x_G the AZ axis made square to it."""
    z = place.facing / np.linalg.norm(place.facing)
    x = np.array(place.az_axis) - (np.array(place.az_axis) @ z) * z
    x /= np.linalg.norm(x)
    return np.column_stack((x, np.cross(z, x), z))


def _sight(station: Station, points_mm: Array, aim_mm: Array, settings: BudgetSettings) -> Sight:
    az, el = station.aim(aim_mm)
    view_px = np.array([station.pixel(p_mm, az, el) for p_mm in points_mm])
    _refuse_unseen(station, points_mm, az, el, view_px)
    rings_px = _ring(station.lens, settings.adjustment.looks, settings.adjustment.ring_px)
    looks_rad = np.array([[station.aim(p_mm, q_px) for p_mm in points_mm] for q_px in rings_px])
    targets_rad = np.array([station.aim(p_mm) for p_mm in points_mm])
    centre_px = np.array((station.lens.cx_px, station.lens.cy_px))
    return Sight(
        view_rad=np.array((az, el)),
        view_px=view_px,
        looks_rad=looks_rad,
        looks_px=np.repeat(rings_px[:, None, :], len(points_mm), axis=1),
        targets_rad=targets_rad,
        targets_px=np.tile(centre_px, (len(points_mm), 1)),
    )


def _ring(lens: Lens, looks: int, radius_px: float) -> Array:
    """Image positions (L, 2), evenly on a circle about the principal point."""
    turns = [2.0 * pi * n / looks for n in range(looks)]
    return np.array([(lens.cx_px + radius_px * cos(turn), lens.cy_px + radius_px * sin(turn)) for turn in turns])


def _refuse_unseen(station: Station, points_mm: Array, az_rad: float, el_rad: float, view_px: Array) -> None:
    depths_mm = station.world_from_camera(az_rad, el_rad).inverse().move(points_mm)[:, 2]
    outside = (view_px < -0.5).any(axis=1) | (view_px > np.array(station.lens.sensor_px) - 0.5).any(axis=1)
    unseen = np.flatnonzero((depths_mm <= 0.0) | outside)
    if len(unseen):
        where = np.round(points_mm[unseen[0]], 1).tolist()
        raise Degenerate(f"{len(unseen)} of {len(points_mm)} points are outside the image of the one view, such as {where} mm")
