"""The bound of a picture against the rule of thumb, a table of another renderer's, and what a fit attains."""

from dataclasses import replace
from math import cos, pi, sqrt

import numpy as np
import pytest

from trackerd.geometry.lens import Lens
from trackerd.sim.ball import Surface
from trackerd.sim.bound import bound, information
from trackerd.sim.picture import Background, Picture, Stem, expected, probe_seen_at, truth
from trackerd.sim.raster import Polygon
from trackerd.sim.sensor import Sensor, expose

LENS = Lens((2048, 1536), 31000.0, 31000.0, 1023.5, 767.5)
ORIGIN_PX = (900, 700)
SENSOR = Sensor()


def picture(r_px=60.0, off_px=(0.3, -0.2), **more):
    side_px = round(2.0 * r_px) + 30
    circle = (0.5 * side_px + off_px[0], 0.5 * side_px + off_px[1], r_px)
    return Picture((side_px, side_px), LENS, probe_seen_at(circle, 4.0, LENS, ORIGIN_PX), 4.0, ORIGIN_PX, **more)


def hidden(r_px):
    """30 % of the outline on the right."""
    begin_px = r_px + 15.3 + cos(0.3 * pi) * r_px
    return picture(r_px, front=(Polygon(((begin_px, -999.0), (999.0, -999.0), (999.0, 999.0), (begin_px, 999.0)), 60.0),))


def sigma_px(made, sensor=SENSOR):
    return np.sqrt(bound(made, sensor).diagonal())


TABLE = {  # sigma of x, y, r in px
    "contrast 120, r 12": (picture(12.0), (0.0043, 0.0043, 0.0034)),
    "contrast 120, r 60": (picture(), (0.0019, 0.0019, 0.0015)),
    "contrast 120, r 150": (picture(150.0), (0.0012, 0.0012, 0.0009)),
    "contrast 15": (picture(surface=Surface(180.0), background=Background(165.0)), (0.018, 0.018, 0.013)),
    "defocus": (picture(defocus_px=4.0), (0.0030, 0.0030, 0.0025)),
    "motion": (picture(motion_px=(8.0, 0.0)), (0.0029, 0.0023, 0.0020)),
    "stem": (picture(stem=Stem(-0.5 * pi, 0.6, 180.0)), (0.0020, 0.0026, 0.0018)),
    "hidden, r 12": (hidden(12.0), (0.0080, 0.0048, 0.0054)),
    "hidden, r 60": (hidden(60.0), (0.0033, 0.0021, 0.0022)),
}


@pytest.mark.parametrize("name", TABLE)
def test_the_bound_is_that_of_an_independent_renderer(name):
    made, table = TABLE[name]
    np.testing.assert_allclose(sigma_px(made), table, rtol=0.1)


@pytest.mark.parametrize(("r_px", "psf_px", "level_dn"), [(20.0, 0.9, 180.0), (60.0, 0.9, 90.0), (40.0, 1.6, 130.0)])
def test_the_bound_follows_the_rule(r_px, psf_px, level_dn):
    contrast_dn, edge_px = level_dn - 60.0, sqrt(psf_px**2 + 1.0 / 12.0)
    noise_dn = sqrt(float(SENSOR.variance_dn2(np.array(0.5 * (level_dn + 60.0)))))
    rule_px = noise_dn / contrast_dn * sqrt(1.128 * edge_px / r_px)
    sigma = sigma_px(picture(r_px, psf_px=psf_px, surface=Surface(level_dn)))
    assert sigma[:2] == pytest.approx((rule_px, rule_px), rel=0.05)


def test_a_fit_from_the_truth_scatters_as_the_bound_says():
    """One step of the best linear fit: its x, y, r for frame after frame, with the slopes taken from other pictures."""
    made = picture(15.0)
    light, circle = expected(made), np.array(truth(made).circle)

    def moved(step):
        return expected(replace(made, probe_mm=probe_seen_at(tuple(circle + step), 4.0, LENS, ORIGIN_PX)))

    slopes = [(moved(step) - moved(-step)) / 0.02 for step in 0.01 * np.eye(3)]
    slopes.append((expected(replace(made, psf_px=0.91)) - expected(replace(made, psf_px=0.89))) / 0.02)
    slopes += [expected(replace(made, surface=Surface(181.0))) - light, np.ones_like(light)]
    stacked = np.stack([slope.ravel() for slope in slopes])
    weighted = stacked / SENSOR.variance_dn2(light).ravel()
    random = np.random.default_rng(2)
    frames = np.stack([expose(light, SENSOR, random).astype(float) - light for _ in range(1500)])
    found = np.linalg.solve(weighted @ stacked.T, weighted @ frames.reshape(1500, -1).T)[:3]
    normalised = np.einsum("in,ij,jn->n", found, np.linalg.inv(bound(made, SENSOR)), found)
    assert normalised.mean() / 3.0 == pytest.approx(1.0, abs=0.06)
    np.testing.assert_allclose(found.std(axis=1), sigma_px(made), rtol=0.07)


@pytest.mark.parametrize("level_dn", [240.0, 253.0, 255.0, 257.0, 261.0])
def test_the_information_of_a_clipped_pixel_is_that_of_its_likelihood(level_dn):
    """The mean square of the score of min(level + noise, 255)."""
    sigma = sqrt(float(SENSOR.variance_dn2(np.array(min(level_dn, 255.0)))))
    noise = np.random.default_rng(6).standard_normal(1_000_000)
    z = (255.0 - level_dn) / sigma
    beyond = (noise > z).mean()
    density = np.exp(-0.5 * z * z) / sqrt(2.0 * pi)
    score = np.where(noise < z, noise, density / beyond if beyond else 0.0)
    assert float(information(np.array(level_dn), SENSOR)) == pytest.approx((score**2).mean() / sigma**2, rel=0.02)


def test_a_saturated_background_leaves_the_centre_and_costs_the_radius():
    made = picture(20.0, surface=Surface(60.0), background=Background(330.0))
    ratio = sigma_px(made) / sigma_px(made, Sensor(bits=12))
    assert ratio[:2] == pytest.approx((1.07, 1.07), abs=0.03)
    assert ratio[2] > 5.0


def test_a_pixel_far_beyond_saturation_says_nothing():
    assert float(information(np.array(400.0), SENSOR)) < 1e-9


def test_the_stem_s_own_edges_say_nothing_of_the_ball():
    bare, thin = sigma_px(picture(30.0)), sigma_px(picture(30.0, stem=Stem(0.3, 0.1, 180.0)))
    assert (thin >= 0.999 * bare).all()


def test_what_stands_beside_the_ball_does_not_change_its_bound():
    aside = Polygon(((2.0, 2.0), (9.0, 2.0), (2.0, 9.0)), 200.0)
    np.testing.assert_allclose(sigma_px(picture(30.0, behind=(aside,))), sigma_px(picture(30.0)), rtol=0.01)


def test_the_bound_of_a_part_of_the_ball_is_wider():
    made = picture(20.0)
    assert (sigma_px(replace(made, size_px=(40, 70))) > sigma_px(made)).all()


def test_a_picture_without_a_ball_has_no_bound():
    with pytest.raises(ValueError, match="no probe is in the picture"):
        bound(replace(picture(), probe_mm=None), SENSOR)
    with pytest.raises(ValueError, match="nothing in the picture depends on the outline"):
        bound(replace(picture(), surface=Surface(60.0)), SENSOR)
    outside = probe_seen_at((900.0, 900.0, 20.0), 4.0, LENS, ORIGIN_PX)
    with pytest.raises(ValueError, match="nothing in the picture depends on the outline"):
        bound(replace(picture(), probe_mm=outside), SENSOR)
