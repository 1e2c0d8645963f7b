"""The tables of a dataset's dataset.toml, as models; what they mean is told in dataset.py."""

from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from trackerd.formats.file_parts import PoseTable
from trackerd.formats.settings import ARCSEC, KeyRuleError, NotNegative, Positive, Settings

TABLES = "dataset.toml"
Vector = tuple[float, float, float]
Sign = Literal[1, -1]
Count = Annotated[int, Field(ge=2, le=200)]


class MoverTable(Settings):
    """What carried the target, and how well its own coordinates are known."""

    kind: Literal["cnc", "robot", "none"] = "none"
    frame: Annotated[str, Field(min_length=1)] = "machine"  # the name of the frame of all coordinates
    sigma_mm: Annotated[float, Field(gt=0, le=100)] | None = None  # of a coordinate that has none of its own
    ball_mm: Vector = (0.0, 0.0, 0.0)  # robot: the ball in the flange, a start value
    ball_sigma_mm: Positive | None = None  # how well that is known; default: it is only a start value


class GimbalTable(Settings):
    """What is believed of one gimbal before it is calibrated."""

    sensor_px: tuple[Annotated[int, Field(gt=0)], Annotated[int, Field(gt=0)]]
    focal_px: Positive | None = None
    lever_mm: Vector = (0.0, 0.0, 0.0)
    order: Literal["az_outer", "el_outer"] = "az_outer"
    az_sign: Sign = 1
    el_sign: Sign = 1
    encoder_sigma_arcsec: Positive = 2.0
    encoder_fixed_arcsec: NotNegative = 0.0
    pixel_sigma_px: Positive = 0.1  # of an image point that has none of its own

    @property
    def encoder_sigma_rad(self) -> float:
        """Of one frame."""
        return self.encoder_sigma_arcsec * ARCSEC

    @property
    def encoder_fixed_rad(self) -> float:
        return self.encoder_fixed_arcsec * ARCSEC


class BoardTable(Settings):
    """A board whose points have known places on it."""

    kind: Literal["chessboard", "charuco", "circles", "acircles", "points"]
    columns: Count | None = None  # chessboard: of inner corners; charuco: of squares
    rows: Count | None = None
    square_mm: Positive | None = None  # circles: from centre to centre
    marker_mm: Positive | None = None
    dictionary: str | None = None
    legacy: bool = False  # charuco: the pattern of OpenCV before 4.6
    file: Path | None = None  # kind "points", LEDs or dots anywhere: feature,x_mm,y_mm,z_mm
    facing: Vector = (0.0, 0.0, -1.0)  # of these: the side that they are seen from
    dark: bool = False

    @model_validator(mode="after")
    def _whole(self) -> Self:
        needed = {"points": ("file",), "charuco": ("columns", "rows", "square_mm", "marker_mm", "dictionary")}
        for key in needed.get(self.kind, ("columns", "rows", "square_mm")):
            if getattr(self, key) is None:
                raise KeyRuleError(key, f'is missing: a board of kind "{self.kind}" needs it')
        return self


class PlacementTable(PoseTable):
    """Where a board is, world_from_board: exactly, or (fixed = false) as a start value."""

    fixed: bool = True


class BarTable(Settings):
    """A known distance between two points."""

    between: tuple[str, str]
    length_mm: Positive
    sigma_mm: Positive

    @model_validator(mode="after")
    def _two(self) -> Self:
        if self.between[0] == self.between[1]:
            raise KeyRuleError("between", "a bar is between two different points")
        return self


class PriorTable(Settings):
    """1 sigma of what is believed of every gimbal beforehand; a key that is not there has the adjustment's default."""

    mount_xy_mm: Positive | None = None  # the camera's place, across its optical axis
    mount_z_mm: Positive | None = None  # along it: the entrance pupil
    mount_rotation_rad: Positive | None = None
    eps_rad: Positive | None = None
    d_mm: Positive | None = None
    f_relative: Positive | None = None
    centre_px: Positive | None = None
    distortion_at_corner: Positive | None = None

    def given(self) -> dict[str, float]:
        return self.model_dump(exclude_none=True)


class DatasetTables(Settings):
    """The whole file."""

    format: Literal["trackerd-dataset"]
    version: Literal[1]
    created: str = ""
    note: str = ""
    start: Path | None = None  # a calibration file: its stations are the start values
    gimbal: Annotated[dict[str, GimbalTable], Field(min_length=1)]
    mover: MoverTable = MoverTable()
    board: dict[str, BoardTable] = Field(default_factory=dict)
    placement: dict[str, PlacementTable] = Field(default_factory=dict)
    bar: tuple[BarTable, ...] = ()
    priors: PriorTable = PriorTable()
