"""ChArUco boards in pictures: the markers' ids say which corners are seen."""

import cv2
import numpy as np

from trackerd.calibrate.board_kinds import Charuco, Detected, Detection, Missed, predefined
from trackerd.calibrate.corners import CLEAR_SHARE, refine, spacing
from trackerd.contract.model import Array, Image

MARGIN_SHARE = 0.75  # of the white margin between a corner and its markers
FEWEST_CORNERS = 6  # fewer tell less than a pose with a check


def detect_charuco(board: Charuco, image: Image) -> Detection:
    """`image` (height, width) uint8. A part of the board will do: at least six corners, not all on one line."""
    printed = cv2.aruco.CharucoBoard(board.squares, board.square_mm, board.marker_mm, predefined(board.dictionary))
    printed.setLegacyPattern(board.legacy)
    corners, ids, _, markers = cv2.aruco.CharucoDetector(printed).detectBoard(image)
    if ids is None or len(ids) < FEWEST_CORNERS:
        return Missed(_why(board, 0 if ids is None else len(ids), 0 if markers is None else len(markers)))
    order = np.argsort(ids.ravel())
    index, q_px = ids.ravel()[order].astype(np.intp), corners.reshape(-1, 2)[order].astype(np.float64)
    if _on_a_line(board.points_mm[index]):
        return Missed(f"only one line of the board's corners ({len(index)})")
    to_marker = 0.5 * (1.0 - board.marker_mm / board.square_mm)  # of a square's side
    q_px, sigma_px = refine(image, q_px, min(CLEAR_SHARE, MARGIN_SHARE * to_marker) * spacing(q_px))
    return Detected(index, q_px, sigma_px)


def _why(board: Charuco, corners: int, markers: int) -> str:
    if not markers:
        return f"no marker of {board.dictionary}"
    seen = f"{markers} markers, {corners} corners; {FEWEST_CORNERS} are needed"
    if markers >= FEWEST_CORNERS and not corners:
        return f"{seen}: other squares or another pattern than {board.name}?"
    return seen


def _on_a_line(points_mm: Array) -> bool:
    return bool(np.linalg.matrix_rank(points_mm - points_mm.mean(0), tol=1e-6 * np.ptp(points_mm)) < 2)
