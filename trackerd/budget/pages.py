"""What `trackerd budget --out DIR` writes: tables as CSV and JSON, pictures, and one HTML page that holds them all."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

import numpy as np

from trackerd.budget.charts import LEAST_MM, PANEL_IN, cloud_picture, layout_picture, overview, telling_cases
from trackerd.budget.contributions import Contributions
from trackerd.budget.layout_shares import Share
from trackerd.budget.look import page
from trackerd.budget.settings import BudgetSettings, Volume
from trackerd.budget.stage import make_stage
from trackerd.budget.summary import Efficiency, Row
from trackerd.budget.tables import (
    Printed,
    as_csv,
    as_json,
    case_table,
    efficiency_table,
    is_number,
    share_table,
    value_tables,
)
from trackerd.budget.trials import CaseRun
from trackerd.budget.volume_chart import volume_picture
from trackerd.contract.errors import TrackerdError
from trackerd.geometry.gimbal import Station
from trackerd.pictures.look import save

CLOUD_WORDS = "simulated; green: 95 % by the Cramér-Rao bound. Mind the scales."
CAUSE_KEYS = ("pixel", "encoder_white", "encoder_fixed", "calibration")  # of CAUSES, as columns
STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; color: #262626; max-width: 72rem; margin: 2rem auto; padding: 0 1rem; }
h1 { font-size: 1.5rem; } h2 { font-size: 1.1rem; margin-top: 2.2rem; }
p.note { color: #6b6b6b; } img { width: 100%; margin: 1rem 0; }
div.table { overflow-x: auto; } table { border-collapse: collapse; font-variant-numeric: tabular-nums; }
th, td { padding: 0.16rem 0.9rem 0.16rem 0; text-align: left; white-space: nowrap; }
th { color: #6b6b6b; font-weight: 600; border-bottom: 1px solid #8c8c8c; }
td.n, th.n { text-align: right; }
tr.first td { border-top: 1px solid #e3e3e3; }
"""


@dataclass(frozen=True, slots=True)
class Study:
    """A whole Monte-Carlo, as numbers and in words."""

    settings: BudgetSettings
    runs: Sequence[CaseRun]
    rows: Sequence[Row]
    efficiencies: Sequence[Efficiency]
    shares: Sequence[Share]
    heading: str

    def printed(self) -> list[Printed]:
        """All tables, in the order in which they are read."""
        tables = [case_table(self.settings), *value_tables(self.rows), efficiency_table(self.efficiencies)]
        return [*tables, share_table(self.shares)] if self.shares else tables


def write_study(folder: Path, study: Study) -> list[Path]:
    """Raises TrackerdError where a file cannot be written."""
    tables = {"budget": study.rows, "efficiency": study.efficiencies, "shares": study.shares}
    written = [_write(folder / f"{name}.csv", as_csv(rows)) for name, rows in tables.items() if rows]
    everything = as_json(study.settings, study.rows, study.efficiencies, study.shares)
    written.append(_write(folder / "budget.json", everything))
    pictures = [_overview(folder, study.settings, study.rows, study.heading)]
    for layout in study.settings.layout:
        pictures += _layout_pictures(folder, study.settings, layout, study.runs)
    html = _html("Error budget", study.heading, study.printed(), pictures)
    return [*written, *pictures, _write(folder / "index.html", html)]


def write_cell(
    folder: Path, title: str, stations: Mapping[str, Station], volume: Volume, found: Contributions, printed: Printed
) -> list[Path]:
    """Raises TrackerdError where a file cannot be written."""
    picture = folder / "cell.png"
    with page((14.0, 9.2), title, "simulated: first-order propagation, U is k = 2") as figure:
        volume_picture(figure, stations, volume, found)
        save(figure, picture)
    return [
        _write(folder / "cell.csv", as_csv(found.parts)),
        _write(folder / "volume.csv", _volume_csv(found)),
        picture,
        _write(folder / "cell.html", _html(title, "simulated: first-order propagation", [printed], [picture])),
    ]


def _overview(folder: Path, settings: BudgetSettings, rows: Sequence[Row], heading: str) -> Path:
    path, words = folder / "overview.png", f"{heading}; what is below {LEAST_MM:g} mm is drawn at it"
    with page((5.2 * max(len(settings.layout), 2), 5.4), "Measured position: every method, every case", words) as figure:
        overview(figure, settings, rows)
        save(figure, path)
    return path


def _layout_pictures(folder: Path, settings: BudgetSettings, layout: str, runs: Sequence[CaseRun]) -> list[Path]:
    telling = telling_cases(settings, layout, runs)
    stage = make_stage(settings, layout, settings.points.draw)
    scene, clouds = folder / f"layout-{layout}.png", folder / f"errors-{layout}.png"
    words = f"{len(stage.stations)} gimbals, {len(stage.points_mm)} targets; dashed: the one view of all points"
    with page((12.0, 6.8 + (PANEL_IN if telling else 0.0)), f"Layout {layout}", words) as figure:
        layout_picture(figure, stage, telling)
        save(figure, scene)
    if not telling:
        return [scene]
    with page((9.6, 0.9 + 4.2 * len(telling)), f"Layout {layout}: errors of the targets", CLOUD_WORDS) as figure:
        cloud_picture(figure, stage, telling)
        save(figure, clouds)
    return [scene, clouds]


def _volume_csv(found: Contributions) -> str:
    """One line a place: where, and 1 sigma of each cause by axis."""
    header = "x_mm,y_mm,z_mm," + ",".join(f"{cause}_{axis}_mm" for cause in CAUSE_KEYS for axis in "xyz")
    sigmas = np.sqrt(found.cov_mm2.diagonal(axis1=2, axis2=3))  # (causes, m, 3)
    lines = np.concatenate([found.p_mm, *sigmas], axis=1)
    return "\n".join([header, *(",".join(f"{value:.6g}" for value in line) for line in lines)]) + "\n"


def _html(title: str, heading: str, tables: Sequence[Printed], pictures: Sequence[Path]) -> str:
    images = "\n".join(f'<img src="{escape(each.name)}" alt="{escape(each.stem)}">' for each in pictures)
    body = "\n".join(_table_html(each) for each in tables)
    return (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>{escape(title)}</title>\n'
        f"<style>{STYLE}</style></head>\n"
        f"<body><h1>{escape(title)}</h1><p>{escape(heading)}</p>\n{images}\n{body}\n</body></html>\n"
    )


def _table_html(printed: Printed) -> str:
    numbers = [all(is_number(row[n]) for row in printed.rows) for n in range(len(printed.header))]

    def cells(tag: str, row: Sequence[str]) -> str:
        return "".join(
            f"<{tag}{' class=n' if number else ''}>{escape(cell)}</{tag}>" for cell, number in zip(row, numbers, strict=True)
        )

    lines, before = [], ""
    for row in printed.rows:
        first = " class=first" if row[0] != before else ""
        before = row[0]
        lines.append(f"<tr{first}>{cells('td', row)}</tr>")
    note = f'<p class="note">{escape(printed.note)}</p>' if printed.note else ""
    head = f"<tr>{cells('th', printed.header)}</tr>"
    return f"<h2>{escape(printed.title)}</h2><div class=table><table>{head}{''.join(lines)}</table></div>{note}"


def _write(path: Path, text: str) -> Path:
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise TrackerdError(f"{path}: cannot be written: {error.strerror or error}") from error
    return path
