import numpy as np
import pytest

from trackerd.formats.twin import PathSettings
from trackerd.sim.path import ProbePath
from trackerd.sim.ramp import Ramp, Stroke

SECOND = 1_000_000_000


def test_the_probe_stands_still_for_the_dwell():
    path = ProbePath(PathSettings(kind="random", dwell_s=2.0))
    for t_ns in (0, SECOND, 2 * SECOND):
        np.testing.assert_array_equal(path.at(t_ns)[0], path.at(0)[0])
        np.testing.assert_array_equal(path.at(t_ns)[1:], np.zeros((2, 3)))


def test_the_default_circle_lies_in_the_plane_z_0_about_its_centre_at_its_speed():
    path = ProbePath(PathSettings(centre_mm=(10.0, 20.0, 30.0), dwell_s=0.0))
    for t_ns in range(2 * SECOND, 6 * SECOND, SECOND // 7):
        p, v, a = path.at(t_ns)
        assert p[2] == 30.0
        assert np.linalg.norm(p - (10.0, 20.0, 30.0)) == pytest.approx(150.0)
        assert np.linalg.norm(v) == pytest.approx(250.0)
        assert np.linalg.norm(a) == pytest.approx(250.0**2 / 150.0)


def test_the_default_circle_starts_without_exceeding_one_metre_per_second_squared():
    path = ProbePath(PathSettings(dwell_s=0.0))
    assert max(np.linalg.norm(path.at(t_ns)[2]) for t_ns in range(0, SECOND, SECOND // 500)) < 1000.0


def test_a_circle_may_lie_in_any_plane():
    path = ProbePath(PathSettings(normal=(1.0, 2.0, -0.5), dwell_s=0.0))
    for t_ns in range(0, 4 * SECOND, SECOND // 3):
        assert path.at(t_ns)[0] @ (1.0, 2.0, -0.5) == pytest.approx(0.0, abs=1e-9)


def test_a_raster_cruises_along_its_rows_and_comes_back_to_where_it_began():
    settings = PathSettings(kind="raster", rows=3, row_mm=20.0, radius_mm=100.0, speed_mm_s=200.0, dwell_s=0.0)
    path = ProbePath(settings)
    positions = np.array([path.at(round(t * 1e9))[0] for t in np.linspace(0.0, 60.0, 6001)])
    speeds = [np.linalg.norm(path.at(round(t * 1e9))[1]) for t in np.linspace(0.0, 60.0, 6001)]
    np.testing.assert_allclose(positions[0], (-100.0, -20.0, 0.0))
    np.testing.assert_allclose(positions.max(axis=0), (100.0, 20.0, 0.0), atol=0.05)
    assert max(speeds) == pytest.approx(200.0)
    assert np.linalg.norm(positions[500:] - positions[0], axis=1).min() < 1.0


def test_a_ramp_too_short_for_its_speed_takes_the_highest_that_leaves_room_to_stop():
    stroke = Stroke.over(5.0, Ramp(250.0, 800.0, 8000.0))
    assert stroke.ramp.speed < 250.0
    way, speed, _ = stroke.at(stroke.duration_s)
    assert way == pytest.approx(5.0)
    assert speed == pytest.approx(0.0, abs=1e-9)


def test_the_same_seed_walks_the_same_random_path_and_another_does_not():
    settings = PathSettings(kind="random", dwell_s=0.0)
    here = ProbePath(settings, seed=5).at(3 * SECOND)[0]
    np.testing.assert_array_equal(here, ProbePath(settings, seed=5).at(3 * SECOND)[0])
    assert np.linalg.norm(here - ProbePath(settings, seed=6).at(3 * SECOND)[0]) > 1.0


def test_an_external_path_goes_where_it_is_told_from_rest_to_rest():
    path = ProbePath(PathSettings(kind="external", centre_mm=(0.0, 0.0, 10.0), dwell_s=6.0))
    np.testing.assert_array_equal(path.at(9 * SECOND)[0], (0.0, 0.0, 10.0))
    there_ns = path.go(9 * SECOND, np.array((30.0, 40.0, 10.0)))
    p, v, a = path.at(there_ns)
    np.testing.assert_allclose(p, (30.0, 40.0, 10.0), atol=1e-9)
    np.testing.assert_allclose((v, a), np.zeros((2, 3)), atol=1e-3)
    np.testing.assert_array_equal(path.at(9 * SECOND)[0], (0.0, 0.0, 10.0))
    middle, v, _ = path.at((9 * SECOND + there_ns) // 2)
    np.testing.assert_allclose(middle, (15.0, 20.0, 10.0), atol=1e-6)
    assert 0.0 < np.linalg.norm(v) <= 250.0


def test_an_external_path_finishes_what_it_has_begun_first():
    path = ProbePath(PathSettings(kind="external"))
    first_ns = path.go(0, np.array((50.0, 0.0, 0.0)))
    second_ns = path.go(first_ns // 2, np.array((50.0, 50.0, 0.0)))
    np.testing.assert_allclose(path.at(first_ns)[0], (50.0, 0.0, 0.0), atol=1e-6)
    np.testing.assert_allclose(path.at(second_ns)[0], (50.0, 50.0, 0.0), atol=1e-6)
    assert path.go(second_ns, np.array((50.0, 50.0, 0.0))) == second_ns


def test_other_paths_are_not_moved_by_requests():
    with pytest.raises(ValueError, match="only an external path"):
        ProbePath(PathSettings(kind="circle")).go(0, np.zeros(3))
