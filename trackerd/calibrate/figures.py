"""How the pictures of a calibration look: one set of colours (Okabe and Ito's), quiet axes, units in every label."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.figure import Figure

from trackerd.contract.errors import TrackerdError

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")  # of the stations, in their order
GOOD, BAD, QUIET, INK = "#009E73", "#CC3311", "#8C8C8C", "#262626"
HEAT = "viridis"
BOTH_WAYS = "RdBu_r"
DOTS_AN_INCH = 120

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
    "grid.color": "#E3E3E3",
    "grid.linewidth": 0.6,
    "axes.axisbelow": True,
    "xtick.color": INK,
    "ytick.color": INK,
    "text.color": INK,
    "legend.frameon": False,
    "legend.fontsize": 8.0,
    "svg.fonttype": "none",
    "svg.hashsalt": "trackerd",
}


@contextmanager
def look() -> Iterator[None]:
    """What is drawn and written inside has these colours and letters."""
    with mpl.rc_context(_LOOK):
        yield


def picture(width_in: float, height_in: float, title: str = "") -> Figure:
    """A figure to draw on, without pyplot: nothing is kept between pictures."""
    figure = Figure(figsize=(width_in, height_in), dpi=DOTS_AN_INCH, facecolor="white", layout="constrained")
    if title:
        figure.suptitle(title, x=0.01, ha="left", fontsize=12, fontweight="bold")
    return figure


def save(figure: Figure, path: Path) -> None:
    """Raises TrackerdError where the file cannot be written."""
    try:
        figure.savefig(path, metadata={"Software": None})
    except OSError as error:
        raise TrackerdError(f"{path}: cannot be written: {error.strerror or error}") from error
