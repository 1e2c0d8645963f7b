"""What the pages of a budget have in common."""

from collections.abc import Iterator
from contextlib import contextmanager

import matplotlib as mpl
from matplotlib.figure import Figure

from trackerd.pictures.look import BLUE, GREEN, INK, LOOK, ORANGE, QUIET, SKY, VERMILION

THESIS, METHOD, ADJUSTED, BOUND = INK, ORANGE, BLUE, GREEN
CAUSES = (SKY, ORANGE, VERMILION, GREEN)
PIXELS_AN_INCH = 130


@contextmanager
def page(size_in: tuple[float, float], title: str, words: str = "") -> Iterator[Figure]:
    """A figure to draw on, without pyplot: nothing is kept between pages."""
    with mpl.rc_context(LOOK):
        figure = Figure(figsize=size_in, dpi=PIXELS_AN_INCH, facecolor="white")
        height = size_in[1]
        figure.text(0.02, 1.0 - 0.12 / height, title, ha="left", va="top", fontsize=13, fontweight="bold")
        figure.text(0.02, 1.0 - 0.40 / height, words, ha="left", va="top", color=QUIET)
        yield figure
