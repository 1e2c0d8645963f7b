"""Lenses for many points at once are the lens for one, and OpenCV's."""

import cv2
import numpy as np
import pytest

from trackerd.contract.model import Array
from trackerd.geometry.lens import Lens
from trackerd.geometry.lens_batch import jacobian_all, normalise_all, project_all, unproject_all

LENSES = [
    Lens((2048, 1536), 31000.0, 31050.0, 1015.0, 775.0, (0.4, -3.0, 1e-4, -2e-4, 5.0)),
    Lens((2048, 1536), 1500.0, 1510.0, 1020.0, 770.0, (-0.12, 0.05, 1e-3, -5e-4, -0.01)),
    Lens((2048, 1536), 1500.0, 1500.0, 1023.5, 767.5),
]


def pixels(count: int = 400) -> Array:
    return np.random.default_rng(1).uniform((0.0, 0.0), (2047.0, 1535.0), (count, 2))


def points(lens: Lens) -> Array:
    return unproject_all(lens, pixels()) * np.random.default_rng(2).uniform(300.0, 5000.0, (400, 1))


def opencv(lens: Lens) -> tuple[Array, Array]:
    matrix = np.array(((lens.fx_px, 0.0, lens.cx_px), (0.0, lens.fy_px, lens.cy_px), (0.0, 0.0, 1.0)))
    return matrix, np.array(lens.distortion)


@pytest.mark.parametrize("lens", LENSES)
def test_many_points_are_treated_as_one_is(lens: Lens) -> None:
    p, q = points(lens), pixels()
    for together, alone in (
        (project_all(lens, p), [lens.project(each) for each in p]),
        (normalise_all(lens, q), [lens.normalise(each) for each in q]),
        (unproject_all(lens, q), [lens.unproject(each) for each in q]),
        (jacobian_all(lens, p), [lens.jacobian(each) for each in p]),
    ):
        assert together.shape == np.shape(alone)
        assert np.allclose(together, alone, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("lens", LENSES)
def test_many_points_are_projected_as_opencv_does(lens: Lens) -> None:
    p = points(lens)
    theirs, slopes = cv2.projectPoints(p, np.zeros(3), np.zeros(3), *opencv(lens))
    assert np.allclose(project_all(lens, p), theirs[:, 0], atol=1e-8)
    assert np.allclose(jacobian_all(lens, p), slopes[:, 3:6].reshape(-1, 2, 3), atol=1e-7)  # camera at the origin: d / d t


@pytest.mark.parametrize("lens", LENSES)
def test_many_pixels_are_undistorted_as_opencv_does(lens: Lens) -> None:
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-14)
    theirs = cv2.undistortPoints(pixels()[:, None], *opencv(lens), criteria=criteria)
    assert np.allclose(normalise_all(lens, pixels()), theirs[:, 0], atol=1e-10)


@pytest.mark.parametrize("lens", LENSES)
def test_there_and_back_and_any_leading_shape(lens: Lens) -> None:
    q = pixels().reshape(20, 20, 2)
    assert np.allclose(project_all(lens, 1234.5 * unproject_all(lens, q)), q, atol=1e-7)
    assert jacobian_all(lens, unproject_all(lens, q)).shape == (20, 20, 2, 3)
    assert normalise_all(lens, np.empty((0, 2))).shape == (0, 2)
