"""Tables of comma-separated values that people read and write: every error names file, line, column, value and rule."""

import csv
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from math import isfinite
from pathlib import Path
from types import MappingProxyType

from trackerd.contract.errors import ConfigError
from trackerd.formats.rules import nearest

NO_OTHER_NAMES: Mapping[str, str] = MappingProxyType({})
MOST_LINES = 20  # of errors in one file: more of them tell nothing more


@dataclass(slots=True)
class Findings:
    """What is wrong in some files, one line each."""

    lines: list[str] = field(default_factory=list)

    def add(self, file: str, line: int, column: str | None, value: str | None, rule: str) -> None:
        where = f"{file} line {line}"
        if column is not None:
            where += f" {column}" + (f" = {value}" if value else "")
        self.lines.append(f"{where}: {rule}")

    def raise_any(self) -> None:
        if len(self.lines) > MOST_LINES:
            self.lines[MOST_LINES:] = [f"... and {len(self.lines) - MOST_LINES} more of the kind"]
        if self.lines:
            raise ConfigError("\n".join(self.lines))


@dataclass(frozen=True, slots=True)
class Row:
    """One line, its values by column; what is empty or has no column is ''."""

    file: str
    line: int
    values: dict[str, str]
    findings: Findings

    def text(self, column: str) -> str:
        """An empty one is an error."""
        value = self.values.get(column, "")
        if not value:
            self.refuse(column, "is missing")
        return value

    def number(self, column: str, default: float | None = None) -> float:
        """Finite; an empty one is the default, or an error without."""
        value = self.values.get(column, "")
        if not value and default is not None:
            return default
        try:
            number = float(self.text(column) or "0")
        except ValueError:
            self.refuse(column, "must be a number")
            return 0.0
        if not isfinite(number):
            self.refuse(column, "must be a finite number")
            return 0.0
        return number

    def has(self, *columns: str) -> bool:
        """All of these are filled in."""
        return all(self.values.get(column, "") for column in columns)

    def refuse(self, column: str | None, rule: str) -> None:
        self.findings.add(self.file, self.line, column, self.values.get(column, "") if column else None, rule)


def read_rows(
    path: Path, needed: Sequence[str], optional: Sequence[str], findings: Findings, also: Mapping[str, str] = NO_OTHER_NAMES
) -> Iterator[Row]:
    """The rows below the header; lines that begin with # and empty ones are left out. `also`: other names of columns.

    Raises ConfigError for a file that cannot be read or whose header lacks a needed column, or has an unknown one.
    """
    rows = ((number, line) for number, line in enumerate(_lines(path), start=1) if line.strip() and line.lstrip()[0] != "#")
    header: list[str] | None = None
    for number, line in rows:
        cells = [cell.strip() for cell in next(csv.reader([line]))]
        if header is None:
            header = _header(path, number, [also.get(cell, cell) for cell in cells], needed, optional)
        elif len(cells) != len(header):
            findings.add(path.name, number, None, None, f"has {len(cells)} values, the header has {len(header)}")
        else:
            yield Row(path.name, number, dict(zip(header, cells, strict=True)), findings)
    if header is None:
        raise ConfigError(f"{path.name}: is empty: its first line names the columns: {','.join(needed)}")


def _lines(path: Path) -> list[str]:
    try:
        return path.read_text(encoding="utf-8").splitlines()
    except FileNotFoundError:
        raise ConfigError(f"{path.name}: no such file: {path.absolute()}") from None
    except OSError as err:
        raise ConfigError(f"{path.name}: cannot be read: {err.strerror} ({path.absolute()})") from None
    except UnicodeDecodeError as err:
        raise ConfigError(f"{path.name}: byte {err.start} is not UTF-8: save the file as UTF-8 text") from None


def _header(path: Path, line: int, cells: list[str], needed: Sequence[str], optional: Sequence[str]) -> list[str]:
    known = (*needed, *optional)
    problems = [f"has no column {name}" for name in needed if name not in cells]
    problems += [f"column {cell!r} is unknown{nearest(cell, known)}" for cell in cells if cell not in known]
    problems += [f"column {cell!r} is there twice" for cell in sorted(set(cells)) if cells.count(cell) > 1]
    if problems:
        raise ConfigError("\n".join(f"{path.name} line {line}: {problem}" for problem in problems))
    return cells
