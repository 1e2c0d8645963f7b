"""What is seen of a board in one picture, whichever kind it is."""

from typing import assert_never

import cv2
import numpy as np

from trackerd.calibrate.board_kinds import Board, Charuco, Chessboard, CircleGrid, Detection, DotArray
from trackerd.calibrate.charuco import detect_charuco
from trackerd.calibrate.chessboard import detect_chessboard
from trackerd.calibrate.circle_grid import detect_circle_grid
from trackerd.calibrate.dot_array import detect_dot_array
from trackerd.contract.model import Image

DARKEST, BRIGHTEST = 0.1, 99.9  # percentiles of a 16 bit picture that become black and white


def detect(board: Board, image: Image) -> Detection:
    """`image` (height, width), uint8 or uint16; a pixel's centre is an integer. Never raises for what a picture holds."""
    grey = eight_bits(image)
    match board:
        case Chessboard():
            return detect_chessboard(board, grey)
        case Charuco():
            return detect_charuco(board, grey)
        case CircleGrid():
            return detect_circle_grid(board, grey)
        case DotArray():
            return detect_dot_array(board, grey)
        case _:
            assert_never(board)


def eight_bits(image: Image) -> Image:
    """What OpenCV's detectors take: levels of a 16 bit picture stretched from its darkest to its brightest."""
    if image.dtype == np.uint8:
        return image
    low, high = np.percentile(image, (DARKEST, BRIGHTEST))
    return np.asarray(cv2.convertScaleAbs(image - min(low, high - 1.0), alpha=255.0 / max(high - low, 1.0)))
