"""Plans: places that fill the volume, a short way, looks that every gimbal can take, and what they will be worth."""

from dataclasses import replace
from math import radians

import numpy as np
import pytest
from scipy.stats import qmc
from sim_cell import station

from trackerd.calibrate.plan.looks import INNER, POSITIONS, Eye, looks_at, places_px
from trackerd.calibrate.plan.make import Pace, errands, plan_stops, two_faced
from trackerd.calibrate.plan.predicted import Noise, predicted
from trackerd.calibrate.plan.volume import Box, short_tour, well_spread
from trackerd.contract.errors import ConfigError, Degenerate

BOX = Box.around(np.array((0.0, 0.0, 20.0)), np.array((400.0, 300.0, 200.0)))
PACE = Pace(20, 55.0)
WIDE = ((radians(-60.0), radians(60.0)), (radians(-60.0), radians(60.0)))
FULL_TURN = ((radians(-260.0), radians(260.0)), (radians(-260.0), radians(260.0)))


def eye(name: str, x_mm: float, travel: tuple[tuple[float, float], tuple[float, float]] = WIDE) -> Eye:
    return Eye(station(name, x_mm), travel, (704, 528), (640, 480), 4.0)


EYES = [eye("left", -550.0), eye("right", 550.0)]


def test_stops_fill_the_volume_as_evenly_as_chance_never_does_in_depth_too() -> None:
    p = well_spread(BOX, 40, seed=1)
    unit = (p - BOX.low_mm) / BOX.size_mm
    assert unit.min() == 0.0
    assert unit.max() == 1.0
    random = [qmc.discrepancy(np.random.default_rng(seed).random((40, 3))) for seed in range(30)]
    assert qmc.discrepancy(unit) < min(random)
    for axis in range(3):
        assert np.histogram(unit[:, axis], bins=4, range=(0.0, 1.0))[0].min() >= 7


def test_the_same_seed_makes_the_same_places() -> None:
    np.testing.assert_array_equal(well_spread(BOX, 10, 3), well_spread(BOX, 10, 3))
    assert not np.array_equal(well_spread(BOX, 10, 3), well_spread(BOX, 10, 4))


def test_a_tour_visits_every_place_once_on_a_short_way() -> None:
    p = well_spread(BOX, 60, seed=2)
    order = short_tour(p)
    assert sorted(order.tolist()) == list(range(60))
    way = np.linalg.norm(np.diff(p[order], axis=0), axis=1).sum()
    assert way < 0.45 * np.linalg.norm(np.diff(p, axis=0), axis=1).sum()


def test_each_place_is_looked_at_five_times_on_two_radii_with_the_whole_ball_in_the_image() -> None:
    one = EYES[0]
    places = places_px(one, BOX.centre_mm, turn=3)
    assert places.shape == (POSITIONS, 2)
    ball = one.ball_px(BOX.centre_mm)
    low = np.array(one.origin_px) + ball
    assert (places >= low).all()
    assert (places <= np.array(one.origin_px) + one.image_px - 1 - ball).all()
    reach = (np.array(one.image_px) - 1) / 2.0 - ball - 12.0
    radius = np.linalg.norm((places - np.array(one.origin_px) - (np.array(one.image_px) - 1) / 2.0) / reach, axis=1)
    assert sorted(np.unique(radius.round(6))) == [INNER, 1.0]


def test_every_look_shows_the_probe_where_it_should_be() -> None:
    for errand in errands(EYES, plan_stops(EYES, BOX, 6, 2, PACE)):
        for one in EYES:
            for look in errand.looks[one.name]:
                seen = one.station.pixel(errand.stop.p_mm, look.az_rad, look.el_rad)
                np.testing.assert_allclose(seen, look.q_px, atol=1e-4)


def test_the_second_face_is_used_where_the_travel_allows() -> None:
    eyes = [eye("left", -550.0, FULL_TURN), EYES[1]]
    planned = errands(eyes, plan_stops(eyes, BOX, 5, 0, PACE))
    assert (two_faced(planned, "left"), two_faced(planned, "right")) == (5, 0)
    first, second = planned[0].looks["left"][0], planned[0].looks["left"][POSITIONS]
    assert (first.face, second.face) == (1, 2)
    assert abs(abs(second.az_rad - first.az_rad) - np.pi) < 0.2
    assert len({planned[0].view(look) for look in planned[0].looks["left"]}) == 2 * POSITIONS


def test_the_second_face_is_reached_without_going_to_and_fro() -> None:
    eyes = [eye("left", -550.0, FULL_TURN), eye("right", 550.0, FULL_TURN)]
    for errand in errands(eyes, plan_stops(eyes, BOX, 12, 0, PACE)):
        for looks in errand.looks.values():
            second = np.degrees([(look.az_rad, look.el_rad) for look in looks if look.face == 2])
            assert np.ptp(second, axis=0).max() < 3.0
            assert second.min() > 150.0


def test_a_stop_lasts_as_long_as_its_slowest_gimbal_needs() -> None:
    eyes = [eye("left", -550.0, FULL_TURN), EYES[1]]
    assert {stop.dwell_s for stop in plan_stops(eyes, BOX, 3, 0, PACE)} == {round(PACE.dwell_s(10), 1)}


def test_check_points_are_named_and_spread_over_the_tour() -> None:
    stops = plan_stops(EYES, BOX, 20, 8, PACE)
    checks = [stop.p_mm for stop in stops if stop.is_check]
    assert len(checks) == 8
    assert len({stop.name for stop in stops}) == 28
    assert (np.ptp(checks, axis=0) > 0.5 * BOX.size_mm).all()


def test_a_volume_out_of_travel_is_refused_with_the_first_places_named() -> None:
    far = Box.around(np.array((4000.0, 0.0, -1900.0)), np.array((100.0, 100.0, 100.0)))
    with pytest.raises(
        ConfigError, match=r"plan: P\d+ at \(.*\) mm cannot be seen: gimbal left: el .* outside -60.0 to \+60.0"
    ):
        plan_stops(EYES, far, 10, 0, PACE)


def test_a_ball_larger_than_the_image_is_refused() -> None:
    huge = replace(EYES[0], probe_radius_mm=30.0)
    with pytest.raises(Degenerate, match="does not fit the image of 640 x 480 px"):
        list(looks_at(huge, BOX.centre_mm, 0))


def test_a_robots_tool_is_turned_from_stop_to_stop_within_the_tilt() -> None:
    turns = [stop.base_from_tool for stop in plan_stops(EYES, BOX, 12, 0, PACE, tilt_rad=radians(20.0))]
    tools = np.array([turn[:, 2] for turn in turns if turn is not None])
    assert len(tools) == 12
    tilt = np.degrees(np.arccos(-tools[:, 2]))
    assert tilt.max() <= 20.0 + 1e-9
    assert np.linalg.matrix_rank(tools - tools.mean(axis=0), tol=0.05) == 3 or np.ptp(tilt) > 10.0


def test_more_stops_predict_a_better_calibration_and_no_more_than_the_pixels_and_encoders_allow() -> None:
    noise = Noise(0.005, 0.1, radians(2.0 / 3600.0), 0.0, 1)
    few, many = (predicted(errands(EYES, plan_stops(EYES, BOX, n, 0, PACE)), EYES, BOX, noise) for n in (8, 40))
    assert many.calibration.typical_mm() < 0.6 * few.calibration.typical_mm()
    assert many.calibration.typical_mm() < 0.03
    assert 0.045 < many.total.typical_mm() < 0.08  # one frame's encoders at 2 m: 0.057 mm
    assert (many.total.depth_mm > many.total.across_mm).all()  # a baseline of 1.1 m at 2 m
    assert "in depth" in many.words
