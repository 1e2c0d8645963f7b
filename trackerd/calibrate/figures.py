"""Figures of a calibration's pages and reports."""

from collections.abc import Iterator
from contextlib import contextmanager

import matplotlib as mpl
from matplotlib.figure import Figure

from trackerd.pictures.look import LOOK

DOTS_AN_INCH = 120


@contextmanager
def look() -> Iterator[None]:
    """What is drawn and written inside has these colours and letters."""
    with mpl.rc_context(LOOK):
        yield


def picture(width_in: float, height_in: float, title: str = "") -> Figure:
    """A figure to draw on, without pyplot: nothing is kept between pictures."""
    figure = Figure(figsize=(width_in, height_in), dpi=DOTS_AN_INCH, facecolor="white", layout="constrained")
    if title:
        figure.suptitle(title, x=0.01, ha="left", fontsize=12, fontweight="bold")
    return figure
