"""The sweep, drawn: how far the encoder is ahead of the image against the speed, before and after the latency is taken out."""

from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from trackerd.calibrate.latency import Latency
from trackerd.calibrate.latency_refusals import ARCSEC, AXES
from trackerd.calibrate.photon_plot import LOOK, MEASURED, PIXELS_AN_INCH, TOTAL
from trackerd.contract.errors import TrackerdError


def draw(found: Latency, title: str, path: Path) -> None:
    """Writes the plot, in the format of the path's ending. Raises TrackerdError where the file cannot be written."""
    date: dict[str, Any] = {"metadata": {"Date": None}} if path.suffix.lower() == ".svg" else {}
    with mpl.rc_context(LOOK):
        figure = Figure(figsize=(8.6, 6.4), dpi=PIXELS_AN_INCH, facecolor="white", layout="constrained")
        figure.suptitle(f"{title}\n{_figures(found)}", x=0.02, ha="left", fontsize=11)
        columns = figure.subplots(2, 2, sharex="col", sharey="row", height_ratios=(3, 2))
        for axis in range(2):
            _before(columns[0, axis], found, axis)
            _after(columns[1, axis], found, axis)
        columns[0, 0].set_ylabel("encoder − image, arcsec")
        columns[1, 0].set_ylabel("without the latency, arcsec")
        try:
            figure.savefig(path, **date)
        except OSError as error:
            raise TrackerdError(f"{path}: cannot be written: {error.strerror or error}") from error


def _figures(found: Latency) -> str:
    parts = (f"{name} {late:+.1f} ± {sigma:.1f} µs" for name, late, sigma in _each(found))
    return f"{', '.join(parts)}, together {found.common_s * 1e6:+.1f} ± {found.common_sigma_s * 1e6:.1f} µs"


def _each(found: Latency) -> list[tuple[str, float, float]]:
    late, sigma = found.offset_s * 1e6, found.sigma_s * 1e6
    return [(name, float(late[i]), float(sigma[i])) for i, name in enumerate(AXES)]


def _before(axes: Axes, found: Latency, axis: int) -> None:
    speed = found.rates_rad_s[:, axis]
    ends = np.array((speed.min(), speed.max()))
    line = ends * found.offset_s[axis] / ARCSEC
    axes.axhline(0.0, color="#8C8C8C", lw=0.8)
    axes.plot(np.degrees(speed), found.before_rad[:, axis] / ARCSEC, "o", ms=2.5, color=MEASURED, label="a frame")
    axes.plot(np.degrees(ends), line, color=TOTAL, lw=1.5, label=f"speed × {found.offset_s[axis] * 1e6:.1f} µs")
    axes.set_title(f"{AXES[axis]} axis", loc="left", fontsize=10, fontweight="bold")
    axes.legend(loc="upper left")


def _after(axes: Axes, found: Latency, axis: int) -> None:
    """With the mean of each tenth of the frames by speed: a bend is hysteresis or smear."""
    speed, left = found.rates_rad_s[:, axis], found.after_rad[:, axis] / ARCSEC
    groups = np.array_split(np.argsort(speed), 10)
    mean = [float(left[group].mean()) for group in groups]
    sigma = [float(left[group].std(ddof=1) / np.sqrt(len(group))) for group in groups]
    axes.axhline(0.0, color=TOTAL, lw=1.5)
    axes.plot(np.degrees(speed), left, "o", ms=2.5, color=MEASURED, alpha=0.35)
    middle = [float(np.degrees(speed[group].mean())) for group in groups]
    axes.errorbar(middle, mean, sigma, fmt="s", ms=4.0, lw=1.0, color="#D55E00", label="mean of a tenth, ± 1 σ")
    axes.margins(y=0.25)  # room for the legend
    axes.set_xlabel("speed, deg/s")
    axes.legend(loc="upper left")
