"""The page of a series: the outline over time, how it scatters, what averaging is good for, what shape is left over."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from trackerd.contract.model import Array
from trackerd.inspection import style
from trackerd.inspection.allan import Allan
from trackerd.inspection.numbers import SCATTER_COLUMNS, Rows, scatter_rows, series_rows
from trackerd.inspection.repeatability import Repeatability, Scatter, positions, stated_sigmas
from trackerd.inspection.series import Sample, Shape, shape
from trackerd.pictures.look import INK, QUIET

SIZE_IN = (16.0, 13.5)
COLOURS = {"x": style.X, "y": style.Y, "r": style.R}
BINS = 31
STATED_BAND = 2.0  # sigmas


def series_page(name: str, series: list[Sample], result: Repeatability) -> Figure:
    """Of at least two frames with a ball."""
    outlines = [sample.outline for sample in series]
    values, sigmas = positions(outlines), stated_sigmas(outlines)
    with style.page(SIZE_IN, name) as figure:
        for row, axis in enumerate("xyr"):
            bottom = 0.795 - 0.158 * row
            time = figure.add_axes((0.06, bottom, 0.72, 0.125))
            beside = figure.add_axes((0.80, bottom, 0.17, 0.125))
            _over_time(time, axis, values[:, row], sigmas[:, row], result.scatter[axis])
            _histogram(beside, time, axis, values[:, row], result.scatter[axis])
            time.tick_params(labelbottom=axis == "r")
        time.set_xlabel(_frame_label(series))
        _allan(figure.add_axes((0.06, 0.06, 0.27, 0.33)), result)
        _shape(figure.add_axes((0.40, 0.27, 0.27, 0.12)), shape(series))
        _plane(figure.add_axes((0.40, 0.06, 0.27, 0.145)), values, result)
        _numbers(figure.add_axes((0.715, 0.04, 0.275, 0.36)), result)
        return figure


def _over_time(axes: Axes, name: str, values: Array, sigmas: Array, scatter: Scatter) -> None:
    factor, unit = style.unit(scatter.peak_to_peak)
    frame, off = np.arange(len(values)), factor * (values - scatter.mean)
    band = STATED_BAND * factor * sigmas
    axes.fill_between(frame, -band, band, color=QUIET, alpha=0.2, linewidth=0, label="±2σ as stated")
    axes.plot(frame, off, ".", color=COLOURS[name], markersize=4 if len(values) < 300 else 2.5)
    if len(values) < 150:
        axes.plot(frame, off, color=COLOURS[name], linewidth=0.6, alpha=0.5)
    missed = np.flatnonzero(~np.isfinite(values))
    if len(missed):
        axes.vlines(
            missed,
            0.0,
            1.0,
            color=style.REJECTED,
            linewidth=0.8,
            alpha=0.6,
            label="missed",
            transform=axes.get_xaxis_transform(),
        )
    limit = 1.12 * float(np.nanmax(np.abs(off), initial=STATED_BAND * 1.2 * factor * scatter.stated))
    axes.set(xlim=(-0.5, len(values) - 0.5), ylim=(-limit, limit), ylabel=f"{name} − mean, {unit}")
    axes.set_title(
        f"{name} = {scatter.mean:.4f} px,  σ {factor * scatter.deviation:.3g} {unit},  stated {factor * scatter.stated:.3g}"
    )
    if name == "x":
        axes.legend(loc="lower right", bbox_to_anchor=(1.0, 0.98), ncols=2, borderpad=0.1)


def _histogram(axes: Axes, beside: Axes, name: str, values: Array, scatter: Scatter) -> None:
    factor, _ = style.unit(scatter.peak_to_peak)
    low, high = beside.get_ylim()
    off = factor * (values[np.isfinite(values)] - scatter.mean)
    bins = np.linspace(low, high, BINS + 1)
    counts, *_ = axes.hist(off, bins=bins.tolist(), orientation="horizontal", color=COLOURS[name], alpha=0.75)
    along = np.linspace(low, high, 300)
    stated = factor * scatter.stated
    bell = np.exp(-0.5 * (along / stated) ** 2) / (stated * np.sqrt(2.0 * np.pi)) * len(off) * (bins[1] - bins[0])
    axes.plot(bell, along, color=INK, linewidth=1.0, label="as stated")
    axes.set(xlim=(0.0, 1.15 * float(np.max(counts))), ylim=(low, high), yticklabels=())
    if name == "x":
        axes.legend(loc="lower right", bbox_to_anchor=(1.0, 0.98), borderpad=0.1)
    if name == "r":
        axes.set_xlabel("frames")


def _allan(axes: Axes, result: Repeatability) -> None:
    """With its 95 % interval, and what white noise of the stated sigma would give."""
    axes.set_title("Allan deviation, 95 % interval")
    longest = max((float(allan.frames[-1]) for allan in result.allan.values() if len(allan.frames)), default=0.0)
    if longest == 0.0:
        axes.text(0.5, 0.5, "no two neighbouring frames with a ball", ha="center", transform=axes.transAxes)
        style.bare(axes)
        return
    factor, unit = style.unit(max(float(allan.deviation.max(initial=0.0)) for allan in result.allan.values()))
    for name, allan in result.allan.items():
        _one_allan(axes, name, allan, factor)
    frames = np.array((1.0, longest))
    stated = factor * result.scatter["x"].stated
    axes.plot(frames, stated / np.sqrt(frames), ":", color=INK, linewidth=1.2, label="white noise as stated (x)")
    axes.set(xscale="log", yscale="log", xlabel="frames averaged", ylabel=unit)
    style.plain_ticks(axes.xaxis, axes.yaxis)
    axes.legend(loc="best")


def _one_allan(axes: Axes, name: str, allan: Allan, factor: float) -> None:
    if len(allan.frames) == 0:
        return
    bars = factor * np.vstack((allan.deviation - allan.low, allan.high - allan.deviation))
    axes.errorbar(allan.frames, factor * allan.deviation, bars, fmt="o-", color=COLOURS[name], markersize=3.5, linewidth=1.1,
                  elinewidth=0.9, capsize=2, label=name)  # fmt: skip
    white = factor * allan.deviation[0] * np.sqrt(allan.frames[0] / allan.frames)
    axes.plot(
        allan.frames, white, "--", color=COLOURS[name], linewidth=0.8, alpha=0.7, label=f"white noise from {name}'s first"
    )


def _shape(axes: Axes, left_over: Shape | None) -> None:
    axes.set_title("Left over by sector, mean of the series ±1σ")
    if left_over is None:
        style.bare(axes)
        return
    factor, unit = style.unit(float(np.nanpercentile(np.abs(left_over.offset_px), 95)))
    axes.axhline(0.0, color=style.FITTED, linewidth=1.0)
    angle = np.degrees(left_over.angle_rad)
    axes.errorbar(angle, factor * left_over.offset_px, factor * left_over.sigma_px, fmt="o", color=INK, markersize=2.5,
                  elinewidth=0.8, ecolor=QUIET)  # fmt: skip
    ticks = style.SECTOR_TICKS
    axes.set(xlim=(0, 360), xticks=ticks, xticklabels=[f"{tick}°" for tick in ticks], ylabel=f"offset, {unit}")


def _plane(axes: Axes, values: Array, result: Repeatability) -> None:
    """The centre in the image plane."""
    x, y = result.scatter["x"], result.scatter["y"]
    factor, unit = style.unit(max(x.peak_to_peak, y.peak_to_peak))
    axes.plot(factor * (values[:, 0] - x.mean), factor * (values[:, 1] - y.mean), ".", color=style.X, markersize=3, alpha=0.6)
    axes.plot(0.0, 0.0, "+", color=INK, markersize=9)
    axes.set_aspect("equal", adjustable="datalim")
    axes.invert_yaxis()
    axes.set(xlabel=f"x − mean, {unit}", ylabel=f"y − mean, {unit}")
    axes.set_title("The centre in the image")


def _numbers(axes: Axes, result: Repeatability) -> None:
    rows: Rows = []
    for cells in scatter_rows(result):
        named = dict(zip(SCATTER_COLUMNS[1:], cells[1:], strict=True))
        rows.append((cells[0], f"{named['mean']} px, σ {named['std. deviation']}"))
        rows.append(("", f"σ is {named['its 95 % interval']} (95 %)"))
        rows.append(("", f"peak to peak {named['peak to peak']}, drift {named['drift over all']}"))
        rows.append(("", f"stated σ {named['stated sigma']}, scatter / stated {named['ratio']}"))
    style.table(axes, [*rows, *series_rows(result)], width=46, column=0.2)


def _frame_label(series: list[Sample]) -> str:
    instants = [sample.t_ns for sample in series if sample.t_ns is not None]
    if len(instants) < 2:
        return "frame"
    return f"frame (one every {(instants[-1] - instants[0]) / (len(instants) - 1) * 1e-6:.2f} ms)"
