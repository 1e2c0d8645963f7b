"""The cell in three dimensions: stations, work volume, points, and how far each may be off."""

from collections.abc import Mapping, Sequence
from itertools import cycle
from typing import Any

import numpy as np
from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection

from trackerd.calibrate.plan.volume import Box
from trackerd.contract.model import Array
from trackerd.geometry.gimbal import Station
from trackerd.pictures.look import INK, QUIET, STATIONS

LARGEST_SHARE = 0.12  # of the scene: the longest axis of the largest ellipsoid that is drawn
NICE = (1.0, 2.0, 5.0)


def draw_cell(axes: Any, stations: Mapping[str, Station], box: Box, elevation: float = 22.0) -> None:
    """Stations with their axes, lines of view to the middle of the volume, the volume. `axes` is a 3D one."""
    middle = box.centre_mm
    for colour, (name, station) in zip(STATIONS, stations.items(), strict=False):
        place = station.world_from_gimbal.translation_mm
        _line(axes, place, middle, color=colour, linewidth=0.9, linestyle=(0, (6, 4)))
        axes.scatter(*_drawn(place), color=colour, s=34, depthshade=False)
        axes.text(*_drawn(place), f"  {name}", color=colour, fontsize=9, fontweight="bold")
        size = 0.06 * float(np.linalg.norm(place - middle))
        az_axis = size * station.world_from_gimbal.rotation[:, 0]
        _line(axes, place - az_axis, place + az_axis, color=colour, linewidth=2.0)
    _box(axes, box)
    _equal(axes, stations, box)
    axes.view_init(elev=elevation, azim=-62.0)


def draw_ellipsoids(axes: Any, p_mm: Array, cov_mm2: Array, colours: Sequence[str], scene_mm: float) -> float:
    """1-sigma ellipsoids of points (m, 3), magnified alike, in these colours by turns; returns by how much."""
    largest = float(np.sqrt(np.linalg.eigvalsh(cov_mm2)[:, -1].max()))
    magnified = nice_below(LARGEST_SHARE * scene_mm / max(largest, 1e-12))
    u, v = np.mgrid[0.0 : 2.0 * np.pi : 19j, 0.0 : np.pi : 11j]
    ball = np.stack((np.cos(u) * np.sin(v), np.sin(u) * np.sin(v), np.cos(v)), axis=-1)
    for place, cov, colour in zip(p_mm, cov_mm2, cycle(colours), strict=False):
        values, vectors = np.linalg.eigh(cov)
        surface = place + magnified * (ball * np.sqrt(np.maximum(values, 0.0))) @ vectors.T
        x, y, z = np.moveaxis(_drawn(surface), -1, 0)
        axes.plot_surface(x, y, z, color=colour, alpha=0.35, linewidth=0, shade=True)
    return magnified


def draw_points(axes: Any, p_mm: Array, colour: str, label: str, marker: str = "o") -> None:
    axes.scatter(*_drawn(p_mm).T, color=colour, s=14, label=label, marker=marker, depthshade=False)


def draw_tour(axes: Any, p_mm: Array) -> None:
    axes.plot(*_drawn(p_mm).T, color=QUIET, linewidth=0.8)


def nice_below(value: float) -> float:
    """1, 2 or 5 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(max(step * power for step in NICE if step * power <= value))


def scene_mm(stations: Mapping[str, Station], box: Box) -> float:
    """The longest side of all that is drawn."""
    low, high = _extent(stations, box)
    return float((high - low).max())


def _drawn(p_mm: Array) -> Array:
    """x to the right, z (away from the cameras) into the picture, y (down) downwards."""
    return np.asarray(np.stack((p_mm[..., 0], p_mm[..., 2], -p_mm[..., 1]), axis=-1))


def _line(axes: Any, a_mm: Array, b_mm: Array, **look: Any) -> None:
    axes.add_collection3d(Line3DCollection([_drawn(np.array((a_mm, b_mm)))], **{**look, "colors": look.pop("color")}))


def _box(axes: Any, box: Box) -> None:
    corners = _drawn(box.grid(2))
    faces: Sequence[tuple[int, ...]] = ((0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5))
    polygons = [corners[list(face)] for face in faces]
    axes.add_collection3d(Poly3DCollection(polygons, facecolors="#56B4E918", edgecolors=QUIET, linewidths=0.7))


def _extent(stations: Mapping[str, Station], box: Box) -> tuple[Array, Array]:
    places = [station.world_from_gimbal.translation_mm for station in stations.values()]
    everything = np.array([*places, box.low_mm, box.high_mm])
    return everything.min(axis=0), everything.max(axis=0)


def _equal(axes: Any, stations: Mapping[str, Station], box: Box) -> None:
    low, high = (_drawn(corner) for corner in _extent(stations, box))
    low, high = np.minimum(low, high), np.maximum(low, high)
    margin = 0.05 * float((high - low).max())
    axes.set(xlim=(low[0] - margin, high[0] + margin), ylim=(low[1] - margin, high[1] + margin))
    axes.set(zlim=(low[2] - margin, high[2] + margin), xlabel="x  mm", ylabel="z  mm", zlabel="−y  mm")
    axes.set_box_aspect(high - low + 2.0 * margin)
    axes.tick_params(labelsize=7, colors=INK)
    axes.xaxis.set_pane_color((1.0, 1.0, 1.0, 0.0))
    axes.yaxis.set_pane_color((1.0, 1.0, 1.0, 0.0))
    axes.zaxis.set_pane_color((1.0, 1.0, 1.0, 0.0))
