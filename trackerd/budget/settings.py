"""The settings of `trackerd budget`: cases, layouts, noise. What they mean is told in config/budget.toml, whose values are the
defaults here: the simulation of chapter 4 of the source thesis, as far as its tables tell it.
"""

import re
from collections.abc import Sequence
from math import hypot
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, field_validator

from trackerd.contract.errors import ConfigError
from trackerd.contract.model import Array
from trackerd.formats.settings import ARCSEC, NotNegative, Positive, Settings
from trackerd.formats.tables import Problems, override, read_tables
from trackerd.geometry.gimbal import AxisOrder

FEWEST_GIMBALS = 2
FEWEST_POINTS = 6  # a view of five has no redundancy: calibrateCamera frees ten parameters
NAME = re.compile(r"[a-zA-Z][a-zA-Z0-9_-]*")

Vector = tuple[float, float, float]
PositiveVector = tuple[Positive, Positive, Positive]
Count = Annotated[int, Field(ge=1, le=100_000)]


class CameraModel(Settings):
    """The camera of every gimbal: square pixels, the principal point in the middle, no distortion."""

    sensor_px: tuple[Annotated[int, Field(ge=32, le=65_536)], Annotated[int, Field(ge=32, le=65_536)]] = (2048, 1536)
    focal_px: Annotated[float, Field(ge=100, le=1e6)] = 2000.0
    lever_arm_mm: Vector = (0.0, -124.5, 0.0)  # of the entrance pupil, in RG


class Points(Settings):
    """Where the known points, and the targets, are: uniform in a box."""

    count: Annotated[int, Field(ge=FEWEST_POINTS, le=1000)] = 12
    centre_mm: Vector = (0.0, 0.0, 0.0)
    half_size_mm: PositiveVector = (150.0, 250.0, 50.0)
    draw: Annotated[int, Field(ge=0, lt=1 << 31)] = 2  # seed of the points; others than that of the noise
    draws: Annotated[int, Field(ge=1, le=10_000)] = 1  # trials take turns over so many sets of points


class Adjustment(Settings):
    """What the bundle adjustment sees beside the one view of all points."""

    looks: Annotated[int, Field(ge=1, le=1000)] = 3  # at each point, the gimbal aimed at it
    ring_px: NotNegative = 0.0  # radius of the looks' image positions about the principal point


class Case(Settings):
    """The noise of one case. The thesis's pixel levels are 3 sigma, its encoder levels 1 sigma."""

    pixel_3sigma_px: Annotated[float, Field(ge=0, le=100)] = 0.0
    encoder_arcsec: Annotated[float, Field(ge=0, le=3600)] = 0.0  # white: other with each reading
    encoder_fixed_arcsec: Annotated[float, Field(ge=0, le=3600)] = 0.0  # rms of the part that is a function of the angle

    @property
    def pixel_sigma_px(self) -> float:
        return self.pixel_3sigma_px / 3.0

    @property
    def encoder_sigma_rad(self) -> float:
        return self.encoder_arcsec * ARCSEC

    @property
    def encoder_fixed_rad(self) -> float:
        return self.encoder_fixed_arcsec * ARCSEC

    @property
    def encoders_rad(self) -> float:
        """Both parts."""
        return hypot(self.encoder_sigma_rad, self.encoder_fixed_rad)


class GimbalPlace(Settings):
    """Where one gimbal stands."""

    position_mm: Vector
    faces_mm: Vector | None = None  # z_G looks at this point of W; default: along z_W
    az_axis: Vector = (1.0, 0.0, 0.0)  # x_G is this direction of W, as nearly as z_G lets it
    aim_mm: Vector | None = None  # where the one view of all points is aimed; default: at their mean
    order: Literal["az_outer", "el_outer"] = "az_outer"

    @property
    def axis_order(self) -> AxisOrder:
        return AxisOrder(self.order)

    @property
    def facing(self) -> Array:
        """Along z_G, (3,), of any length."""
        if self.faces_mm is None:
            return np.array((0.0, 0.0, 1000.0))
        return np.subtract(self.faces_mm, self.position_mm)


class Layout(Settings):
    """The gimbals, by name."""

    source_spacing_mm: Literal[1000, 500] | None = None  # printed beside the thesis's tables of this spacing
    gimbal: dict[str, GimbalPlace]

    @field_validator("gimbal")
    @classmethod
    def _enough(cls, value: dict[str, GimbalPlace]) -> dict[str, GimbalPlace]:
        if len(value) < FEWEST_GIMBALS:
            raise ValueError(f"a position needs at least {FEWEST_GIMBALS} gimbals, here {len(value)}")
        return value


class Volume(Settings):
    """The noise and the volume of `--cell`; encoders and calibration are the cell's own."""

    pixel_sigma_px: Annotated[float, Field(gt=0, le=100)] = 0.1  # of the ball's centre in one picture
    centre_mm: Vector = (0.0, 0.0, 0.0)
    half_size_mm: PositiveVector = (200.0, 200.0, 150.0)
    steps: Annotated[int, Field(ge=2, le=41)] = 9  # along each axis


def _pair(spacing_mm: Literal[1000, 500]) -> Layout:
    half_mm = spacing_mm / 2.0
    places = {name: GimbalPlace(position_mm=(0.0, y, -1000.0)) for name, y in (("left", -half_mm), ("right", half_mm))}
    return Layout(source_spacing_mm=spacing_mm, gimbal=places)


def _source_cases() -> dict[str, Case]:
    encoders = {"B": 10.0, "C": 36.0, "D": 360.0}
    pixels = {"E": 0.03125, "F": 0.1, "G": 0.25, "H": 0.5}
    return {
        "A": Case(),
        **{name: Case(encoder_arcsec=level) for name, level in encoders.items()},
        **{name: Case(pixel_3sigma_px=level) for name, level in pixels.items()},
    }


def _source_layouts() -> dict[str, Layout]:
    return {"spacing-1000": _pair(1000), "spacing-500": _pair(500)}


class BudgetSettings(Settings):
    """A whole file."""

    trials: Count = 200
    seed: Annotated[int, Field(ge=0, lt=1 << 63)] = 1
    camera: CameraModel = CameraModel()
    points: Points = Points()
    adjustment: Adjustment = Adjustment()
    case: dict[str, Case] = Field(default_factory=_source_cases)
    layout: dict[str, Layout] = Field(default_factory=_source_layouts)
    volume: Volume = Volume()

    @field_validator("case", "layout")
    @classmethod
    def _named(cls, value: dict[str, Settings]) -> dict[str, Settings]:
        if not value:
            raise ValueError("needs at least one table")
        for name in value:
            if not NAME.fullmatch(name):
                raise ValueError(f'"{name}": a name has letters, digits, - and _ only, and begins with a letter')
        return value


def load_budget(path: Path | None, overrides: Sequence[str] = ()) -> BudgetSettings:
    """The settings of a file, or the defaults, with `table.key=value` laid over them.

    Raises ConfigError with every error: file, table, key, value, rule.
    """
    tables = BudgetSettings().model_dump(mode="json") if path is None else read_tables(path)
    problems = Problems("budget" if path is None else path.name)
    for text in overrides:
        try:
            where, value = override(tables, text)
        except ConfigError as error:
            problems.lines.append(str(error))
        else:
            problems.overridden[where] = value
    settings = problems.check(BudgetSettings, tables)
    if settings is not None:
        _check_places(settings, problems)
    problems.raise_any()
    assert settings is not None
    return settings


def _check_places(settings: BudgetSettings, problems: Problems) -> None:
    """What no single key can tell: a gimbal that looks along its own AZ axis, or at where it stands."""
    for layout, places in settings.layout.items():
        for name, place in places.gimbal.items():
            table = ("layout", layout, "gimbal", name)
            facing = place.facing
            if not np.linalg.norm(facing) > 1.0:
                problems.add(table, "faces_mm", place.faces_mm, "must be at least 1 mm away from position_mm")
            elif not np.linalg.norm(np.cross(facing, place.az_axis)) > 1e-3 * np.linalg.norm(facing):
                problems.add(
                    table, "az_axis", place.az_axis, "must be a direction that is not parallel to where the gimbal looks"
                )
