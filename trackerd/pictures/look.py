"""How everything drawn looks: one set of colours (Okabe and Ito's, told apart by colour-blind people too), quiet axes."""

from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.figure import Figure

from trackerd.contract.errors import TrackerdError

BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY = "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9"
RED, QUIET, INK, GRID = "#CC3311", "#8C8C8C", "#262626", "#E3E3E3"
STATIONS = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY)  # in their order
HEAT, BOTH_WAYS = "viridis", "RdBu_r"

NAMELESS: dict[str, dict[str, Any]] = {".svg": {"Date": None}, ".png": {"Software": None}}  # equal pages are equal files
LOOK: Any = {
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
    "svg.fonttype": "none",
    "svg.hashsalt": "trackerd",
}


def save(figure: Figure, path: Path) -> None:
    """Raises TrackerdError where the file cannot be written."""
    try:
        with mpl.rc_context(LOOK):
            figure.savefig(path, metadata=NAMELESS.get(path.suffix.lower()))
    except OSError as error:
        raise TrackerdError(f"{path}: cannot be written: {error.strerror or error}") from error
