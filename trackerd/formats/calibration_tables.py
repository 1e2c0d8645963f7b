"""The tables of the calibration file, and what was found as such tables."""

from collections.abc import Mapping
from dataclasses import asdict
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from trackerd.formats.calibration_model import AssumedNoise, Calibration, DataIdentity, Verification, Volume
from trackerd.formats.file_parts import CovarianceTable, Identity, PoseTable, Table, TimeText, Vector, pose_table
from trackerd.formats.settings import KeyRuleError
from trackerd.formats.tables import Tables
from trackerd.geometry.gimbal import AxisOrder, Station
from trackerd.geometry.lens import Lens

Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Name = Annotated[str, Field(min_length=1)]
Sign = Literal[1, -1]


class LensTable(Table):
    sensor_px: tuple[Annotated[int, Field(gt=0)], Annotated[int, Field(gt=0)]]
    fx_px: Positive
    fy_px: Positive
    cx_px: float
    cy_px: float
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)


class StationTable(Table):
    order: Literal["az_outer", "el_outer"] = "az_outer"
    az_sign: Sign = 1
    el_sign: Sign = 1
    eps_rad: Annotated[float, Field(gt=-0.2, lt=0.2)] = 0.0
    d_mm: float = 0.0
    zoom: Name | None = None
    world_from_gimbal: PoseTable
    rg_from_camera: PoseTable
    lens: LensTable

    def station(self, name: str) -> Station:
        return Station(
            name=name,
            world_from_gimbal=self.world_from_gimbal.rigid(),
            rg_from_camera=self.rg_from_camera.rigid(),
            lens=Lens(**self.lens.model_dump()),
            order=AxisOrder(self.order),
            az_sign=self.az_sign,
            el_sign=self.el_sign,
            eps_rad=self.eps_rad,
            d_mm=self.d_mm,
        )


class NoiseTable(Table):
    pixel_px: NotNegative
    encoder_rad: NotNegative
    encoder_fixed_rad: NotNegative = 0.0


class VolumeTable(Table):
    min_mm: Vector
    max_mm: Vector

    @model_validator(mode="after")
    def _ordered(self) -> "VolumeTable":
        if any(low > high for low, high in zip(self.min_mm, self.max_mm, strict=True)):
            raise KeyRuleError("max_mm", "must not lie below min_mm")
        return self


class VerificationTable(Table):
    status: Literal["verified", "unverified"]
    date: TimeText
    points: Annotated[int, Field(ge=0)]
    rms_mm: NotNegative
    max_mm: NotNegative
    en_max: NotNegative
    rms_limit_mm: Positive | None = None
    max_limit_mm: Positive | None = None
    en_limit: Positive = 1.0
    expires: TimeText | None = None

    @model_validator(mode="after")
    def _true_to_its_figures(self) -> "VerificationTable":
        shortcomings = self.verification().shortcomings()
        if self.status == "verified" and shortcomings:
            raise KeyRuleError("status", f"its own figures say unverified: {', '.join(shortcomings)}")
        if self.status == "unverified" and not shortcomings:
            raise KeyRuleError("status", "its own figures say verified: delete the table to withdraw the verification")
        return self

    def verification(self) -> Verification:
        return Verification(**self.model_dump(exclude={"status"}))


class FileTable(Table):
    """Version 2, whole."""

    format: Literal["trackerd-calibration"]
    version: Literal[2]
    id: Name
    created: TimeText
    software: str
    method: Name
    parent: Name | None = None
    chi2_per_dof: NotNegative | None = None
    dof: Annotated[int, Field(ge=0)] | None = None
    forced: bool = False
    forced_because: str = ""
    data: Identity | None = None
    noise: NoiseTable | None = None
    volume: VolumeTable | None = None
    verification: VerificationTable | None = None
    station: Annotated[dict[str, StationTable], Field(min_length=1)]
    covariance: CovarianceTable | None = None

    @model_validator(mode="after")
    def _forced_for_a_reason(self) -> "FileTable":
        if self.forced and not self.forced_because.strip():
            raise KeyRuleError("forced_because", "needs the reason why it was forced, in words")
        if self.forced_because and not self.forced:
            raise KeyRuleError("forced", "must be true where forced_because gives a reason")
        return self

    def calibration(self) -> Calibration:
        covariance = self.covariance or CovarianceTable(parameters=(), matrix=())
        return Calibration(
            id=self.id,
            created=self.created,
            software=self.software,
            method=self.method,
            stations={name: table.station(name) for name, table in self.station.items()},
            parameters=covariance.parameters,
            covariance=covariance.array(),
            chi2_per_dof=self.chi2_per_dof,
            forced=self.forced,
            forced_because=self.forced_because,
            dof=self.dof,
            parent=self.parent,
            data=None if self.data is None else DataIdentity(self.data.name, self.data.sha256),
            noise=None if self.noise is None else AssumedNoise(**self.noise.model_dump()),
            volume=None if self.volume is None else Volume(self.volume.min_mm, self.volume.max_mm),
            verification=None if self.verification is None else self.verification.verification(),
            zooms={name: table.zoom for name, table in self.station.items() if table.zoom is not None},
        )


def tables_of(c: Calibration, head: Tables) -> Tables:
    """As TOML has them, in the order of the file; what is not known is left out."""
    tables: Tables = {
        **head,
        "id": c.id,
        "created": c.created,
        "software": c.software,
        "method": c.method,
        "parent": c.parent,
        "chi2_per_dof": None if c.chi2_per_dof is None else float(c.chi2_per_dof),
        "dof": c.dof,
        "forced": c.forced,
        "forced_because": c.forced_because or None,
        "data": c.data and {"name": c.data.name, "sha256": c.data.sha256},
        "noise": c.noise and {key: float(value) for key, value in asdict(c.noise).items()},
        "volume": c.volume and {"min_mm": _floats(c.volume.min_mm), "max_mm": _floats(c.volume.max_mm)},
        "verification": c.verification and _verification_table(c.verification),
        "station": {name: _station_table(station, c.zooms.get(name)) for name, station in c.stations.items()},
    }
    if c.parameters:
        tables["covariance"] = {"parameters": list(c.parameters), "matrix": c.covariance.tolist()}
    return _known(tables)


def _verification_table(v: Verification) -> Tables:
    return _known(
        {
            "status": "verified" if v.verified else "unverified",
            "date": v.date,
            "expires": v.expires,
            "points": v.points,
            "rms_mm": float(v.rms_mm),
            "max_mm": float(v.max_mm),
            "en_max": float(v.en_max),
            "rms_limit_mm": v.rms_limit_mm,
            "max_limit_mm": v.max_limit_mm,
            "en_limit": float(v.en_limit),
        }
    )


def _station_table(s: Station, zoom: str | None) -> Tables:
    lens = s.lens
    return _known(
        {
            "order": str(s.order),
            "az_sign": s.az_sign,
            "el_sign": s.el_sign,
            "eps_rad": float(s.eps_rad),
            "d_mm": float(s.d_mm),
            "zoom": zoom,
            "world_from_gimbal": pose_table(s.world_from_gimbal),
            "rg_from_camera": pose_table(s.rg_from_camera),
            "lens": {
                "sensor_px": list(lens.sensor_px),
                "fx_px": float(lens.fx_px),
                "fy_px": float(lens.fy_px),
                "cx_px": float(lens.cx_px),
                "cy_px": float(lens.cy_px),
                "distortion": _floats(lens.distortion),
            },
        }
    )


def _floats(values: tuple[float, ...]) -> list[float]:
    return [float(value) for value in values]


def _known(tables: Mapping[str, Any]) -> Tables:
    return {key: value for key, value in tables.items() if value is not None}
