"""A datum: where the cell's own frame W lies in the world of a machine or a workpiece; apart from the stations' calibration.

format = "trackerd-datum"
version = 1
name = "..."                    # of the world
created = "..."                 # ISO 8601
software, method                # "best fit" or "3-2-1"
calibration_id                  # of the calibration that the points were measured with, where it is known
rms_mm, max_mm, chi2_per_dof, dof, scale, scale_sigma       # what the points said; the scale is not applied
[measured], [nominal]           # name, sha256 of the files of points
[world_from_cell]               # rotation (rows) or quaternion_wxyz, translation_mm
[covariance]                    # parameters: rx_rad, ry_rad, rz_rad, x_mm, y_mm, z_mm; R = exp([r]x) R_file
[[point]]                       # id, error_mm: measured and moved, minus nominal
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from trackerd.contract.model import Array
from trackerd.formats.atomic import toml_text, write_atomically
from trackerd.formats.calibration_model import DataIdentity
from trackerd.formats.file_parts import (
    CovarianceTable,
    Identity,
    PoseTable,
    Table,
    TimeText,
    Vector,
    check_covariance,
    pose_table,
)
from trackerd.formats.rules import NO_VALUE
from trackerd.formats.tables import Problems, Tables, read_tables
from trackerd.geometry.rigid import Rigid

FORMAT = "trackerd-datum"
VERSION = 1
PARAMETERS = ("rx_rad", "ry_rad", "rz_rad", "x_mm", "y_mm", "z_mm")

Name = Annotated[str, Field(min_length=1)]
NotNegative = Annotated[float, Field(ge=0)]


@dataclass(frozen=True, slots=True)
class Datum:
    """`covariance` is (6, 6), of PARAMETERS."""

    name: str
    created: str
    software: str
    method: str
    world_from_cell: Rigid
    covariance: Array
    errors_mm: dict[str, Vector]  # by the point's id
    rms_mm: float
    max_mm: float
    dof: int
    scale: float
    scale_sigma: float
    measured: DataIdentity
    nominal: DataIdentity
    chi2_per_dof: float | None = None  # None: the points had no sigmas
    calibration_id: str | None = None


class _Point(Table):
    id: Name
    error_mm: Vector


class _File(Table):
    format: Literal["trackerd-datum"]
    version: Literal[1]
    name: Name
    created: TimeText
    software: str
    method: Name
    calibration_id: Name | None = None
    rms_mm: NotNegative
    max_mm: NotNegative
    chi2_per_dof: NotNegative | None = None
    dof: Annotated[int, Field(ge=0)]
    scale: Annotated[float, Field(gt=0)]
    scale_sigma: NotNegative
    measured: Identity
    nominal: Identity
    world_from_cell: PoseTable
    covariance: CovarianceTable
    point: tuple[_Point, ...] = ()


def load_datum(path: Path) -> Datum:
    """Raises ConfigError with every error of the file: file, table, key, value, rule."""
    tables = read_tables(path)
    problems = Problems(path.name)
    if tables.get("format") != FORMAT:
        problems.add((), "format", tables.get("format", NO_VALUE), f'is no datum: format must be "{FORMAT}"')
    elif tables.get("version") != VERSION:
        problems.add((), "version", tables.get("version", NO_VALUE), f"this trackerd reads version {VERSION} of the datum")
    problems.raise_any()
    return _datum(_checked(problems, tables))


def save_datum(datum: Datum, path: Path) -> None:
    """Replaces the file in one step. Raises ConfigError for what could not be read again, and OSError."""
    tables = _tables(datum)
    _checked(Problems(path.name), tables)
    write_atomically(path, toml_text(tables))


def _checked(problems: Problems, tables: Tables) -> _File:
    file = problems.check(_File, tables)
    if file is not None:
        check_covariance(file.covariance, problems)
        if file.covariance.parameters != PARAMETERS:
            problems.add(("covariance",), "parameters", file.covariance.parameters, f"must be {', '.join(PARAMETERS)}")
    problems.raise_any()
    assert file is not None
    return file


def _datum(file: _File) -> Datum:
    kept = file.model_dump(
        exclude={"format", "version", "measured", "nominal", "world_from_cell", "covariance", "point"},
    )
    return Datum(
        **kept,
        world_from_cell=file.world_from_cell.rigid(),
        covariance=file.covariance.array(),
        errors_mm={point.id: point.error_mm for point in file.point},
        measured=DataIdentity(file.measured.name, file.measured.sha256),
        nominal=DataIdentity(file.nominal.name, file.nominal.sha256),
    )


def _tables(d: Datum) -> Tables:
    tables: dict[str, Any] = {
        "format": FORMAT,
        "version": VERSION,
        "name": d.name,
        "created": d.created,
        "software": d.software,
        "method": d.method,
        "calibration_id": d.calibration_id,
        "rms_mm": float(d.rms_mm),
        "max_mm": float(d.max_mm),
        "chi2_per_dof": None if d.chi2_per_dof is None else float(d.chi2_per_dof),
        "dof": d.dof,
        "scale": float(d.scale),
        "scale_sigma": float(d.scale_sigma),
        "measured": {"name": d.measured.name, "sha256": d.measured.sha256},
        "nominal": {"name": d.nominal.name, "sha256": d.nominal.sha256},
        "world_from_cell": pose_table(d.world_from_cell),
        "covariance": {"parameters": list(PARAMETERS), "matrix": d.covariance.tolist()},
        "point": [{"id": name, "error_mm": [float(x) for x in error]} for name, error in d.errors_mm.items()],
    }
    return {key: value for key, value in tables.items() if value is not None}
