"""Points of a board as a camera would see them, without pictures: true pixels and seeded noise."""

from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from trackerd.calibrate.board_kinds import Board, Chessboard, Detected
from trackerd.geometry.lens import Lens
from trackerd.geometry.lens_batch import project_all

Floats = npt.NDArray[np.float64]
BOARD = Chessboard((6, 5), 30.0)
WIDE = Lens((640, 480), 540.0, 540.0, 322.0, 236.0, (-0.25, 0.08, 0.001, -0.0005, 0.0))
NARROW = Lens((2048, 1536), 31000.0, 31000.0, 1030.0, 760.0)  # 4 degrees, as the source thesis's zoom lens


def views(
    lens: Lens = WIDE,
    board: Board = BOARD,
    count: int = 12,
    sigma_px: float = 0.1,
    seed: int = 0,
    ranges_mm: tuple[float, float] = (250.0, 450.0),
    tilt: float = 0.6,
    share: float = 0.5,
) -> list[tuple[str, Detected]]:
    """`count` boards, each whole in the picture; `share`: of the field that their middles fill."""
    rng = np.random.default_rng(seed)
    found: list[tuple[str, Detected]] = []
    while len(found) < count:
        rotation = cv2.Rodrigues(rng.uniform(-tilt, tilt, 3))[0]
        middle = (board.points_mm.min(0) + board.points_mm.max(0)) / 2
        range_mm = rng.uniform(*ranges_mm)
        half = share * range_mm * np.array(lens.sensor_px) / (2 * lens.fx_px)
        off = np.array((*rng.uniform(-half, half), range_mm))
        q = project_all(lens, (board.points_mm - middle) @ rotation.T + off)
        if (q >= 0).all() and (q <= np.array(lens.sensor_px) - 1).all():
            noisy = q + rng.normal(0.0, sigma_px, q.shape)
            found.append((f"{len(found):02d}.png", Detected(np.arange(len(q)), noisy, np.full(len(q), sigma_px))))
    return found


def intrinsics(lens: Lens) -> Floats:
    return np.array([lens.fx_px, lens.fy_px, lens.cx_px, lens.cy_px, *lens.distortion])


def moved(one: Detected, points: Any, shift_px: tuple[float, float]) -> Detected:
    """With gross errors."""
    q = one.q_px.copy()
    q[points] += shift_px
    return Detected(one.index, q, one.sigma_px)
