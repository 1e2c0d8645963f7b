"""`trackerd calibrate capture`: the dataset of a calibration, taken stop by stop."""

import asyncio
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from trackerd.calibrate.plan.looks import Eye
from trackerd.calibrate.plan.make import errands
from trackerd.cli.calibrate_plan import SIGMA_MM
from trackerd.contract.errors import ConfigError
from trackerd.contract.model import Source
from trackerd.formats.config import CellConfig
from trackerd.formats.dataset import Dataset, read_dataset
from trackerd.formats.dataset_file import DatasetFile, flange_text, points_text
from trackerd.formats.dataset_points import FLANGE, POINTS
from trackerd.formats.looks import Errand
from trackerd.formats.mover import Stop, read_program
from trackerd.formats.tables import Tables
from trackerd.service.capture import Told
from trackerd.wiring.capture import CaptureRequest, eyes_of
from trackerd.wiring.capture import capture as run
from trackerd.wiring.cell import load, source_of

START = "start.toml"


@dataclass(frozen=True, slots=True)
class Request:
    config: Path
    overrides: Sequence[str]
    plan: Path
    output: Path
    arm: bool
    frames: int
    deg_s: float
    mover: str
    sigma_mm: float | None


def capture(request: Request) -> None:
    """Raises ConfigError for what a person has to change, DeviceError where a gimbal or the mover fails."""
    cell = load(request.config, request.overrides)
    source = source_of(cell)
    if source is Source.REPLAY:
        raise ConfigError(f"{request.config.name}: is a recording's cell: there is nothing to turn")
    if source is Source.LIVE and not request.arm:
        raise ConfigError("calibrate capture: THE AXES MOVE: see that nobody is near them, then add --arm")
    stops = read_program(request.plan)
    eyes = eyes_of(cell)
    planned = errands(eyes, stops)
    sigma_mm = request.sigma_mm or SIGMA_MM[request.mover]
    dataset = DatasetFile(request.output, _tables(cell, eyes, request.mover, sigma_mm), _files(cell, stops, request.mover))
    with _progress(planned, dataset) as told:
        asyncio.run(run(CaptureRequest(cell, request.overrides, planned, dataset, request.frames, request.deg_s, told)))
    for line in _coverage(read_dataset(request.output), planned):
        print(line)
    print(f"written: {request.output}")


def _coverage(data: Dataset, planned: Sequence[Errand]) -> Iterator[str]:
    """How much of the plan, of the travel and of the image each gimbal has seen, and of the volume all of them."""
    for name, table in data.gimbals.items():
        mine = [point for point in data.image_points if point.gimbal == name]
        asked = sum(len(errand.looks[name]) for errand in planned)
        az, el = np.ptp(np.degrees([(point.az_rad, point.el_rad) for point in mine]), axis=0)
        pixels = np.array([point.q_px for point in mine if point.q_px is not None])
        width, height = np.ptp(pixels, axis=0) / table.sensor_px
        faces = len({point.face for point in mine})
        yield (
            f"{name}: {len(mine)} views of {asked}, {faces} face{'s' if faces > 1 else ''}, az over {az:.1f} deg, el over"
            f" {el:.1f} deg, {width:.0%} x {height:.0%} of the sensor"
        )
    size = np.ptp([errand.stop.p_mm for errand in planned], axis=0)
    yield f"volume: {len(data.points)} stops over {' x '.join(f'{side:.0f}' for side in size)} mm"


def _files(cell: CellConfig, stops: Sequence[Stop], mover: str) -> dict[str, str]:
    files = {POINTS: points_text(stops), START: cell.calibration.read_text(encoding="utf-8")}
    if mover == "robot":
        if any(stop.base_from_tool is None and not stop.is_bar_end for stop in stops):
            raise ConfigError("--mover robot: the program has stops without the tool's turn")
        files[FLANGE] = flange_text(stops)
    return files


def _tables(cell: CellConfig, eyes: Sequence[Eye], mover: str, sigma_mm: float) -> Tables:
    return {
        "format": "trackerd-dataset",
        "version": 1,
        "note": f"captured from {cell.name}",
        "start": START,
        "mover": {"kind": mover, "sigma_mm": sigma_mm},
        "gimbal": {eye.name: _gimbal(cell, eye) for eye in eyes},
    }


def _gimbal(cell: CellConfig, eye: Eye) -> Tables:
    gimbal, station = cell.gimbals[eye.name], eye.station
    return {
        "sensor_px": list(station.lens.sensor_px),
        "focal_px": station.lens.fx_px,
        "lever_mm": station.rg_from_camera.translation_mm.tolist(),
        "order": str(station.order),
        "az_sign": station.az_sign,
        "el_sign": station.el_sign,
        "encoder_sigma_arcsec": gimbal.encoder_sigma_arcsec,
        "encoder_fixed_arcsec": gimbal.encoder_fixed_arcsec,
    }


@contextmanager
def _progress(planned: Sequence[Errand], dataset: DatasetFile) -> Iterator["_Coverage"]:
    """A bar on a terminal, a line a stop elsewhere."""
    total = sum(len(looks) for errand in planned for looks in errand.looks.values())
    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TextColumn("views"), TimeRemainingColumn()
    with Progress(*columns, console=Console(stderr=True), transient=True, disable=not sys.stderr.isatty()) as bar:
        yield _Coverage(bar, bar.add_task("capture", total=total, completed=len(dataset.taken)), not sys.stderr.isatty())


@dataclass(slots=True)
class _Coverage:
    bar: Progress
    task: int
    plain: bool
    last: str = ""

    def __call__(self, told: Told) -> None:
        self.bar.update(self.task, completed=told.done, description=told.stop)  # type: ignore[arg-type]
        if self.plain and told.stop != self.last:
            self.last = told.stop
            print(f"{told.stop}: {told.done} of {told.of} views", file=sys.stderr)
