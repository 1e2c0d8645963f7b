"""`trackerd inspect`: what the detector sees, in pictures from files and from a running camera."""

import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from trackerd.contract.errors import ConfigError, TrackerdError
from trackerd.contract.model import Found, Image
from trackerd.formats.config import CellConfig
from trackerd.formats.stills import Stills, read_still, stills
from trackerd.inspection.camera import Camera, camera_of
from trackerd.inspection.detector import detector_for
from trackerd.inspection.examine import examine
from trackerd.inspection.image_page import image_page
from trackerd.inspection.numbers import SCATTER_COLUMNS, Rows, examination_rows, scatter_rows, series_rows
from trackerd.inspection.repeatability import Repeatability, reasons, repeatability
from trackerd.inspection.series import Sample, samples, write_csv
from trackerd.inspection.series_page import series_page
from trackerd.inspection.style import ENDINGS
from trackerd.pictures.look import save
from trackerd.vision.rays import Circle
from trackerd.wiring.cell import load


@dataclass(frozen=True, slots=True)
class Request:
    """What is asked for."""

    path: Path
    out: Path | None = None  # default: NAME.inspect.png in the working folder
    csv: Path | None = None
    guess: Circle | None = None
    station: str | None = None
    config: Path | None = None
    camera: str | None = None
    overrides: Sequence[str] = ()


def inspect(request: Request) -> bool:
    """Writes a page for the picture, the folder, or each station of the recording; False: no ball in any picture.

    Raises ConfigError for what a person has to change, TrackerdError where a file cannot be written.
    """
    if request.out is not None and request.out.suffix.lower() not in ENDINGS:
        raise ConfigError(f"--out {request.out}: must end in {', '.join(ENDINGS)}")
    cell = load(request.config, request.overrides) if request.config is not None else None
    if cell is None and request.camera is not None:
        raise ConfigError(f"--camera {request.camera}: needs --config FILE, the cell that has this camera")
    found = [_inspect_one(request, cell, one, several) for one, several in _chosen(request)]
    return any(found)


def _chosen(request: Request) -> list[tuple[Stills, bool]]:
    """The series to look at, and whether there are several."""
    all_of_them = stills(request.path)
    if request.station is None:
        return [(one, len(all_of_them) > 1) for one in all_of_them]
    chosen = [one for one in all_of_them if one.station == request.station]
    if not chosen:
        names = ", ".join(one.station for one in all_of_them if one.station) or "none: it is no recording"
        raise ConfigError(f"{request.path}: --station {request.station}: there is no such station (there are: {names})")
    return [(one, len(all_of_them) > 1) for one in chosen]


def _inspect_one(request: Request, cell: CellConfig | None, pictures: Stills, several: bool) -> bool:
    for note in pictures.notes:
        print(f"note: {note}", file=sys.stderr)
    camera = None if cell is None else camera_of(cell, request.camera, pictures.station or request.path.resolve().parent.name)
    name = pictures.station if several and pictures.station else None
    page = _page_path(request, name)
    csv = None if request.csv is None else _named(request.csv, name)
    series = list(_located(pictures, request.guess, camera))
    if csv is not None:
        _write_csv(csv, series)
    result = repeatability([sample.outline for sample in series])
    if len(series) == 1 or result is None:
        _picture(request, camera, pictures, series, page)
    else:
        save(series_page(f"{request.path}: {pictures.name}", series, result), page)
        _tell_series(pictures.name, result)
    for written in (page, csv):
        if written is not None:
            print(f"written: {written}")
    found = any(isinstance(sample.outline, Found) for sample in series)
    if not found:
        for reason, count in reasons([sample.outline for sample in series]).items():
            print(f"trackerd: {pictures.name}: no ball in {count} of {len(series)} pictures: {reason}", file=sys.stderr)
    return found


def _picture(request: Request, camera: Camera | None, pictures: Stills, series: list[Sample], page: Path) -> None:
    """The page of one picture: of several, the first with a ball, or else the first."""
    which = next((n for n, sample in enumerate(series) if isinstance(sample.outline, Found)), 0)
    file = pictures.files[which]
    image = read_still(file)
    examination = examine(image, request.guess, detector_for(image, camera), str(file))
    save(image_page(examination), page)
    _tell(file.name, examination_rows(examination))


def _located(pictures: Stills, guess: Circle | None, camera: Camera | None) -> Iterator[Sample]:
    columns = TextColumn(pictures.name), BarColumn(), MofNCompleteColumn(), TextColumn("pictures"), TimeRemainingColumn()
    with Progress(*columns, console=Console(stderr=True), transient=True, disable=not sys.stderr.isatty()) as bar:
        task = bar.add_task("locating", total=pictures.count)
        for sample in samples(_frames(pictures), guess, camera):
            bar.advance(task)
            yield sample


def _frames(pictures: Stills) -> Iterator[tuple[str, int | None, Image]]:
    instants: Sequence[int | None] = pictures.instants_ns or (None,) * pictures.count
    for (name, image), t_ns in zip(pictures.frames(), instants, strict=True):
        yield name, t_ns, image


def _page_path(request: Request, station: str | None) -> Path:
    """Default: in the working folder, so that folders of pictures stay as they are."""
    if request.out is not None:
        return _named(request.out, station)
    path = request.path.resolve()
    name = path.name if path.is_dir() else path.stem
    return Path(f"{name}.{station}.inspect.png" if station else f"{name}.inspect.png")


def _named(path: Path, station: str | None) -> Path:
    return path if station is None else path.with_name(f"{path.stem}.{station}{path.suffix}")


def _write_csv(path: Path, series: list[Sample]) -> None:
    try:
        write_csv(path, series)
    except OSError as error:
        raise TrackerdError(f"{path}: cannot be written: {error.strerror or error}") from error


def _tell_series(name: str, result: Repeatability) -> None:
    console = Console()
    if not console.is_terminal:
        for row in scatter_rows(result):
            cells = zip(SCATTER_COLUMNS[1:], row[1:], strict=True)
            print(f"{row[0]}: " + ", ".join(f"{column} {cell}" for column, cell in cells))
    else:
        table = Table(*SCATTER_COLUMNS, title=name, title_justify="left")
        for row in scatter_rows(result):
            table.add_row(*row)
        console.print(table)
    _tell(name, series_rows(result))


def _tell(name: str, rows: Rows) -> None:
    """A table on a terminal, plain lines elsewhere."""
    console = Console()
    if not console.is_terminal:
        for title, words in rows:
            print(f"{title}: {words}")
        return
    table = Table(title=name, show_header=False, title_justify="left")
    table.add_column(style="dim")
    table.add_column()
    for row in rows:
        table.add_row(*row)
    console.print(table)
