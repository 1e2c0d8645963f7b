import cv2
import numpy as np
import pytest
from sim_cell import PLAIN, RADIUS_MM, camera, scene, station

from trackerd.formats.twin import LookSettings
from trackerd.geometry.rigid import Rigid, rotation_about_y
from trackerd.geometry.sphere import outline
from trackerd.sim.render import Renderer

STATION = station("left", -550.0)
CAMERA = camera(96, 96)
POSE = STATION.world_from_camera(0.0, 0.0)
FINE = 16  # subpixels of the brute force


def ball_at(x_px, y_px, range_mm=6000.0):
    """A point of W whose ball is seen around a pixel of the region; r = 20 px at 6 m."""
    pixel = np.array((x_px + CAMERA.offset_x_px, y_px + CAMERA.offset_y_px))
    return POSE.move(STATION.lens.unproject(pixel) * range_mm)


def renderer(**look):
    return Renderer(STATION, CAMERA, LookSettings(**PLAIN | look), RADIUS_MM, seed=1)


def expected(p_world, **look):
    return renderer(**look).expected([POSE], [p_world]).astype(float)


def true_outline(p_world):
    ellipse = outline(POSE.inverse().move(p_world), RADIUS_MM, STATION.lens)
    return ellipse.x_px - CAMERA.offset_x_px, ellipse.y_px - CAMERA.offset_y_px, ellipse.r_px


def brute_force(p_world, limb=0.0, psf_px=0.9):
    """Supersampled disc, its subpixels covered by their share, blurred, integrated over the pixels."""
    x0, y0, r = true_outline(p_world)
    size = 96 * FINE
    fine = (np.arange(size) + 0.5) / FINE - 0.5
    squared = ((fine[None, :] - x0) ** 2 + (fine[:, None] - y0) ** 2) / r**2
    shade = 180.0 * (1.0 - limb * (1.0 - np.sqrt(np.clip(1.0 - squared, 0.0, 1.0))))
    cover = np.clip((r - np.sqrt(squared) * r) * FINE + 0.5, 0.0, 1.0)
    image = 60.0 + cover * (shade - 60.0)
    image = cv2.GaussianBlur(image, (0, 0), psf_px * FINE, borderType=cv2.BORDER_REPLICATE)
    return image.reshape(96, FINE, 96, FINE).mean(axis=(1, 3))


def centroid(image, background=60.0):
    weight = image - background
    y, x = np.mgrid[0:96, 0:96]
    return (weight * x).sum() / weight.sum(), (weight * y).sum() / weight.sum(), np.sqrt(weight.sum() / 120.0 / np.pi)


@pytest.mark.parametrize("at", [(48.0, 48.0), (47.3, 50.7), (45.51, 46.25), (50.125, 44.9)])
def test_centre_and_radius_are_those_of_the_outline(at):
    p_world = ball_at(*at)
    assert centroid(expected(p_world)) == pytest.approx(true_outline(p_world), abs=2e-3)


@pytest.mark.parametrize("psf_px", [0.6, 0.9, 2.0])
def test_the_edge_agrees_with_supersampling(psf_px):
    p_world = ball_at(47.3, 50.7)
    assert np.abs(expected(p_world, psf_px=psf_px) - brute_force(p_world, psf_px=psf_px)).max() < 0.2


def test_a_darkened_limb_agrees_with_supersampling():
    p_world = ball_at(47.3, 50.7)
    image, reference = expected(p_world, limb=0.4), brute_force(p_world, limb=0.4)
    assert np.abs(image - reference).max() < 0.5
    assert centroid(image)[:2] == pytest.approx(centroid(reference)[:2], abs=1e-3)


def test_a_ball_cut_by_the_border_is_the_whole_ball_s_part():
    p_world = ball_at(5.0, 90.0)
    assert np.abs(expected(p_world) - brute_force(p_world))[4:-4, 4:-4].max() < 0.2


@pytest.mark.parametrize("at", [(-200.0, 48.0), (48.0, 400.0)])
def test_a_ball_outside_the_image_leaves_the_background(at):
    np.testing.assert_array_equal(expected(ball_at(*at)), np.full((96, 96), 60.0))


def test_a_ball_behind_the_camera_or_hidden_leaves_the_background():
    behind = POSE.move(np.array((0.0, 0.0, -500.0)))
    np.testing.assert_array_equal(expected(behind), np.full((96, 96), 60.0))
    np.testing.assert_array_equal(renderer().expected([POSE], []), np.full((96, 96), 60.0))


def test_motion_smears_along_its_way_about_the_middle():
    ways = np.linspace(-4.5, 4.5, 10)
    image = renderer().expected([POSE] * 10, [ball_at(48.0 + way, 48.0) for way in ways]).astype(float)
    x, y, _ = centroid(image)
    assert (x, y) == pytest.approx(true_outline(ball_at(48.0, 48.0))[:2], abs=2e-3)
    slope = np.abs(np.gradient(image, axis=1)).max(), np.abs(np.gradient(image, axis=0)).max()
    assert slope[0] < slope[1] / 2.0


def test_a_motion_that_does_not_show_is_rendered_once():
    still = renderer().expected([POSE], [ball_at(48.0, 48.0)]).copy()
    for ways in ((-0.05, 0.05), (-0.05, 0.0, 0.05)):
        nearly = renderer().expected([POSE] * len(ways), [ball_at(48.0 + way, 48.0) for way in ways])
        np.testing.assert_allclose(nearly, still, atol=0.1)


@pytest.mark.parametrize(("stem_deg", "at"), [(-90.0, (10, 48)), (90.0, (85, 48)), (0.0, (48, 85)), (180.0, (48, 10))])
def test_the_stem_leaves_the_ball_in_its_direction(stem_deg, at):
    image = expected(ball_at(48.0, 48.0), stem_width=0.4, stem_dn=140.0, stem_deg=stem_deg)
    assert image[at] == pytest.approx(140.0, abs=0.1)
    assert image[95 - at[0], 95 - at[1]] == pytest.approx(60.0, abs=0.1)
    assert image[48, 48] == pytest.approx(180.0, abs=0.1)


def test_the_noise_has_the_variance_of_photons_read_out_and_rounding():
    look = LookSettings(**PLAIN, gain_e_per_dn=5.0, read_noise_e=10.0)
    made = Renderer(STATION, CAMERA, look, RADIUS_MM, seed=1)
    frames = np.stack([made.render([POSE], [], frame) for frame in range(200)]).astype(float)
    assert frames.mean() == pytest.approx(60.0, abs=0.02)
    assert frames.var(axis=0).mean() == pytest.approx(60.0 / 5.0 + (10.0 / 5.0) ** 2 + 1.0 / 12.0, rel=0.01)
    neighbours = np.corrcoef((frames[1:] - 60.0).ravel(), (frames[:-1] - 60.0).ravel())[0, 1]
    assert abs(neighbours) < 0.01


def test_full_wells_saturate():
    made = Renderer(STATION, CAMERA, LookSettings(**PLAIN, background_dn=255.0), RADIUS_MM, seed=1)
    assert made.render([POSE], [], 0).max() == 255


def test_the_texture_stands_still_in_the_world():
    made = renderer(texture_dn=10.0)
    before = made.expected([POSE], []).copy()
    turned = Rigid(POSE.rotation @ rotation_about_y(8.0 / 31000.0), POSE.translation_mm)
    after = made.expected([turned], [])
    np.testing.assert_allclose(after[:, :-8], before[:, 8:], atol=0.05)
    assert before.std() == pytest.approx(10.0, rel=0.4)


def test_the_same_seed_and_frame_give_the_same_image_in_the_buffer_given():
    out = np.empty((96, 96), np.uint8)
    p_world = ball_at(48.0, 48.0)
    assert renderer(texture_dn=2.0).render([POSE], [p_world], 3, out) is out
    np.testing.assert_array_equal(out, renderer(texture_dn=2.0).render([POSE], [p_world], 3))
    assert (out != renderer(texture_dn=2.0).render([POSE], [p_world], 4)).any()


def test_a_ball_far_beside_the_view_is_not_folded_back_into_it_by_the_distortion():
    one = scene(camera=PLAIN)
    renderer = one.renderer("left")
    az, el = one.start_angles("left")
    for off_rad in np.linspace(0.1, 1.7, 80):
        pose = one.gimbals["left"].station.world_from_camera(az, el + off_rad)
        assert renderer.render((pose,), (np.zeros(3),), 0).max() < 100
