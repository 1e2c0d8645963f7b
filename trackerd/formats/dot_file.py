"""Coordinates of an array of LEDs or dots, as somebody measured them: CSV as every list of points, or TOML.

format = "trackerd-dots"
version = 1
facing = [0, 0, -1]             # the direction from which they are seen, in the coordinates' frame
dark = false                    # true: dark dots on bright ground
[point]
a1 = [0.0, 0.0, 0.0]            # x, y, z, mm
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from trackerd.contract.model import Array
from trackerd.formats.file_parts import Table, Vector
from trackerd.formats.points import read_points
from trackerd.formats.rules import NO_VALUE
from trackerd.formats.tables import Problems, read_tables

FORMAT, VERSION = "trackerd-dots", 1
FACING = (0.0, 0.0, -1.0)  # z points into the board, as on every board


@dataclass(frozen=True, slots=True)
class Dots:
    ids: tuple[str, ...]
    p_mm: Array  # (n, 3)
    facing: Vector = FACING
    dark: bool = False


class _File(Table):
    format: Literal["trackerd-dots"]
    version: Literal[1]
    facing: Vector = FACING
    dark: bool = False
    point: Annotated[dict[str, Vector], Field(min_length=1)]


def read_dots(path: Path) -> Dots:
    """Raises ConfigError: file, place, value and rule of everything that is wrong."""
    if path.suffix.lower() != ".toml":
        points = read_points(path)
        return Dots(points.ids, points.p_mm)
    tables, problems = read_tables(path), Problems(path.name)
    found, version = tables.get("format", NO_VALUE), tables.get("version", NO_VALUE)
    if found != FORMAT:
        problems.add((), "format", found, f'is no file of dots: format must be "{FORMAT}"')
    elif type(version) is not int or version != VERSION:
        problems.add((), "version", version, f"this trackerd reads version {VERSION} of the file of dots")
    problems.raise_any()
    file = problems.check(_File, tables)
    problems.raise_any()
    assert file is not None
    return Dots(tuple(file.point), np.array(list(file.point.values())), file.facing, file.dark)
