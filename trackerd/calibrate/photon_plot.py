"""The photon transfer curve, drawn: variance against level with its parts, and how far each point is off the line."""

from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from trackerd.calibrate.noise import CameraNoise
from trackerd.contract.errors import TrackerdError

ENDINGS = (".svg", ".png", ".pdf")
MEASURED, TOTAL, PHOTONS, READ, ROUNDING = "#262626", "#0072B2", "#E69F00", "#009E73", "#8C8C8C"  # Okabe and Ito's
PIXELS_AN_INCH = 120

LOOK: Any = {
    "font.size": 9.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": ROUNDING,
    "axes.grid": True,
    "grid.color": "#E3E3E3",
    "grid.linewidth": 0.6,
    "axes.axisbelow": True,
    "legend.frameon": False,
    "svg.fonttype": "none",
    "svg.hashsalt": "trackerd",  # equal plots are equal files
}


def draw(noise: CameraNoise, title: str, path: Path) -> None:
    """Writes the plot, in the format of the path's ending. Raises TrackerdError where the file cannot be written."""
    date: dict[str, Any] = {"metadata": {"Date": None}} if path.suffix.lower() == ".svg" else {}
    with mpl.rc_context(LOOK):
        figure = Figure(figsize=(7.2, 6.4), dpi=PIXELS_AN_INCH, facecolor="white", layout="constrained")
        figure.suptitle(f"{title}\n{_figures(noise)}", x=0.02, ha="left", fontsize=11)
        curve, residuals = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
        _curve(curve, noise)
        _residuals(residuals, noise)
        try:
            figure.savefig(path, **date)
        except OSError as error:
            raise TrackerdError(f"{path}: cannot be written: {error.strerror or error}") from error


def _figures(noise: CameraNoise) -> str:
    below = noise.read_below_e
    read = f"{noise.read_noise_e:.2f} ± {noise.read_sigma_e:.2f} e⁻" if below is None else f"below {below:.1f} e⁻ (95 %)"
    chi2 = f"χ² {noise.line.chi2:.0f} of {noise.line.freedom}"
    return f"gain {noise.gain_e_per_dn:.3f} ± {noise.gain_sigma_e_per_dn:.3f} e⁻/DN, read noise {read}, {chi2}"


def _curve(axes: Axes, noise: CameraNoise) -> None:
    """Variances, because they add up: what each part gives is what lies between two lines."""
    points, line, rounding = noise.points, noise.line, noise.rounding_dn2
    level = np.linspace(0.0, 1.05 * max(points.level_dn[-1], noise.saturation_dn or 0.0), 200)
    read = rounding + max(line.intercept_dn2, 0.0)
    total = np.maximum(line.variance_dn2(level) + rounding, 0.0)
    axes.fill_between(level, 0.0, rounding, color=ROUNDING, alpha=0.6, lw=0.0, label="rounding")
    axes.fill_between(level, rounding, read, color=READ, alpha=0.6, lw=0.0, label="read noise")
    axes.fill_between(level, read, np.maximum(total, read), color=PHOTONS, alpha=0.25, lw=0.0, label="photons: level / gain")
    axes.plot(level, total, color=TOTAL, lw=1.5, label="all together, fitted")
    sigma = points.sigma_dn2(line.variance_dn2(points.level_dn))
    measured: Any = {"fmt": "o", "ms": 3.5, "lw": 1.0, "color": MEASURED, "label": "measured, ± 1 σ"}
    axes.errorbar(points.level_dn, points.variance_dn2 + rounding, sigma, **measured)
    axes.set(ylabel="variance of a pixel, DN²", ylim=(0.0, 1.05 * float(total[-1])), xlim=(0.0, level[-1]))
    if noise.saturation_dn is not None:
        axes.axvline(noise.saturation_dn, color=MEASURED, lw=1.0, ls=":")
        axes.annotate("saturation ", (noise.saturation_dn, 0.02 * total[-1]), ha="right", rotation=90, va="bottom")
    axes.legend(loc="upper left", reverse=True)


def _residuals(axes: Axes, noise: CameraNoise) -> None:
    points = noise.points
    expected = noise.line.variance_dn2(points.level_dn)
    off = (points.variance_dn2 - expected) / points.sigma_dn2(expected)
    axes.axhspan(-2.0, 2.0, color=TOTAL, alpha=0.08, lw=0.0)
    axes.axhline(0.0, color=TOTAL, lw=1.5)
    axes.plot(points.level_dn, off, "o", ms=3.5, color=MEASURED)
    most = max(3.0, 1.1 * float(np.abs(off).max()))
    axes.set(xlabel="level, DN", ylabel="measured\n− fitted, σ", ylim=(-most, most))
