"""What must hold always: there and back through lens, quaternion, gimbal and sphere; covariances against sampling."""

from dataclasses import replace
from math import hypot, pi, radians, remainder
from typing import Literal

import cv2
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from trackerd.contract.clock import HostNs
from trackerd.contract.errors import Degenerate
from trackerd.contract.model import Array, AxisAngles, Found
from trackerd.geometry.gimbal import AxisOrder, Station
from trackerd.geometry.lens import Lens
from trackerd.geometry.rigid import (
    Rigid,
    cross,
    euler_321_from_matrix,
    matrix_from_euler_321,
    matrix_from_quaternion,
    quaternion_from_matrix,
    rotation_about,
    rotation_about_x,
    rotation_about_y,
    skew,
)
from trackerd.geometry.sightline import Instants, angular_cov, sightline, tangent_basis
from trackerd.geometry.sphere import centre_and_range, outline

ARCSEC = pi / 648_000.0
TRACKING = Lens((2048, 1536), 31000.0, 31050.0, 1015.0, 775.0, (0.4, -3.0, 1e-4, -2e-4, 5.0))
WIDE = Lens((2048, 1536), 1500.0, 1510.0, 1020.0, 770.0, (-0.12, 0.05, 1e-3, -5e-4, -0.01))
angle = st.floats(-0.8, 0.8)
unit = st.floats(-1.0, 1.0)


@st.composite
def quaternions(draw: st.DrawFn) -> Array:
    q = np.array([draw(unit) for _ in range(4)])
    assume(np.linalg.norm(q) > 0.1)
    return q / np.linalg.norm(q)


def station(
    order: AxisOrder = AxisOrder.AZ_OUTER,
    az_sign: int = 1,
    el_sign: int = 1,
    lever_mm: float = -124.5,
    eps_rad: float = 1e-4,
    d_mm: float = 0.05,
) -> Station:
    lever = (3.0, lever_mm, 40.0) if order is AxisOrder.AZ_OUTER else (lever_mm, 3.0, 40.0)
    tilt = matrix_from_quaternion(np.array((1.0, 0.01, -0.02, 0.015)))
    mount = matrix_from_quaternion(np.array((1.0, 0.002, -0.003, 0.001)))
    base = Rigid(tilt, np.array((-550.0, 30.0, 10.0)))
    return Station("left", base, Rigid(mount, np.array(lever)), TRACKING, order, az_sign, el_sign, eps_rad, d_mm)


every_station = st.builds(
    station,
    st.sampled_from(AxisOrder),
    st.sampled_from((1, -1)),
    st.sampled_from((1, -1)),
    st.sampled_from((-124.5, 0.0, 80.0)),
    st.floats(-0.02, 0.02),
    st.floats(-5.0, 5.0),
)


# ---- rigid -----------------------------------------------------------------------------------------------------------


@given(quaternions())
def test_a_quaternion_survives_the_matrix(q: Array) -> None:
    matrix = matrix_from_quaternion(q)
    assert np.allclose(matrix @ matrix.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(matrix) == pytest.approx(1.0)
    back = quaternion_from_matrix(matrix)
    assert back[0] >= 0.0
    assert min(np.abs(back - q).max(), np.abs(back + q).max()) < 1e-12


@pytest.mark.parametrize("q", np.eye(4).tolist())
def test_half_turns_are_quaternions_too(q: list[float]) -> None:
    assert np.allclose(np.abs(quaternion_from_matrix(matrix_from_quaternion(np.array(q)))), q)


@given(quaternions(), quaternions(), st.tuples(unit, unit, unit))
def test_a_transform_and_its_inverse_cancel(q: Array, r: Array, p: tuple[float, float, float]) -> None:
    a = Rigid.from_quaternion(q, np.array((100.0, -20.0, 3.0)))
    b = Rigid.from_quaternion(r, np.array((-7.0, 2000.0, 5.0)))
    point = 1000.0 * np.array(p)
    assert np.allclose(a.inverse().move(a.move(point)), point, atol=1e-9)
    assert np.allclose((a @ b).move(point), a.move(b.move(point)), atol=1e-9)
    assert np.allclose(a.rotate(point), a.move(point) - a.translation_mm, atol=1e-9)


@given(angle)
def test_rotations_about_the_axes_agree_and_are_right_handed(turn: float) -> None:
    assert np.allclose(rotation_about(np.array((1.0, 0.0, 0.0)), turn), rotation_about_x(turn))
    assert np.allclose(rotation_about(np.array((0.0, 1.0, 0.0)), turn), rotation_about_y(turn))
    assert np.allclose(rotation_about_x(pi / 2) @ (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    assert np.allclose(rotation_about_y(pi / 2) @ (0.0, 0.0, 1.0), (1.0, 0.0, 0.0))


@given(st.tuples(unit, unit, unit), st.tuples(unit, unit, unit))
def test_the_cross_product_and_its_matrix_are_numpys(a: tuple[float, ...], b: tuple[float, ...]) -> None:
    assert np.allclose(cross(np.array(a), np.array(b)), np.cross(a, b))
    assert np.allclose(skew(np.array(a)) @ b, np.cross(a, b))


@given(st.tuples(*[st.floats(-pi, pi)] * 2), st.floats(-1.5, 1.5))
def test_321_angles_survive_the_matrix(turns: tuple[float, float], theta: float) -> None:
    psi, phi = turns
    back = euler_321_from_matrix(matrix_from_euler_321(psi, theta, phi))
    for angle_rad, expected in zip(back, (psi, theta, phi), strict=True):
        assert abs((angle_rad - expected + pi) % (2 * pi) - pi) < 1e-10


@given(quaternions())
def test_any_rotation_survives_its_321_angles(q: Array) -> None:
    matrix = matrix_from_quaternion(q)
    assert np.allclose(matrix_from_euler_321(*euler_321_from_matrix(matrix)), matrix, atol=1e-7)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_in_gimbal_lock_the_whole_turn_is_psis_and_the_rotation_is_kept(sign: float) -> None:
    matrix = matrix_from_euler_321(0.7, sign * pi / 2, 0.3)
    psi, theta, phi = euler_321_from_matrix(matrix)
    assert (theta, phi) == (sign * pi / 2, 0.0)
    assert psi == pytest.approx(0.7 - sign * 0.3)
    assert np.allclose(matrix_from_euler_321(psi, theta, phi), matrix, atol=1e-12)


def test_321_angles_turn_about_x_first_and_about_z_last() -> None:
    assert np.allclose(matrix_from_euler_321(0.3, 0.0, 0.0) @ (1.0, 0.0, 0.0), (np.cos(0.3), np.sin(0.3), 0.0))
    both = matrix_from_euler_321(pi / 2, 0.0, pi / 2)
    assert np.allclose(both @ (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))  # y to z by the first turn, where the last one leaves it


# ---- lens ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("lens", [TRACKING, WIDE])
@given(x=st.floats(0, 2047), y=st.floats(0, 1535))
def test_a_pixel_survives_unproject_and_project(lens: Lens, x: float, y: float) -> None:
    direction = lens.unproject(np.array((x, y)))
    assert np.linalg.norm(direction) == pytest.approx(1.0)
    assert np.allclose(lens.project(1234.5 * direction), (x, y), atol=1e-7)


@pytest.mark.parametrize("lens", [TRACKING, WIDE])
@given(x=st.floats(-0.03, 0.03), y=st.floats(-0.02, 0.02))
def test_the_lens_is_opencvs_and_its_jacobian_its_slope(lens: Lens, x: float, y: float) -> None:
    point = np.array((x, y, 1.0)) * 2000.0
    matrix = np.array(((lens.fx_px, 0.0, lens.cx_px), (0.0, lens.fy_px, lens.cy_px), (0.0, 0.0, 1.0)))
    theirs, _ = cv2.projectPoints(point[None], np.zeros(3), np.zeros(3), matrix, np.array(lens.distortion))
    assert np.allclose(lens.project(point), theirs[0, 0], atol=1e-8)
    steps = np.eye(3) * 1e-2
    slope = np.column_stack([(lens.project(point + s) - lens.project(point - s)) / 2e-2 for s in steps])
    assert np.allclose(lens.jacobian(point), slope, atol=1e-6)


# ---- gimbal ----------------------------------------------------------------------------------------------------------


@given(every_station, st.tuples(unit, unit, unit), st.tuples(unit, unit), st.sampled_from((1, 2)))
@settings(max_examples=120)
def test_a_station_aimed_at_a_point_sees_it_at_the_pixel(
    s: Station, p: tuple[float, ...], q: tuple[float, float], face: Literal[1, 2]
) -> None:
    """To 1e-9 px by either face, whatever the order, the signs, the errors and the lever arm."""
    point = np.array((0.0, 0.0, 1900.0)) + np.array(p) * (500.0, 500.0, 400.0)
    pixel = np.array((s.lens.cx_px, s.lens.cy_px)) + np.array(q) * 300.0
    assert np.abs(s.pixel(point, *s.aim(point, face=face)) - (s.lens.cx_px, s.lens.cy_px)).max() < 1e-9
    az, el = s.aim(point, pixel, face)
    assert np.abs(s.pixel(point, az, el) - pixel).max() < 1e-9
    camera = s.world_from_camera(az, el)
    assert camera.inverse().move(point)[2] > 0.0
    range_mm = float(np.linalg.norm(point - camera.translation_mm))
    assert np.allclose(s.point_at(pixel, az, el, range_mm), point, atol=1e-6)


@given(every_station, st.tuples(unit, unit, unit))
def test_the_second_face_is_half_a_turn_of_the_outer_axis_and_over_the_top_of_the_inner_one(
    s: Station, p: tuple[float, ...]
) -> None:
    point = np.array((0.0, 0.0, 1900.0)) + np.array(p) * (500.0, 500.0, 400.0)
    outer, inner = (0, 1) if s.order is AxisOrder.AZ_OUTER else (1, 0)
    ideal = replace(s, rg_from_camera=Rigid.identity(), eps_rad=0.0, d_mm=0.0)
    for each, tolerance_rad in ((ideal, 1e-9), (s, 0.2)):  # lever arm, mount and errors turn them a little
        first, second = each.aim(point), each.aim(point, face=2)
        assert abs(remainder(second[outer] - first[outer] - pi, 2 * pi)) < tolerance_rad
        assert abs(remainder(second[inner] + first[inner] - pi, 2 * pi)) < tolerance_rad
        assert max(map(abs, (*first, *second))) < pi + tolerance_rad


@given(every_station, angle, angle)
@settings(max_examples=60)
def test_the_axes_are_what_the_camera_turns_about(s: Station, az: float, el: float) -> None:
    """A small encoder step is a rotation about the stated axis through the stated point; so is the pixels' motion."""
    h = 1e-6
    axes = s.axes(az, el)
    here = s.world_from_camera(az, el)
    point = here.move(np.array((20.0, -15.0, 2000.0)))
    for axis, p_axis, there, back in (
        (axes.az, axes.p_az_mm, s.world_from_camera(az + h, el), s.world_from_camera(az - h, el)),
        (axes.el, axes.p_el_mm, s.world_from_camera(az, el + h), s.world_from_camera(az, el - h)),
    ):
        assert np.allclose((there.rotation - back.rotation) / (2 * h), skew(axis) @ here.rotation, atol=1e-8)
        motion = (there.translation_mm - back.translation_mm) / (2 * h)
        assert np.allclose(motion, cross(axis, here.translation_mm - p_axis), atol=1e-5)
    d_az = (s.pixel(point, az + h, el) - s.pixel(point, az - h, el)) / (2 * h)
    d_el = (s.pixel(point, az, el + h) - s.pixel(point, az, el - h)) / (2 * h)
    assert np.allclose(s.pixel_jacobian(point, az, el), np.column_stack((d_az, d_el)), atol=0.05)


def test_a_point_inside_the_lever_arm_cannot_be_aimed_at() -> None:
    s = station()
    with pytest.raises(Degenerate, match="inside the lever arm"):
        s.aim(s.world_from_gimbal.move(np.array((2000.0, 50.0, 20.0))))


@pytest.mark.parametrize("order", AxisOrder)
@pytest.mark.parametrize("face", [1, 2])
def test_a_point_on_the_outer_axis_cannot_be_seen_beside_the_inner_axis_great_circle(
    order: AxisOrder, face: Literal[1, 2]
) -> None:
    """The outer axis does not move it there, so that it is told as what it is, not as some pair of angles."""
    s = replace(station(order, lever_mm=0.0), rg_from_camera=Rigid.identity(), eps_rad=0.0, d_mm=0.0)
    az_outer = order is AxisOrder.AZ_OUTER
    on_axis = s.world_from_gimbal.move(np.array((1500.0, 0.0, 0.0) if az_outer else (0.0, 1500.0, 0.0)))
    beside = np.array((s.lens.cx_px, s.lens.cy_px)) + ((0.0, 300.0) if az_outer else (300.0, 0.0))
    with pytest.raises(Degenerate, match="cannot be aimed"):
        s.aim(on_axis, beside, face)


def test_a_target_that_the_pupil_has_passed_cannot_be_aimed_at() -> None:
    s = replace(station(), rg_from_camera=Rigid(np.eye(3), np.array((0.0, -124.5, 400.0))))
    with pytest.raises(Degenerate, match="behind the camera"):
        s.aim(s.world_from_gimbal.move(np.array((0.0, 0.0, 300.0))))


def test_the_order_of_the_axes_matters() -> None:
    a, b = (replace(station(order), rg_from_camera=Rigid.identity()) for order in AxisOrder)
    assert np.allclose(a.world_from_camera(0.0, 0.3).rotation, b.world_from_camera(0.0, 0.3).rotation, atol=1e-4)
    assert not np.allclose(a.world_from_camera(0.4, 0.3).rotation, b.world_from_camera(0.4, 0.3).rotation, atol=1e-2)


# ---- sphere ----------------------------------------------------------------------------------------------------------


@given(st.floats(-0.03, 0.03), st.floats(-0.02, 0.02), st.floats(800.0, 4000.0), st.floats(3.0, 30.0))
def test_a_sphere_is_found_again_from_its_outline(x: float, y: float, z_mm: float, radius_mm: float) -> None:
    point = np.array((x, y, 1.0)) * z_mm
    lens = replace(TRACKING, distortion=(0.0, 0.0, 0.0, 0.0, 0.0))
    ellipse = outline(point, radius_mm, lens)
    direction, range_mm = centre_and_range(np.array((ellipse.x_px, ellipse.y_px)), ellipse.r_px, radius_mm, lens)
    assert np.allclose(direction * range_mm, point, rtol=1e-9)


@pytest.mark.parametrize(
    ("lens", "point", "tolerance_px"),
    [
        (replace(WIDE, distortion=(0.0,) * 5), (400.0, 250.0, 1500.0), 1e-8),
        (TRACKING, (1.2, 0.8, 2000.0), 1e-2),
        (TRACKING, (30.0, 15.0, 2000.0), 0.05),
    ],
    ids=["pinhole, far off the axis", "tracked", "500 px off"],
)
def test_the_outline_is_that_of_the_tangent_cone(lens: Lens, point: tuple[float, ...], tolerance_px: float) -> None:
    """Every ray of the cone that touches the sphere is projected onto the ellipse."""
    radius_mm = 12.7
    e = outline(np.array(point), radius_mm, lens)
    assert e.a_px >= e.b_px
    range_mm = float(np.linalg.norm(point))
    axis = np.array(point) / range_mm
    u = cross(axis, np.array((1.0, 0.0, 0.0)))
    u /= np.linalg.norm(u)
    sin_alpha = radius_mm / range_mm
    c, s = np.cos(e.angle_rad), np.sin(e.angle_rad)
    excess_px = []
    for turn in np.linspace(0.0, 2 * pi, 16):
        side = np.cos(turn) * u + np.sin(turn) * cross(axis, u)
        q = lens.project(axis * np.sqrt(1.0 - sin_alpha**2) + side * sin_alpha) - (e.x_px, e.y_px)
        excess_px.append(e.a_px * (hypot((c * q[0] + s * q[1]) / e.a_px, (c * q[1] - s * q[0]) / e.b_px) - 1.0))
    assert np.abs(excess_px).max() < tolerance_px


# ---- line of sight ---------------------------------------------------------------------------------------------------


def seen(s: Station, point: Array, az: float, el: float, cov_px2: Array) -> Found:
    e = outline(s.world_from_camera(az, el).inverse().move(point), 12.7, s.lens)
    return Found(e.x_px, e.y_px, e.r_px, cov_px2, 1.0, 1.0, 0.0)


INSTANTS = Instants(HostNs(5), 7.0, HostNs(9))
POINT = np.array((60.0, -40.0, 1950.0))


def angles_at(az: float, el: float, sigma_rad: float, fixed_rad: float) -> AxisAngles:
    return AxisAngles(az, el, sigma_rad, fixed_rad, None, 0.0, "latch")


@given(every_station, st.tuples(unit, unit))
@settings(max_examples=40)
def test_the_line_of_sight_passes_through_the_sphere_that_was_seen(s: Station, q: tuple[float, float]) -> None:
    az, el = s.aim(POINT, np.array((s.lens.cx_px, s.lens.cy_px)) + np.array(q) * 300.0)
    found = seen(s, POINT, az, el, np.diag((0.01, 0.01, 0.01)))
    line = sightline(s, found, angles_at(az, el, 2 * ARCSEC, 1 * ARCSEC), 12.7, INSTANTS)
    assert np.allclose(line.origin_mm + line.range_mm * line.direction, POINT, atol=2e-3)
    assert np.allclose(line.cov_rad2 @ line.direction, 0.0, atol=1e-20)
    assert (line.station, line.instant, line.instant_sigma_ns, line.received) == ("left", 5, 7.0, 9)


@pytest.mark.parametrize(
    ("pixel", "encoder", "fixed"),
    [(0.1, 0.0, 0.0), (0.0, 2.0, 0.0), (0.0, 0.0, 3.0), (0.2, 2.0, 0.0)],
    ids=["pixel part", "lever-arm part", "fixed part", "both"],
)
@pytest.mark.parametrize("order", AxisOrder)
def test_the_covariance_of_a_line_of_sight_is_what_sampling_finds(
    order: AxisOrder, pixel: float, encoder: float, fixed: float
) -> None:
    """At the target's range: the camera's own displacement on its lever arm counts as well as its turn. A long lever arm."""
    s = station(order, lever_mm=-600.0)
    az, el = s.aim(POINT, np.array((1300.0, 500.0)))
    cov_px2 = np.diag((pixel**2, (0.5 * pixel) ** 2, pixel**2))
    found = seen(s, POINT, az, el, cov_px2)
    line = sightline(s, found, angles_at(az, el, encoder * ARCSEC, fixed * ARCSEC), 12.7, INSTANTS)
    assert line.range_sigma_mm == pytest.approx(line.range_mm * pixel / found.r_px)
    rng = np.random.default_rng(3)
    across = np.eye(3) - np.outer(line.direction, line.direction)
    errors = []
    for _ in range(1500):
        noise = rng.normal(0.0, hypot(encoder, fixed) * ARCSEC, 2)
        shifted = replace(found, x_px=found.x_px + rng.normal(0, pixel), y_px=found.y_px + rng.normal(0, 0.5 * pixel))
        other = sightline(s, shifted, angles_at(az + noise[0], el + noise[1], 0.0, 0.0), 12.7, INSTANTS)
        errors.append(across @ (other.origin_mm + line.range_mm * other.direction - POINT) / line.range_mm)
    claimed = line.cov_rad2 + line.fixed_cov_rad2
    sampled = np.cov(np.array(errors).T)
    values, vectors = np.linalg.eigh(claimed)
    basis = vectors[:, 1:] / np.sqrt(values[1:])
    assert np.allclose(basis.T @ sampled @ basis, np.eye(2), atol=0.15)


@given(st.tuples(unit, unit, unit))
def test_the_tangent_basis_is_right_handed_and_across_the_line(d: tuple[float, ...]) -> None:
    assume(hypot(*d) > 0.1)
    direction = np.array(d) / hypot(*d)
    u, v = tangent_basis(direction)
    assert np.allclose(np.cross(u, v), direction, atol=1e-12)
    assert np.allclose((u @ u, v @ v, u @ v, u @ direction), (1.0, 1.0, 0.0, 0.0), atol=1e-12)
    assert np.abs(u).min() == 0.0  # level as seen along an axis of W


@given(every_station, st.tuples(unit, unit))
@settings(max_examples=40)
def test_two_angles_carry_the_whole_covariance_of_a_line(s: Station, q: tuple[float, float]) -> None:
    az, el = s.aim(POINT, np.array((s.lens.cx_px, s.lens.cy_px)) + np.array(q) * 300.0)
    found = seen(s, POINT, az, el, np.array(((0.01, 0.004, 0.0), (0.004, 0.02, 0.0), (0.0, 0.0, 0.01))))
    line = sightline(s, found, angles_at(az, el, 2 * ARCSEC, 3 * ARCSEC), 12.7, INSTANTS)
    basis = tangent_basis(line.direction)
    for part, whole in zip(angular_cov(line), (line.cov_rad2, line.fixed_cov_rad2), strict=True):
        assert part.shape == (2, 2)
        assert np.linalg.eigvalsh(part)[0] > 0.0
        assert np.allclose(basis.T @ part @ basis, whole, rtol=1e-9, atol=1e-20)


def test_the_two_angles_scatter_as_their_covariance_says() -> None:
    s, rng, cov_px2 = station(), np.random.default_rng(8), np.array(((0.01, 0.006, 0.0), (0.006, 0.01, 0.0), (0.0, 0.0, 0.01)))
    az, el = s.aim(POINT, np.array((1300.0, 500.0)))
    found = seen(s, POINT, az, el, cov_px2)
    line = sightline(s, found, angles_at(az, el, 0.0, 0.0), 12.7, INSTANTS)
    basis, claimed = tangent_basis(line.direction), angular_cov(line)[0]
    shifts = rng.multivariate_normal(np.zeros(2), cov_px2[:2, :2], 2000)
    shifted = (replace(found, x_px=found.x_px + float(x), y_px=found.y_px + float(y)) for x, y in shifts)
    errors = np.array([basis @ sightline(s, each, angles_at(az, el, 0.0, 0.0), 12.7, INSTANTS).direction for each in shifted])
    assert 0.9 < np.einsum("ni,ij,nj->n", errors, np.linalg.inv(claimed), errors).mean() / 2.0 < 1.1


def test_a_lever_arm_of_zero_leaves_only_the_turn() -> None:
    s = replace(station(), rg_from_camera=Rigid(np.eye(3), np.zeros(3)), d_mm=0.0)
    az, el = s.aim(POINT)
    line = sightline(s, seen(s, POINT, az, el, np.zeros((3, 3))), angles_at(az, el, ARCSEC, 0.0), 12.7, INSTANTS)
    el_axis = s.axes(az, el).el
    assert np.sqrt(cross(el_axis, line.direction) @ cross(el_axis, line.direction)) == pytest.approx(1.0, abs=1e-3)
    assert np.sqrt(np.linalg.eigvalsh(line.cov_rad2)[-1]) == pytest.approx(ARCSEC, rel=1e-3)
    assert radians(1 / 3600) == pytest.approx(ARCSEC)
