"""Sharp shapes on a grid of subpixels: how much of each subpixel a shape covers, exactly where the edge is straight.

Coordinates are the image's own: an integer is a pixel's centre, so pixel i reaches from i - 1/2 to i + 1/2.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import hypot, sqrt
from typing import NamedTuple, TypeAlias

import numpy as np

from trackerd.contract.model import Array

SOFT_SLOPE = 0.8  # tanh(0.8 z) is the normal integral's shape to 2 %


class Window(NamedTuple):
    """A rectangle of whole pixels."""

    left: int
    top: int
    width: int
    height: int

    def grown(self, margin_px: int) -> "Window":
        return Window(self.left - margin_px, self.top - margin_px, self.width + 2 * margin_px, self.height + 2 * margin_px)

    def clipped(self, other: "Window") -> "Window":
        """What both have in common; a width or height of 0 where there is nothing."""
        left, top = max(self.left, other.left), max(self.top, other.top)
        right = min(self.left + self.width, other.left + other.width)
        bottom = min(self.top + self.height, other.top + other.height)
        return Window(left, top, max(0, right - left), max(0, bottom - top))

    @property
    def empty(self) -> bool:
        return self.width == 0 or self.height == 0


def window_about(x_px: float, y_px: float, reach_x_px: float, reach_y_px: float) -> Window:
    """The smallest window that holds x ± reach, y ± reach, edges of its pixels included."""
    left, top = int(np.floor(x_px - reach_x_px)), int(np.floor(y_px - reach_y_px))
    return Window(left, top, int(np.ceil(x_px + reach_x_px)) - left + 1, int(np.ceil(y_px + reach_y_px)) - top + 1)


@dataclass(frozen=True, slots=True)
class Grid:
    """`fine` x `fine` subpixels in each pixel of a window."""

    window: Window
    fine: int

    @property
    def shape(self) -> tuple[int, int]:
        return self.window.height * self.fine, self.window.width * self.fine

    @property
    def x_px(self) -> Array:
        """Centres of the subpixels' columns, (1, columns)."""
        return self.window.left - 0.5 + (np.arange(self.shape[1])[None, :] + 0.5) / self.fine

    @property
    def y_px(self) -> Array:
        """Centres of the subpixels' rows, (rows, 1)."""
        return self.window.top - 0.5 + (np.arange(self.shape[0])[:, None] + 0.5) / self.fine

    def part(self, window: Window) -> "Grid":
        """The subpixels of this grid that are in a window, too."""
        return Grid(self.window.clipped(window), self.fine)

    def of(self, values: Array, part: "Grid") -> Array:
        """The view of `values`, (rows, columns) of this grid, that belongs to a part of it."""
        row = (part.window.top - self.window.top) * self.fine
        column = (part.window.left - self.window.left) * self.fine
        return values[row : row + part.shape[0], column : column + part.shape[1]]


@dataclass(frozen=True, slots=True)
class Disc:
    """A round thing that is no ball: a hole, a screw's head. `soft_px` is the sigma of an edge that is out of focus."""

    x_px: float
    y_px: float
    r_px: float
    level_dn: float
    soft_px: float = 0.0

    def box(self) -> Window:
        reach_px = self.r_px + 4.0 * self.soft_px + 1.0
        return window_about(self.x_px, self.y_px, reach_px, reach_px)

    def cover(self, grid: Grid) -> Array:
        dx, dy = grid.x_px - self.x_px, grid.y_px - self.y_px
        radius = np.maximum(np.hypot(dx, dy), 1e-9)
        return _covered(self.r_px - radius, dx / radius, dy / radius, grid.fine, self.soft_px)


@dataclass(frozen=True, slots=True)
class Polygon:
    """A convex polygon; its corners (x, y) either way round."""

    corners_px: tuple[tuple[float, float], ...]
    level_dn: float
    soft_px: float = 0.0

    def box(self) -> Window:
        x, y = np.array(self.corners_px).T
        reach = 4.0 * self.soft_px + 1.0
        return window_about(
            float(x.min() + x.max()) / 2.0,
            float(y.min() + y.max()) / 2.0,
            float(x.max() - x.min()) / 2.0 + reach,
            float(y.max() - y.min()) / 2.0 + reach,
        )

    def cover(self, grid: Grid) -> Array:
        """The least of what its sides cover: exact but for the subpixels of its corners."""
        cover = np.ones(grid.shape)
        x, y = grid.x_px, grid.y_px
        for (x0, y0), (x1, y1) in zip(self._corners(), self._corners()[1:] + self._corners()[:1], strict=True):
            length = hypot(x1 - x0, y1 - y0)
            nx, ny = (y0 - y1) / length, (x1 - x0) / length
            np.minimum(cover, _covered((x - x0) * nx + (y - y0) * ny, nx, ny, grid.fine, self.soft_px), out=cover)
        return cover

    def _corners(self) -> tuple[tuple[float, float], ...]:
        """So ordered that (-dy, dx) of a side points inwards."""
        x, y = np.array(self.corners_px).T
        doubled_area = float((x * np.roll(y, -1) - y * np.roll(x, -1)).sum())
        return self.corners_px if doubled_area > 0.0 else self.corners_px[::-1]


Shape: TypeAlias = Disc | Polygon


def bar(
    begin_px: tuple[float, float], end_px: tuple[float, float], width_px: float, level_dn: float, soft_px: float = 0.0
) -> Polygon:
    """A straight line of some width."""
    (x0, y0), (x1, y1) = begin_px, end_px
    scale = 0.5 * width_px / hypot(x1 - x0, y1 - y0)
    dx, dy = (y1 - y0) * scale, (x0 - x1) * scale
    return Polygon(((x0 + dx, y0 + dy), (x1 + dx, y1 + dy), (x1 - dx, y1 - dy), (x0 - dx, y0 - dy)), level_dn, soft_px)


def paint(shapes: Sequence[Shape], grid: Grid, light_dn: Array) -> None:
    """Each shape over what is there already, in place."""
    for shape in shapes:
        part = grid.part(shape.box())
        if not part.window.empty:
            behind = grid.of(light_dn, part)
            behind += shape.cover(part) * (shape.level_dn - behind)


def half_plane_cover(distance: Array, nx: Array | float, ny: Array | float) -> Array:
    """Of unit squares, by the half-planes on the positive side of straight edges; exact.

    `distance` of the squares' centres from the edge, in sides of a square, positive inside; (nx, ny) the edge's unit normal.
    """
    wide, narrow = np.maximum(np.abs(nx), np.abs(ny)), np.minimum(np.abs(nx), np.abs(ny))
    corner = np.maximum(0.5 * (wide + narrow) - np.abs(distance), 0.0)  # how far the edge is from the last corner
    inner = 0.5 * (wide - narrow)
    with np.errstate(divide="ignore", invalid="ignore"):
        beyond = np.where(narrow > 1e-9, corner * corner / (2.0 * wide * narrow), 0.0)
        outside = np.where(np.abs(distance) <= inner, 0.5 - np.abs(distance) / wide, beyond)
    return np.asarray(np.where(distance >= 0.0, 1.0 - outside, outside))


def _covered(distance_px: Array, nx: Array | float, ny: Array | float, fine: int, soft_px: float) -> Array:
    if soft_px > 0.0:
        return np.asarray(0.5 + 0.5 * np.tanh(SOFT_SLOPE / soft_px * distance_px))
    cover = (distance_px > 0.0).astype(np.float64)
    rows, columns = np.nonzero(np.abs(distance_px) * fine < 0.5 * sqrt(2.0))
    along_x = nx[rows, columns] if isinstance(nx, np.ndarray) else nx
    along_y = ny[rows, columns] if isinstance(ny, np.ndarray) else ny
    cover[rows, columns] = half_plane_cover(distance_px[rows, columns] * fine, along_x, along_y)
    return cover
