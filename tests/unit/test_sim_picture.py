"""The judge renderer against brute force: light at points, none of its formulae, eight or more of them to a pixel's side."""

from dataclasses import dataclass, replace
from math import cos, pi, sin

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sim_cell import PLAIN, camera, station

from trackerd.formats.twin import LookSettings
from trackerd.geometry.lens import Lens
from trackerd.geometry.sphere import centre_and_range
from trackerd.sim import picture as judge
from trackerd.sim.ball import Highlight, Lamp, Surface
from trackerd.sim.picture import Background, Picture, Stem, expected, probe_seen_at, truth
from trackerd.sim.raster import Disc, Grid, Polygon, Window, bar, half_plane_cover
from trackerd.sim.render import Renderer
from trackerd.sim.sensor import Sensor, expose

FINER = 6  # points a side of a subpixel that an edge crosses
TELE = Lens((2048, 1536), 18400.0, 18400.0, 1023.5, 767.5)
WIDE = Lens((2048, 1536), 2400.0, 2410.0, 1013.5, 760.5, (-0.15, 0.05, 1e-3, -5e-4, 0.0))
CORNER_PX = (1800, 1300)
LAMP = Surface(190.0, limb=0.2, lamp=Lamp((0.8, -0.3, -0.6), 0.4))
RUBY = Surface(20.0, rim_dn=60.0, highlights=(Highlight((-0.3, -0.4, -0.85), 200.0, 0.15),))


def picture(r_px=14.0, lens=TELE, origin_px=(900, 700), off_px=(0.3, -0.2), **more):
    side_px = round(2.2 * r_px) + 14
    circle = (0.5 * side_px + off_px[0], 0.5 * side_px + off_px[1], r_px)
    return Picture((side_px, side_px), lens, probe_seen_at(circle, 4.0, lens, origin_px), 4.0, origin_px, **more)


# ---- brute force -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Brute:
    """A picture's light at points, from the rays through them; `fine` points a side of a pixel."""

    picture: Picture
    fine: int

    def pixels(self):
        margin = int(np.ceil(7.0 * self.picture.psf_px + self.picture.defocus_px + 2.0))
        light = self._fine(margin)
        if self.picture.defocus_px:
            light = circle_blurred(light, self.picture.defocus_px, self.fine)
        t = np.arange(-margin * self.fine, margin * self.fine + 1) / self.fine
        gauss = np.exp(-0.5 * (t / self.picture.psf_px) ** 2)
        light = cv2.sepFilter2D(light, -1, gauss / gauss.sum(), gauss / gauss.sum())
        inner = light[margin * self.fine : -margin * self.fine, margin * self.fine : -margin * self.fine]
        return inner.reshape(self.picture.size_px[1], self.fine, self.picture.size_px[0], self.fine).mean(axis=(1, 3))

    def _fine(self, margin):
        x, y = (
            np.arange((size + 2 * margin) * self.fine) / self.fine - margin - 0.5 + 0.5 / self.fine
            for size in self.picture.size_px
        )
        light = self.at(x[None, :], y[:, None])
        jump = cv2.dilate(light, np.ones((3, 3))) - cv2.erode(light, np.ones((3, 3)))
        rows, columns = np.nonzero(jump > 2.0)
        part = ((np.arange(FINER) + 0.5) / FINER - 0.5) / self.fine
        light[rows, columns] = self.at(
            x[columns][:, None, None] + part[None, None, :], y[rows][:, None, None] + part[None, :, None]
        ).mean(axis=(1, 2))
        return light

    def at(self, x, y):
        """Light of the sharp scene at points, in DN."""
        ground = np.full(np.broadcast_shapes(x.shape, y.shape), self.picture.background.level_dn)
        if self.picture.stem is not None:
            ground = np.where(self._in_stem(x, y), self.picture.stem.level_dn, ground)
        u, v = self._undistorted(x + self.picture.origin_px[0], y + self.picture.origin_px[1])
        ray = [part / np.sqrt(1.0 + u * u + v * v) for part in (u, v, 1.0)]
        centre, r_mm, surface = self.picture.probe_mm, self.picture.radius_mm, self.picture.surface
        along = sum(part * c for part, c in zip(ray, centre, strict=True))
        squared = along**2 - (np.dot(centre, centre) - r_mm**2)
        if surface == Surface(surface.level_dn):
            return np.where(squared > 0.0, surface.level_dn, ground)
        distance = along - np.sqrt(np.maximum(squared, 0.0))
        normal = [(distance * part - c) / r_mm for part, c in zip(ray, centre, strict=True)]
        return np.where(squared > 0.0, shaded(surface, ray, normal), ground)

    def _in_stem(self, x, y):
        stem, ball = self.picture.stem, truth(self.picture)
        c, s, dx, dy = cos(stem.angle_rad), sin(stem.angle_rad), x - ball.x_px, y - ball.y_px
        return (dx * c + dy * s > 0.0) & (np.abs(dy * c - dx * s) < stem.width * ball.r_px)

    def _undistorted(self, x, y):
        lens = self.picture.lens
        xd, yd = (x - lens.cx_px) / lens.fx_px, (y - lens.cy_px) / lens.fy_px
        k1, k2, p1, p2, k3 = lens.distortion
        u, v = xd, yd
        for _ in range(8 if any(lens.distortion) else 0):
            r2 = u * u + v * v
            radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
            u, v = (
                (xd - 2.0 * p1 * u * v - p2 * (r2 + 2.0 * u * u)) / radial,
                (yd - p1 * (r2 + 2.0 * v * v) - 2.0 * p2 * u * v) / radial,
            )
        return u, v


def shaded(surface, ray, normal):
    cosine = np.maximum(-dot(ray, normal), 0.0)
    light = surface.level_dn * (1.0 - surface.limb * (1.0 - cosine))
    if surface.lamp is not None:
        light = light * (
            surface.lamp.ambient + (1.0 - surface.lamp.ambient) * np.maximum(dot(normal, unit(surface.lamp.direction)), 0.0)
        )
    light = light + surface.rim_dn * (1.0 - cosine) ** 5
    return light + sum(h.strength_dn * np.exp((dot(normal, unit(h.normal)) - 1.0) / h.width_rad**2) for h in surface.highlights)


def dot(a, b):
    return sum(x * y for x, y in zip(a, b, strict=True))


def unit(vector):
    return np.array(vector) / np.linalg.norm(vector)


def circle_blurred(light, radius_px, fine):
    reach = int(radius_px * fine) + 2
    points = ((np.arange((2 * reach + 1) * FINER) + 0.5) / FINER - reach - 0.5) / fine
    inside = points[:, None] ** 2 + points[None, :] ** 2 < radius_px**2
    disc = inside.reshape(2 * reach + 1, FINER, 2 * reach + 1, FINER).mean(axis=(1, 3))
    size = [cv2.getOptimalDFTSize(n + 2 * reach) for n in light.shape]
    blurred = np.fft.irfft2(np.fft.rfft2(light, size) * np.fft.rfft2(disc / disc.sum(), size), size)
    return blurred[reach : reach + light.shape[0], reach : reach + light.shape[1]]


def displacement_px(made, difference_dn):
    """By how much (x, y, r) of a noiseless weighted fit would move; blur and both levels are free, too."""
    circle = np.array(truth(made).circle)

    def rendered(**changed):
        return judge.render(replace(made, **changed), made.window, judge.stem_bar(made))

    def moved(step):
        return rendered(probe_mm=probe_seen_at(tuple(circle + step), made.radius_mm, made.lens, made.origin_px))

    slopes = [moved(step) - moved(-step) for step in 0.5 * np.eye(3) / 10.0]
    slopes.append(rendered(psf_px=1.01 * made.psf_px) - rendered(psf_px=0.99 * made.psf_px))
    ball = rendered(surface=Surface(1.0), background=Background(0.0), stem=None)
    slopes = np.stack([slope.ravel() for slope in (*slopes, ball, 1.0 - ball)])
    weighted = slopes / Sensor().variance_dn2(expected(made)).ravel()
    return np.linalg.solve(weighted @ slopes.T, weighted @ difference_dn.ravel())[:3] / 10.0


CASES = {
    "flat": picture(),
    "on a subpixel's edge": picture(off_px=(0.125, 0.5)),
    "sharp": picture(psf_px=0.45),
    "dark limb": picture(surface=Surface(180.0, limb=0.6)),
    "lamp": picture(surface=LAMP),
    "ruby": picture(surface=RUBY),
    "stem": picture(stem=Stem(-1.2, 0.4, 140.0)),
    "defocus": picture(defocus_px=3.0),
    "wide and distorted": picture(lens=WIDE, origin_px=CORNER_PX),
    "wide, distorted, lamp": picture(lens=WIDE, origin_px=CORNER_PX, surface=LAMP),
    "r 60": picture(r_px=60.0),
}


@pytest.mark.parametrize("name", CASES)
def test_the_picture_is_that_of_brute_force(name):
    made = CASES[name]
    difference = expected(made) - Brute(made, 8 if name == "r 60" else 16).pixels()
    assert np.abs(difference).max() < 0.2
    assert np.abs(displacement_px(made, difference)).max() < 2e-4


def test_a_displaced_picture_fails_that_comparison():
    made = CASES["flat"]
    x, y, r = truth(made).circle
    aside = replace(made, probe_mm=probe_seen_at((x + 1e-3, y, r), made.radius_mm, made.lens, made.origin_px))
    shift = displacement_px(made, expected(aside) - expected(made))
    assert shift == pytest.approx((1e-3, 0.0, 0.0), abs=2e-5)


@pytest.mark.parametrize("stem", [None, Stem(0.7, 0.5, 140.0)])
def test_motion_is_the_mean_of_its_instants(stem):
    made = picture(motion_px=(5.0, -3.3), stem=stem, background=Background(60.0, texture_dn=5.0))
    x, y, r = truth(made).circle
    shares = (np.arange(64) + 0.5) / 64 - 0.5
    still = replace(made, motion_px=(0.0, 0.0))
    instants = [
        replace(still, probe_mm=probe_seen_at((x + 5.0 * s, y - 3.3 * s, r), made.radius_mm, made.lens, made.origin_px))
        for s in shares
    ]
    np.testing.assert_allclose(expected(made), np.mean([expected(instant) for instant in instants], axis=0), atol=0.05)


# ---- truth -----------------------------------------------------------------------------------------------------------


@given(
    x=st.floats(200.0, 1800.0),
    y=st.floats(200.0, 1300.0),
    r=st.floats(10.0, 200.0),
    lens=st.sampled_from((TELE, WIDE)),
)
def test_the_true_outline_gives_the_true_direction_and_range(x, y, r, lens):
    made = Picture((64, 64), lens, probe_seen_at((x - 100.0, y - 50.0, r), 4.0, lens, (100, 50)), 4.0, (100, 50))
    true = truth(made)
    assert true.circle == pytest.approx((x - 100.0, y - 50.0, r), abs=1e-6)
    direction, range_mm = centre_and_range(np.array((true.x_px + 100.0, true.y_px + 50.0)), true.r_px, 4.0, lens)
    np.testing.assert_allclose(direction, true.direction, atol=1e-10)
    assert range_mm == pytest.approx(true.range_mm, rel=1e-9)


def test_without_a_probe_there_is_no_truth():
    with pytest.raises(ValueError, match="no probe is in the picture"):
        truth(replace(picture(), probe_mm=None))


# ---- light -----------------------------------------------------------------------------------------------------------


def test_a_highlight_is_where_the_normal_points():
    angle_rad = 0.6
    spot = Highlight((sin(angle_rad), 0.0, -cos(angle_rad)), 100.0, 0.1)
    made = picture(r_px=30.0, surface=Surface(100.0, highlights=(spot,)))
    y, x = np.unravel_index(expected(made).argmax(), made.size_px)
    true = truth(made)
    assert (x, y) == pytest.approx((true.x_px + 30.0 * sin(angle_rad), true.y_px), abs=1.0)


def test_a_lamp_lights_its_own_side_and_leaves_the_ambient_share_to_the_other():
    made = picture(r_px=30.0, surface=Surface(200.0, lamp=Lamp((1.0, 0.0, 0.0), 0.45)))
    true = truth(made)
    row, lit, unlit = expected(made)[round(true.y_px)], round(true.x_px + 24.0), round(true.x_px - 20.0)
    assert row[lit] == pytest.approx(200.0 * (0.45 + 0.55 * (lit - true.x_px) / 30.0), abs=0.5)
    assert row[unlit] == pytest.approx(90.0, abs=1e-6)


def test_what_is_in_front_hides_the_ball_and_what_is_behind_does_not():
    cover = Polygon(((20.0, -50.0), (100.0, -50.0), (100.0, 100.0), (20.0, 100.0)), 130.0)
    hidden, seen = expected(picture(front=(cover,))), expected(picture(behind=(cover,)))
    assert hidden[22, 30] == pytest.approx(130.0)
    assert seen[22, 30] == pytest.approx(180.0)
    assert seen[2, 42] == pytest.approx(130.0)


def test_the_texture_has_its_rms_and_stays_where_it_is_when_the_ball_moves():
    ground = Background(60.0, texture_dn=8.0, texture_px=4.0, seed=5)
    made = Picture((200, 200), TELE, None, 4.0, psf_px=0.9, background=ground)
    image = expected(made)
    assert image.std() == pytest.approx(8.0, rel=0.15)
    with_ball = expected(replace(made, probe_mm=probe_seen_at((60.3, 80.1, 30.0), 4.0, TELE)))
    np.testing.assert_allclose(with_ball[150:, 150:], image[150:, 150:], atol=0.05)


def test_parts_of_a_large_picture_fit_together(monkeypatch):
    made = picture(surface=LAMP, stem=Stem(-1.0, 0.4, 140.0), lens=WIDE, origin_px=CORNER_PX, defocus_px=1.5)
    whole = expected(made)
    monkeypatch.setattr(judge, "TILE_PX", 17)
    np.testing.assert_allclose(expected(made), whole, atol=1e-3)


def test_a_ball_cut_by_the_border_is_the_whole_ball_s_part():
    made = picture(surface=LAMP)
    part = replace(made, size_px=(20, 25))
    np.testing.assert_allclose(expected(part), expected(made)[:25, :20], atol=1e-9)


# ---- shapes ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("angle_rad", [0.0, 0.2, pi / 4.0, 1.3, 2.0, 4.0])
@pytest.mark.parametrize("distance", [-0.6, -0.3, 0.0, 0.1, 0.55])
def test_a_half_plane_covers_its_area_of_a_square(angle_rad, distance):
    points = (np.arange(1000) + 0.5) / 1000.0 - 0.5
    inside = points[None, :] * cos(angle_rad) + points[:, None] * sin(angle_rad) > -distance
    covered = half_plane_cover(np.array(distance), cos(angle_rad), sin(angle_rad))
    assert float(covered) == pytest.approx(inside.mean(), abs=2e-3)


@pytest.mark.parametrize(
    ("shape", "area_px2", "middle_px"),
    [
        (Disc(20.3, 18.6, 7.7, 100.0), pi * 7.7**2, (20.3, 18.6)),
        (bar((8.0, 9.0), (30.0, 24.0), 3.3, 100.0), np.hypot(22.0, 15.0) * 3.3, (19.0, 16.5)),
        (Polygon(((10.0, 10.0), (10.0, 28.0), (31.0, 10.0)), 100.0), 189.0, (17.0, 16.0)),
    ],
)
def test_a_shape_covers_its_area_about_its_middle(shape, area_px2, middle_px):
    grid = Grid(Window(0, 0, 40, 40), 4)
    cover = shape.cover(grid)
    assert cover.sum() / 16.0 == pytest.approx(area_px2, rel=1e-3)
    middle = (cover * grid.x_px).sum() / cover.sum(), (cover * grid.y_px).sum() / cover.sum()
    assert middle == pytest.approx(middle_px, abs=5e-3)
    box = shape.box()
    assert cover[: 4 * box.top].sum() + cover[:, : 4 * box.left].sum() == 0.0


def test_a_soft_edge_is_as_wide_as_it_says():
    cover = Disc(0.0, 20.0, 20.0, 1.0, soft_px=2.0).cover(Grid(Window(0, 20, 40, 1), 1))[0]
    spread = -np.diff(cover)
    x = np.arange(39) + 0.5
    middle = (x * spread).sum() / spread.sum()
    assert middle == pytest.approx(20.0, abs=0.05)
    assert np.sqrt(((x - middle) ** 2 * spread).sum()) == pytest.approx(2.0, rel=0.2)


# ---- sensor ----------------------------------------------------------------------------------------------------------


def exposures(sensor, level_dn, count=300):
    random = np.random.default_rng(8)
    return np.stack([expose(np.full((32, 32), level_dn), sensor, random) for _ in range(count)])


@pytest.mark.parametrize(("bits", "dtype", "level_dn"), [(8, np.uint8, 90.0), (12, np.uint16, 1500.0)])
def test_a_frame_has_the_noise_of_photons_read_out_and_rounding(bits, dtype, level_dn):
    sensor = Sensor(gain_e_per_dn=5.0, read_noise_e=10.0, bits=bits)
    frames = exposures(sensor, level_dn)
    assert frames.dtype == dtype
    assert frames.mean() == pytest.approx(level_dn, abs=0.2)
    assert frames.var() == pytest.approx(float(sensor.variance_dn2(np.array(level_dn))), rel=0.02)


def test_levels_are_clipped_where_the_sensor_ends():
    assert exposures(Sensor(), 300.0).min() == 255
    assert exposures(Sensor(bits=12), 5000.0).min() == 4095
    assert exposures(Sensor(), -20.0).max() == 0


def test_flicker_is_common_to_a_frame_and_a_pixel_s_own_response_to_all_frames():
    frames = exposures(Sensor(gain_e_per_dn=1e6, read_noise_e=0.0, flicker=0.01, prnu=0.02, bits=16), 10_000.0).astype(float)
    assert frames.mean(axis=(1, 2)).std() == pytest.approx(100.0, rel=0.15)
    assert frames.mean(axis=0).std() == pytest.approx(200.0, rel=0.1)


# ---- the twin's renderer ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("limb", [0.0, 0.4])
def test_the_twin_s_fast_renderer_draws_the_same_ball(limb):
    cell, roi = station("left", -550.0), camera(96, 96)
    origin_px = (roi.offset_x_px, roi.offset_y_px)
    made = Picture(
        (96, 96),
        cell.lens,
        probe_seen_at((47.3, 50.7, 25.0), 4.0, cell.lens, origin_px),
        4.0,
        origin_px,
        surface=Surface(180.0, limb=limb),
    )
    pose = cell.world_from_camera(0.0, 0.0)
    renderer = Renderer(cell, roi, LookSettings(**PLAIN | {"limb": limb, "psf_px": 0.9}), 4.0, seed=1)
    fast = renderer.expected([pose], [pose.move(np.array(made.probe_mm))]).astype(float)
    difference = fast - expected(made)
    assert np.abs(difference).max() < 0.5
    assert np.abs(displacement_px(made, difference)[:2]).max() < 1e-3
