"""A figure of merit over the work volume, as three slices through its depth."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure

from trackerd.calibrate.plan.volume import Box
from trackerd.contract.model import Array
from trackerd.pictures.look import HEAT, INK

SLICES = (0.0, 0.5, 1.0)  # of the depth
WORDS = ("near", "middle", "far")


def draw_slices(figure: Figure | SubFigure, box: Box, steps: int, values: Array, title: str) -> None:
    """`values` (steps^3,) on the box's grid, x and y of each of three slices; one scale for all of them."""
    cube = values.reshape(steps, steps, steps)
    low, high = float(values.min()), float(values.max())
    x, y = (np.linspace(box.low_mm[i], box.high_mm[i], steps) for i in (0, 1))
    levels = np.linspace(low, high if high > low else low + 1e-9, 25)
    panels: Sequence[Axes] = figure.subplots(1, len(SLICES), sharey=True).tolist()
    figure.suptitle(title, x=0.02, ha="left", fontsize=10, fontweight="bold")
    for axes, share, word in zip(panels, SLICES, WORDS, strict=True):
        index = round(share * (steps - 1))
        depth = box.low_mm[2] + share * box.size_mm[2]
        filled = axes.contourf(x, y, cube[:, :, index].T, levels=levels, cmap=HEAT)
        axes.set(aspect="equal", xlabel="x  mm")
        axes.set_title(f"{word}, z = {round(depth)} mm", fontsize=8.5, fontweight="normal")
        axes.invert_yaxis()
        axes.grid(visible=False)
        axes.tick_params(labelsize=7.5)
    panels[0].set_ylabel("y  mm")
    bar = figure.colorbar(filled, ax=panels, pad=0.02, ticks=np.linspace(low, levels[-1], 5), format="%.3g")
    bar.ax.tick_params(labelsize=8, colors=INK)
