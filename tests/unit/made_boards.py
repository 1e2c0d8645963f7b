"""Pictures of boards whose points are known: supersampled through a lens with distortion, blurred, with noise, rounded."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from trackerd.calibrate.board_kinds import Charuco, Chessboard, CircleGrid, DotArray, predefined
from trackerd.geometry.lens import Lens
from trackerd.geometry.lens_batch import normalise_all
from trackerd.geometry.rigid import Rigid, rotation_about

Floats = npt.NDArray[np.float64]
Pattern = Callable[[Floats, Floats], Floats]  # levels 0..1 at x, y mm on the board
LENS = Lens((640, 480), 540.0, 540.0, 322.0, 236.0, (-0.25, 0.08, 0.001, -0.0005, 0.0))
FINE_PX_PER_MM = 20  # of the printed markers


@dataclass(frozen=True, slots=True)
class Picture:
    """How the camera sees: levels of black and white, blur and noise."""

    lens: Lens = LENS
    black_dn: float = 40.0
    white_dn: float = 200.0
    blur_px: float = 0.7
    noise_dn: float = 2.0
    samples: int = 5
    seed: int = 1

    def of(self, pattern: Pattern, camera_from_board: Rigid) -> npt.NDArray[np.uint8]:
        width, height = self.lens.sensor_px
        s = self.samples
        x_mm, y_mm = on_board(camera_from_board, rays(self.lens, s))
        fine = pattern(x_mm, y_mm).reshape(height, s, width, s).mean((1, 3))
        image = self.black_dn + (self.white_dn - self.black_dn) * cv2.GaussianBlur(fine, (0, 0), self.blur_px)
        noise = np.random.default_rng(self.seed).normal(0.0, self.noise_dn, image.shape)
        return np.clip(np.rint(image + noise), 0, 255).astype(np.uint8)


@cache
def rays(lens: Lens, samples: int) -> Floats:
    """Of all samples of all pixels, (n, 2), on the plane at unit distance."""
    width, height = lens.sensor_px
    u, v = ((np.arange(side * samples) + 0.5) / samples - 0.5 for side in (width, height))
    return normalise_all(lens, np.stack(np.meshgrid(u, v), axis=-1)).reshape(-1, 2)


def on_board(camera_from_board: Rigid, xy: Floats) -> tuple[Floats, Floats]:
    """Where rays (n, 2) meet the board's plane."""
    plane = np.linalg.inv(np.column_stack((camera_from_board.rotation[:, :2], camera_from_board.translation_mm)))
    p = np.column_stack((xy, np.ones(len(xy)))) @ plane.T
    return p[:, 0] / p[:, 2], p[:, 1] / p[:, 2]


def seen(lens: Lens, camera_from_board: Rigid, points_mm: Floats) -> Floats:
    """The true pixels (n, 2) of the board's points."""
    return np.array([lens.project(p) for p in camera_from_board.move(points_mm)])


def pose(board_mm: Floats, range_mm: float, tilt: tuple[float, float, float] = (0.0, 0.0, 0.0), off: Any = (0, 0)) -> Rigid:
    """The board's middle at `range_mm` in front of the camera, off by so much, turned by the vector `tilt`."""
    angle = float(np.linalg.norm(tilt))
    rotation = rotation_about(np.array(tilt) / angle, angle) if angle else np.eye(3)
    middle = (board_mm.min(0) + board_mm.max(0)) / 2
    return Rigid(rotation, np.array((*off, range_mm)) - rotation @ middle)


def chessboard(board: Chessboard) -> Pattern:
    """The square between corner 0 and its neighbours along both sides is black; a white margin round the outer squares."""

    def levels(x_mm: Floats, y_mm: Floats) -> Floats:
        i, j = np.floor(x_mm / board.square_mm), np.floor(y_mm / board.square_mm)
        inside = (i >= -1) & (j >= -1) & (i < board.corners[0]) & (j < board.corners[1])
        return np.where(inside & ((i + j) % 2 == 0), 0.0, 1.0)

    return levels


def circles(board: CircleGrid, diameter_mm: float, bright: bool = False) -> Pattern:
    return dots(board.points_mm, diameter_mm, bright)


def leds(board: DotArray, diameter_mm: float) -> Pattern:
    return dots(board.points_mm, diameter_mm, not board.dark)


def dots(points_mm: Floats, diameter_mm: float, bright: bool) -> Pattern:
    def levels(x_mm: Floats, y_mm: Floats) -> Floats:
        lit = np.zeros(x_mm.shape, bool)
        for p in points_mm:
            lit |= (x_mm - p[0]) ** 2 + (y_mm - p[1]) ** 2 < diameter_mm**2 / 4
        return np.where(lit == bright, 1.0, 0.0)

    return levels


def charuco(board: Charuco) -> Pattern:
    step = round(board.square_mm * FINE_PX_PER_MM)
    printed = cv2.aruco.CharucoBoard(board.squares, board.square_mm, board.marker_mm, predefined(board.dictionary))
    image = printed.generateImage((board.squares[0] * step, board.squares[1] * step), marginSize=0, borderBits=1)
    height, width = image.shape

    def levels(x_mm: Floats, y_mm: Floats) -> Floats:
        i, j = np.floor(x_mm * FINE_PX_PER_MM), np.floor(y_mm * FINE_PX_PER_MM)
        inside = (i >= 0) & (j >= 0) & (i < width) & (j < height)
        found = image[np.where(inside, j, 0).astype(int), np.where(inside, i, 0).astype(int)]
        return np.where(inside, found / 255.0, 1.0)

    return levels
