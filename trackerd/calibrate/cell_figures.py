"""The pictures of a cell's calibration."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from trackerd.calibrate.cell.result import CellResult
from trackerd.calibrate.cell_data import CellData
from trackerd.calibrate.cell_view import draw_cell, draw_ellipsoids, draw_points, scene_mm
from trackerd.calibrate.cell_worth import Worth
from trackerd.calibrate.figures import picture
from trackerd.calibrate.volume_map import draw_slices
from trackerd.contract.model import Array
from trackerd.pictures.look import BOTH_WAYS, INK, QUIET, RED, STATIONS

ARCSEC = 206264.80624709636
ARROWS = 400  # of residuals: more only blacken the page
SHORT = {"world_from_gimbal": "pose", "rg_from_camera": "hand-eye"}


def cell_picture(result: CellResult, worth: Worth) -> Figure:
    """The cell with the error ellipsoids of targets and of the stations' places."""
    figure = picture(12.0, 5.8)
    whole, near = figure.subplots(1, 2, subplot_kw={"projection": "3d"})
    scene = scene_mm(result.stations, worth.box)
    draw_cell(whole, result.stations, worth.box)
    places = np.array([station.world_from_gimbal.translation_mm for station in result.stations.values()])
    covs = np.array([_place_cov(result, name) for name in result.stations])
    known = np.trace(covs, axis1=1, axis2=2) > 0.0
    words = "places held"
    if known.any():
        words = f"places' 1-sigma ellipsoids, × {draw_ellipsoids(whole, places[known], covs[known], STATIONS, scene):.0f}"
    whole.set_title(f"the cell; {words}")
    _volume_picture(near, result, worth)
    return figure


def _volume_picture(axes: Any, result: CellResult, worth: Worth) -> None:
    grid = worth.p_mm.reshape(-1, 3)
    corners = np.flatnonzero((np.isclose(grid, worth.box.low_mm) | np.isclose(grid, worth.box.high_mm)).all(axis=1))
    middle = int(np.argmin(np.linalg.norm(grid - worth.box.centre_mm, axis=1)))
    chosen = [*corners.tolist(), middle]
    draw_cell(axes, {}, worth.box)
    seen = result.points_mm[np.isfinite(result.points_mm).all(axis=1)]
    draw_points(axes, seen[:: max(1, len(seen) // ARROWS)], QUIET, "points of the adjustment")
    if worth.checked is not None:
        draw_points(axes, worth.checked.p_mm, RED, "check points", "^")
    scene = float(worth.box.size_mm.max())
    magnified = draw_ellipsoids(axes, grid[chosen], worth.prediction.total_mm2[chosen], STATIONS[2:3], scene)
    axes.set_title(f"targets in one frame: 1-sigma ellipsoids, × {magnified:.0f}")
    axes.legend(loc="upper left")


def _place_cov(result: CellResult, name: str) -> Array:
    """(3, 3) of a station's place, mm^2; 0 where it is not among the parameters."""
    index = [i for axis in "xyz" for i, p in enumerate(result.parameters) if p == f"{name}.world_from_gimbal.{axis}_mm"]
    return np.asarray(result.covariance[np.ix_(index, index)]) if len(index) == 3 else np.zeros((3, 3))


def error_map(worth: Worth, steps: int) -> Figure:
    figure = picture(8.2, 9.4)
    rows = figure.add_gridspec(3, 1)
    titles = (
        ("a target in one frame, in depth: U (k = 2), mm", worth.total.depth_mm),
        ("a target in one frame, across: U (k = 2), mm", worth.total.across_mm),
        ("the calibration's part, in depth: U (k = 2), mm", worth.calibration.depth_mm),
    )
    for row, (title, values) in enumerate(titles):
        draw_slices(figure.add_subfigure(rows[row]), worth.box, steps, values, title)
    return figure


def residual_picture(data: CellData, result: CellResult, gimbal: str) -> Figure:
    """Of one gimbal: over the sensor, as a histogram, and against both angles."""
    o, residuals = data.observations, result.residuals
    index = o.gimbals.index(gimbal)
    mine = o.gimbal[o.view] == index
    used, left_out = mine & residuals.used, mine & ~residuals.used
    colour = STATIONS[index % len(STATIONS)]
    figure = picture(12.0, 6.4, gimbal)
    top, bottom = figure.subplots(2, 3)
    _field(top[0], o.q_px[used], residuals.px[used], result.stations[gimbal].lens.sensor_px, colour)
    if left_out.any():
        top[0].plot(*o.q_px[left_out].T, "x", color=RED, markersize=5, label=f"{int(left_out.sum())} left out")
        top[0].legend(loc="upper right")
    _histogram(top[1], residuals.whitened[used].ravel(), colour)
    angles = np.degrees(o.angles_rad[o.view[used]])
    _against(top[2], angles[:, 0], residuals.whitened[used], "az, encoder  °", colour)
    _against(bottom[2], angles[:, 1], residuals.whitened[used], "el, encoder  °", colour)
    views = (o.gimbal == index) & residuals.used_view
    _corrections(bottom[0], o.angles_rad[views, 0], residuals.encoder_rad[views, 0], "az", colour)
    _corrections(bottom[1], o.angles_rad[views, 1], residuals.encoder_rad[views, 1], "el", colour)
    return figure


def _field(axes: Axes, q_px: Array, residual_px: Array, sensor_px: tuple[int, int], colour: str) -> None:
    step = max(1, len(q_px) // ARROWS)
    q, r = q_px[::step], residual_px[::step]
    rms = float(np.sqrt((residual_px**2).sum(axis=1).mean())) if len(q_px) else 0.0
    axes.quiver(*q.T, *r.T, color=colour, angles="xy", scale_units="xy", scale=max(rms, 1e-9) / 80.0, width=0.003)
    axes.set(xlim=(-0.5, sensor_px[0] - 0.5), ylim=(sensor_px[1] - 0.5, -0.5), aspect="equal", xlabel="u  px", ylabel="v  px")
    axes.set_title(f"residuals on the sensor: {rms:.3f} px rms")


def _histogram(axes: Axes, whitened: Array, colour: str) -> None:
    bins = np.linspace(-5.0, 5.0, 41).tolist()
    axes.hist(whitened, bins=bins, density=True, color=colour, alpha=0.7)
    x = np.linspace(-5.0, 5.0, 200)
    axes.plot(x, np.exp(-0.5 * x * x) / np.sqrt(2.0 * np.pi), color=INK, linewidth=1.2, label="as the noise says")
    axes.set(xlabel="residual / its sigma", title=f"scatter {float(np.std(whitened)):.2f} of its sigma")
    axes.legend(loc="upper right")


def _against(axes: Axes, angle_deg: Array, whitened: Array, label: str, colour: str) -> None:
    for column, marker, name in ((0, "o", "u"), (1, "^", "v")):
        axes.plot(angle_deg, whitened[:, column], marker, color=colour, markersize=2.5, alpha=0.5, label=name)
    axes.axhline(0.0, color=QUIET, linewidth=0.8)
    axes.set(xlabel=label, ylabel="residual / its sigma", ylim=(-5.0, 5.0), title="residuals against the angle")
    axes.legend(loc="upper right")


def _corrections(axes: Axes, angle_rad: Array, correction_rad: Array, name: str, colour: str) -> None:
    values = correction_rad * ARCSEC
    axes.plot(np.degrees(angle_rad), values, "o", color=colour, markersize=2.5, alpha=0.6)
    axes.axhline(0.0, color=QUIET, linewidth=0.8)
    axes.set(xlabel=f"{name}, encoder  °", ylabel="correction  ″", title=f"{name}: {float(np.std(values)):.2f}″ rms")


def correlation_picture(result: CellResult) -> Figure:
    """Of all parameters that are not held, in the file's order."""
    sigma = np.sqrt(np.diag(result.covariance))
    free = np.flatnonzero(sigma > 0.0)
    correlation = result.covariance[np.ix_(free, free)] / np.outer(sigma[free], sigma[free])
    names = [_short(result.parameters[i]) for i in free]
    size = min(13.0, 3.0 + 0.19 * len(names))
    figure = picture(size + 0.8, size)
    axes = figure.subplots()
    shown = axes.imshow(correlation, cmap=BOTH_WAYS, vmin=-1.0, vmax=1.0, interpolation="nearest")
    axes.set_xticks(range(len(names)), names, rotation=90, fontsize=6.5)
    axes.set_yticks(range(len(names)), names, fontsize=6.5)
    axes.grid(visible=False)
    _borders(axes, [result.parameters[i].partition(".")[0] for i in free])
    figure.colorbar(shown, ax=axes, shrink=0.7, label="correlation")
    return figure


def _borders(axes: Axes, stations: Sequence[str]) -> None:
    for i in range(1, len(stations)):
        if stations[i] != stations[i - 1]:
            axes.axhline(i - 0.5, color=INK, linewidth=0.8)
            axes.axvline(i - 0.5, color=INK, linewidth=0.8)


def _short(parameter: str) -> str:
    for long, short in SHORT.items():
        parameter = parameter.replace(long, short)
    return parameter


def check_picture(worth: Worth) -> Figure | None:
    """Errors of the check points with their expanded uncertainty; None: there are none."""
    if worth.checked is None:
        return None
    checked = worth.checked.verification
    figure = picture(9.0, 3.4)
    errors, en = figure.subplots(1, 2, width_ratios=(2.0, 1.0))
    places = np.arange(len(checked.en))
    for axis, (name, colour) in enumerate(zip("xyz", STATIONS, strict=False)):
        errors.plot(places + 0.15 * (axis - 1), 1e3 * checked.error_mm[:, axis], "o", color=colour, label=name, markersize=4)
    errors.axhline(0.0, color=QUIET, linewidth=0.8)
    errors.set_xticks(places, worth.checked.names, rotation=60, fontsize=7)
    errors.set(ylabel="measured − reference  µm", title=f"check points: {1e3 * checked.rms_mm:.1f} µm rms (3D)")
    errors.legend(loc="upper right", ncols=3)
    en.bar(places, checked.en, color=[STATIONS[2] if value <= 1.0 else RED for value in checked.en])
    en.axhline(1.0, color=INK, linewidth=1.0)
    en.set_xticks(places, worth.checked.names, rotation=60, fontsize=7)
    en.set(title="normalised error En (limit 1)")
    return figure
