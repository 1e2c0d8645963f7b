"""A recording of the simulated cell, for replay."""

from functools import partial
from pathlib import Path

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeRemainingColumn

from trackerd.contract.errors import TrackerdError
from trackerd.formats.calibration import load_calibration
from trackerd.formats.config import CellConfig
from trackerd.sim.record import record
from trackerd.twin.cell import scene_of


def record_cell(cell: CellConfig, folder: Path, duration_s: float) -> None:
    scene = scene_of(cell, load_calibration(cell.calibration).stations)
    columns = TextColumn("recording"), BarColumn(), MofNCompleteColumn(), TextColumn("frames"), TimeRemainingColumn()
    with Progress(*columns) as bar:
        task = bar.add_task("recording", total=None)
        try:
            frames = record(scene, folder, duration_s, cell.calibration, partial(_advance, bar, task))
        except OSError as error:
            raise TrackerdError(f"{folder}: {error.strerror}") from error
    print(f"{frames} frames in {folder}")


def _advance(bar: Progress, task: TaskID, done: int, total: int) -> None:
    bar.update(task, completed=done, total=total)
