"""views.csv: what each gimbal saw, one line an image point. dataset.py tells the columns."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from math import pi
from pathlib import Path

import numpy as np

from trackerd.contract.model import Array
from trackerd.formats.csv_table import Findings, Row, read_rows
from trackerd.formats.dataset_points import POINTS, Point
from trackerd.formats.dataset_tables import TABLES, DatasetTables, GimbalTable
from trackerd.formats.rules import nearest

VIEWS = "views.csv"
PIXEL_COVARIANCE = ("cuu_px2", "cuv_px2", "cvv_px2")
VIEW_COLUMNS = ("view", "gimbal", "az_rad", "el_rad", "target")
VIEW_EXTRAS = ("feature", "u_px", "v_px", "sigma_px", *PIXEL_COVARIANCE, "face", "frames", "image")
MOST_RAD = 2.0 * pi  # no gimbal of a cell turns further: more than that is degrees


@dataclass(frozen=True, slots=True)
class ImagePoint:
    """One line of views.csv. `feature` counts the points of a board, 0 for a probe."""

    line: int
    view: str
    gimbal: str
    face: int  # 1, or 2 with the axes at az + 180, 180 - el
    az_rad: float
    el_rad: float
    target: str
    feature: int
    q_px: Array | None  # (2,); None: to be found in the image
    cov_px2: Array  # (2, 2)
    frames: int  # that were averaged: of the encoders' noise so much less is left
    image: Path | None

    @property
    def board(self) -> str | None:
        """The board's name where the target is one."""
        name, slash, _ = self.target.partition("/")
        return name if slash else None


@dataclass(slots=True)
class Views:
    """The lines of views.csv."""

    folder: Path
    tables: DatasetTables
    points: Mapping[str, Point]
    listed: Mapping[str, Array]
    findings: Findings

    def read(self) -> Iterator[ImagePoint]:
        angles: dict[tuple[str, str], tuple[float, float, int]] = {}
        taken: dict[tuple[str, str, str, int], int] = {}
        for row in read_rows(self.folder / VIEWS, VIEW_COLUMNS, VIEW_EXTRAS, self.findings):
            point = self._point(row)
            if point is None:
                continue
            az, el, line = angles.setdefault((point.gimbal, point.view), (point.az_rad, point.el_rad, row.line))
            if (az, el) != (point.az_rad, point.el_rad):
                row.refuse("az_rad", f"a view has one pair of angles: line {line} has others for view {point.view}")
            first = taken.setdefault((point.gimbal, point.view, point.target, point.feature), row.line)
            if first != row.line:
                row.refuse("target", f"is there twice in view {point.view}, first in line {first}")
            yield point

    def _point(self, row: Row) -> ImagePoint | None:
        gimbal = row.text("gimbal")
        if gimbal not in self.tables.gimbal:
            row.refuse("gimbal", f"there is no [gimbal.{gimbal}] in {TABLES}{nearest(gimbal, list(self.tables.gimbal))}")
            return None
        table = self.tables.gimbal[gimbal]
        image = self.folder / row.values["image"] if row.has("image") else None
        if image is not None and not image.is_file():
            row.refuse("image", f"no such file: {image}")
        face = int(row.number("face", 1.0))
        if face not in (1, 2):
            row.refuse("face", "must be 1 or 2")
        return ImagePoint(
            line=row.line,
            view=row.text("view"),
            gimbal=gimbal,
            face=face,
            az_rad=self._angle(row, "az_rad"),
            el_rad=self._angle(row, "el_rad"),
            target=self._target(row),
            feature=self._feature(row),
            q_px=self._pixel(row, table, image),
            cov_px2=self._cov(row, table),
            frames=self._frames(row),
            image=image,
        )

    def _angle(self, row: Row, column: str) -> float:
        angle = row.number(column)
        if abs(angle) > MOST_RAD:
            row.refuse(column, "is more than a turn: angles are in radians here (these look like degrees)")
        return angle

    def _target(self, row: Row) -> str:
        target = row.text("target")
        board, slash, placement = target.partition("/")
        if slash and (board not in self.tables.board or not placement):
            row.refuse("target", f"is BOARD/PLACEMENT; there is no [board.{board}] in {TABLES}")
        elif not slash and target and target not in self.points:
            row.refuse("target", f"is not in {POINTS}{nearest(target, list(self.points)) if self.points else ''}")
        return target

    def _frames(self, row: Row) -> int:
        frames = row.number("frames", 1.0)
        if frames != int(frames) or frames < 1:
            row.refuse("frames", "must be a whole number, 1 or above")
        return max(1, int(frames))

    def _feature(self, row: Row) -> int:
        number = row.number("feature", 0.0)
        board = row.values.get("target", "").partition("/")[0]
        count = len(self.listed[board]) if board in self.listed else None
        if number != int(number) or number < 0 or (count is not None and number >= count):
            row.refuse("feature", "must be a whole number, 0 or above" + (f" and below {count}" if count is not None else ""))
        return int(number)

    def _pixel(self, row: Row, table: GimbalTable, image: Path | None) -> Array | None:
        if not row.has("u_px") and not row.has("v_px") and image is not None and "/" in row.values["target"]:
            return None
        q_px = np.array((row.number("u_px"), row.number("v_px")))
        for column, value, size in zip(("u_px", "v_px"), q_px, table.sensor_px, strict=True):
            if not -0.5 <= value <= size - 0.5:
                row.refuse(column, f"is not on the sensor of {table.sensor_px[0]} x {table.sensor_px[1]} px")
        return q_px

    def _cov(self, row: Row, table: GimbalTable) -> Array:
        if any(row.has(column) for column in PIXEL_COVARIANCE):
            uu, uv, vv = (row.number(column) for column in PIXEL_COVARIANCE)
            if not (uu > 0.0 and vv > 0.0 and uu * vv > uv * uv):
                row.refuse("cuu_px2", "the covariance must be positive definite")
            return np.array(((uu, uv), (uv, vv)))
        sigma_px = row.number("sigma_px", table.pixel_sigma_px)
        if sigma_px <= 0.0:
            row.refuse("sigma_px", "must be above 0")
        return sigma_px**2 * np.eye(2)
