"""The Cramér-Rao bound of a picture: the least covariance that any unbiased estimate of its outline can have.

Fisher information of the rendered pixels for x, y and r of the outline, with the blur, the ball's level and everything else's
level unknown, too: before a ground that is clipped, r is hardly known, since a brighter ground looks like a smaller dark ball.
The stem stays where it is when the outline is moved: that its middle is the ball's is no knowledge of the outline.
"""

from dataclasses import replace
from functools import lru_cache
from math import erfc, exp, pi, sqrt

import numpy as np

from trackerd.contract.model import Array
from trackerd.sim.ball import Surface
from trackerd.sim.optics import margin_px
from trackerd.sim.picture import Background, Picture, ball_box, probe_seen_at, render, stem_bar, truth
from trackerd.sim.raster import Polygon, Shape, Window
from trackerd.sim.sensor import Sensor

STEP_PX = 0.05  # of x, y and r, to either side: the third derivative of an edge costs 0.1 % of a slope
BLUR_STEP = 0.02  # of the blur, as a share
LEAST_INFORMATION = 1e-6  # 1 / px: what rounding of floats leaves of none
CLIP_REACH = 8.0  # sigmas from saturation beyond which a pixel is wholly clipped, or not at all


def bound(picture: Picture, sensor: Sensor) -> Array:
    """Covariance (3, 3) of x, y, r in px^2. Raises ValueError without a probe, or where the picture does not determine it."""
    window, stem = _window(picture), stem_bar(picture)
    light = render(picture, window, stem)
    slopes = [*_outline_slopes(picture, window, stem), _blur_slope(picture, window, stem)]
    ball = render(_ball_alone(picture), window, _dark(stem))
    slopes += [ball, 1.0 - ball]
    weight = information(light, sensor)
    moved = np.stack([slope.ravel() for slope in slopes])
    fisher = (moved * weight.ravel()) @ moved.T
    scale = np.sqrt(np.diag(fisher))
    if not (scale > LEAST_INFORMATION).all():
        raise ValueError("nothing in the picture depends on the outline")
    covariance = np.linalg.inv(fisher / np.outer(scale, scale)) / np.outer(scale, scale)
    return np.asarray(covariance[:3, :3])


def information(expected_dn: Array, sensor: Sensor) -> Array:
    """On the expected level of each pixel, in 1/DN^2: 1 / variance, less where the level is clipped."""
    variance = sensor.variance_dn2(np.minimum(expected_dn, sensor.saturation_dn))
    z = np.clip((sensor.saturation_dn - expected_dn) / np.sqrt(variance), -CLIP_REACH, CLIP_REACH)
    places, shares = _clipped_information()
    return np.asarray(np.interp(z, places, shares) / variance)


def _outline_slopes(picture: Picture, window: Window, stem: Polygon | None) -> list[Array]:
    """d light / d (x, y, r): the sphere moves so that its outline does."""
    slopes = []
    for axis in range(3):
        there, back = (render(_moved(picture, axis, step), window, stem) for step in (STEP_PX, -STEP_PX))
        slopes.append((there - back) / (2.0 * STEP_PX))
    return slopes


def _moved(picture: Picture, axis: int, step_px: float) -> Picture:
    circle = list(truth(picture).circle)
    circle[axis] += step_px
    x, y, r = circle
    return replace(picture, probe_mm=probe_seen_at((x, y, r), picture.radius_mm, picture.lens, picture.origin_px))


def _blur_slope(picture: Picture, window: Window, stem: Polygon | None) -> Array:
    step_px = BLUR_STEP * picture.psf_px
    more, less = (render(replace(picture, psf_px=picture.psf_px + step), window, stem) for step in (step_px, -step_px))
    return (more - less) / (2.0 * step_px)


def _ball_alone(picture: Picture) -> Picture:
    """The share of each pixel's light that the ball gives."""
    return replace(
        picture,
        surface=Surface(level_dn=1.0),
        background=Background(level_dn=0.0),
        behind=(),
        front=tuple(_black(shape) for shape in picture.front),
    )


def _black(shape: Shape) -> Shape:
    return replace(shape, level_dn=0.0)


def _dark(stem: Polygon | None) -> Polygon | None:
    return None if stem is None else replace(stem, level_dn=0.0)


def _window(picture: Picture) -> Window:
    """The part of the image in which anything depends on the outline."""
    margin = margin_px(picture.psf_px, picture.defocus_px, picture.motion_px)
    return ball_box(picture).grown(margin).clipped(picture.window)


@lru_cache(maxsize=1)
def _clipped_information() -> tuple[Array, Array]:
    """What is left, as a share, of the information of a normal observation that is clipped z sigmas above its mean."""
    places = np.linspace(-CLIP_REACH, CLIP_REACH, 1601)
    return places, np.array([_share_left(z) for z in places])


def _share_left(z: float) -> float:
    """Of an observation min(mean + sigma n, mean + sigma z): Phi(z) - z phi(z) + phi(z)^2 / (1 - Phi(z))."""
    density, beyond = exp(-0.5 * z * z) / sqrt(2.0 * pi), 0.5 * erfc(z / sqrt(2.0))
    return 1.0 - beyond - z * density + density * density / beyond
