"""`trackerd budget`: what limits a cell, in tables, pictures and files."""

import os
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table

from trackerd.budget.contributions import CellNoise, Contributions, contributions, grid
from trackerd.budget.layout_shares import layout_shares
from trackerd.budget.pages import Study, write_cell, write_study
from trackerd.budget.settings import BudgetSettings, load_budget
from trackerd.budget.summary import efficiency_of, rows_of
from trackerd.budget.tables import Printed, contribution_table, is_number, plain
from trackerd.budget.trials import count_of, run
from trackerd.contract.errors import ConfigError, TrackerdError
from trackerd.formats.calibration import load_calibration
from trackerd.formats.config import CellConfig
from trackerd.wiring.cell import load

SIMULATED = "simulated"


@dataclass(frozen=True, slots=True)
class BudgetRequest:
    """What is asked for. Without a cell it is the Monte-Carlo; `overrides` belong to whichever file is the subject."""

    file: Path | None
    out: Path | None
    cell: Path | None = None
    trials: int | None = None
    seed: int | None = None
    workers: int | None = None
    cases: Sequence[str] = ()
    layouts: Sequence[str] = ()
    pixel_sigma_px: float | None = None
    overrides: Sequence[str] = ()


def budget(request: BudgetRequest) -> None:
    """Prints the tables, and writes them with pictures into `out`.

    Raises ConfigError for what a person mends, TrackerdError where a file cannot be written.
    """
    if request.out is not None:
        _make_folder(request.out)
    if request.cell is None:
        _study(request)
    else:
        _cell(request, request.cell)


def _study(request: BudgetRequest) -> None:
    if request.pixel_sigma_px is not None:
        raise ConfigError("--pixel-sigma: needs --cell CELL; the cases of the Monte-Carlo have their own")
    settings = _chosen(request, load_budget(request.file, request.overrides))
    shares = layout_shares(settings)
    with _progress("trials", count_of(settings)) as advance:
        runs = run(settings, request.workers or os.cpu_count() or 1, advance)
    efficiencies = [efficiency_of(settings, each) for each in runs]
    study = Study(settings, runs, rows_of(settings, runs), efficiencies, shares, _heading(settings))
    print(study.heading)
    for each in study.printed():
        _show(each)
    if request.out is not None:
        _tell(write_study(request.out, study))


def _heading(settings: BudgetSettings) -> str:
    draws = settings.points.draws
    sets = f"points drawn with {settings.points.draw}" + (f" to {settings.points.draw + draws - 1}" if draws > 1 else "")
    return f"{SIMULATED}: {settings.trials} trials a case, seed {settings.seed}, {settings.points.count} {sets}"


def _chosen(request: BudgetRequest, settings: BudgetSettings) -> BudgetSettings:
    """The file's settings with the options laid over them."""
    changed: dict[str, object] = {
        name: value for name, value in (("trials", request.trials), ("seed", request.seed)) if value is not None
    }
    for key, wanted in (("case", request.cases), ("layout", request.layouts)):
        known = getattr(settings, key)
        for name in wanted:
            if name not in known:
                raise ConfigError(f"--{key}s {name}: there is no [{key}.{name}] (there are: {', '.join(known)})")
        if wanted:
            changed[key] = {name: known[name] for name in known if name in wanted}
    return settings.model_copy(update=changed)


def _cell(request: BudgetRequest, path: Path) -> None:
    cell = load(path, request.overrides)
    volume = load_budget(request.file).volume
    if request.pixel_sigma_px is not None:
        volume = volume.model_copy(update={"pixel_sigma_px": request.pixel_sigma_px})
    calibration = load_calibration(cell.calibration)
    stations = {name: calibration.stations[name] for name in cell.gimbals}
    noise = _noise_of(cell, volume.pixel_sigma_px)
    found = contributions(stations, calibration.parameters, calibration.covariance, grid(volume), noise)
    title = f"{cell.name}: predicted uncertainty of a measured target, calibration {calibration.id}"
    print(f"{SIMULATED}: first-order propagation; pixels {noise.pixel_sigma_px:g} px 1 sigma")
    printed = contribution_table(title, found)
    _show(printed)
    _worst(found)
    if not calibration.parameters:
        print(f"note: calibration {calibration.id} states no covariance: its part is not known, and left out", file=sys.stderr)
    if request.out is not None:
        _tell(write_cell(request.out, title, stations, volume, found, printed))


def _noise_of(cell: CellConfig, pixel_sigma_px: float) -> CellNoise:
    """Of the worst gimbal: a cell whose encoders differ is no better than that."""
    gimbals = cell.gimbals.values()
    return CellNoise(
        pixel_sigma_px=pixel_sigma_px,
        encoder_sigma_rad=max(each.encoder_sigma_rad for each in gimbals),
        encoder_fixed_rad=max(each.encoder_fixed_rad for each in gimbals),
    )


def _worst(found: Contributions) -> None:
    sigmas = np.sqrt(found.total_mm2.trace(axis1=1, axis2=2))
    place = ", ".join(f"{x:.0f}" for x in found.p_mm[int(sigmas.argmax())])
    print(f"3D sigma over the volume: {sigmas.min():.4f} to {sigmas.max():.4f} mm, worst at ({place}) mm")


def _make_folder(path: Path) -> None:
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise TrackerdError(f"--out {path}: cannot be made: {error.strerror or error}") from error


def _tell(written: Sequence[Path]) -> None:
    for path in written:
        print(f"written: {path}")


def _show(printed: Printed) -> None:
    """A table on a terminal, aligned text elsewhere."""
    console = Console()
    if not console.is_terminal:
        print(plain(printed))
        return
    table = Table()
    for n, name in enumerate(printed.header):
        numbers = all(is_number(row[n]) for row in printed.rows)
        table.add_column(name, justify="right" if numbers else "left", no_wrap=n == 0)
    for row, after in zip(printed.rows, (*printed.rows[1:], None), strict=True):
        table.add_row(*row, end_section=after is not None and after[0] != row[0])
    console.print(f"[bold]{printed.title}[/bold]", table, f"[dim]{printed.note}[/dim]\n", sep="\n", highlight=False)


@contextmanager
def _progress(words: str, steps: int) -> Iterator[Callable[[int], None]]:
    columns = TextColumn(words), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn()
    with Progress(*columns, console=Console(stderr=True), transient=True, disable=not sys.stderr.isatty()) as bar:
        task = bar.add_task(words, total=steps)
        yield lambda done: bar.advance(task, done)
