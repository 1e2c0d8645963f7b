"""Boards of a dataset: where their points are on them, and where in a picture."""

from collections.abc import Sequence

import cv2
import numpy as np

from trackerd.calibrate.board_kinds import Board, Charuco, Chessboard, CircleGrid, DotArray, Missed
from trackerd.calibrate.boards import detect
from trackerd.calibrate.cell_data import BoardPoint
from trackerd.contract.errors import ConfigError
from trackerd.contract.model import Array
from trackerd.formats.dataset import Dataset
from trackerd.formats.dataset_views import ImagePoint


def board_points(dataset: Dataset, name: str) -> Array:
    """(n, 3) in the board's own frame, by feature."""
    return board_of(dataset, name).points_mm


def board_of(dataset: Dataset, name: str) -> Board:
    """Raises ConfigError for a table that describes no such board."""
    table = dataset.boards[name]
    try:
        if table.kind == "points":
            return DotArray(dataset.board_points_mm[name], name, table.facing, table.dark)
        assert table.columns is not None
        assert table.rows is not None
        assert table.square_mm is not None
        size = table.columns, table.rows
        if table.kind == "chessboard":
            return Chessboard(size, table.square_mm)
        if table.kind == "charuco":
            return Charuco(size, table.square_mm, table.marker_mm or 0.0, table.dictionary or "", table.legacy)
        return CircleGrid(size, table.square_mm, asymmetric=table.kind == "acircles")
    except ConfigError as error:
        raise ConfigError(f"dataset.toml [board.{name}]: {error}") from None


def find_board(dataset: Dataset, line: ImagePoint) -> Sequence[BoardPoint] | str:
    """The board's points in the line's picture, or why there is none."""
    assert line.image is not None
    assert line.board is not None
    image = cv2.imread(str(line.image), cv2.IMREAD_GRAYSCALE)
    if image is None:
        return "is no picture that can be read"
    sensor = dataset.gimbals[line.gimbal].sensor_px
    if image.shape != sensor[::-1]:
        return f"is {image.shape[1]} x {image.shape[0]} px, the sensor {sensor[0]} x {sensor[1]}"
    found = detect(board_of(dataset, line.board), np.asarray(image))
    if isinstance(found, Missed):
        return found.reason
    return [BoardPoint(int(i), q, float(s)) for i, q, s in zip(found.index, found.q_px, found.sigma_px, strict=True)]
