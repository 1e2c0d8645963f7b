"""What a cell shows, by category: seeded pictures for the judge renderer, and frames of them.

Every category draws its position to a fraction of a pixel, its radius (20 to 120 px), its levels and its blur (PSF sigma 0.75
to 1.1 px) at random. The ranges are a real cell's: an exposure that leaves a matt ball at 80 to 220 DN before a darker ground,
or a dark ball before a lit one; f 31000 px, as the source's camera has it; edges of other things in focus or somewhat out of
it. None was chosen by looking at what a detector makes of it.
"""

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future
from dataclasses import replace
from math import cos, pi, radians, sin
from pathlib import Path
from zlib import crc32

import numpy as np
from ingredients import CENTRE_PX, SENSOR_PX, Random, a_ball, a_thing, beside, sign, softness, textured, towards_camera
from rendering import Frame, Rendered, rendered, rendering

from trackerd.geometry.lens import Lens
from trackerd.sim.ball import Highlight, Lamp, Surface
from trackerd.sim.picture import Background, Picture, Stem, truth
from trackerd.sim.raster import Polygon, Shape
from trackerd.sim.sensor import Sensor

SERIES = 1_000_000  # seeds of one still series: it is one scene, and only the noise of its frames is new
STILL_SENSOR = Sensor(flicker=0.01, prnu=0.005)
PROCESSES = 2


def scene(category: str, seed: int) -> Picture:
    """The same picture for the same seed. Raises KeyError for a category that is not in CATEGORIES."""
    drawn = seed // SERIES if category == "still" else seed
    return CATEGORIES[category](np.random.default_rng((crc32(category.encode()), drawn)))


def sensor_of(category: str) -> Sensor:
    """10 ke- at 255 DN, 3 e- of read noise, 8 bits; in the still series a light that flickers and pixels that differ, too."""
    return STILL_SENSOR if category == "still" else Sensor()


def frames(category: str, seeds: Iterable[int], cache: Path | None = None, processes: int = PROCESSES) -> Iterator[Frame]:
    """Expected light (DN), truth, bound (3, 3) and sensor of each scene, in the order of the seeds; rendered by processes.

    Truth and bound are None where there is no ball. `cache` is a folder that keeps what was rendered, by the picture itself:
    changed scenes are rendered anew, but after a change of the renderer the folder has to be emptied.
    """
    sensor = sensor_of(category)
    with rendering(processes) as submit:
        waiting: deque[Future[Rendered]] = deque()
        for seed in seeds:
            waiting.append(submit(rendered, scene(category, seed), sensor, cache))
            if len(waiting) > 8 * processes:
                yield waiting.popleft().result().frame(sensor)
        while waiting:
            yield waiting.popleft().result().frame(sensor)


def _clean(random: Random) -> Picture:
    """Nothing but the ball, before a level or gently sloping ground."""
    return a_ball(random)


def _low_contrast(random: Random) -> Picture:
    """8 to 16 DN between ball and background, either way."""
    ground_dn, contrast_dn = random.uniform(40.0, 160.0), random.uniform(8.0, 16.0) * sign(random)
    picture = a_ball(random)
    return replace(
        picture, surface=Surface(ground_dn + contrast_dn), background=replace(picture.background, level_dn=ground_dn)
    )


def _stem(random: Random) -> Picture:
    """A stem of 0.3 to 0.6 d and any level, mostly upwards as on a spindle, else from any side."""
    upwards = -0.5 * pi + random.uniform(-0.4, 0.4)
    angle_rad = upwards if random.random() < 0.7 else random.uniform(-pi, pi)
    stem = Stem(angle_rad, random.uniform(0.3, 0.6), random.uniform(20.0, 220.0))
    return textured(random, replace(a_ball(random), stem=stem))


def _hidden(random: Random) -> Picture:
    """A straight edge of something in front, of any level, hides 30 % of the outline."""
    picture = a_ball(random)
    ball, angle_rad, far_px = truth(picture), random.uniform(-pi, pi), 2.0 * sum(picture.size_px)
    along, across = (cos(angle_rad), sin(angle_rad)), (-sin(angle_rad), cos(angle_rad))
    begin_px = cos(0.3 * pi) * ball.r_px  # the chord of 0.3 of a turn
    corners = tuple(
        (ball.x_px + a * along[0] + b * across[0], ball.y_px + a * along[1] + b * across[1])
        for a, b in ((begin_px, -far_px), (begin_px, far_px), (far_px, far_px), (far_px, -far_px))
    )
    return replace(picture, front=(Polygon(corners, random.uniform(20.0, 220.0), softness(random)),))


def _small(random: Random) -> Picture:
    return a_ball(random, r_px=12.0)


def _large(random: Random) -> Picture:
    return a_ball(random, r_px=150.0)


def _motion(random: Random) -> Picture:
    """2 to 10 px during the exposure, in any direction, before a ground that stands still."""
    length_px, angle_rad = random.uniform(2.0, 10.0), random.uniform(-pi, pi)
    return replace(a_ball(random), motion_px=(length_px * cos(angle_rad), length_px * sin(angle_rad)))


def _defocus(random: Random) -> Picture:
    """A blur circle of 1.5 to 4.5 px radius."""
    return replace(a_ball(random), defocus_px=random.uniform(1.5, 4.5))


def _shaded(random: Random) -> Picture:
    """A lamp from one side, 10 to 60 deg from the camera's own, and 0.2 to 0.6 of ambient light.

    The ground is 20 DN darker than the ball's dark side, or more: the contrast keeps its sign all round.
    """
    ambient, level_dn = random.uniform(0.2, 0.6), random.uniform(170.0, 235.0)
    lamp = Lamp(towards_camera(random, radians(10.0), radians(60.0)), ambient)
    ground = Background(random.uniform(5.0, ambient * level_dn - 20.0))
    return replace(a_ball(random), surface=Surface(level_dn, lamp=lamp), background=ground)


def _highlight(random: Random) -> Picture:
    """One or two lamps mirrored by a ball that is somewhat glossy; many spots saturate."""
    spots = tuple(
        Highlight(towards_camera(random, 0.0, radians(60.0)), random.uniform(60.0, 400.0), random.uniform(0.05, 0.25))
        for _ in range(random.integers(1, 3))
    )
    picture = a_ball(random)
    return replace(picture, surface=replace(picture.surface, limb=random.uniform(0.0, 0.2), highlights=spots))


def _ruby(random: Random) -> Picture:
    """A dark, clear, glossy ball: darker than the ground, with the surroundings mirrored towards the rim (Fresnel), one bright
    highlight, and on the other side the spot to which the ball gathers the light that went through it."""
    ground_dn, body_dn = random.uniform(50.0, 120.0), random.uniform(10.0, 32.0)
    rim_dn = random.uniform(0.2, 0.8) * (ground_dn - body_dn)
    x, y, z = towards_camera(random, radians(15.0), radians(50.0))
    spots = (
        Highlight((x, y, z), random.uniform(150.0, 600.0), random.uniform(0.05, 0.12)),
        Highlight((-x, -y, z), random.uniform(20.0, 100.0), random.uniform(0.12, 0.25)),
    )
    surface = Surface(body_dn, rim_dn=rim_dn, highlights=spots)
    return textured(random, replace(a_ball(random), surface=surface, background=Background(ground_dn)))


def _saturated(random: Random) -> Picture:
    """A dark ball before a lit screen: the ground at saturation and up to 1.3 times beyond."""
    return replace(
        a_ball(random), surface=Surface(random.uniform(20.0, 90.0)), background=Background(random.uniform(255.0, 330.0))
    )


def _clutter(random: Random) -> Picture:
    """Three to six things of any level behind the ball, about its outline, and in half of the scenes one in front."""
    picture = textured(random, a_ball(random))
    ball = truth(picture)
    behind = tuple(a_thing(random, *beside(random, ball), ball.r_px) for _ in range(random.integers(3, 7)))
    front: tuple[Shape, ...] = ()
    if random.random() < 0.5:
        front = (a_thing(random, *beside(random, ball), 0.3 * ball.r_px),)
    return replace(picture, behind=behind, front=front)


def _wide(random: Random) -> Picture:
    """An 8 mm lens, f 2400 px, up to 26 deg off its axis; half of the lenses distort (k1 -0.1 to -0.2)."""
    distortion = (random.uniform(-0.2, -0.1), random.uniform(0.0, 0.05), *random.uniform(-5e-4, 5e-4, 2).tolist(), 0.0)
    lens = Lens(SENSOR_PX, 2400.0, 2400.0, *CENTRE_PX, distortion if random.random() < 0.5 else (0.0,) * 5)
    off_px, angle_rad = 1170.0 * random.uniform(0.1, 1.0) ** 0.5, random.uniform(-pi, pi)
    x = float(np.clip(CENTRE_PX[0] + off_px * cos(angle_rad), 160.0, SENSOR_PX[0] - 160.0))
    y = float(np.clip(CENTRE_PX[1] + off_px * sin(angle_rad), 160.0, SENSOR_PX[1] - 160.0))
    return a_ball(random, lens=lens, about_px=(x, y))


def _tele(random: Random) -> Picture:
    """f 18000 to 31000 px, anywhere on the sensor."""
    f_px = random.uniform(18000.0, 31000.0)
    about_px = (random.uniform(180.0, SENSOR_PX[0] - 180.0), random.uniform(180.0, SENSOR_PX[1] - 180.0))
    return a_ball(random, lens=Lens(SENSOR_PX, f_px, f_px, *CENTRE_PX), about_px=about_px)


def _still(random: Random) -> Picture:
    """A white ball of r 60 on its stem before a textured ground: one scene for all seeds of a series."""
    stem = Stem(-0.5 * pi + random.uniform(-0.1, 0.1), 0.4, random.uniform(90.0, 150.0))
    ground = Background(random.uniform(40.0, 80.0), texture_dn=1.5, seed=int(random.integers(1 << 31)))
    surface = Surface(random.uniform(160.0, 190.0))
    return replace(a_ball(random, r_px=60.0), surface=surface, background=ground, stem=stem)


def _empty(random: Random) -> Picture:
    """No ball: texture, a slope, and up to ten polygons, bars and lines; nothing is round."""
    picture = textured(random, a_ball(random))
    slope = tuple(random.uniform(-0.3, 0.3, 2).tolist())
    width, height = picture.size_px
    behind = tuple(
        a_thing(random, random.uniform(0.0, width), random.uniform(0.0, height), random.uniform(0.1, 0.5) * width)
        for _ in range(random.integers(0, 11))
    )
    ground = replace(picture.background, gradient_dn_per_px=slope)
    return replace(picture, probe_mm=None, background=ground, behind=behind)


CATEGORIES: dict[str, Callable[[Random], Picture]] = {
    "clean": _clean,
    "low contrast": _low_contrast,
    "stem": _stem,
    "hidden": _hidden,
    "small": _small,
    "large": _large,
    "motion": _motion,
    "defocus": _defocus,
    "shaded": _shaded,
    "highlight": _highlight,
    "ruby": _ruby,
    "saturated": _saturated,
    "clutter": _clutter,
    "wide": _wide,
    "tele": _tele,
    "still": _still,
    "empty": _empty,
}
