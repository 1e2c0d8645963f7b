"""A plan as a picture: where the probe stops, and the error that targets will have over the volume."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from trackerd.calibrate.cell_view import draw_cell, draw_points, draw_tour
from trackerd.calibrate.figures import look, picture
from trackerd.calibrate.plan.predicted import STEPS, Predicted
from trackerd.calibrate.volume_map import draw_slices
from trackerd.formats.looks import Errand
from trackerd.pictures.look import INK, RED, save


def draw(found: Predicted, planned: Sequence[Errand], title: str, path: Path) -> None:
    """Raises TrackerdError where the file cannot be written."""
    with look():
        figure = picture(13.5, 9.6, title)
        grid = figure.add_gridspec(1, 2, width_ratios=(1.0, 1.2))
        left, right = figure.add_subfigure(grid[0]), figure.add_subfigure(grid[1])
        whole, near = left.subplots(2, 1, subplot_kw={"projection": "3d"}, height_ratios=(1.0, 1.25))
        draw_cell(whole, found.stations, found.box)
        draw_cell(near, {}, found.box)
        stops = [errand.stop for errand in planned]
        draw_tour(near, np.array([stop.p_mm for stop in stops]))
        for check, colour, words, marker in ((False, INK, "stop", "o"), (True, RED, "check point", "^")):
            chosen = [stop.p_mm for stop in stops if stop.is_check is check]
            if chosen:
                draw_points(near, np.array(chosen), colour, f"{len(chosen)} {words}s", marker)
        near.legend(loc="upper left")
        left.supxlabel(_wrapped(found.words), x=0.04, ha="left", fontsize=9.5)
        rows = right.add_gridspec(3, 1)
        draw_slices(right.add_subfigure(rows[0]), found.box, STEPS, found.total.depth_mm, "one frame, in depth: U (k = 2), mm")
        draw_slices(right.add_subfigure(rows[1]), found.box, STEPS, found.total.across_mm, "one frame, across: U (k = 2), mm")
        part = found.calibration.depth_mm
        draw_slices(right.add_subfigure(rows[2]), found.box, STEPS, part, "the calibration's part, in depth: U (k = 2), mm")
        save(figure, path)


def _wrapped(words: str) -> str:
    return words.replace(", of it", ",\nof it").replace("; at worst", ";\nat worst")
