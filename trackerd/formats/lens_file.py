"""Version 1 of the lens file: intrinsics of one camera's lens, one table for each zoom setting. A lens is no calibrated cell.

    format = "trackerd-lens"
    version = 1
    [lens.ZOOM]                     # created, software, board, sensor_px, fx_px, fy_px, cx_px, cy_px,
                                    # distortion (k1, k2, p1, p2, k3), rms_px, sigma_px, inflation,
                                    # sha256 (of the sums of its pictures), pixel_um, warnings
    [lens.ZOOM.covariance]          # parameters: fx_px, fy_px, cx_px, cy_px, k1, k2, p1, p2, k3; matrix, 0 where one was held
    [lens.ZOOM.picture."NAME"]      # rms_px, points, rejected (numbers of points), sha256 of the file
    [lens.ZOOM.left_out]            # "NAME" = "why"

Every float is read back bit by bit.
"""

from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from trackerd.contract.errors import ConfigError
from trackerd.contract.model import Array
from trackerd.formats.atomic import toml_text, write_atomically
from trackerd.formats.calibration_tables import LensTable
from trackerd.formats.file_parts import CovarianceTable, Sha256, Table, TimeText, check_covariance
from trackerd.formats.rules import NO_VALUE
from trackerd.formats.tables import Problems, Tables, read_tables
from trackerd.geometry.lens import Lens

FORMAT, VERSION = "trackerd-lens", 1
PARAMETERS = ("fx_px", "fy_px", "cx_px", "cy_px", "k1", "k2", "p1", "p2", "k3")
IDENTITY_RULE = "is not the sum of its pictures' own: a picture was added, taken away or exchanged"

NotNegative = Annotated[float, Field(ge=0)]


@dataclass(frozen=True, slots=True)
class UsedPicture:
    rms_px: float  # of the distances between points and their reprojections
    points: int
    sha256: str  # of the file
    rejected: tuple[int, ...] = ()  # points by number


@dataclass(frozen=True, slots=True)
class LensRecord:
    """The lens at one zoom setting. `covariance` (9, 9) of PARAMETERS."""

    lens: Lens
    covariance: Array
    created: str  # ISO 8601
    software: str
    board: str
    rms_px: float
    sigma_px: float  # of a coordinate
    inflation: float  # of the sigmas, by the pictures' disagreement
    pictures: dict[str, UsedPicture]
    left_out: dict[str, str] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    pixel_um: float | None = None

    @property
    def sha256(self) -> str:
        """The identity of the data: of the pictures that were used."""
        sums = "".join(f"{picture.sha256}\n" for _, picture in sorted(self.pictures.items()))
        return sha256(sums.encode()).hexdigest()


class _Picture(Table):
    rms_px: NotNegative
    points: Annotated[int, Field(ge=1)]
    sha256: Sha256
    rejected: tuple[Annotated[int, Field(ge=0)], ...] = ()


class _Lens(LensTable):
    created: TimeText
    software: str
    board: str
    rms_px: NotNegative
    sigma_px: NotNegative
    inflation: Annotated[float, Field(ge=1)] = 1.0
    sha256: Sha256
    pixel_um: Annotated[float, Field(gt=0)] | None = None
    warnings: tuple[str, ...] = ()
    covariance: CovarianceTable
    picture: Annotated[dict[str, _Picture], Field(min_length=1)]
    left_out: dict[str, str] = Field(default_factory=dict)

    def record(self) -> LensRecord:
        return LensRecord(
            lens=Lens(self.sensor_px, self.fx_px, self.fy_px, self.cx_px, self.cy_px, self.distortion),
            covariance=self.covariance.array(),
            created=self.created,
            software=self.software,
            board=self.board,
            rms_px=self.rms_px,
            sigma_px=self.sigma_px,
            inflation=self.inflation,
            pictures={name: UsedPicture(p.rms_px, p.points, p.sha256, p.rejected) for name, p in self.picture.items()},
            left_out=self.left_out,
            warnings=self.warnings,
            pixel_um=self.pixel_um,
        )


class _File(Table):
    format: Literal["trackerd-lens"]
    version: Literal[1]
    lens: Annotated[dict[str, _Lens], Field(min_length=1)]


def load_lenses(path: Path) -> dict[str, LensRecord]:
    """By zoom setting. Raises ConfigError with every error of the file: file, table, key, value, rule."""
    return _checked(path.name, read_tables(path))


def save_lenses(lenses: dict[str, LensRecord], path: Path) -> None:
    """Replaces the file in one step. What could not be read again is not written: raises ConfigError. Raises OSError."""
    tables: Tables = {"format": FORMAT, "version": VERSION, "lens": {zoom: _table(one) for zoom, one in lenses.items()}}
    _checked(path.name, tables)
    write_atomically(path, toml_text(tables))


def add_lens(zoom: str, record: LensRecord, path: Path) -> None:
    """Adds a zoom setting to the file, or replaces it there; others stay. Raises ConfigError, also for a foreign file."""
    there = load_lenses(path) if path.exists() else {}
    for name, one in there.items():
        if one.lens.sensor_px != record.lens.sensor_px:
            (width, height), (new_width, new_height) = one.lens.sensor_px, record.lens.sensor_px
            raise ConfigError(
                f"{path.name} [lens.{name}] sensor_px = [{width}, {height}]: these pictures have {new_width} x {new_height} px:"
                " a file holds the zoom settings of one camera"
            )
    save_lenses({**there, zoom: record}, path)


def _checked(file: str, tables: Tables) -> dict[str, LensRecord]:
    problems = Problems(file)
    found, version = tables.get("format", NO_VALUE), tables.get("version", NO_VALUE)
    if found != FORMAT:
        problems.add((), "format", found, f'is no lens file: format must be "{FORMAT}"')
    elif type(version) is not int or version != VERSION:
        problems.add((), "version", version, f"this trackerd reads version {VERSION} of the lens file")
    problems.raise_any()
    checked = problems.check(_File, tables)
    if checked is not None:
        for zoom, one in checked.lens.items():
            _check_zoom(zoom, one, problems)
    problems.raise_any()
    assert checked is not None
    return {zoom: one.record() for zoom, one in checked.lens.items()}


def _check_zoom(zoom: str, one: _Lens, problems: Problems) -> None:
    where = ("lens", zoom)
    if one.covariance.parameters != PARAMETERS:
        rule = f"must be {', '.join(PARAMETERS)}, in this order"
        problems.add((*where, "covariance"), "parameters", list(one.covariance.parameters), rule)
        return
    before = len(problems.lines)
    check_covariance(one.covariance, problems, (*where, "covariance"))
    if len(problems.lines) == before and one.record().sha256 != one.sha256:
        problems.add(where, "sha256", one.sha256, IDENTITY_RULE)


def _table(one: LensRecord) -> dict[str, Any]:
    lens = one.lens
    table: dict[str, Any] = {
        "created": one.created,
        "software": one.software,
        "board": one.board,
        "sensor_px": list(lens.sensor_px),
        "fx_px": float(lens.fx_px),
        "fy_px": float(lens.fy_px),
        "cx_px": float(lens.cx_px),
        "cy_px": float(lens.cy_px),
        "distortion": [float(k) for k in lens.distortion],
        "rms_px": float(one.rms_px),
        "sigma_px": float(one.sigma_px),
        "inflation": float(one.inflation),
        "sha256": one.sha256,
        "warnings": list(one.warnings),
    }
    if one.pixel_um is not None:
        table["pixel_um"] = float(one.pixel_um)
    table["covariance"] = {"parameters": list(PARAMETERS), "matrix": np.asarray(one.covariance, float).tolist()}
    table["left_out"] = dict(one.left_out)
    table["picture"] = {
        name: {"rms_px": float(p.rms_px), "points": p.points, "rejected": list(p.rejected), "sha256": p.sha256}
        for name, p in one.pictures.items()
    }
    return table
