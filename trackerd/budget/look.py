"""How every picture looks: one set of colours (Okabe and Ito's, told apart by colour-blind people too), quiet axes, units."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.figure import Figure

from trackerd.contract.errors import TrackerdError

THESIS, METHOD, ADJUSTED, BOUND = "#262626", "#E69F00", "#0072B2", "#009E73"
GIMBALS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00")
CAUSES = ("#56B4E9", "#E69F00", "#D55E00", "#009E73")
INK, QUIET, GRID = "#262626", "#8C8C8C", "#E3E3E3"
HEAT = "viridis"
PIXELS_AN_INCH = 130

_LOOK: Any = {
    "font.size": 9.0,
    "axes.titlesize": 10.0,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": QUIET,
    "axes.labelcolor": INK,
    "axes.grid": True,
    "grid.color": GRID,
    "grid.linewidth": 0.6,
    "axes.axisbelow": True,
    "xtick.color": INK,
    "ytick.color": INK,
    "text.color": INK,
    "legend.frameon": False,
    "legend.fontsize": 8.0,
}


@contextmanager
def page(size_in: tuple[float, float], title: str, words: str = "") -> Iterator[Figure]:
    """A figure to draw on, without pyplot: nothing is kept between pages."""
    with mpl.rc_context(_LOOK):
        figure = Figure(figsize=size_in, dpi=PIXELS_AN_INCH, facecolor="white")
        height = size_in[1]
        figure.text(0.02, 1.0 - 0.12 / height, title, ha="left", va="top", fontsize=13, fontweight="bold")
        figure.text(0.02, 1.0 - 0.40 / height, words, ha="left", va="top", color=QUIET)
        yield figure


def save(figure: Figure, path: Path) -> None:
    """Raises TrackerdError where the file cannot be written."""
    try:
        with mpl.rc_context(_LOOK):
            figure.savefig(path, dpi=PIXELS_AN_INCH)
    except OSError as error:
        raise TrackerdError(f"{path}: cannot be written: {error.strerror or error}") from error
