"""What scenes are made of: a ball in an image that a tracker would cut out of the sensor, and the things that stand about."""

from dataclasses import replace
from math import cos, pi, sin

import numpy as np

from trackerd.geometry.lens import Lens
from trackerd.sim.ball import Surface
from trackerd.sim.picture import Background, Picture, Truth, probe_seen_at
from trackerd.sim.raster import Polygon, Shape, bar

SENSOR_PX = (2048, 1536)
CENTRE_PX = (1023.5, 767.5)
LENS = Lens(SENSOR_PX, 31000.0, 31000.0, *CENTRE_PX)
RADIUS_MM = 4.0
R_PX = (20.0, 120.0)

Random = np.random.Generator


def a_ball(random: Random, r_px: float | None = None, lens: Lens = LENS, about_px: tuple[float, float] = CENTRE_PX) -> Picture:
    """A ball within 8 px of the middle of an image that a tracker would cut out of the sensor, and a level or gently sloping
    ground. Three of four balls are lighter than the ground."""
    r_px = random.uniform(*R_PX) if r_px is None else r_px
    side_px = round(2.6 * r_px + 48.0)
    origin_px = round(about_px[0] - 0.5 * side_px), round(about_px[1] - 0.5 * side_px)
    x_px, y_px = (0.5 * side_px + random.uniform(-8.0, 8.0, 2)).tolist()
    lighter, contrast_dn = random.random() < 0.75, random.uniform(50.0, 110.0)
    ground_dn = random.uniform(30.0, 110.0) if lighter else random.uniform(130.0, 200.0)
    return Picture(
        size_px=(side_px, side_px),
        lens=lens,
        probe_mm=probe_seen_at((x_px, y_px, r_px), RADIUS_MM, lens, origin_px),
        radius_mm=RADIUS_MM,
        origin_px=origin_px,
        psf_px=random.uniform(0.75, 1.1),
        surface=Surface(ground_dn + contrast_dn if lighter else ground_dn - contrast_dn),
        background=Background(ground_dn, tuple(random.uniform(-0.03, 0.03, 2).tolist())),
    )


def textured(random: Random, picture: Picture) -> Picture:
    """Before a ground of some grain, up to 2 DN."""
    grain = {"texture_dn": random.uniform(0.0, 2.0), "texture_px": random.uniform(1.5, 6.0)}
    return replace(picture, background=replace(picture.background, **grain, seed=int(random.integers(1 << 31))))


def a_thing(random: Random, x_px: float, y_px: float, size_px: float) -> Shape:
    """A triangle, a rectangle, or a bar or line through a point; any level."""
    level_dn, soft_px, turn_rad = random.uniform(15.0, 220.0), softness(random), random.uniform(-pi, pi)
    if random.random() < 0.4:
        dx, dy = 2.0 * size_px * cos(turn_rad), 2.0 * size_px * sin(turn_rad)
        width_px = random.uniform(1.0, 0.25 * size_px + 1.0)
        return bar((x_px - dx, y_px - dy), (x_px + dx, y_px + dy), width_px, level_dn, soft_px)
    corners = int(random.integers(3, 5))
    reach_px, flat = random.uniform(0.3, 0.7) * size_px, random.uniform(0.4, 1.0)
    angles = (turn_rad + 2.0 * pi * n / corners for n in range(corners))
    return Polygon(tuple((x_px + reach_px * cos(a), y_px + flat * reach_px * sin(a)) for a in angles), level_dn, soft_px)


def beside(random: Random, ball: Truth) -> tuple[float, float]:
    """A point near the outline, rather outside than inside."""
    angle_rad, distance_px = random.uniform(-pi, pi), ball.r_px * random.uniform(0.9, 1.25)
    return ball.x_px + distance_px * cos(angle_rad), ball.y_px + distance_px * sin(angle_rad)


def towards_camera(random: Random, least_rad: float, most_rad: float) -> tuple[float, float, float]:
    """A direction in C so far from the one towards the camera, on any side."""
    off_rad, side_rad = random.uniform(least_rad, most_rad), random.uniform(-pi, pi)
    return sin(off_rad) * cos(side_rad), sin(off_rad) * sin(side_rad), -cos(off_rad)


def softness(random: Random) -> float:
    """Sigma in px of another thing's edge: half of them are in focus."""
    return 0.0 if random.random() < 0.5 else random.uniform(0.5, 3.0)


def sign(random: Random) -> float:
    return 1.0 if random.random() < 0.5 else -1.0
