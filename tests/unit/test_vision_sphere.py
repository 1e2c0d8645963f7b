"""The sphere behind a lens: direction and range of its centre, wherever it is in the field, with covariances that hold."""

from dataclasses import replace

import numpy as np
import pytest

from trackerd.contract.model import Array, Missed
from trackerd.geometry.lens import Lens
from trackerd.sim.picture import Background, Picture, expected, probe_seen_at, truth
from trackerd.sim.sensor import Sensor, expose
from trackerd.vision.curve import View, angles
from trackerd.vision.noise import NoiseModel
from trackerd.vision.sphere import SphereFound, locate_sphere

RADIUS_MM = 20.0
NOISE = NoiseModel(39.2, 3.0)
TELE = Lens((2048, 1536), 31000.0, 31000.0, 1023.5, 767.5)
WIDE = Lens((2048, 1536), 2400.0, 2400.0, 1023.5, 767.5)
BENT = replace(WIDE, distortion=(-0.18, 0.03, 0.001, -0.0005, 0.0))
ORIGIN_PX = (1500, 1150)


def picture(lens: Lens, r_px: float = 45.0) -> Picture:
    side = round(2.6 * r_px + 60.0)
    circle = 0.5 * side + 3.3, 0.5 * side - 2.6, r_px
    return Picture(
        size_px=(side, side),
        lens=lens,
        probe_mm=probe_seen_at(circle, RADIUS_MM, lens, ORIGIN_PX),
        radius_mm=RADIUS_MM,
        origin_px=ORIGIN_PX,
        background=Background(60.0),
    )


def seen(of: Picture, seed: int, light: Array) -> SphereFound:
    random = np.random.default_rng(seed)
    x, y, r = truth(of).circle
    guess = x + random.uniform(-4.0, 4.0), y + random.uniform(-4.0, 4.0), r * random.uniform(0.95, 1.05)
    found = locate_sphere(expose(light, Sensor(), random), guess, of.lens, RADIUS_MM, ORIGIN_PX, NOISE)
    assert isinstance(found, SphereFound), found
    return found


@pytest.mark.parametrize("lens", [TELE, WIDE, BENT], ids=["long lens", "wide lens", "wide and distorted"])
def test_the_centre_of_the_sphere_is_found_with_a_true_covariance(lens: Lens) -> None:
    scene = picture(lens)
    light, p_mm = expected(scene), np.array(scene.probe_mm)
    nees = []
    for seed in range(40):
        found = seen(scene, seed, light)
        off_mm = found.centre_mm - p_mm
        nees.append(off_mm @ np.linalg.solve(found.cov_mm2, off_mm) / 3.0)
    assert 0.6 < np.mean(nees) < 1.6


def test_as_a_circle_the_same_outline_would_point_beside_the_centre() -> None:
    scene = picture(WIDE, 90.0)
    found, told = seen(scene, 1, expected(scene)), truth(scene)
    outline = found.outline
    assert found.direction == pytest.approx(told.direction, abs=0.03 / WIDE.fx_px)
    beside_px = np.array((outline.x_px, outline.y_px)) + ORIGIN_PX - WIDE.project(told.direction)
    assert np.hypot(*beside_px) > 1.0  # the ellipse's centre is not the sphere's


def test_the_range_follows_the_known_radius() -> None:
    scene = picture(BENT)
    found = seen(scene, 2, expected(scene))
    assert abs(found.range_mm - truth(scene).range_mm) < 4.0 * found.range_sigma_mm
    assert found.range_sigma_mm == pytest.approx(found.range_mm * np.sqrt(found.outline.cov_px2[2, 2]) / 45.0, rel=0.1)


@pytest.mark.parametrize("lens", [TELE, WIDE, BENT], ids=["long lens", "wide lens", "wide and distorted"])
def test_every_point_of_the_curve_is_seen_under_the_sphere_s_own_angle(lens: Lens) -> None:
    told = truth(picture(lens))
    curve = View(lens, ORIGIN_PX).curve(*told.circle, 96)
    radius, turn = told.r_px + curve.bulge[:, 0], angles(96)
    points = np.array((told.x_px, told.y_px)) + ORIGIN_PX + radius[:, None] * np.column_stack((np.cos(turn), np.sin(turn)))
    between = np.arccos([float(lens.unproject(q) @ told.direction) for q in points])
    assert np.abs(between - np.arcsin(RADIUS_MM / told.range_mm)).max() * lens.fx_px < 1e-3


def test_a_curve_is_made_anew_only_where_the_old_one_would_be_wrong() -> None:
    far, near = View(TELE), View(BENT)
    circle = (1500.0, 1100.0, 45.0)
    assert far.curve(*circle, 96) is far.curve(1503.0, 1098.0, 45.2, 96)
    assert near.curve(*circle, 96) is not near.curve(1503.0, 1098.0, 45.2, 96)


def test_an_outline_that_no_lens_shows_is_missed() -> None:
    lens = replace(WIDE, fx_px=100.0, fy_px=100.0)  # the outline would reach round behind the camera
    scene = picture(WIDE)
    image = expose(expected(scene), Sensor(), np.random.default_rng(1))
    assert isinstance(locate_sphere(image, truth(scene).circle, lens, RADIUS_MM, ORIGIN_PX, NOISE), Missed)
