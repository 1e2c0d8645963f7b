"""A cell in three dimensions: gimbals, targets, lines of sight, and error ellipsoids, as in the thesis's Fig. 4.3."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d import Axes3D
from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection

from trackerd.contract.model import Array
from trackerd.geometry.gimbal import Station
from trackerd.geometry.rigid import Rigid
from trackerd.pictures.look import INK, QUIET, STATIONS

BODY_SHARE = 0.09  # size of a camera, of the scene
ELLIPSOID_SHARE = 0.22  # longest axis of the largest ellipsoid, of the scene
FACETS = (18, 10)  # round, and from pole to pole
NAMES = ("x", "y", "z")


@dataclass(frozen=True, slots=True)
class Frame:
    """Which axes of W are drawn to the right, into the depth, and upwards."""

    axes: tuple[int, int, int]
    mirrored: bool  # the last one is drawn downwards, so that the scene stays right-handed

    def __call__(self, p_mm: Array) -> Array:
        return np.asarray(p_mm)[..., list(self.axes)]


def frame_of(stations: Sequence[Station], p_mm: Array) -> Frame:
    """Depth is where the gimbals look; of the others the one along which they are spread lies level."""
    positions = np.array([station.world_from_gimbal.translation_mm for station in stations])
    depth = int(np.abs(p_mm.mean(axis=0) - positions.mean(axis=0)).argmax())
    first, second = (axis for axis in range(3) if axis != depth)
    level = first if np.ptp(positions[:, first]) >= np.ptp(positions[:, second]) else second
    up = second if level == first else first
    return Frame((level, depth, up), mirrored=(level, depth, up) in ((0, 2, 1), (1, 0, 2), (2, 1, 0)))


def draw_cell(axes: Axes3D, stations: Mapping[str, Station], p_mm: Array, aim_mm: Array, *, dots: bool = True) -> None:
    """Gimbals with their cameras aimed at a point, and the targets with their shadows on the floor."""
    frame = frame_of(list(stations.values()), p_mm)
    poses = {name: station.world_from_camera(*station.aim(aim_mm)) for name, station in stations.items()}
    bases = np.array([station.world_from_gimbal.translation_mm for station in stations.values()])
    everything = frame(np.concatenate([p_mm, bases, np.array([pose.translation_mm for pose in poses.values()])]))
    size_mm = float(np.ptp(everything, axis=0).max())
    set_up(axes, everything, frame, 0.10 * size_mm)
    floor_mm = axes.get_zlim()[0]
    for n, (name, station) in enumerate(stations.items()):
        _camera(axes, frame, poses[name], station, aim_mm, BODY_SHARE * size_mm, STATIONS[n % len(STATIONS)])
        _base(axes, frame, name, station, poses[name], floor_mm, BODY_SHARE * size_mm, STATIONS[n % len(STATIONS)])
    if dots:
        draw_points(axes, frame(p_mm), floor_mm)


def draw_stems(axes: Axes3D, p: Array, floor_mm: float) -> None:
    """From the floor to each place, so that the eye finds its depth."""
    stems = [((x, y, floor_mm), (x, y, z)) for x, y, z in p]
    axes.add_collection3d(Line3DCollection(stems, colors=QUIET, linewidths=0.6, alpha=0.5))
    axes.scatter(p[:, 0], p[:, 1], np.full(len(p), floor_mm), s=8, color=QUIET, alpha=0.35, lw=0, depthshade=False)


def draw_points(axes: Axes3D, p: Array, floor_mm: float) -> None:
    draw_stems(axes, p, floor_mm)
    axes.scatter(p[:, 0], p[:, 1], p[:, 2], s=26, color=INK, edgecolors="white", linewidths=0.6, depthshade=False)


def draw_ellipsoids(axes: Axes3D, frame: Frame, p_mm: Array, cov_mm2: Array, colours: Sequence[Any], scale: float) -> None:
    """Of `scale` sigmas, at each place (m, 3)."""
    u = np.linspace(0.0, 2.0 * np.pi, FACETS[0])
    v = np.linspace(0.0, np.pi, FACETS[1])
    ball = np.stack([np.outer(np.cos(u), np.sin(v)), np.outer(np.sin(u), np.sin(v)), np.outer(np.ones_like(u), np.cos(v))], -1)
    for place, cov, colour in zip(p_mm, cov_mm2, colours, strict=True):
        values, vectors = np.linalg.eigh(cov)
        surface = frame(place + scale * ball @ (vectors * np.sqrt(np.maximum(values, 0.0))).T)
        axes.plot_surface(*np.moveaxis(surface, -1, 0), color=colour, alpha=0.75, linewidth=0.0, antialiased=True, shade=True)


def magnification(p_mm: Array, cov_mm2: Array, share: float = ELLIPSOID_SHARE) -> float:
    """A round number of sigmas that makes the largest ellipsoid well seen: 1, 2 or 5 times a power of ten."""
    size_mm = float(np.ptp(p_mm, axis=0).max())
    longest_mm = 2.0 * float(np.sqrt(np.linalg.eigvalsh(cov_mm2)[:, -1].max()))
    wanted = share * size_mm / longest_mm
    power = 10.0 ** np.floor(np.log10(wanted))
    return float(max(step for step in (1.0, 2.0, 5.0) if step * power <= wanted * (1.0 + 1e-12)) * power)


def set_up(axes: Axes3D, shown: Array, frame: Frame, margin_mm: float, zoom: float = 1.15) -> None:
    """Equal scales, names of the axes of W, quiet panes."""
    low, high = shown.min(axis=0) - margin_mm, shown.max(axis=0) + margin_mm
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    axes.set_box_aspect(tuple((high - low).tolist()), zoom=zoom)
    if frame.mirrored:
        axes.set_zlim(high[2], low[2])
    labels = (axes.set_xlabel, axes.set_ylabel, axes.set_zlabel)
    for label, name in zip(labels, (NAMES[axis] for axis in frame.axes), strict=True):
        label(f"{name}, mm", labelpad=4)
    for axis, extent_mm in zip((axes.xaxis, axes.yaxis, axes.zaxis), high - low, strict=True):
        axis.set_pane_color((0.975, 0.975, 0.975, 1.0))
        axis.line.set_color(QUIET)
        axis.set_major_locator(MaxNLocator(max(2, round(5 * extent_mm / (high - low).max())), steps=(1, 2, 2.5, 5, 10)))
    axes.tick_params(labelsize=7, pad=1)
    axes.patch.set_visible(False)


def _camera(
    axes: Axes3D, frame: Frame, world_from_camera: Rigid, station: Station, aim_mm: Array, size_mm: float, colour: str
) -> None:
    """The field of view as a pyramid, and the line of sight to the aim."""
    width, height = station.lens.sensor_px
    half = 0.5 * np.array((width, height)) / max(width, height)
    corners = np.array([(x * half[0], y * half[1], 1.0) for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))]) * size_mm
    rim = frame(world_from_camera.move(corners))
    tip = frame(world_from_camera.translation_mm)
    faces = [(tip, rim[n], rim[(n + 1) % 4]) for n in range(4)]
    axes.add_collection3d(Poly3DCollection(faces, facecolors=colour, edgecolors=colour, alpha=0.28, linewidths=0.9))
    axes.add_collection3d(Line3DCollection([(tip, frame(aim_mm))], colors=colour, linewidths=1.1, linestyles="--", alpha=0.9))


def _base(
    axes: Axes3D, frame: Frame, name: str, station: Station, pose: Rigid, floor_mm: float, size_mm: float, colour: str
) -> None:
    """The gimbal's centre, its outer axis, the lever arm to the camera, and a post."""
    centre = station.world_from_gimbal.translation_mm
    outer = station.world_from_gimbal.rotation[:, 0 if station.order == "az_outer" else 1] * 0.8 * size_mm
    lines = [(frame(centre - outer), frame(centre + outer)), (frame(centre), frame(pose.translation_mm))]
    axes.add_collection3d(Line3DCollection(lines, colors=(colour, INK), linewidths=(2.2, 1.6)))
    x, y, z = frame(centre)
    axes.plot((x, x), (y, y), (floor_mm, z), color=QUIET, lw=0.8, ls=":")
    axes.scatter(x, y, z, s=34, color=colour, edgecolors="white", linewidths=0.8, depthshade=False)
    up = -1.0 if frame.mirrored else 1.0
    axes.text(x, y, z + up * 1.5 * size_mm, name, color=colour, fontsize=9, fontweight="bold", ha="center")


def box_edges(centre_mm: Array, half_mm: Array) -> list[tuple[Array, Array]]:
    """The twelve edges of a box in W."""
    corners = {signs: centre_mm + np.array(signs) * half_mm for signs in product((-1.0, 1.0), repeat=3)}
    return [
        (corners[a], corners[b])
        for a in corners
        for b in corners
        if a < b and sum(x != y for x, y in zip(a, b, strict=True)) == 1
    ]
