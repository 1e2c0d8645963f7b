"""Many frames from few renderings: a backdrop, balls as sprites that are laid over it, and fast noise.

A sprite is what the judge's renderer makes of the ball alone: its light, and the share of the background's light that passes.
Blur is linear, so a ball before an even background is exact; before an edge it is not, by a little light that both would blur
into one another: far less than a lock is judged by.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numba
import numpy as np
import numpy.typing as npt

from trackerd.contract.model import Image
from trackerd.geometry.lens import Lens
from trackerd.sim.optics import margin_px
from trackerd.sim.picture import Background, Picture, ball_box, expected, truth
from trackerd.sim.raster import Disc, Polygon, Shape, bar
from trackerd.sim.sensor import Sensor

LENS = Lens((2048, 1536), 31000.0, 31000.0, 1023.5, 767.5)
RADIUS_MM = 4.0
BRIGHT_DN = 100.0  # of the background against which a sprite's shadow is measured
DEVIATES = 1 << 24  # in the bank of normal ones: 54 frames of 640 x 480, entered anywhere

Circle = tuple[float, float, float]
Light = npt.NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Sprite:
    """A ball on a window of the image, (h, w): image = background * through + light. `circle` is its true outline."""

    left: int
    top: int
    light: Light
    through: Light
    circle: Circle

    def moved(self, dx: int, dy: int) -> "Sprite":
        """By whole pixels."""
        x, y, r = self.circle
        return Sprite(self.left + dx, self.top + dy, self.light, self.through, (x + dx, y + dy, r))

    def lay_over(self, light: Light) -> None:
        """In place; what is outside of the image is cut off."""
        height, width = light.shape
        x0, y0 = max(self.left, 0), max(self.top, 0)
        x1, y1 = min(self.left + self.light.shape[1], width), min(self.top + self.light.shape[0], height)
        if x0 < x1 and y0 < y1:
            own = slice(y0 - self.top, y1 - self.top), slice(x0 - self.left, x1 - self.left)
            below = light[y0:y1, x0:x1]
            below *= self.through[own]
            below += self.light[own]


def sprite(picture: Picture) -> Sprite:
    """The picture's ball with its stem, if any, up to the picture's border."""
    margin = 2 * margin_px(picture.psf_px, picture.defocus_px, picture.motion_px)
    window = ball_box(picture).grown(margin)
    left, top, width, height = window if picture.stem is None else picture.window
    origin = (picture.origin_px[0] + left, picture.origin_px[1] + top)
    alone = replace(picture, size_px=(width, height), origin_px=origin, behind=(), front=())
    dark = expected(replace(alone, background=Background(level_dn=0.0)))
    bright = expected(replace(alone, background=Background(level_dn=BRIGHT_DN)))
    through = ((bright - dark) / BRIGHT_DN).astype(np.float32)
    return Sprite(left, top, dark.astype(np.float32), through, truth(picture).circle)


def backdrop(random: np.random.Generator, size_px: tuple[int, int], things: int, holes: int = 0) -> Light:
    """A gradient, a texture and clutter, as bright and as dark as a workshop; `holes` of it are round."""
    ground = Background(
        random.uniform(40.0, 130.0),
        tuple((random.uniform(-15.0, 15.0, 2) / size_px[0]).tolist()),
        texture_dn=random.uniform(0.0, 2.0),
        texture_px=random.uniform(1.0, 5.0),
        seed=int(random.integers(1 << 30)),
    )
    shapes = [*(clutter(random, size_px) for _ in range(things)), *(hole(random, size_px) for _ in range(holes))]
    picture = Picture(size_px, LENS, None, RADIUS_MM, background=ground, behind=tuple(shapes))
    return expected(picture).astype(np.float32)


def clutter(random: np.random.Generator, size_px: tuple[int, int]) -> Shape:
    """A bar or a polygon of up to five corners somewhere in the image, sharp or out of focus."""
    x, y = random.uniform((0.0, 0.0), size_px).tolist()
    level, soft = random.uniform(15.0, 200.0), float(random.choice((0.0, 0.0, 3.0)))
    if random.random() < 0.4:
        dx, dy = random.uniform(-300.0, 300.0, 2).tolist()
        return bar((x, y), (x + dx + 30.0, y + dy), random.uniform(2.0, 40.0), level, soft)
    turn = np.sort(random.uniform(0.0, 2.0 * np.pi, int(random.integers(3, 6))))
    corners = random.uniform(20.0, 130.0) * np.column_stack((np.cos(turn), np.sin(turn))) + (x, y)
    return Polygon(tuple(map(tuple, corners.tolist())), level, soft)


def hole(random: np.random.Generator, size_px: tuple[int, int]) -> Disc:
    x, y = random.uniform((60.0, 60.0), np.subtract(size_px, 60.0)).tolist()
    return Disc(x, y, random.uniform(20.0, 80.0), random.uniform(5.0, 35.0))


class Noise:
    """Fresh noise for every frame, from a bank of normal deviates that is entered anywhere."""

    def __init__(self, seed: int, sensor: Sensor) -> None:
        self._random = np.random.default_rng(seed)
        self._bank = self._random.standard_normal(DEVIATES, dtype=np.float32)
        self._sensor = sensor

    def expose(self, light: Light, out: Image) -> Image:
        first = int(self._random.integers(0, DEVIATES - light.size))
        electrons = np.float32(1.0 / self._sensor.gain_e_per_dn)
        floor = np.float32((self._sensor.read_noise_e / self._sensor.gain_e_per_dn) ** 2)
        _expose(light.ravel(), self._bank[first : first + light.size], electrons, floor, out.ravel())
        return out


@numba.njit(fastmath=True, cache=True)  # type: ignore[misc]
def _expose(light, deviates, dn_per_e, floor_dn2, out):  # type: ignore[no-untyped-def]
    for n in range(light.size):
        level = max(light[n], np.float32(0.0))
        seen = level + np.sqrt(level * dn_per_e + floor_dn2) * deviates[n] + np.float32(0.5)
        out[n] = np.uint8(min(max(seen, np.float32(0.0)), np.float32(255.0)))


def door(random: np.random.Generator, side_px: float, level_dn: float) -> Sprite:
    """A square of some grain about (0, 0), with soft borders, that slides in front of things."""
    side = round(side_px) + 12
    cover = np.zeros((side, side), np.float32)
    cover[6:-6, 6:-6] = 1.0
    cover = cv2.GaussianBlur(cover, (0, 0), 1.0)
    grain = cv2.GaussianBlur(random.standard_normal(cover.shape).astype(np.float32), (0, 0), 3.0)
    light = (np.float32(level_dn) + np.float32(8.0) * grain) * cover
    return Sprite(-side // 2, -side // 2, light.astype(np.float32), np.float32(1.0) - cover, (0.0, 0.0, 0.0))


def compose(background: Light, over: Sequence[Sprite], canvas: Light) -> Light:
    """The later sprites over the earlier ones, on a canvas that is written anew."""
    np.copyto(canvas, background)
    for one in over:
        one.lay_over(canvas)
    return canvas
