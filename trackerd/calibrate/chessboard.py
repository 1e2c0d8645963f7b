"""Chessboards in pictures: OpenCV's sector-based detector (Duda and Frese, 2018), then every corner refined."""

from collections.abc import Sequence

import cv2
import numpy as np

from trackerd.calibrate.board_kinds import Chessboard, Detected, Detection, Missed
from trackerd.calibrate.corners import CLEAR_SHARE, refine, spacing
from trackerd.contract.model import Array, Image

TRIES = (  # a board that one of them misses is often found by the next
    cv2.CALIB_CB_ACCURACY,
    cv2.CALIB_CB_ACCURACY | cv2.CALIB_CB_NORMALIZE_IMAGE,
    cv2.CALIB_CB_ACCURACY | cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE,
)
LARGE_PX = 1400  # side of a picture that is searched at this size first: the search takes a second for each million pixels


def detect_chessboard(board: Chessboard, image: Image) -> Detection:
    """`image` (height, width) uint8. The whole board or nothing: without ids nobody knows which part is seen."""
    corners_px = _found(board, image)
    if corners_px is None:
        columns, rows = board.corners
        return Missed(f"no chessboard of {columns} x {rows} inner corners, whole and with its white margin")
    q_px = ordered(board, image, corners_px)
    q_px, sigma_px = refine(image, q_px, CLEAR_SHARE * spacing(q_px))
    return Detected(np.arange(len(q_px)), q_px, sigma_px)


def _found(board: Chessboard, image: Image) -> Array | None:
    """Corners (n, 2) to a pixel or better, in whichever order."""
    scale = LARGE_PX / max(image.shape)
    if scale >= 1.0:
        return _searched(board, image, TRIES)
    small = _searched(board, cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), TRIES)
    if small is not None:
        return np.asarray((small + 0.5) / scale - 0.5)
    return _searched(board, image, TRIES[1:2])  # its squares may be small


def _searched(board: Chessboard, image: Image, tries: Sequence[int]) -> Array | None:
    for flags in tries:
        found, corners = cv2.findChessboardCornersSB(image, board.corners, flags=flags)
        if found:
            return np.asarray(corners, float).reshape(-1, 2)
    return None


def ordered(board: Chessboard, image: Image, q_px: Array) -> Array:
    """Corner 0 where the board's description has it; the picture is the board's front, so x to y turns as in the picture."""
    columns, rows = board.corners
    grid = q_px.reshape(rows, columns, 2)
    if _handedness(grid) < 0.0:
        grid = grid[:, ::-1]
    if columns == rows:
        return min((np.ascontiguousarray(_turned(grid, n)) for n in range(4)), key=lambda g: _rank(image, g)).reshape(-1, 2)
    return min((grid, grid[::-1, ::-1]), key=lambda g: _rank(image, g)).reshape(-1, 2)


def _rank(image: Image, grid: Array) -> tuple[bool, float]:
    """Black at corner 0 comes first, then what is nearer to the upper left."""
    return not _black_first(image, grid), float(grid[0, 0].sum())


def _turned(grid: Array, quarters: int) -> Array:
    return np.rot90(grid, quarters, axes=(0, 1))


def _handedness(grid: Array) -> float:
    along, down = grid[0, -1] - grid[0, 0], grid[-1, 0] - grid[0, 0]
    return float(along[0] * down[1] - along[1] * down[0])


def _black_first(image: Image, grid: Array) -> bool:
    """Whether the squares of corner 0's colour are the darker ones, over the whole board."""
    middles = (grid[:-1, :-1] + grid[1:, :-1] + grid[:-1, 1:] + grid[1:, 1:]) / 4.0
    x, y = np.rint(middles).astype(int).transpose(2, 0, 1)
    inside = (x >= 0) & (y >= 0) & (x < image.shape[1]) & (y < image.shape[0])
    level = image[np.clip(y, 0, image.shape[0] - 1), np.clip(x, 0, image.shape[1] - 1)].astype(float)
    even = np.add.outer(np.arange(x.shape[0]), np.arange(x.shape[1])) % 2 == 0
    return bool(level[even & inside].mean() < level[~even & inside].mean())
