"""The pixels of a ring round a circle, parted into sectors: a table that depends on the radius alone, so it is kept."""

from dataclasses import dataclass
from functools import lru_cache
from math import ceil, pi

import numpy as np
import numpy.typing as npt

from trackerd.contract.model import Image

Floats = npt.NDArray[np.float64]
Whole = npt.NDArray[np.intp]
Short = npt.NDArray[np.int32]

FEW_SECTORS, MANY_SECTORS = 48, 96
MANY_FROM_PX = 25  # a smaller circle has too few pixels for 96 sectors


@dataclass(frozen=True, slots=True)
class Ring:
    """Offsets of pixels from a whole-numbered centre, (S, n): sector by sector, filled up by copies of weight 0."""

    dx: Floats
    dy: Floats
    column: Short
    row: Short
    weight: Floats  # 1 for a pixel, 0 for a copy that only fills up
    count: Short  # (S,) pixels of each sector
    middle: Floats  # (S, 2): cosine and sine of the sector's middle
    blur_design: Floats  # (S, 3): 1, cos and sin of twice the sector's angle: d (blur's variance) / d unknown
    reach_px: int  # no offset is greater
    inside_px: float  # of an outline that is no circle, the pixels this far from it are used: the ring is wider
    outside_px: float


@dataclass(frozen=True, slots=True)
class Gathered:
    """Grey values of a ring's pixels, (S, n), and their weights: 0 outside the image."""

    level: Floats
    weight: Floats


@lru_cache(maxsize=32)
def ring(radius_px: int, inside_px: int, outside_px: int, bulge_px: int = 0) -> Ring:
    """Pixels with -inside - bulge <= distance - radius <= outside + bulge."""
    reach = radius_px + outside_px + bulge_px + 1
    side = np.arange(-reach, reach + 1)
    column, row = (a.ravel() for a in np.meshgrid(side, side))
    distance = np.hypot(column, row)
    kept = (distance >= max(radius_px - inside_px - bulge_px, 1)) & (distance <= radius_px + outside_px + bulge_px)
    column, row = column[kept], row[kept]
    sectors = sectors_of(radius_px)
    turn = np.arctan2(row, column) / (2.0 * pi) * sectors
    order, weight = _fill(np.floor(turn).astype(np.intp) % sectors, distance[kept], sectors)
    column, row = column[order], row[order]
    middle = (np.arange(sectors) + 0.5) * (2.0 * pi / sectors)
    return Ring(
        column.astype(np.float64),
        row.astype(np.float64),
        column.astype(np.int32),
        row.astype(np.int32),
        weight,
        weight.sum(axis=1).astype(np.int32),
        np.column_stack((np.cos(middle), np.sin(middle))),
        np.column_stack((np.ones(sectors), np.cos(2.0 * middle), np.sin(2.0 * middle))),
        reach,
        float(inside_px),
        float(outside_px),
    )


def sectors_of(radius_px: float) -> int:
    return MANY_SECTORS if round(radius_px) >= MANY_FROM_PX else FEW_SECTORS


def ring_for(radius_px: float, sigma_px: float, bulge_px: float = 0.0) -> Ring:
    """The ring that an edge of this blur needs: wide enough for both levels, no wider (clutter is near)."""
    inside, outside = (8, 5) if sigma_px <= 1.2 else (ceil(4.0 * sigma_px + 6.0), ceil(4.0 * sigma_px + 4.0))
    whole = max(round(radius_px), 3)
    return ring(whole, min(inside, max(round(0.6 * whole), 2)), outside, ceil(bulge_px))


def gather(image: Image, pixels: Ring, column: int, row: int) -> Gathered:
    """Grey values round a pixel of the image."""
    height, width = image.shape
    reach = pixels.reach_px
    if reach <= column < width - reach and reach <= row < height - reach:
        return Gathered(image[pixels.row + row, pixels.column + column].astype(np.float64), pixels.weight)
    x, y = pixels.column + column, pixels.row + row
    inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    level = image[np.clip(y, 0, height - 1), np.clip(x, 0, width - 1)].astype(np.float64)
    return Gathered(level, pixels.weight * inside)


def _fill(sector: Whole, distance: Floats, sectors: int) -> tuple[Whole, Floats]:
    """Indices (S, n) of each sector's pixels from the inside outwards, and which of them only fill up."""
    order = np.lexsort((distance, sector))
    count = np.bincount(sector, minlength=sectors)
    first = np.concatenate(((0,), np.cumsum(count)[:-1]))
    place = np.arange(count.max())[None, :]
    real = place < count[:, None]
    index = first[:, None] + np.minimum(place, np.maximum(count - 1, 0)[:, None])
    return order[np.minimum(index, len(order) - 1)], real.astype(np.float64)
