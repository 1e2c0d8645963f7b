"""Tables as the bench prints them: a row for each thing, a plain mark where there is a limit."""

from dataclasses import dataclass, field
from math import isnan

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table as Drawn

WIDTH = 220  # of the printed tables: they are read in files, too
COLOURS = {"MISSED": "bold red", "met": "green", "stretch": "bold green"}

Value = float | int | str


@dataclass(slots=True)
class Row:
    name: str
    values: tuple[Value, ...]
    verdict: str  # MISSED | met | stretch | nothing
    limit: str


@dataclass(slots=True)
class Table:
    title: str
    columns: tuple[str, ...]
    rows: list[Row] = field(default_factory=list)

    def add(self, name: str, *values: Value, verdict: str = "", limit: str = "") -> None:
        self.rows.append(Row(name, values, verdict, limit))

    def print(self, console: Console) -> None:
        judged = any(row.verdict for row in self.rows)
        drawn = Drawn(box=SIMPLE_HEAD, pad_edge=False)
        drawn.add_column("")
        for column in self.columns:
            drawn.add_column(column, justify="right")
        for heading in ("", "limit (stretch)") if judged else ():
            drawn.add_column(heading)
        for row in self.rows:
            told = [marked(row.verdict), row.limit] if judged else []
            drawn.add_row(row.name, *map(number, row.values), *told)
        console.print(f"\n[bold]{self.title}[/]")
        console.print(drawn if self.rows else "none")


def marked(verdict: str) -> str:
    """In its colour."""
    return f"[{COLOURS[verdict]}]{verdict}[/]" if verdict else ""


def number(value: Value) -> str:
    """Three digits, as short as they can be told."""
    if isinstance(value, str):
        return value
    if isnan(value):
        return "-"
    if isinstance(value, int) or value == 0.0 or abs(value) >= 1000.0:
        return f"{value:.0f}"
    digits = 4 if abs(value) < 0.0995 else 3 if abs(value) < 0.995 else 2 if abs(value) < 99.5 else 0
    return f"{value:.{digits}f}"
