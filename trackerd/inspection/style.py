"""What the pages of an inspection have in common: what each colour means, axes, ticks, images."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from trackerd.contract.model import Image
from trackerd.pictures.look import BLUE, GREEN, LOOK, ORANGE, PURPLE, QUIET, RED, VERMILION

FITTED, INSIDE, OUTSIDE, REJECTED = BLUE, VERMILION, GREEN, RED
X, Y, R = BLUE, ORANGE, GREEN
GUESS = PURPLE
WEIGHTS = "viridis"
ENDINGS = (".png", ".svg", ".pdf")
PIXELS_AN_INCH = 100  # of a page; the 100 x magnified pixel has its name from it
LINE_IN = 0.2  # from one line of a table to the next
SECTOR_TICKS = (0, 90, 180, 270, 360)


@contextmanager
def page(size_in: tuple[float, float], title: str) -> Iterator[Figure]:
    """A figure to draw on, without pyplot: nothing is kept between pages."""
    with mpl.rc_context(LOOK):
        figure = Figure(figsize=size_in, dpi=PIXELS_AN_INCH, facecolor="white")
        figure.suptitle(title, x=0.02, y=0.985, ha="left", va="top", fontsize=13, fontweight="bold")
        yield figure


def show(axes: Axes, image: Image, least_dn: float, most_dn: float) -> None:
    """An image in its own pixel coordinates, y down, from black to white."""
    height, width = image.shape
    axes.imshow(image, cmap="gray", vmin=least_dn, vmax=max(most_dn, least_dn + 1.0), interpolation="nearest")
    axes.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5))
    axes.grid(visible=False)
    bare(axes)


def bare(axes: Axes) -> None:
    """No frame, no ticks."""
    axes.set(xticks=(), yticks=())
    for spine in axes.spines.values():
        spine.set_visible(False)


def stretch(image: Image) -> tuple[float, float]:
    """Grey levels to draw as black and white: all but a few pixels lie between them."""
    least, most = np.percentile(image[:: max(image.shape[0] // 500, 1), :: max(image.shape[1] // 500, 1)], (0.2, 99.8)).tolist()
    return least, most


def table(axes: Axes, rows: Sequence[tuple[str, str]], width: int = 44, column: float = 0.30) -> None:
    """Names and words, one below the other; words that are longer than `width` are broken, and begin at `column`."""
    bare(axes)
    lines = [(name if n == 0 else "", part) for name, words in rows for n, part in enumerate(_broken(words, width))]
    assert axes.figure is not None
    height_in = axes.get_position().height * axes.figure.get_size_inches()[1]  # type: ignore[union-attr]
    step = min(1.0 / max(len(lines), 1), LINE_IN / height_in)
    for n, (name, words) in enumerate(lines):
        y = 1.0 - (n + 0.5) * step
        axes.text(0.0, y, name, transform=axes.transAxes, va="center", color=QUIET)
        axes.text(column, y, words, transform=axes.transAxes, va="center")


def plain_ticks(*logarithmic: Axis) -> None:
    """0.5, 1, 2, 5 instead of powers of ten."""
    for axis in logarithmic:
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.set_minor_formatter(NullFormatter())


def unit(spread_px: float) -> tuple[float, str]:
    """Factor and name of the unit that a spread is best told in."""
    return (1e3, "10⁻³ px") if spread_px < 0.2 else (1.0, "px")


def _broken(words: str, width: int) -> list[str]:
    lines = [""]
    for word in words.split():
        if lines[-1] and len(lines[-1]) + 1 + len(word) > width:
            lines.append("")
        lines[-1] = f"{lines[-1]} {word}".strip()
    return lines
