"""CSV tables of recordings, read so that every error names file, line, column and value."""

import csv
from collections.abc import Iterator
from dataclasses import dataclass
from math import isfinite
from pathlib import Path

from trackerd.contract.errors import ConfigError


@dataclass(frozen=True, slots=True)
class Row:
    file: Path
    line: int
    cells: dict[str, str]

    def text(self, column: str) -> str:
        return (self.cells.get(column) or "").strip()

    def whole(self, column: str) -> int:
        """A whole number >= 0. Raises ConfigError."""
        text = self.text(column)
        if not text.isdecimal():
            raise self.error(column, "must be a whole number, 0 or above")
        return int(text)

    def number(self, column: str) -> float:
        """A finite number. Raises ConfigError."""
        try:
            value = float(self.text(column))
        except ValueError:
            value = float("nan")
        if not isfinite(value):
            raise self.error(column, "must be a finite number")
        return value

    def error(self, column: str, rule: str) -> ConfigError:
        return ConfigError(f"{self.file}, line {self.line}: {column} = {self.text(column)!r}: {rule}")


def read_rows(file: Path, columns: tuple[str, ...]) -> Iterator[Row]:
    """Rows of a table that has at least these columns; empty lines are passed over. Raises ConfigError."""
    try:
        with file.open(encoding="utf-8-sig", newline="") as text:
            reader = csv.DictReader(text)
            missing = [column for column in columns if column not in (reader.fieldnames or ())]
            if missing:
                found = ",".join(reader.fieldnames or ())
                raise ConfigError(f"{file}, line 1: no column {', '.join(missing)}: needs {','.join(columns)}, has {found!r}")
            for cells in reader:
                yield Row(file, reader.line_num, cells)
    except (OSError, UnicodeDecodeError, csv.Error) as err:
        raise ConfigError(f"{file}: cannot be read: {err}") from err
