"""A sphere's light on a grid of subpixels: which rays meet it, and how bright it is where they do.

With theta the angle between a ray and the sphere's centre, and alpha the sphere's angular radius, a ray meets the sphere where
rho = sin(theta) / sin(alpha) is below 1, at an angle of incidence whose sine is rho: exact at any range and off any axis.
"""

from dataclasses import dataclass
from functools import lru_cache
from math import pi

import numpy as np
import numpy.typing as npt

from trackerd.contract.model import Array
from trackerd.geometry.lens import Lens
from trackerd.geometry.sphere import outline
from trackerd.sim.raster import Grid, Window, half_plane_cover, window_about

RIM_SUBPIXELS = 2.5  # subpixels from the outline within which they are treated one by one
DEGREE = 10  # of the polynomial that undistorts a grid: below 1e-7 px on a tile of any lens with a field up to 90 deg
BEND_SHARE, BEND_PX = 0.05, 3.0  # how far a distorted outline leaves its ellipse, at most: share of the radius, and px

Indices = npt.NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class Lamp:
    """A light from one side, `direction` (3,) in C from the ball; `ambient` is the share that comes from everywhere."""

    direction: tuple[float, float, float]
    ambient: float


@dataclass(frozen=True, slots=True)
class Highlight:
    """A shining spot about the place whose outward normal is `normal` (3,) in C: a Gaussian over the normal's angle."""

    normal: tuple[float, float, float]
    strength_dn: float
    width_rad: float


@dataclass(frozen=True, slots=True)
class Surface:
    """What a ball looks like. Without more, a flat disc of one level."""

    level_dn: float = 180.0
    limb: float = 0.0  # share by which the level falls towards the rim, with 1 - cos of the angle of incidence
    lamp: Lamp | None = None  # Lambert's law
    highlights: tuple[Highlight, ...] = ()
    rim_dn: float = 0.0  # light reflected at grazing incidence, with (1 - cos)^5 as Schlick has it: a glossy ball's glow


@dataclass(frozen=True, slots=True)
class Rays:
    """Through the subpixels of a grid; all (rows, columns)."""

    u: Array
    v: Array
    norm: Array

    def along(self, direction: Array) -> Array:
        """Scalar product of the rays' unit directions with a vector (3,)."""
        return np.asarray((direction[0] * self.u + direction[1] * self.v + direction[2]) / self.norm)


def box_of(p_camera_mm: Array, radius_mm: float, lens: Lens, origin_px: tuple[int, int]) -> Window:
    """All pixels that the ball may touch."""
    ball = outline(p_camera_mm, radius_mm, lens)
    reach = ball.a_px * (1.0 + (BEND_SHARE if any(lens.distortion) else 0.0)) + BEND_PX
    return window_about(ball.x_px - origin_px[0], ball.y_px - origin_px[1], reach, reach)


def ball_light(
    p_camera_mm: Array, radius_mm: float, surface: Surface, lens: Lens, grid: Grid, origin_px: tuple[int, int]
) -> tuple[Array, Array]:
    """Share of each subpixel that the ball covers, and the light (DN) of that share's mean; both (rows, columns)."""
    rays = rays_through(lens, grid, origin_px)
    range_mm = float(np.linalg.norm(p_camera_mm))
    sin_alpha = radius_mm / range_mm
    towards = rays.along(p_camera_mm / range_mm)
    rho2 = (1.0 - towards * towards) / sin_alpha**2
    rho = np.sqrt(np.maximum(rho2, 0.0))
    cosine = np.sqrt(np.maximum(1.0 - rho2, 0.0))
    cover = (rho < 1.0).astype(np.float64)
    steepest = 1.0 / (outline(p_camera_mm, radius_mm, lens).b_px * grid.fine)
    _settle_the_rim(rho, steepest, cover, cosine)
    facing = _Facing(rays, p_camera_mm / range_mm, towards, sin_alpha, cosine)
    return cover, _light(surface, facing)


def rays_through(lens: Lens, grid: Grid, origin_px: tuple[int, int]) -> Rays:
    """Exact without distortion; with it, to the accuracy of the polynomial."""
    x, y = grid.x_px + origin_px[0], grid.y_px + origin_px[1]
    if not any(lens.distortion):
        u, v = (x - lens.cx_px) / lens.fx_px, (y - lens.cy_px) / lens.fy_px
        return Rays(u, v, np.sqrt(u * u + v * v + 1.0))
    left, top = grid.window.left + origin_px[0], grid.window.top + origin_px[1]
    along_u, along_v = _undistortion(lens, Window(left, top, grid.window.width, grid.window.height))
    across = np.polynomial.chebyshev.chebvander(_scaled(x.ravel(), left, grid.window.width), DEGREE)
    down = np.polynomial.chebyshev.chebvander(_scaled(y.ravel(), top, grid.window.height), DEGREE)
    u, v = down @ along_u @ across.T, down @ along_v @ across.T
    return Rays(u, v, np.sqrt(u * u + v * v + 1.0))


@dataclass(frozen=True, slots=True)
class _Facing:
    """How the surface is turned where the rays meet it."""

    rays: Rays
    centre: Array  # unit direction (3,)
    towards: Array  # cos(theta)
    sin_alpha: float
    cosine: Array  # of the angle of incidence

    def normal_along(self, direction: Array) -> Array:
        """Scalar product of the outward normal with a vector (3,): n = -cos(i) d - (c - cos(theta) d) / sin(alpha)."""
        along = self.rays.along(direction)
        return np.asarray(-self.cosine * along - (float(self.centre @ direction) - self.towards * along) / self.sin_alpha)


def _light(surface: Surface, facing: _Facing) -> Array:
    light = np.full(facing.cosine.shape, surface.level_dn)
    if surface.limb > 0.0:
        light *= 1.0 - surface.limb + surface.limb * facing.cosine
    if surface.lamp is not None:
        shade = np.maximum(facing.normal_along(_unit(surface.lamp.direction)), 0.0)
        light *= surface.lamp.ambient + (1.0 - surface.lamp.ambient) * shade
    if surface.rim_dn > 0.0:
        light += surface.rim_dn * (1.0 - facing.cosine) ** 5
    for spot in surface.highlights:
        light += spot.strength_dn * np.exp((facing.normal_along(_unit(spot.normal)) - 1.0) / spot.width_rad**2)
    return light


def _settle_the_rim(rho: Array, slope: float, cover: Array, cosine: Array) -> None:
    """Near the outline: the covered share, and the mean cosine over it (whose slope is infinite at the rim). In place.

    `slope` is what rho changes by at most from one subpixel to the next.
    """
    rows, columns = _rim(rho, slope)
    gx = 0.5 * (rho[rows, columns + 1] - rho[rows, columns - 1])  # per subpixel
    gy = 0.5 * (rho[rows + 1, columns] - rho[rows - 1, columns])
    at, steep = rho[rows, columns], np.hypot(gx, gy)
    cover[rows, columns] = half_plane_cover((1.0 - at) / steep, gx / steep, gy / steep)
    half = 0.5 * np.maximum(np.abs(gx), np.abs(gy))
    low, high = np.clip(at - half, 0.0, 1.0), np.clip(at + half, 0.0, 1.0)
    inside = high - low > 1e-12
    mean = np.zeros_like(at)
    mean[inside] = (_cosine_integral(high[inside]) - _cosine_integral(low[inside])) / (high[inside] - low[inside])
    cosine[rows, columns] = mean


def _rim(rho: Array, slope: float) -> tuple[Indices, Indices]:
    """Rows and columns of the subpixels near the outline, except those on the border of the grid."""
    rows, columns = np.nonzero(np.abs(rho[1:-1, 1:-1] - 1.0) < RIM_SUBPIXELS * slope)
    return rows + 1, columns + 1


def _cosine_integral(rho: Array) -> Array:
    """Of sqrt(1 - rho^2) from 0."""
    return np.asarray(0.5 * (rho * np.sqrt(np.maximum(1.0 - rho * rho, 0.0)) + np.arcsin(rho)))


def _unit(direction: tuple[float, float, float]) -> Array:
    vector = np.array(direction)
    return np.asarray(vector / np.linalg.norm(vector))


def _scaled(q_px: Array, first_px: int, count_px: int) -> Array:
    """Of a window's pixels onto -1..1, edges included."""
    return (q_px - (first_px - 0.5)) * (2.0 / count_px) - 1.0


@lru_cache(maxsize=128)
def _undistortion(lens: Lens, window: Window) -> tuple[Array, Array]:
    """Chebyshev coefficients (rows, columns) of the undistorted coordinates over a window of the sensor."""
    nodes = np.cos(pi * (np.arange(DEGREE + 1) + 0.5) / (DEGREE + 1))
    x = window.left - 0.5 + 0.5 * (nodes + 1.0) * window.width
    y = window.top - 0.5 + 0.5 * (nodes + 1.0) * window.height
    values = np.array([[lens.normalise(np.array((column, row))) for column in x] for row in y])
    inverse = np.linalg.inv(np.polynomial.chebyshev.chebvander(nodes, DEGREE))
    return inverse @ values[..., 0] @ inverse.T, inverse @ values[..., 1] @ inverse.T
