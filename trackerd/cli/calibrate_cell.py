"""`trackerd calibrate cell`: the joint adjustment of all gimbals from a dataset."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from trackerd.calibrate.board_views import board_points, find_board
from trackerd.calibrate.cell import CellResult, Group, Held, Options, Priors, calibrate_cell
from trackerd.calibrate.cell_calibration import calibration_of
from trackerd.calibrate.cell_data import CellData, cell_data
from trackerd.calibrate.cell_report import report
from trackerd.calibrate.cell_words import Rows, summary, thesis_rows
from trackerd.calibrate.cell_worth import RELIABILITY_STEPS, Worth, worth
from trackerd.calibrate.plan.volume import Box
from trackerd.calibrate.shift import shift_between
from trackerd.calibrate.thesis import by_thesis
from trackerd.cli.recorded_cell import is_recording, recorded_dataset
from trackerd.cli.telling import print_rows
from trackerd.contract.errors import ConfigError, TrackerdError, Undetermined
from trackerd.formats.atomic import write_atomically
from trackerd.formats.calibration import Calibration, load_calibration, save_calibration
from trackerd.formats.calibration_store import CalibrationStore
from trackerd.formats.dataset import Dataset, read_dataset
from trackerd.formats.rules import nearest
from trackerd.geometry.gimbal import AxisOrder, Station

AUTO = "auto"


@dataclass(frozen=True, slots=True)
class CellRequest:
    dataset: Path
    output: Path
    report: Path | None = None  # default: beside the output
    order: str | None = None  # auto: found from the data; None: as the dataset says
    signs: str | None = None  # auto, or as in +-
    only: tuple[str, ...] = ()
    free: tuple[str, ...] = ()
    parent: Path | None = None
    force: str = ""
    check_points: tuple[str, ...] | None = None
    method: str = "bundle"
    volume: tuple[tuple[float, ...], tuple[float, ...]] | None = None
    config: Path | None = None  # of a recording: the cell that was recorded
    overrides: Sequence[str] = ()


def cell(request: CellRequest) -> None:
    """Prints the summary, writes the calibration file and the report.

    Raises ConfigError for what a person has to change, Undetermined where the data do not tell it, or chi-square refuses.
    """
    dataset = _dataset(request)
    parent = None if request.parent is None else load_calibration(request.parent)
    data = cell_data(dataset, find_board, board_points, request.check_points)
    for line in data.left_out:
        print(f"note: left out: {line}", file=sys.stderr)
    if request.method == "thesis":
        print_rows("the thesis's method", thesis_rows(by_thesis(data)))
        return
    data = replace(data, nominal=_nominal(request, data.nominal, parent))
    result = calibrate_cell(data.observations, data.targets, data.nominal, _options(request, dataset, data, parent))
    _finish(request, dataset, data, result, parent)


def _dataset(request: CellRequest) -> Dataset:
    if is_recording(request.dataset):
        return recorded_dataset(request.dataset, request.config, request.overrides)
    return read_dataset(request.dataset)


def _finish(request: CellRequest, dataset: Dataset, data: CellData, result: CellResult, parent: Calibration | None) -> None:
    box = None
    if request.volume is not None:
        size, centre = (np.array(part) for part in request.volume)
        box = Box.around(centre, size)
    found = worth(dataset, data, result, box)
    calibration = calibration_of(result, found, dataset, now=datetime.now(UTC), forced_because=request.force, parent=parent)
    rows = summary(dataset, data, result, found, calibration)
    if parent is not None:
        rows += _shift_rows(parent, result, found)
    print_rows(calibration.id, rows)
    for warning in result.warnings:
        print(f"note: {warning}", file=sys.stderr)
    page = request.report or request.output.with_suffix(".html")
    try:
        _keep(request.output, calibration, replace_it=parent is None)
        write_atomically(page, report(data, result, found, calibration, rows, _comparison(data)))
    except OSError as error:
        raise TrackerdError(f"{request.output}: cannot be written: {error.strerror}") from error
    print(f"written: {page}")


def _keep(path: Path, calibration: Calibration, replace_it: bool) -> None:
    """A version of it, and of what was there before; the file itself where nobody has to look at a shift first."""
    store = CalibrationStore(path)
    there = path.exists()
    if there:
        store.keep_active()
    version = store.add(calibration)
    if replace_it or not there:
        save_calibration(calibration, path)
        print(f"written: {path}")
    else:
        print(f"kept as version {version.name}; {path} stays as it is until `trackerd calibration activate {version.name}`")


def _shift_rows(parent: Calibration, result: CellResult, found: Worth) -> Rows:
    moved = shift_between(parent.stations, result.stations, found.box.grid(RELIABILITY_STEPS))
    words = f"targets move by {moved.rms_mm:.4f} mm rms, at most {moved.max_mm:.4f} mm, over the volume"
    return [(f"against {parent.id}", words)]


def _comparison(data: CellData) -> list[tuple[str, Rows]]:
    """The thesis's method on the same data, where these are fit for it."""
    try:
        return [("The same data by the source thesis's method (mean ± sd over the views)", thesis_rows(by_thesis(data)))]
    except Undetermined:
        return []


def _nominal(request: CellRequest, nominal: dict[str, Station], parent: Calibration | None) -> dict[str, Station]:
    stations = {name: _believed(request, station) for name, station in nominal.items()}
    if parent is None:
        return stations
    missing = sorted(set(stations) - set(parent.stations))
    if missing:
        raise ConfigError(f"--parent {request.parent}: has no station {', '.join(missing)}")
    return dict(parent.stations)


def _believed(request: CellRequest, station: Station) -> Station:
    """The station with the axes as the command line has them."""
    if request.order not in (None, AUTO):
        station = replace(station, order=AxisOrder(request.order))
    if request.signs not in (None, AUTO):
        az, el = (1 if sign == "+" else -1 for sign in request.signs or "")
        station = replace(station, az_sign=az, el_sign=el)
    return station


def _options(request: CellRequest, dataset: Dataset, data: CellData, parent: Calibration | None) -> Options:
    free = _free(request, data, parent)
    return Options(
        priors=Priors(**dataset.priors),
        find_axes=AUTO in (request.order, request.signs),
        from_nominal=parent is not None,
        free=free,
        held=None if parent is None or not parent.parameters else Held(parent.parameters, parent.covariance),
        force=bool(request.force),
    )


def _free(request: CellRequest, data: CellData, parent: Calibration | None) -> dict[str, frozenset[Group]] | None:
    if not request.only and not request.free:
        return None
    if parent is None:
        raise ConfigError("--only, --free: need --parent FILE, the calibration that the rest is held to")
    names = request.only or tuple(data.nominal)
    for name in names:
        if name not in data.nominal:
            raise ConfigError(f"--only {name}: the dataset has no gimbal of this name{nearest(name, list(data.nominal))}")
    return {name: frozenset(map(Group, request.free or Group)) for name in names}
