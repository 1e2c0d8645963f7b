"""The judge's renderer: the picture of a sphere as a lens and a sensor's pixels give it, with everything around it.

A picture is layered on a grid of subpixels (background, what stands behind, stem and ball, what stands in front), blurred and
integrated over the pixels' areas. Slow and exact, where sim.render is fast: what a detector is judged by must be closer to the
truth than the detector.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import lru_cache
from math import cos, hypot, pi, sin, sqrt

import cv2
import numpy as np

from trackerd.contract.model import Array
from trackerd.geometry.lens import Lens
from trackerd.geometry.sphere import centre_and_range, outline
from trackerd.sim.ball import Surface, ball_light, box_of, inside_of
from trackerd.sim.optics import defocus, gather, margin_px, smear
from trackerd.sim.raster import Grid, Polygon, Shape, Window, bar, paint

FINE, FINE_WHEN_SMOOTH = 4, 2  # subpixels a side of a pixel; in the midst of the ball
FINE_WHEN_SHARP, SHARP_PX = 8, 0.6  # a sharper edge needs more of them
TILE_PX = 96  # a larger picture is made in parts: in many of them nothing has an edge
TEXTURE_MARGIN_PX = 64  # texture beyond the picture's border, from which light is blurred into it


@dataclass(frozen=True, slots=True)
class Background:
    """Behind everything: a level, a gradient about the picture's centre, and a texture that stands still."""

    level_dn: float = 60.0
    gradient_dn_per_px: tuple[float, float] = (0.0, 0.0)
    texture_dn: float = 0.0  # rms, before the optics
    texture_px: float = 3.0  # sigma of its grain, >= 1
    seed: int = 0


@dataclass(frozen=True, slots=True)
class Stem:
    """A bar behind the ball, from its middle outwards."""

    angle_rad: float  # of its direction in the image, from x towards y: up is -pi/2
    width: float  # as a share of the ball's diameter
    level_dn: float
    length: float = 100.0  # in radii of the ball, from its centre


@dataclass(frozen=True, slots=True)
class Picture:
    """Everything that is in one exposure."""

    size_px: tuple[int, int]  # width, height of the image
    lens: Lens
    probe_mm: tuple[float, float, float] | None  # the sphere's centre in C at mid-exposure; None: no probe in the picture
    radius_mm: float
    origin_px: tuple[int, int] = (0, 0)  # sensor coordinates of the image's first pixel
    motion_px: tuple[float, float] = (0.0, 0.0)  # of ball and stem during the exposure, even
    psf_px: float = 0.9  # sigma of the optics' blur, >= 0.25; the pixel's area is integrated besides
    defocus_px: float = 0.0  # radius of the blur circle
    surface: Surface = field(default_factory=Surface)
    background: Background = field(default_factory=Background)
    stem: Stem | None = None
    behind: tuple[Shape, ...] = ()  # the later over the earlier; image coordinates
    front: tuple[Shape, ...] = ()

    @property
    def window(self) -> Window:
        return Window(0, 0, *self.size_px)


@dataclass(frozen=True, slots=True)
class Truth:
    """The outline in image coordinates, so that geometry.sphere.centre_and_range gives this direction and range."""

    x_px: float
    y_px: float
    r_px: float  # sqrt(a b)
    direction: Array  # (3,), unit, in C
    range_mm: float

    @property
    def circle(self) -> tuple[float, float, float]:
        return self.x_px, self.y_px, self.r_px


def expected(picture: Picture) -> Array:
    """Light of each pixel (height, width) in DN: no noise, not rounded, not clipped."""
    return render(picture, picture.window, stem_bar(picture))


def truth(picture: Picture) -> Truth:
    """Raises ValueError where no probe is in the picture."""
    p_mm = _probe(picture)
    ball = outline(p_mm, picture.radius_mm, picture.lens)
    range_mm = float(np.linalg.norm(p_mm))
    x_px, y_px = ball.x_px - picture.origin_px[0], ball.y_px - picture.origin_px[1]
    return Truth(x_px, y_px, ball.r_px, p_mm / range_mm, range_mm)


def probe_seen_at(
    circle_px: tuple[float, float, float], radius_mm: float, lens: Lens, origin_px: tuple[int, int] = (0, 0)
) -> tuple[float, float, float]:
    """The sphere's centre in C whose outline is (x, y, r) in image coordinates: the inverse of `truth`."""
    q_px = np.array((circle_px[0] + origin_px[0], circle_px[1] + origin_px[1]))
    direction, range_mm = centre_and_range(q_px, circle_px[2], radius_mm, lens)
    x, y, z = (direction * range_mm).tolist()
    return x, y, z


def stem_bar(picture: Picture) -> Polygon | None:
    """Where the stem is, without the motion."""
    if picture.stem is None or picture.probe_mm is None:
        return None
    stem, ball = picture.stem, truth(picture)
    length_px = min(stem.length * ball.r_px, hypot(*picture.size_px) + hypot(ball.x_px, ball.y_px) + ball.r_px)
    end_px = (ball.x_px + length_px * cos(stem.angle_rad), ball.y_px + length_px * sin(stem.angle_rad))
    return bar((ball.x_px, ball.y_px), end_px, 2.0 * ball.r_px * stem.width, stem.level_dn)


def render(picture: Picture, window: Window, stem: Polygon | None) -> Array:
    """`expected` of a window of the image, with the stem at a place of its own."""
    out = np.empty((window.height, window.width))
    for tile in _tiles(window):
        top, left = tile.top - window.top, tile.left - window.left
        out[top : top + tile.height, left : left + tile.width] = _render_tile(picture, tile, stem)
    return out


def _tiles(window: Window) -> Iterator[Window]:
    for top in range(window.top, window.top + window.height, TILE_PX):
        for left in range(window.left, window.left + window.width, TILE_PX):
            yield Window(left, top, TILE_PX, TILE_PX).clipped(window)


def _render_tile(picture: Picture, tile: Window, stem: Polygon | None) -> Array:
    margin = margin_px(picture.psf_px, picture.defocus_px, picture.motion_px)
    around = tile.grown(margin)
    grid = Grid(around, _fine(picture, around, stem))
    light = _background(picture, grid)
    paint(picture.behind, grid, light)
    cover, probe_light = _probe_layer(picture, grid, stem)
    if cover is not None:
        light *= 1.0 - cover
        light += probe_light
    paint(picture.front, grid, light)
    if picture.defocus_px > 0.0:
        light = defocus(light, grid.fine, picture.defocus_px)
        return gather(light, grid.fine, margin, picture.psf_px, means=2)
    return gather(light, grid.fine, margin, picture.psf_px)


def _fine(picture: Picture, around: Window, stem: Polygon | None) -> int:
    """Subpixels a side; few are enough where nothing has an edge."""
    if picture.psf_px < SHARP_PX:
        return FINE_WHEN_SHARP
    inside = picture.probe_mm is not None and _inside_ball(picture, around)
    boxes = [shape.box() for shape in (picture.front if inside else (*picture.behind, *picture.front))]
    if picture.probe_mm is not None and not inside:
        boxes += [ball_box(picture), *([stem.box()] if stem is not None else [])]
    if all(box.clipped(around).empty for box in boxes):
        return FINE_WHEN_SMOOTH if inside else 1
    return FINE


def _inside_ball(picture: Picture, window: Window) -> bool:
    return inside_of(window, _probe(picture), picture.radius_mm, picture.lens, picture.origin_px)


def _background(picture: Picture, grid: Grid) -> Array:
    ground = picture.background
    (width, height), (slope_x, slope_y) = picture.size_px, ground.gradient_dn_per_px
    light = np.full(grid.shape, float(ground.level_dn))
    if slope_x or slope_y:
        light += slope_x * (grid.x_px - 0.5 * (width - 1)) + slope_y * (grid.y_px - 0.5 * (height - 1))
    if ground.texture_dn > 0.0:
        light += _texture(picture, grid)
    return light


def _texture(picture: Picture, grid: Grid) -> Array:
    """A piece of the picture's texture, interpolated between its own pixels."""
    ground, window = picture.background, grid.window.grown(2)
    top, left = window.top + TEXTURE_MARGIN_PX, window.left + TEXTURE_MARGIN_PX
    whole = _grain(picture.size_px, ground.texture_px, ground.seed)
    piece = whole[top : top + window.height, left : left + window.width] * ground.texture_dn
    size = (window.width * grid.fine, window.height * grid.fine)
    finer = cv2.resize(piece, size, interpolation=cv2.INTER_CUBIC) if grid.fine > 1 else piece
    return np.asarray(finer[2 * grid.fine : -2 * grid.fine, 2 * grid.fine : -2 * grid.fine])


@lru_cache(maxsize=4)
def _grain(size_px: tuple[int, int], grain_px: float, seed: int) -> Array:
    """Blurred noise of mean 0 and rms 1, with its margin."""
    shape = (size_px[1] + 2 * TEXTURE_MARGIN_PX, size_px[0] + 2 * TEXTURE_MARGIN_PX)
    white = np.random.default_rng(seed).standard_normal(shape)
    blurred = cv2.GaussianBlur(white, (0, 0), grain_px)
    return np.asarray(blurred * (2.0 * sqrt(pi) * grain_px))


def _probe_layer(picture: Picture, grid: Grid, stem: Polygon | None) -> tuple[Array | None, Array]:
    """What stem and ball cover, and their light times what they cover, smeared; None where nothing of them is near."""
    cover, light = np.zeros(grid.shape), np.zeros(grid.shape)
    part = grid.part(stem.box()) if stem is not None else None
    if stem is not None and part is not None and not part.window.empty:
        grid.of(cover, part)[:] = stem.cover(part)
        grid.of(light, part)[:] = stem.level_dn * grid.of(cover, part)
    near = picture.probe_mm is not None and _draw_ball(picture, grid, cover, light)
    if not near and (part is None or part.window.empty):
        return None, light
    if any(picture.motion_px):
        cover, light = smear(cover, grid.fine, picture.motion_px), smear(light, grid.fine, picture.motion_px)
    return cover, light


def _draw_ball(picture: Picture, grid: Grid, cover: Array, light: Array) -> bool:
    """Over the stem, in place; False where the grid has none of it."""
    part = grid.part(ball_box(picture))
    if part.window.empty:
        return False
    ball, shine = ball_light(_probe(picture), picture.radius_mm, picture.surface, picture.lens, part, picture.origin_px)
    under, under_light = grid.of(cover, part), grid.of(light, part)
    under *= 1.0 - ball
    under += ball
    under_light *= 1.0 - ball
    under_light += ball * shine
    return True


def ball_box(picture: Picture) -> Window:
    """All pixels that the ball may touch, without blur and motion. Raises ValueError where no probe is in the picture."""
    return box_of(_probe(picture), picture.radius_mm, picture.lens, picture.origin_px)


def _probe(picture: Picture) -> Array:
    if picture.probe_mm is None:
        raise ValueError("no probe is in the picture")
    return np.array(picture.probe_mm)
