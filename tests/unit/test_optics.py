"""Focal length, angle and field of view, as a lens' maker tells them."""

from dataclasses import replace
from math import atan, degrees, hypot

import numpy as np
import pytest

from trackerd.geometry.lens import Lens
from trackerd.geometry.optics import angle_of_view, field_of_view, focal_length_mm

MIDDLE = Lens((2048, 1536), 31000.0, 31000.0, 1023.5, 767.5)


def test_the_focal_length_is_the_pixels_times_their_pitch() -> None:
    assert focal_length_mm(replace(MIDDLE, fy_px=31310.0), (3.45, 3.45)) == pytest.approx((106.95, 108.0195))


def test_the_angles_of_view_are_those_of_a_pinhole_from_edge_to_edge() -> None:
    view = angle_of_view(MIDDLE)
    assert view.horizontal_rad == pytest.approx(2.0 * atan(1024.0 / 31000.0))
    assert view.vertical_rad == pytest.approx(2.0 * atan(768.0 / 31000.0))
    assert view.diagonal_rad == pytest.approx(2.0 * atan(1280.0 / 31000.0))
    assert degrees(view.horizontal_rad) == pytest.approx(3.784, abs=1e-3)


def test_the_field_of_view_grows_with_the_distance() -> None:
    near, far = field_of_view(MIDDLE, 1420.0), field_of_view(MIDDLE, 2000.0)
    assert (near.width_mm, near.height_mm) == pytest.approx((2048.0 * 1420.0 / 31000.0, 1536.0 * 1420.0 / 31000.0))
    assert near.diagonal_mm == pytest.approx(hypot(near.width_mm, near.height_mm))
    assert near.x_mm_per_px == pytest.approx(near.width_mm / 2048.0)
    assert far.height_mm == pytest.approx(near.height_mm * 2000.0 / 1420.0)
    assert far.distance_mm == 2000.0


def test_a_principal_point_off_the_middle_and_distortion_are_counted() -> None:
    lens = Lens((2048, 1536), 1500.0, 1510.0, 1120.0, 700.0, (-0.12, 0.05, 1e-3, -5e-4, -0.01))
    ends = [lens.normalise(np.array((x, 767.5))) for x in (-0.5, 2047.5)]
    assert angle_of_view(lens).horizontal_rad == pytest.approx(atan(ends[1][0]) - atan(ends[0][0]), rel=1e-3)
    barrel, pinhole = field_of_view(lens, 1000.0), field_of_view(replace(lens, distortion=(0.0,) * 5), 1000.0)
    assert barrel.width_mm > 1.03 * pinhole.width_mm  # what the barrel draws together comes from farther out
    assert barrel.x_mm_per_px == pytest.approx(1000.0 / 1500.0)
