"""Version 1 of the calibration file: poses, lenses and their covariance, as TOML for people and programs.

    format = "trackerd-calibration"
    version = 1
    id = "..."                      # every published position names it
    created = "..."                 # ISO 8601
    software, method, chi2_per_dof, forced
    [station.NAME]                  # order, signs, eps_rad, d_mm
    [station.NAME.world_from_gimbal]    quaternion_wxyz, translation_mm
    [station.NAME.rg_from_camera]       quaternion_wxyz, translation_mm (the lever arm)
    [station.NAME.lens]                 sensor_px, fx_px, fy_px, cx_px, cy_px, distortion (k1, k2, p1, p2, k3)
    [covariance]                    # parameters: names; matrix: rows, in the parameters' own units squared

A parameter is named station.group.element: left.world_from_gimbal.rx_rad, left.world_from_gimbal.x_mm, left.eps_rad, left.d_mm,
left.rg_from_camera.z_mm, left.lens.fx_px and so on. Rotations are perturbed from the left: R = exp([r]x) R_file. Every float is
written so that it is read back bit by bit; a rotation matrix goes through its quaternion, and so comes back to rounding.
"""

import os
import re
import tempfile
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import tomli_w
from pydantic import BaseModel, ConfigDict, Field, field_validator

from trackerd.contract.model import Array
from trackerd.formats.rules import NO_VALUE
from trackerd.formats.tables import Problems, Tables, read_tables
from trackerd.geometry.gimbal import AxisOrder, Station
from trackerd.geometry.lens import Lens
from trackerd.geometry.rigid import Rigid, quaternion_from_matrix

FORMAT = "trackerd-calibration"
VERSION = 1
NORM_TOLERANCE = 1e-6  # of a quaternion: more is a typing error, not rounding
PSD_TOLERANCE = 1e-9  # of a covariance's eigenvalues, relative to the largest after scaling to correlations
NUMBERS = re.compile(r"\[\n((?:\s+[-+.\deE]+,\n)+)\s*\]")  # a list of numbers, which tomli_w spreads over many lines

Vector = tuple[float, float, float]
Positive = Annotated[float, Field(gt=0)]
Sign = Literal[1, -1]


@dataclass(frozen=True, slots=True)
class Calibration:
    """What one calibration run found. `covariance` is that of `parameters`, (n, n); n = 0: not known."""

    id: str
    created: str
    software: str
    method: str  # nominal | twin | bundle | ...
    stations: dict[str, Station]
    parameters: tuple[str, ...] = ()
    covariance: Array = field(default_factory=lambda: np.zeros((0, 0)))
    chi2_per_dof: float | None = None
    forced: bool = False  # accepted by a person although chi-square refused it


class _Table(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class _Pose(_Table):
    quaternion_wxyz: tuple[float, float, float, float]
    translation_mm: Vector

    @field_validator("quaternion_wxyz")
    @classmethod
    def _unit(cls, value: tuple[float, float, float, float]) -> tuple[float, float, float, float]:
        norm = float(np.linalg.norm(value))
        if abs(norm - 1.0) > NORM_TOLERANCE:
            raise ValueError(f"a rotation's quaternion has norm 1, not {norm:.9g}")
        return value

    def rigid(self) -> Rigid:
        return Rigid.from_quaternion(np.array(self.quaternion_wxyz), np.array(self.translation_mm))


class _Lens(_Table):
    sensor_px: tuple[Annotated[int, Field(gt=0)], Annotated[int, Field(gt=0)]]
    fx_px: Positive
    fy_px: Positive
    cx_px: float
    cy_px: float
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)

    def lens(self) -> Lens:
        return Lens(**self.model_dump())


class _Station(_Table):
    order: Literal["az_outer", "el_outer"] = "az_outer"
    az_sign: Sign = 1
    el_sign: Sign = 1
    eps_rad: Annotated[float, Field(gt=-0.2, lt=0.2)] = 0.0
    d_mm: float = 0.0
    world_from_gimbal: _Pose
    rg_from_camera: _Pose
    lens: _Lens

    def station(self, name: str) -> Station:
        return Station(
            name=name,
            world_from_gimbal=self.world_from_gimbal.rigid(),
            rg_from_camera=self.rg_from_camera.rigid(),
            lens=self.lens.lens(),
            order=AxisOrder(self.order),
            az_sign=self.az_sign,
            el_sign=self.el_sign,
            eps_rad=self.eps_rad,
            d_mm=self.d_mm,
        )


class _Covariance(_Table):
    parameters: tuple[str, ...]
    matrix: tuple[tuple[float, ...], ...]


class _File(_Table):
    format: Literal["trackerd-calibration"]
    version: Literal[1]
    id: Annotated[str, Field(min_length=1)]
    created: str
    software: str
    method: Annotated[str, Field(min_length=1)]
    chi2_per_dof: Annotated[float, Field(ge=0)] | None = None
    forced: bool = False
    station: Annotated[dict[str, _Station], Field(min_length=1)]
    covariance: _Covariance | None = None

    @field_validator("created")
    @classmethod
    def _time(cls, value: str) -> str:
        try:
            datetime.fromisoformat(value)
        except ValueError:
            raise ValueError('must be a time as ISO 8601 writes it, e.g. "2025-03-01T08:00:00+00:00"') from None
        return value


def load_calibration(path: Path) -> Calibration:
    """Raises ConfigError with every error of the file: file, table, key, value, rule."""
    tables = read_tables(path)
    _refuse_foreign(path.name, tables)
    problems = Problems(path.name)
    file = problems.check(_File, tables)
    if file is not None and file.covariance is not None:
        _check_covariance(file.covariance, problems)
    problems.raise_any()
    assert file is not None
    covariance = file.covariance or _Covariance(parameters=(), matrix=())
    n = len(covariance.parameters)
    return Calibration(
        id=file.id,
        created=file.created,
        software=file.software,
        method=file.method,
        stations={name: station.station(name) for name, station in file.station.items()},
        parameters=covariance.parameters,
        covariance=np.array(covariance.matrix, float).reshape(n, n),
        chi2_per_dof=file.chi2_per_dof,
        forced=file.forced,
    )


def save_calibration(calibration: Calibration, path: Path) -> None:
    """Replaces the file in one step: a reader, or a power cut, sees the old one or the new one, whole."""
    text = NUMBERS.sub(_one_line, tomli_w.dumps(_tables(calibration)))
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        Path(temporary).chmod(0o644)
        Path(temporary).replace(path)
    except BaseException:
        with suppress(FileNotFoundError):
            Path(temporary).unlink()
        raise
    _sync_folder(path.parent)


def _one_line(numbers: re.Match[str]) -> str:
    return "[" + ", ".join(numbers[1].replace(",", " ").split()) + "]"


def _sync_folder(folder: Path) -> None:
    """Makes the new name durable."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _refuse_foreign(file: str, tables: Tables) -> None:
    """Another file, or another version of this one, is one error: its keys would only be noise."""
    problems = Problems(file)
    found = tables.get("format", NO_VALUE)
    if found != FORMAT:
        problems.add((), "format", found, f'is no calibration file: format must be "{FORMAT}"')
    elif tables.get("version") != VERSION:
        version = tables.get("version", NO_VALUE)
        problems.add((), "version", version, f"this trackerd reads version {VERSION} of the calibration file: calibrate again")
    problems.raise_any()


def _check_covariance(found: _Covariance, problems: Problems) -> None:
    rule = _covariance_rule(found)
    if rule is not None:
        problems.add(("covariance",), "matrix", NO_VALUE, rule)
    twice = {name for name in found.parameters if found.parameters.count(name) > 1}
    for name in sorted(twice):
        problems.add(("covariance",), "parameters", NO_VALUE, f'"{name}" is there twice')


def _covariance_rule(found: _Covariance) -> str | None:
    """The rule that the matrix breaks."""
    n = len(found.parameters)
    if len(found.matrix) != n or any(len(row) != n for row in found.matrix):
        return f"needs {n} rows of {n} numbers, one for each parameter"
    matrix = np.array(found.matrix, float).reshape(n, n)
    if not np.array_equal(matrix, matrix.T):
        row, column = np.argwhere(matrix != matrix.T)[0]
        return f"must be symmetric: row {row}, column {column} differs from its mirror image"
    if n and not _positive_semidefinite(matrix):
        return "must be positive semidefinite: it gives some combination of parameters a negative variance"
    return None


def _positive_semidefinite(matrix: Array) -> bool:
    """Judged on the correlations, so that radians beside pixels do not hide a wrong sign."""
    variances = np.diag(matrix)
    if variances.min() < 0.0:
        return False
    scale = np.sqrt(np.where(variances > 0.0, variances, 1.0))
    return float(np.linalg.eigvalsh(matrix / np.outer(scale, scale)).min()) >= -PSD_TOLERANCE * len(matrix)


def _tables(c: Calibration) -> Tables:
    tables: Tables = {
        "format": FORMAT,
        "version": VERSION,
        "id": c.id,
        "created": c.created,
        "software": c.software,
        "method": c.method,
        "forced": c.forced,
        "station": {name: _station_table(station) for name, station in c.stations.items()},
    }
    if c.chi2_per_dof is not None:
        tables["chi2_per_dof"] = float(c.chi2_per_dof)
    if c.parameters:
        tables["covariance"] = {"parameters": list(c.parameters), "matrix": c.covariance.tolist()}
    return tables


def _station_table(s: Station) -> Mapping[str, Any]:
    lens = s.lens
    return {
        "order": str(s.order),
        "az_sign": s.az_sign,
        "el_sign": s.el_sign,
        "eps_rad": float(s.eps_rad),
        "d_mm": float(s.d_mm),
        "world_from_gimbal": _pose_table(s.world_from_gimbal),
        "rg_from_camera": _pose_table(s.rg_from_camera),
        "lens": {
            "sensor_px": list(lens.sensor_px),
            "fx_px": float(lens.fx_px),
            "fy_px": float(lens.fy_px),
            "cx_px": float(lens.cx_px),
            "cy_px": float(lens.cy_px),
            "distortion": [float(k) for k in lens.distortion],
        },
    }


def _pose_table(pose: Rigid) -> Mapping[str, Any]:
    return {
        "quaternion_wxyz": quaternion_from_matrix(pose.rotation).tolist(),
        "translation_mm": np.asarray(pose.translation_mm, float).tolist(),
    }
