"""A camera's image of the probe, in DN: exact outline, blurred edge, stem, background, noise.

Only the rectangle of probe and stem is computed anew; OpenCV and NumPy release the interpreter lock for most of the time.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import cos, hypot, radians, sin

import numpy as np
import numpy.typing as npt

from trackerd.contract.model import Array
from trackerd.formats.settings import CameraSettings
from trackerd.formats.twin import LookSettings
from trackerd.geometry.gimbal import Station
from trackerd.geometry.rigid import Rigid
from trackerd.geometry.sphere import Ellipse, outline
from trackerd.sim.backdrop import Backdrop, SensorNoise
from trackerd.sim.edge import Edge, Floats, Limb
from trackerd.sim.noise import key

FARTHEST_ASIDE = 1.0  # of the depth: beyond 45 deg no lens of a cell sees, and distortion would fold the ball back into view
SHARP_PX = 0.2  # a motion below this widens an edge of sigma 0.9 px by less than 0.3 %


@dataclass(frozen=True, slots=True)
class Window:
    """Columns left..right-1 and rows top..bottom-1 of the image."""

    left: int
    top: int
    right: int
    bottom: int

    @property
    def empty(self) -> bool:
        return self.right <= self.left or self.bottom <= self.top

    def grid(self) -> tuple[Floats, Floats]:
        """Pixel coordinates: a row of x and a column of y."""
        return (
            np.arange(self.left, self.right, dtype=np.float32)[None, :],
            np.arange(self.top, self.bottom, dtype=np.float32)[:, None],
        )

    def of(self, image: Floats) -> Floats:
        return image[self.top : self.bottom, self.left : self.right]


class Renderer:
    """One camera's images; not for two threads at once. `station` is the true one."""

    def __init__(self, station: Station, camera: CameraSettings, look: LookSettings, radius_mm: float, seed: int) -> None:
        self._lens = station.lens
        self._look = look
        self._radius_mm = radius_mm
        self._origin_px = (camera.offset_x_px, camera.offset_y_px)
        self._size_px = (camera.width_px, camera.height_px)
        self._dn = np.empty((camera.height_px, camera.width_px), np.float32)
        self._edge = Edge(look.psf_px)
        self._limb = Limb(self._edge)
        reference = station.world_from_camera(0.0, 0.0).rotation
        stream = key(seed, station.name, "image")
        self._backdrop = Backdrop(look, station.lens, reference, self._size_px, key(stream, "texture"))
        self._noise = SensorNoise(look, self._dn.shape, key(stream, "noise"))

    def render(
        self,
        poses: Sequence[Rigid],
        probes_mm: Sequence[Array],
        frame_id: int,
        out: npt.NDArray[np.uint8] | None = None,
    ) -> npt.NDArray[np.uint8]:
        """The exposure whose middles of equal parts have these poses world_from_camera and probe positions (3,) in W.

        Without probes the probe is hidden. `out`, if given, is (height, width) and contiguous; it is returned.
        """
        image = np.empty(self._dn.shape, np.uint8) if out is None else out
        self._noise.expose(self.expected(poses, probes_mm), frame_id, image)
        return image

    def expected(self, poses: Sequence[Rigid], probes_mm: Sequence[Array]) -> Floats:
        """The image without noise and rounding, in DN; valid until the next call."""
        self._backdrop.draw(poses[len(poses) // 2].rotation, self._dn)
        balls = self._balls(poses, probes_mm)
        window = self._window(balls)
        if balls and not window.empty:
            self._average(balls, window)
        return self._dn

    def _balls(self, poses: Sequence[Rigid], probes_mm: Sequence[Array]) -> list[Ellipse]:
        """Outlines in image coordinates; a single one amid them where their motion does not show."""
        balls = []
        for pose, probe_mm in zip(poses, probes_mm, strict=False):
            p_camera = pose.inverse().move(probe_mm)
            if p_camera[2] > 2.0 * self._radius_mm and hypot(p_camera[0], p_camera[1]) < FARTHEST_ASIDE * p_camera[2]:
                e = outline(p_camera, self._radius_mm, self._lens)
                x_px, y_px = e.x_px - self._origin_px[0], e.y_px - self._origin_px[1]
                balls.append(Ellipse(x_px, y_px, e.a_px, e.b_px, e.angle_rad))
        if balls and hypot(balls[-1].x_px - balls[0].x_px, balls[-1].y_px - balls[0].y_px) < SHARP_PX:
            x_px, y_px = (sum(values) / len(balls) for values in zip(*((b.x_px, b.y_px) for b in balls), strict=True))
            return [replace(balls[len(balls) // 2], x_px=x_px, y_px=y_px)]
        return balls

    def _average(self, balls: list[Ellipse], window: Window) -> None:
        behind = window.of(self._dn)
        if len(balls) == 1:
            self._draw(behind, window, balls[0])
            return
        total = np.zeros_like(behind)
        for ball in balls:
            picture = behind.copy()
            self._draw(picture, window, ball)
            total += picture
        np.multiply(total, np.float32(1.0 / len(balls)), out=behind)

    def _draw(self, picture: Floats, window: Window, ball: Ellipse) -> None:
        if self._look.stem_width > 0.0:
            self._draw_stem(picture, window, ball)
        self._draw_ball(picture, window, ball)

    def _draw_ball(self, picture: Floats, window: Window, ball: Ellipse) -> None:
        part = self._clip(*_box(ball, self._edge.reach_px))
        if part.empty:
            return
        distance = _distance(ball, part) + np.float32(self._edge.bend(ball.r_px))
        coverage = self._edge.coverage(distance)
        target = _inside(picture, window, part)
        target += coverage * (np.float32(self._look.probe_dn) - target)
        if self._look.limb > 0.0:
            target -= np.float32(self._look.probe_dn * self._look.limb) * self._limb.loss(distance, ball.r_px)

    def _draw_stem(self, picture: Floats, window: Window, ball: Ellipse) -> None:
        """A bar from the ball's middle outwards; the ball is drawn over its beginning."""
        part = self._clip(*self._stem_box(ball))
        if part.empty:
            return
        x, y = part.grid()
        along_x, along_y = self._stem_direction()
        dx, dy = x - np.float32(ball.x_px), y - np.float32(ball.y_px)
        across = np.abs(dx * np.float32(-along_y) + dy * np.float32(along_x))
        coverage = self._edge.coverage(across - np.float32(self._look.stem_width * ball.r_px))
        coverage *= dx * np.float32(along_x) + dy * np.float32(along_y) > 0.0
        target = _inside(picture, window, part)
        target += coverage * (np.float32(self._look.stem_dn) - target)

    def _window(self, balls: Sequence[Ellipse]) -> Window:
        """All that ball and stem touch."""
        boxes = [_box(ball, self._edge.reach_px) for ball in balls]
        if self._look.stem_width > 0.0:
            boxes += [self._stem_box(ball) for ball in balls]
        if not boxes:
            return Window(0, 0, 0, 0)
        left, top, right, bottom = zip(*boxes, strict=True)
        return self._clip(min(left), min(top), max(right), max(bottom))

    def _stem_box(self, ball: Ellipse) -> tuple[float, float, float, float]:
        along_x, along_y = self._stem_direction()
        half = self._look.stem_width * ball.r_px + self._edge.reach_px
        length = float(sum(self._size_px)) + abs(ball.x_px) + abs(ball.y_px)  # beyond the image, wherever the ball is
        end_x, end_y = ball.x_px + length * along_x, ball.y_px + length * along_y
        side_x, side_y = half * abs(along_y), half * abs(along_x)
        return (
            min(ball.x_px, end_x) - side_x,
            min(ball.y_px, end_y) - side_y,
            max(ball.x_px, end_x) + side_x,
            max(ball.y_px, end_y) + side_y,
        )

    def _stem_direction(self) -> tuple[float, float]:
        angle = radians(self._look.stem_deg)
        return cos(angle), sin(angle)

    def _clip(self, left: float, top: float, right: float, bottom: float) -> Window:
        width, height = self._size_px
        return Window(
            min(max(0, int(left)), width),
            min(max(0, int(top)), height),
            max(0, min(width, int(right) + 2)),
            max(0, min(height, int(bottom) + 2)),
        )


def _box(ball: Ellipse, margin_px: float) -> tuple[float, float, float, float]:
    reach = ball.a_px + margin_px
    return ball.x_px - reach, ball.y_px - reach, ball.x_px + reach, ball.y_px + reach


def _distance(ball: Ellipse, part: Window) -> Floats:
    """Signed distance from the outline, along the ray from its centre: negative inside."""
    x, y = part.grid()
    x, y = x - np.float32(ball.x_px), y - np.float32(ball.y_px)
    c, s = cos(ball.angle_rad), sin(ball.angle_rad)
    a2, b2 = ball.a_px**2, ball.b_px**2
    xx, yy, xy = c * c / a2 + s * s / b2, s * s / a2 + c * c / b2, 2.0 * c * s * (1.0 / a2 - 1.0 / b2)
    x2, y2 = x * x, y * y
    squared = x2 + y2 + np.float32(1e-6)  # the centre has a distance too
    form = np.float32(xx) * x2 + np.float32(yy) * y2 + np.float32(1e-6 / a2)
    form += (np.float32(xy) * x) * y
    radius = np.sqrt(squared / form)
    return np.asarray(np.sqrt(squared) - radius)


def _inside(picture: Floats, window: Window, part: Window) -> Floats:
    """The part of a window's picture."""
    return picture[part.top - window.top : part.bottom - window.top, part.left - window.left : part.right - window.left]
