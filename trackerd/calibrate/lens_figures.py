"""What a lens' calibration looks like: residuals by picture and over the sensor, coverage, distortion."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import cv2
import numpy as np
from matplotlib import colormaps, rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from trackerd.calibrate.lens_judgement import COLUMNS, ROWS
from trackerd.calibrate.lens_result import LensResult
from trackerd.contract.model import Array, Image

INK, FAINT, ACCENT, STRONG = "#1d2733", "#64748b", "#0072B2", "#D55E00"  # Okabe and Ito's
RING, CROSS, X_AXIS, Y_AXIS, LINE = (178, 114, 0), (0, 94, 213), (0, 159, 230), (115, 158, 0), (30, 30, 30)  # BGR
MAGNIFIED = 50  # of a residual in a picture
STYLE: Any = {
    "font.size": 10.0,
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    "axes.edgecolor": "#9aa7b5",
    "axes.labelcolor": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlesize": 11.0,
    "axes.titleweight": "bold",
    "axes.grid": True,
    "grid.color": "#e6ebf0",
    "axes.axisbelow": True,
    "xtick.color": FAINT,
    "ytick.color": FAINT,
    "svg.fonttype": "path",
    "svg.hashsalt": "trackerd",
}
LONGEST_ARROW = 0.06  # of the sensor's width, for the 95 % residual
SHOWN_PX = 720  # width of a picture in the report


def residual_figure(result: LensResult) -> Figure:
    """Scatter of all residuals, and RMS by picture (the source thesis's Fig. 4.5)."""
    with _styled():
        figure = Figure(figsize=(11.0, 4.6), layout="constrained")
        scatter, bars = figure.subplots(1, 2, width_ratios=(1.0, 1.45))
        _scatter(scatter, result)
        _bars(bars, result)
        return figure


def field_figure(result: LensResult) -> Figure:
    """Residuals as arrows over the sensor, magnified; bold, the mean of each cell."""
    with _styled():
        figure = Figure(figsize=(8.6, 6.6), layout="constrained")
        axes = figure.subplots()
        _sensor(axes, result)
        r, q = result.residuals_px, result.views.q_px
        large = float(np.quantile(np.linalg.norm(r, axis=1), 0.95)) or 1.0
        scale = LONGEST_ARROW * result.lens.sensor_px[0] / large
        options: Any = {"angles": "xy", "scale_units": "xy", "scale": 1.0}
        axes.quiver(*q.T, *(r * scale).T, color=ACCENT, alpha=0.55, width=0.0016, headwidth=4, headlength=5, **options)
        places, means = _cell_means(result)
        bold = axes.quiver(*places.T, *(means * scale).T, color=STRONG, width=0.0042, headwidth=3.4, headlength=4, **options)
        unit = _round_down(large)
        axes.quiverkey(bold, 0.84, 1.035, unit * scale, f"{unit:g} px", labelpos="E", coordinates="axes")
        axes.set_title("residuals, measured − projected; orange: mean of a cell", loc="left", pad=14)
        return figure


def coverage_figure(result: LensResult) -> Figure:
    with _styled():
        figure = Figure(figsize=(8.6, 6.6), layout="constrained")
        axes = figure.subplots()
        _sensor(axes, result)
        width, height = result.lens.sensor_px
        cells = np.ma.masked_equal(result.coverage.cells, 0)
        mesh = axes.pcolormesh(
            np.linspace(-0.5, width - 0.5, COLUMNS + 1),
            np.linspace(-0.5, height - 0.5, ROWS + 1),
            cells,
            cmap="Blues",
            vmin=-0.1 * float(result.coverage.cells.max()),
            vmax=2.2 * float(result.coverage.cells.max()),
            edgecolor="white",
            linewidth=1.2,
        )
        mesh.set_zorder(0.5)
        axes.grid(visible=False)
        axes.scatter(result.views.q_px[:, 0], result.views.q_px[:, 1], s=3.0, color=INK, linewidths=0)
        angle = np.linspace(0, 2 * np.pi, 200)
        x, y = (width - 1) / 2, (height - 1) / 2
        radius = result.coverage.radius_px
        axes.plot(x + radius * np.cos(angle), y + radius * np.sin(angle), "--", color=STRONG, lw=1.1)
        axes.plot(result.lens.cx_px, result.lens.cy_px, "+", color=STRONG, ms=14, mew=1.8)
        share = f"{result.coverage.share:.0%} of the cells, out to {result.coverage.radius_share:.0%} of the corner"
        axes.set_title(f"points: {share}; + principal point", loc="left")
        return figure


def distortion_figure(result: LensResult) -> Figure:
    """How far the distortion moves a point outwards, against its undistorted radius, with 2 sigma."""
    with _styled():
        figure = Figure(figsize=(8.6, 4.6), layout="constrained")
        axes = figure.subplots()
        lens, f = result.lens, (result.lens.fx_px + result.lens.fy_px) / 2
        radius = np.linspace(0.0, result.coverage.corner_px, 240)
        x2 = np.square(radius / f)
        slopes = np.stack((radius * x2, radius * x2**2, radius * x2**3))
        shift = np.array(lens.distortion)[[0, 1, 4]] @ slopes
        block = result.covariance[np.ix_((4, 5, 8), (4, 5, 8))]
        sigma = np.sqrt(np.maximum(np.einsum("in,ij,jn->n", slopes, block, slopes), 0.0))
        seen = radius <= result.coverage.radius_px
        axes.fill_between(radius, shift - 2 * sigma, shift + 2 * sigma, color=ACCENT, alpha=0.25, lw=0, label="2 sigma")
        axes.plot(radius[seen], shift[seen], color=ACCENT, lw=2.0, label="radial distortion")
        axes.plot(radius[~seen], shift[~seen], "--", color=ACCENT, lw=1.5, label="where no point was seen")
        axes.axhline(0.0, color=FAINT, lw=0.8)
        axes.set_xlabel("distance from the principal point without distortion, px")
        axes.set_ylabel("shift outwards, px")
        axes.set_xlim(0.0, radius[-1])
        axes.legend(frameon=False, loc="best")
        axes.set_title("distortion", loc="left")
        return figure


def draw_picture(image: Image, result: LensResult, number: int, board_mm: Array) -> Image:
    """Corners (rings), where the model puts them (crosses), the residuals magnified (lines), and the board's axes: x orange, y
    green (the source thesis's Fig. 4.6)."""
    zoom = SHOWN_PX / image.shape[1]
    method = cv2.INTER_AREA if zoom < 1.0 else cv2.INTER_CUBIC
    shown = cv2.cvtColor(cv2.resize(image, None, fx=zoom, fy=zoom, interpolation=method), cv2.COLOR_GRAY2BGR)
    shown = (0.35 * 255 + 0.65 * shown.astype(np.float32)).astype(np.uint8)  # paler, so that the marks stand out
    mine = result.views.view == number
    measured = result.views.q_px[mine]
    _axes(shown, result, number, board_mm, zoom)
    for q, r in zip(measured, result.residuals_px[mine], strict=True):
        x, y = _fixed(q - r, zoom)
        cv2.line(shown, (x, y), _fixed(q - r + MAGNIFIED * r, zoom), LINE, 1, cv2.LINE_AA, 4)
        cv2.circle(shown, _fixed(q, zoom), 5 << 4, RING, 1, cv2.LINE_AA, 4)
        for dx, dy in ((64, 0), (0, 64)):
            cv2.line(shown, (x - dx, y - dy), (x + dx, y + dy), CROSS, 1, cv2.LINE_AA, 4)
    return shown


def _axes(shown: Image, result: LensResult, number: int, board_mm: Array, zoom: float) -> None:
    length = 0.3 * float(np.ptp(board_mm, axis=0).max())
    ends = board_mm[0] + length * np.array(((0, 0, 0), (1, 0, 0), (0, 1, 0)))
    p = ends @ result.estimate.rotation[number].T + result.estimate.translation_mm[number]
    if (p[:, 2] <= 0.0).any():
        return
    origin, *others = (_fixed(result.lens.project(one), zoom) for one in p)
    for end, colour in zip(others, (X_AXIS, Y_AXIS), strict=True):
        cv2.arrowedLine(shown, origin, end, colour, 2, cv2.LINE_AA, 4, 0.1)


def _fixed(q_px: Array, zoom: float) -> tuple[int, int]:
    """In sixteenths of a pixel of the resized picture, whose pixels' centres move with the zoom."""
    x, y = ((q_px + 0.5) * zoom - 0.5) * 16
    return round(float(x)), round(float(y))


@contextmanager
def _styled() -> Iterator[None]:
    with rc_context(STYLE):
        yield


def _scatter(axes: Axes, result: LensResult) -> None:
    r = result.residuals_px
    colours = result.views.view / max(result.views.count - 1, 1)
    axes.scatter(r[:, 0], r[:, 1], c=colours, cmap="turbo", s=9, alpha=0.7, linewidths=0)
    angle = np.linspace(0.0, 2.0 * np.pi, 200)
    for n, width in ((1.0, 1.4), (3.0, 0.9)):
        radius = n * result.sigma_px
        axes.plot(radius * np.cos(angle), radius * np.sin(angle), color=INK, lw=width, ls="-" if n == 1.0 else "--")
    limit = 1.08 * max(float(np.abs(r).max()), 3.0 * result.sigma_px, 1e-6)
    axes.set(xlim=(-limit, limit), ylim=(limit, -limit), aspect="equal", xlabel="x, px", ylabel="y, px (down)")
    axes.set_title("residuals; rings: 1 and 3 sigma", loc="left")


def _bars(axes: Axes, result: LensResult) -> None:
    count = len(result.pictures)
    rms = [picture.rms_px for picture in result.pictures]
    colours = colormaps["turbo"](np.linspace(0.0, 1.0, count))
    axes.bar(range(count), rms, color=colours, width=0.72)
    axes.axhline(result.rms_px, color=INK, lw=1.2, ls="--")
    axes.annotate(
        f"all: {result.rms_px:.3f} px", (count - 0.45, result.rms_px), xytext=(0, 4), textcoords="offset points", ha="right"
    )
    step = -(-count // 32)
    axes.set_xticks(range(0, count, step), [p.name for p in result.pictures][::step], rotation=60, ha="right", fontsize=8.5)
    axes.grid(axis="x", visible=False)
    axes.set_xlim(-0.6, count - 0.4)
    axes.set_ylim(0.0, 1.18 * max(rms))
    axes.set_ylabel("rms, px")
    axes.set_title("rms of each picture", loc="left")


def _sensor(axes: Axes, result: LensResult) -> None:
    width, height = result.lens.sensor_px
    axes.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5), aspect="equal", xlabel="x, px", ylabel="y, px")
    axes.spines[["top", "right"]].set_visible(True)


def _cell_means(result: LensResult) -> tuple[Array, Array]:
    """Middle of the points and mean residual of each cell that has three points or more."""
    size = np.array(result.lens.sensor_px)
    column, row = np.floor((result.views.q_px + 0.5) / size * (COLUMNS, ROWS)).astype(int).T
    cell = np.clip(row, 0, ROWS - 1) * COLUMNS + np.clip(column, 0, COLUMNS - 1)
    chosen = [cell == n for n in range(ROWS * COLUMNS) if np.count_nonzero(cell == n) >= 3]
    places = np.array([result.views.q_px[mask].mean(0) for mask in chosen]).reshape(-1, 2)
    return places, np.array([result.residuals_px[mask].mean(0) for mask in chosen]).reshape(-1, 2)


def _round_down(value: float) -> float:
    """To 1, 2 or 5 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(power * max(n for n in (1.0, 2.0, 5.0) if n * power <= value * (1 + 1e-9)))
