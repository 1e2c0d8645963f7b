"""One picture of it all: k by category, ours and the peers, against what is to be reached."""

from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")

import numpy as np
from accuracy import Judged
from limits import LIMITS
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from peers import PEERS

MARKERS = "sD^v<>P"
FAILING = 0.2  # share of failures from which a peer's mark is hollow: its k speaks of the easy frames alone
OURS, REACH, STRETCH = "#c0392b", "#2c3e50", "#7f8c8d"


def draw(judged: list[Judged], file: Path) -> None:
    """PNG, SVG or whatever else the file's name ends in."""
    figure, axes = plt.subplots(figsize=(11.0, 0.42 * len(judged) + 2.2), layout="constrained")
    for row, one in enumerate(judged):
        _row(axes, row, one)
    for name, (marker, colour) in _looks().items():
        axes.plot([], [], marker, color=colour, markersize=5, linestyle="none", label=name)
    axes.plot([], [], "o", color=OURS, markersize=9, linestyle="none", label="ours")
    axes.plot([], [], "|", color=REACH, markersize=9, markeredgewidth=2.5, linestyle="none", label="to reach")
    axes.plot([], [], "|", color=STRETCH, markersize=9, markeredgewidth=1.2, linestyle="none", label="stretch")
    axes.set_yticks(range(len(judged)), [f"{one.category} ({one.ours.frames})" for one in judged])
    axes.set_ylim(len(judged) - 0.5, -0.5)
    axes.set_xscale("log")
    axes.axvline(1.0, color="black", linewidth=0.8)
    axes.grid(visible=True, axis="x", which="both", alpha=0.25)
    axes.set_xlabel("k: rms error of x and y over the Cramér-Rao bound of each frame (1 is perfect)")
    axes.set_title(f"Frames in brackets; hollow: fails in more than {100 * FAILING:.0f} % of the frames", fontsize=9)
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=8, frameon=False)
    file.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(file, dpi=130)
    plt.close(figure)


def _row(axes: Axes, row: int, one: Judged) -> None:
    axes.axhspan(row - 0.5, row + 0.5, color="#f4f4f4" if row % 2 else "white", zorder=0)
    for limit in LIMITS[one.category]:
        if limit.quantity in {"k", "direction k"}:
            for value, colour, width in ((limit.reach, REACH, 2.5), (limit.stretch, STRETCH, 1.2)):
                if value is not None and np.isfinite(value):
                    axes.plot(value, row, "|", color=colour, markersize=17, markeredgewidth=width, zorder=2)
    for name, (marker, colour) in _looks().items():
        score = one.peers[name]
        if score.errors_px:
            failing = score.failures > FAILING * score.frames
            axes.plot(score.k, row, marker, color=colour, markersize=5, fillstyle="none" if failing else "full", zorder=3)
    if one.ours.errors_px:
        axes.plot(one.ours.k, row, "o", color=OURS, markersize=9, zorder=4)


def _looks() -> dict[str, tuple[str, str]]:
    """Marker and colour of each peer."""
    colours = plt.get_cmap("tab10").colors  # type: ignore[attr-defined]
    return {name: (MARKERS[n], colours[(0, 1, 2, 4, 5, 6, 9)[n]]) for n, name in enumerate(PEERS)}
