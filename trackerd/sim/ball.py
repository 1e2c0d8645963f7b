"""A sphere's light on a grid of subpixels: which rays meet it, and how bright it is where they do.

With theta the angle between a ray and the sphere's centre, and alpha the sphere's angular radius, a ray meets the sphere where
rho = sin(theta) / sin(alpha) is below 1, at an angle of incidence whose sine is rho: exact at any range and off any axis.
"""

from dataclasses import dataclass, replace
from functools import lru_cache
from math import hypot, pi

import numpy as np
import numpy.typing as npt

from trackerd.contract.model import Array
from trackerd.geometry.lens import Lens
from trackerd.geometry.sphere import outline
from trackerd.sim.raster import Grid, Window, half_plane_cover, window_about

RIM_INSIDE, RIM_OUTSIDE = 3.0, 1.0  # subpixels from the outline within which they are taken to parts
RIM_PARTS = 4  # a side
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
    """Through the subpixels of a grid, or through any other points; the arrays broadcast to one shape."""

    u: Array
    v: Array
    norm: Array

    @classmethod
    def of(cls, u: Array, v: Array) -> "Rays":
        """Through points of the plane at unit distance."""
        return cls(u, v, np.sqrt(u * u + v * v + 1.0))

    def along(self, direction: Array) -> Array:
        """Scalar product of the rays' unit directions with a vector (3,)."""
        return np.asarray((direction[0] * self.u + direction[1] * self.v + direction[2]) / self.norm)


def box_of(p_camera_mm: Array, radius_mm: float, lens: Lens, origin_px: tuple[int, int]) -> Window:
    """All pixels that the ball may touch."""
    ball = outline(p_camera_mm, radius_mm, lens)
    reach = ball.a_px * (1.0 + (BEND_SHARE if any(lens.distortion) else 0.0)) + BEND_PX
    return window_about(ball.x_px - origin_px[0], ball.y_px - origin_px[1], reach, reach)


def inside_of(window: Window, p_camera_mm: Array, radius_mm: float, lens: Lens, origin_px: tuple[int, int]) -> bool:
    """Whether all of a window is ball, and its outline some pixels away."""
    ball = outline(p_camera_mm, radius_mm, lens)
    x_px, y_px = ball.x_px - origin_px[0], ball.y_px - origin_px[1]
    far_x = max(abs(window.left - 0.5 - x_px), abs(window.left + window.width - 0.5 - x_px))
    far_y = max(abs(window.top - 0.5 - y_px), abs(window.top + window.height - 0.5 - y_px))
    return hypot(far_x, far_y) < ball.b_px * (1.0 - (BEND_SHARE if any(lens.distortion) else 0.0)) - BEND_PX


def ball_light(
    p_camera_mm: Array, radius_mm: float, surface: Surface, lens: Lens, grid: Grid, origin_px: tuple[int, int]
) -> tuple[Array, Array]:
    """Share of each subpixel that the ball covers, and the light (DN) of that share's mean; both (rows, columns)."""
    range_mm = float(np.linalg.norm(p_camera_mm))
    ball = _Cone(p_camera_mm / range_mm, radius_mm / range_mm)
    rays = rays_through(lens, grid, origin_px)
    met = ball.meet(rays)
    cover, light = (met.rho < 1.0).astype(np.float64), _area_mean(_light(surface, met))
    steepest = 1.0 / (outline(p_camera_mm, radius_mm, lens).b_px * grid.fine)
    rim = _rim(met.rho, steepest)
    cover[rim], light[rim] = _rim_light(ball, surface, rays, met.rho, rim)
    return cover, light


def rays_through(lens: Lens, grid: Grid, origin_px: tuple[int, int]) -> Rays:
    """Exact without distortion; with it, to the accuracy of the polynomial."""
    x, y = grid.x_px + origin_px[0], grid.y_px + origin_px[1]
    if not any(lens.distortion):
        u, v = (x - lens.cx_px) / lens.fx_px, (y - lens.cy_px) / lens.fy_px
        return Rays.of(u, v)
    left, top = grid.window.left + origin_px[0], grid.window.top + origin_px[1]
    along_u, along_v = _undistortion(lens, Window(left, top, grid.window.width, grid.window.height))
    across = np.polynomial.chebyshev.chebvander(_scaled(x.ravel(), left, grid.window.width), DEGREE)
    down = np.polynomial.chebyshev.chebvander(_scaled(y.ravel(), top, grid.window.height), DEGREE)
    return Rays.of(down @ along_u @ across.T, down @ along_v @ across.T)


@dataclass(frozen=True, slots=True)
class _Meeting:
    """Where rays meet a sphere; the arrays are of the rays' shape."""

    cone: "_Cone"
    rays: Rays
    towards: Array  # cos(theta)
    rho: Array
    cosine: Array  # of the angle of incidence; 0 where a ray misses

    def normal_along(self, direction: Array) -> Array:
        """Scalar product of the outward normal with a vector (3,): n = -cos(i) d - (c - cos(theta) d) / sin(alpha)."""
        along = self.rays.along(direction)
        across = float(self.cone.centre @ direction) - self.towards * along
        return np.asarray(-self.cosine * along - across / self.cone.sin_alpha)


@dataclass(frozen=True, slots=True)
class _Cone:
    """A sphere as it is seen: direction (3,) of its centre, and the sine of its angular radius."""

    centre: Array
    sin_alpha: float

    def meet(self, rays: Rays) -> _Meeting:
        towards = rays.along(self.centre)
        rho2 = (1.0 - towards * towards) / self.sin_alpha**2
        cosine = np.sqrt(np.maximum(1.0 - rho2, 0.0))
        return _Meeting(self, rays, towards, np.sqrt(np.maximum(rho2, 0.0)), cosine)


def _light(surface: Surface, met: _Meeting) -> Array:
    light = np.full(met.cosine.shape, float(surface.level_dn))
    if surface.limb > 0.0:
        light *= 1.0 - surface.limb + surface.limb * met.cosine
    if surface.lamp is not None:
        shade = np.maximum(met.normal_along(_unit(surface.lamp.direction)), 0.0)
        light *= surface.lamp.ambient + (1.0 - surface.lamp.ambient) * shade
    if surface.rim_dn > 0.0:
        light += surface.rim_dn * (1.0 - met.cosine) ** 5
    for spot in surface.highlights:
        light += spot.strength_dn * np.exp((met.normal_along(_unit(spot.normal)) - 1.0) / spot.width_rad**2)
    return light


def _area_mean(light: Array) -> Array:
    """Means over the subpixels' areas from the values at their centres, to second order; the border is left as it is."""
    mean = light.copy()
    inner = light[1:-1, 1:-1]
    mean[1:-1, 1:-1] += (light[1:-1, 2:] + light[1:-1, :-2] + light[2:, 1:-1] + light[:-2, 1:-1] - 4.0 * inner) / 24.0
    return mean


def _rim(rho: Array, slope: float) -> tuple[Indices, Indices]:
    """Rows and columns of the subpixels that the outline crosses, and of some inside of it; none on the grid's border.

    `slope` is the most by which rho changes from one subpixel to the next.
    """
    inner = rho[1:-1, 1:-1]
    rows, columns = np.nonzero((inner > 1.0 - RIM_INSIDE * slope) & (inner < 1.0 + RIM_OUTSIDE * slope))
    return rows + 1, columns + 1


def _rim_light(ball: _Cone, surface: Surface, rays: Rays, rho: Array, rim: tuple[Indices, Indices]) -> tuple[Array, Array]:
    """Cover and light of the rim's subpixels, from parts of them: light has an infinite slope at the rim."""
    offset = (np.arange(RIM_PARTS) + 0.5) / RIM_PARTS - 0.5
    met = ball.meet(_between(rays, rim, offset[None, None, :], offset[None, :, None]))
    slope_x, slope_y = (slope[:, None, None] / RIM_PARTS for slope in _slopes(rho, rim))
    slope = np.hypot(slope_x, slope_y)
    cover = half_plane_cover((1.0 - met.rho) / slope, slope_x / slope, slope_y / slope)
    mean_cosine = _mean_cosine(met.rho, 0.5 * np.maximum(np.abs(slope_x), np.abs(slope_y)))
    light = _light(surface, replace(met, cosine=mean_cosine))
    covered = cover.mean(axis=(1, 2))
    return covered, (cover * light).mean(axis=(1, 2)) / np.maximum(covered, 1e-12)


def _between(rays: Rays, at: tuple[Indices, Indices], right: Array, down: Array) -> Rays:
    """Rays beside those of some subpixels, by parts of a subpixel; (subpixels, ...) in the shape of `right` and `down`."""
    u, v = np.broadcast_arrays(rays.u, rays.v)
    beside = []
    for values in (u, v):
        slope_x, slope_y = (slope[:, None, None] for slope in _slopes(values, at))
        beside.append(values[at][:, None, None] + slope_x * right + slope_y * down)
    return Rays.of(*beside)


def _slopes(values: Array, at: tuple[Indices, Indices]) -> tuple[Array, Array]:
    """Per subpixel, along the rows and down the columns."""
    rows, columns = at
    along = 0.5 * (values[rows, columns + 1] - values[rows, columns - 1])
    return along, 0.5 * (values[rows + 1, columns] - values[rows - 1, columns])


def _mean_cosine(rho: Array, reach: Array) -> Array:
    """Of sqrt(1 - rho^2) over rho ± reach, as far as that is on the ball."""
    low, high = np.clip(rho - reach, 0.0, 1.0), np.clip(rho + reach, 0.0, 1.0)
    width = np.maximum(high - low, 1e-12)
    return (_cosine_integral(high) - _cosine_integral(low)) / width


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
