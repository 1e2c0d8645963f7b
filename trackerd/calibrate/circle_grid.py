"""Grids of dots in pictures: OpenCV finds the order, the centres are those of the dots' light, corrected for perspective."""

import cv2
import numpy as np

from trackerd.calibrate.blobs import Spots, find_spots
from trackerd.calibrate.board_kinds import CircleGrid, Detected, Detection, Indices, Missed
from trackerd.calibrate.corners import spacing
from trackerd.contract.model import Array, Image

PAINTED_SPACING_PX, PAINTED_RADIUS_PX = 30.0, 7
SAME_SPOT = 0.5  # of the distance to the next dot


def detect_circle_grid(board: CircleGrid, image: Image) -> Detection:
    """`image` (height, width) uint8. The whole grid or nothing. Dark dots are tried first, then bright ones."""
    count, most = board.dots[0] * board.dots[1], 0
    for dark in (True, False):
        spots = find_spots(image, dark)
        most = max(most, len(spots))
        order = _order(board, spots) if len(spots) >= count else None
        if order is not None:
            q_px = spots.q_px[order] - _perspective_shift(board.points_mm, spots.q_px[order], spots.area_px2[order])
            return Detected(np.arange(count), q_px, spots.sigma_px[order])
    if most < count:
        return Missed(f"{most} dots, {count} are needed")
    return Missed(f"{most} dots, but no grid of {board.dots[0]} x {board.dots[1]} among them")


def _order(board: CircleGrid, spots: Spots) -> list[int] | None:
    """Indices of the spots in the board's order."""
    kind = cv2.CALIB_CB_ASYMMETRIC_GRID if board.asymmetric else cv2.CALIB_CB_SYMMETRIC_GRID
    scale = PAINTED_SPACING_PX / float(np.median(spacing(spots.q_px)))
    painted, shift = _painted(spots.q_px * scale)
    found, centres = cv2.findCirclesGrid(painted, board.dots, flags=kind | cv2.CALIB_CB_CLUSTERING)
    if not found:
        return None
    centres = (centres.reshape(-1, 2) + shift) / scale
    chosen = np.linalg.norm(centres[:, None] - spots.q_px[None], axis=2).argmin(1)
    if np.unique(chosen).size != chosen.size:
        return None
    return [int(n) for n in chosen[_numbering(board, spots.q_px[chosen])]]


def _painted(q_px: Array) -> tuple[Image, Array]:
    """Clean black dots on white, all alike, and the corner of their picture: what OpenCV's own search of dots finds surely."""
    shift = q_px.min(0) - PAINTED_SPACING_PX
    width, height = np.ceil(q_px.max(0) - shift + PAINTED_SPACING_PX).astype(int)
    canvas = np.full((height, width), 255, np.uint8)
    for x, y in np.rint(q_px - shift).astype(int).tolist():
        cv2.circle(canvas, (x, y), PAINTED_RADIUS_PX, 0, -1, cv2.LINE_AA)
    return canvas, shift


def _numbering(board: CircleGrid, q_px: Array) -> Indices:
    """The order that shows the board's front, and of those that look alike the one that begins nearest to the upper left."""
    columns, rows = board.dots
    grid = np.arange(columns * rows).reshape(rows, columns)
    turns = [grid, grid[::-1, ::-1], grid[:, ::-1], grid[::-1]]
    if columns == rows and not board.asymmetric:
        turns += [turn.T for turn in turns]
    fitting = [turn for turn in turns if _fits(board.points_mm, q_px[turn.ravel()])]
    best = min(fitting or [grid], key=lambda turn: float(q_px[turn[0, 0]].sum()))
    return np.asarray(best.ravel(), np.intp)


def _fits(points_mm: Array, q_px: Array) -> bool:
    """Whether a homography that does not mirror maps the one to the other."""
    h, _ = cv2.findHomography(points_mm[:, :2], q_px)
    if h is None:
        return False
    mapped = cv2.perspectiveTransform(points_mm[None, :, :2], h)[0]
    close = np.linalg.norm(mapped - q_px, axis=1).max() < SAME_SPOT * np.linalg.norm(q_px[1] - q_px[0])
    return bool(close and np.linalg.det(h) > 0.0)


def _perspective_shift(points_mm: Array, q_px: Array, area_px2: Array) -> Array:
    """Centre of each dot's image minus the image of its centre, (n, 2): a circle's picture is an ellipse, and the far half of
    it is the smaller one (Heikkila 2000). The dots' size on the board is that of their pictures."""
    h = np.asarray(cv2.findHomography(points_mm[:, :2], q_px)[0], float)
    slopes = np.array([_slopes(h, p) for p in points_mm[:, :2]])
    radius_mm = float(np.median(np.sqrt(area_px2 / np.abs(np.linalg.det(slopes)) / np.pi)))
    return np.array([_ellipse_centre(h, p, radius_mm) - _map(h, p) for p in points_mm[:, :2]])


def _map(h: Array, p_mm: Array) -> Array:
    mapped = h @ (p_mm[0], p_mm[1], 1.0)
    return np.asarray(mapped[:2] / mapped[2])


def _slopes(h: Array, p_mm: Array) -> Array:
    """d pixel / d mm of the homography, (2, 2)."""
    mapped = h @ (p_mm[0], p_mm[1], 1.0)
    return np.asarray((h[:2, :2] - np.outer(mapped[:2] / mapped[2], h[2, :2])) / mapped[2])


def _ellipse_centre(h: Array, p_mm: Array, radius_mm: float) -> Array:
    """Of the picture of a circle: the pole of the line at infinity, from the dual conic."""
    x, y = p_mm
    circle = np.array([[radius_mm**2 - x * x, -x * y, -x], [-x * y, radius_mm**2 - y * y, -y], [-x, -y, -1.0]])
    dual = h @ circle @ h.T
    return np.asarray(dual[:2, 2] / dual[2, 2])
