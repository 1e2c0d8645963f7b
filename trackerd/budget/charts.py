"""Pictures of the Monte-Carlo: each layout with its error ellipsoids, the clouds of both methods, all cases at a glance."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Ellipse
from matplotlib.ticker import FuncFormatter, MaxNLocator, NullFormatter
from mpl_toolkits.mplot3d import Axes3D

from trackerd.budget.look import ADJUSTED, BOUND, METHOD, THESIS
from trackerd.budget.scene import NAMES, Frame, draw_cell, draw_ellipsoids, draw_stems, frame_of, magnification, set_up
from trackerd.budget.settings import BudgetSettings, Case
from trackerd.budget.stage import Stage
from trackerd.budget.summary import Row
from trackerd.budget.trials import CaseRun
from trackerd.contract.model import Array
from trackerd.pictures.look import INK, QUIET

VIEW: Any = {"elev": 22, "azim": -62}
CHI_95_2D = 2.4477  # radius in sigmas of the ellipse that holds 95 % of a plane's normal errors
LEAST_MM = 1e-4  # what a chart shows at least: below it is rounding
CLOUD_DOTS = 1500
PANEL_IN = 4.2  # height of the ellipsoids' panels


def telling_cases(settings: BudgetSettings, layout: str, runs: Sequence[CaseRun]) -> list[CaseRun]:
    """The worst case of each kind of noise: encoders alone, pixels alone, both."""

    def kind(case: Case) -> tuple[bool, bool]:
        return case.encoders_rad > 0.0, case.pixel_3sigma_px > 0.0

    own = [run for run in runs if run.layout == layout]
    worst: dict[tuple[bool, bool], CaseRun] = {}
    for run in own:
        key = kind(settings.case[run.case])
        if any(key) and (key not in worst or _size(run) > _size(worst[key])):
            worst[key] = run
    return list(worst.values())


def layout_picture(figure: Figure, stage: Stage, telling: Sequence[CaseRun]) -> None:
    """The cell, and below it the ellipsoids of each telling case."""
    split = PANEL_IN / figure.get_size_inches()[1] if telling else 0.0
    scene = _solid(figure, (0.06, split, 0.86, 0.97 - split))
    draw_cell(scene, stage.stations, stage.points_mm, stage.points_mm.mean(axis=0))
    scene.view_init(**VIEW)
    for n, run in enumerate(telling):
        left, width = n / len(telling), 1.0 / len(telling)
        panel = _solid(figure, (left + 0.02, 0.03, width - 0.06, split - 0.07))
        words = _ellipsoids(panel, stage, run)
        figure.text(left + 0.03, split - 0.01, f"case {run.case}: bound of the targets", va="top", fontweight="bold")
        figure.text(left + 0.03, split - 0.03, words, va="top", color=QUIET)
        panel.view_init(**VIEW)


def cloud_picture(figure: Figure, stage: Stage, telling: Sequence[CaseRun]) -> None:
    """Errors of the targets seen from above: its method beside the adjustment, each with its own scale."""
    frame = frame_of(list(stage.stations.values()), stage.points_mm)
    panels = figure.subplots(len(telling), 2, squeeze=False)
    height = figure.get_size_inches()[1]
    figure.subplots_adjust(left=0.09, right=0.98, bottom=0.55 / height, top=1.0 - 1.0 / height, wspace=0.22, hspace=0.26)
    for row, run in zip(panels, telling, strict=True):
        cov = np.concatenate([bound.target_mm2 for bound in run.bounds]).mean(axis=0)
        source = [trial.source.target_mm for trial in run.trials if trial.source]
        adjusted = [trial.adjusted.target_mm for trial in run.trials if trial.adjusted]
        for axes, errors, colour, words in (
            (row[0], source, METHOD, "thesis's method"),
            (row[1], adjusted, ADJUSTED, "bundle adjustment"),
        ):
            _cloud(axes, frame, np.array(errors).reshape(-1, 3), cov, colour)
            axes.set_title(f"case {run.case}, {words}")


def overview(figure: Figure, settings: BudgetSettings, rows: Sequence[Row]) -> None:
    """d of the measured position by case, one panel a layout, logarithmic."""
    layouts = list(settings.layout)
    panels = figure.subplots(1, len(layouts), squeeze=False, sharey=True)[0]
    figure.subplots_adjust(left=0.07, right=0.98, bottom=0.15, top=0.83, wspace=0.06)
    for axes, layout in zip(panels, layouts, strict=True):
        own = [row for row in rows if row.layout == layout and row.value == "d" and row.table in ("4.4", "4.7", "position")]
        _columns(axes, own)
        axes.set_title(layout)
    panels[0].set_ylabel("d, mm: norm of the three mean errors")
    figure.legend(handles=_legend(), loc="lower center", ncols=4, bbox_to_anchor=(0.5, 0.0))


def _columns(axes: Axes, rows: Sequence[Row]) -> None:
    x = np.arange(len(rows))
    for n, row in enumerate(rows):
        if row.method and row.adjusted:
            span = (max(row.adjusted, LEAST_MM), max(row.method, LEAST_MM))
            axes.plot((n, n), span, color="#D8D8D8", lw=5.0, zorder=1)
        if row.bound is not None:
            axes.plot((n - 0.3, n + 0.3), (max(row.bound, LEAST_MM),) * 2, color=BOUND, lw=2.0, zorder=2)
    for name, colour, mark in (("method", METHOD, "s"), ("adjusted", ADJUSTED, "o")):
        values = np.array([getattr(row, name) or np.nan for row in rows], float)
        axes.plot(x, np.maximum(values, LEAST_MM), mark, color=colour, ms=7, mec="white", mew=0.8, zorder=3)
    printed = np.array([row.source or np.nan for row in rows], float)
    least = min([value for row in rows for value in (row.method, row.adjusted, row.bound) if value], default=LEAST_MM)
    axes.plot(x, printed, "_", color=THESIS, ms=17, mew=1.8, zorder=4)
    axes.set(yscale="log", xticks=x, xlim=(-0.6, len(rows) - 0.4), ylim=(0.6 * max(least, LEAST_MM), None), xlabel="case")
    axes.set_xticklabels([row.case for row in rows])
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.grid(visible=False, axis="x")


def _legend() -> list[Line2D]:
    return [
        Line2D([], [], marker="_", ls="", color=THESIS, ms=14, mew=1.8, label="printed in the thesis"),
        Line2D([], [], marker="s", ls="", color=METHOD, ms=7, label="its method reproduced"),
        Line2D([], [], marker="o", ls="", color=ADJUSTED, ms=7, label="bundle adjustment"),
        Line2D([], [], color=BOUND, lw=2.0, label="Cramér-Rao bound"),
    ]


def _solid(figure: Figure, place: tuple[float, float, float, float]) -> Axes3D:
    axes = figure.add_axes(place, projection="3d")
    assert isinstance(axes, Axes3D)
    return axes


def _ellipsoids(axes: Axes3D, stage: Stage, run: CaseRun) -> str:
    """Draws them; what they are, in words."""
    cov = run.bounds[0].target_mm2
    frame = frame_of(list(stage.stations.values()), stage.points_mm)
    scale = magnification(stage.points_mm, cov)
    shown = frame(stage.points_mm)
    set_up(axes, shown, frame, 0.12 * float(np.ptp(shown, axis=0).max()), zoom=0.95)
    draw_stems(axes, shown, axes.get_zlim()[0])
    draw_ellipsoids(axes, frame, stage.points_mm, cov, [BOUND] * len(cov), scale)
    rms_mm = np.sqrt(cov.trace(axis1=1, axis2=2).mean())
    return f"1 sigma, magnified {scale:,.0f} times; 3D rms {rms_mm:.3g} mm"


def _cloud(axes: Axes, frame: Frame, errors: Array, cov: Array, colour: str) -> None:
    """Across and in depth, with the 95 % ellipse of the bound's mean covariance."""
    level, depth = frame.axes[0], frame.axes[1]
    thin = errors[:: max(len(errors) // CLOUD_DOTS, 1)]
    axes.axhline(0.0, color=QUIET, lw=0.6)
    axes.axvline(0.0, color=QUIET, lw=0.6)
    axes.plot(thin[:, level], thin[:, depth], ".", color=colour, ms=5.0, alpha=0.5, mew=0.0)
    part = cov[np.ix_((level, depth), (level, depth))]
    values, vectors = np.linalg.eigh(part)
    wide, high = (2.0 * CHI_95_2D * np.sqrt(values)).tolist()
    turn = float(np.degrees(np.arctan2(vectors[1, 0], vectors[0, 0])))
    axes.add_patch(Ellipse((0.0, 0.0), wide, high, angle=turn, fill=False, ec=BOUND, lw=1.8, zorder=4))
    reach = 1.15 * max(float(np.quantile(np.abs(thin[:, (level, depth)]), 0.998)), high / 2.0, wide / 2.0) if len(thin) else 1.0
    axes.set(xlim=(-reach, reach), ylim=(-reach, reach))
    axes.set_box_aspect(1.0)
    axes.xaxis.set_major_locator(MaxNLocator(6))
    axes.yaxis.set_major_locator(MaxNLocator(6))
    axes.set(xlabel=f"error in {NAMES[level]}, mm", ylabel=f"error in depth ({NAMES[depth]}), mm")
    rms_mm = float(np.sqrt((errors**2).sum(axis=1).mean())) if len(errors) else np.nan
    axes.annotate(f"3D rms {rms_mm:.3g} mm", (0.03, 0.96), xycoords="axes fraction", va="top", color=INK)


def _size(run: CaseRun) -> float:
    return max(float(bound.target_mm2.trace(axis1=1, axis2=2).max()) for bound in run.bounds)
