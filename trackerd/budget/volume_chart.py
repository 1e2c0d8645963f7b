"""The picture of `trackerd budget --cell`: the cell with its error ellipsoids, what causes them, and where they are large."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d import Axes3D
from mpl_toolkits.mplot3d.art3d import Line3DCollection

from trackerd.budget.contributions import CAUSES, Contributions, u_across_mm, u_depth_mm
from trackerd.budget.look import CAUSES as COLOURS
from trackerd.budget.scene import NAMES, Frame, box_edges, draw_cell, draw_ellipsoids, frame_of, magnification, set_up
from trackerd.budget.settings import Volume
from trackerd.contract.model import Array
from trackerd.geometry.gimbal import Station
from trackerd.pictures.look import HEAT, QUIET

VIEW: Any = {"elev": 22, "azim": -62}


def volume_picture(figure: Figure, stations: Mapping[str, Station], volume: Volume, found: Contributions) -> None:
    """Above: the cell, the volume's ellipsoids, and what they come from; below: U on planes through its middle."""
    frame = frame_of(list(stations.values()), found.p_mm)
    _cell(_solid(figure, (0.0, 0.41, 0.40, 0.50)), frame, stations, volume)
    _ellipsoids(figure, _solid(figure, (0.38, 0.43, 0.30, 0.46)), frame, volume, found)
    _parts(figure.add_axes((0.755, 0.49, 0.175, 0.36)), found)
    _planes(figure, volume, found, frame)


def _solid(figure: Figure, place: tuple[float, float, float, float]) -> Axes3D:
    axes = figure.add_axes(place, projection="3d")
    assert isinstance(axes, Axes3D)
    return axes


def _cell(axes: Axes3D, frame: Frame, stations: Mapping[str, Station], volume: Volume) -> None:
    corners = np.array([corner for edge in _edges(volume) for corner in edge])
    draw_cell(axes, stations, corners, np.array(volume.centre_mm), dots=False)
    _draw_box(axes, frame, volume)
    axes.view_init(**VIEW)


def _ellipsoids(figure: Figure, axes: Axes3D, frame: Frame, volume: Volume, found: Contributions) -> None:
    """On 3 x 3 x 3 of the places, coloured by their 3D sigma."""
    chosen = _spread(volume)
    p_mm, cov = found.p_mm[chosen], found.total_mm2[chosen]
    scale = magnification(p_mm, cov, share=0.24)
    sigmas = np.sqrt(found.total_mm2.trace(axis1=1, axis2=2))
    heat = ScalarMappable(Normalize(float(sigmas.min()), float(sigmas.max())), colormaps[HEAT])
    set_up(axes, frame(p_mm), frame, 0.12 * float(np.ptp(p_mm, axis=0).max()), zoom=0.88)
    _draw_box(axes, frame, volume)
    draw_ellipsoids(axes, frame, p_mm, cov, list(heat.to_rgba(sigmas[chosen])), scale)
    axes.view_init(**VIEW)
    figure.text(0.42, 0.90, "Error ellipsoids", fontweight="bold", fontsize=10)
    figure.text(0.42, 0.875, f"1 sigma, magnified {scale:,.0f} times", color=QUIET)
    bar = figure.colorbar(heat, cax=figure.add_axes((0.42, 0.415, 0.22, 0.012)), orientation="horizontal", ticks=MaxNLocator(5))
    bar.set_label("3D sigma, mm")
    bar.outline.set_visible(False)


def _edges(volume: Volume) -> list[tuple[Array, Array]]:
    return box_edges(np.array(volume.centre_mm), np.array(volume.half_size_mm))


def _draw_box(axes: Axes3D, frame: Frame, volume: Volume) -> None:
    edges = [(frame(a), frame(b)) for a, b in _edges(volume)]
    axes.add_collection3d(Line3DCollection(edges, colors=QUIET, linewidths=0.8))


def _spread(volume: Volume) -> Array:
    """Indices of a 3 x 3 x 3 choice of the grid."""
    steps = volume.steps
    some = np.unique(np.linspace(0, steps - 1, 3).round().astype(int))
    i, j, k = np.meshgrid(some, some, some, indexing="ij")
    return np.asarray((i * steps + j) * steps + k).ravel()


def _parts(axes: Axes, found: Contributions) -> None:
    """Variances add up, so the bars are shares of them; the number at the end is 1 sigma or U."""
    labels = ("sigma x", "sigma y", "sigma z", "U across", "U in depth")
    values = np.array([(*part.sigma_mm, part.u_across_mm, part.u_depth_mm) for part in found.parts])
    shares = values[:-1] ** 2 / (values[:-1] ** 2).sum(axis=0)
    places = np.arange(len(labels))[::-1]
    left = np.zeros(len(labels))
    for name, share, colour in zip(CAUSES, shares, COLOURS, strict=True):
        axes.barh(places, share, left=left, color=colour, label=name, height=0.62)
        left += share
    for place, value in zip(places, values[-1], strict=True):
        axes.annotate(f"{value:.4f}", (1.03, place), va="center", annotation_clip=False)
    axes.set(yticks=places, yticklabels=labels, xlim=(0.0, 1.0), xlabel="share of the variance over the volume")
    axes.set_title("What it comes from", pad=30)
    axes.grid(visible=False, axis="y")
    axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2, borderaxespad=0.1, handlelength=1.0, columnspacing=0.8)
    axes.annotate("mm", (1.03, len(labels) - 0.45), annotation_clip=False, color=QUIET)


def _planes(figure: Figure, volume: Volume, found: Contributions, frame: Frame) -> None:
    """U in depth and across, each on the level plane and on the one square to the view."""
    level, depth, up = frame.axes
    places = iter(np.linspace(0.055, 0.785, 4))
    for words, measure_mm in (("U in depth", u_depth_mm), ("U across", u_across_mm)):
        cube = measure_mm(found.total_mm2, found.depth).reshape((volume.steps,) * 3)
        for right, upward, fixed in ((level, depth, up), (level, up, depth)):
            axes = figure.add_axes((float(next(places)), 0.06, 0.155, 0.25))
            _heat(figure, axes, volume, np.take(cube, volume.steps // 2, axis=fixed), (right, upward))
            axes.set_title(f"{words}, mm, at {NAMES[fixed]} = {volume.centre_mm[fixed]:g}")
            if upward == up and frame.mirrored:
                axes.invert_yaxis()


def _heat(figure: Figure, axes: Axes, volume: Volume, plane: Array, cut: tuple[int, int]) -> None:
    """A plane of the grid, whose two axes are in W's order."""
    right, upward = cut
    x, y = (
        np.linspace(volume.centre_mm[n] - volume.half_size_mm[n], volume.centre_mm[n] + volume.half_size_mm[n], volume.steps)
        for n in (right, upward)
    )
    shown = plane.T if right < upward else plane
    filled = axes.pcolormesh(x, y, shown, cmap=HEAT, shading="gouraud")
    axes.contour(x, y, shown, levels=6, colors="white", linewidths=0.6, alpha=0.7)
    axes.set(xlabel=f"{NAMES[right]}, mm", ylabel=f"{NAMES[upward]}, mm", aspect="equal")
    axes.grid(visible=False)
    bar = figure.colorbar(filled, ax=axes, fraction=0.05, pad=0.07, ticks=MaxNLocator(5))
    bar.outline.set_visible(False)
    bar.ax.tick_params(labelsize=7)
