"""What a calibration says it is worth, held against sampling."""

from dataclasses import replace

import numpy as np
import pytest
from made_cells import Cell, Noise, cell, encoder_maps, looks, probe_data, probe_views, shoot, turned, volume

from trackerd.calibrate.cell import (
    ARCSEC,
    Held,
    Options,
    bound,
    calibrate_cell,
    known_points,
    measure,
    predict,
    reliability,
    verify,
)
from trackerd.calibrate.cell.predict import Prediction
from trackerd.calibrate.cell.state import layout_of, moved, state_of, stations_of
from trackerd.contract.clock import HostNs
from trackerd.contract.errors import ConfigError, Degenerate
from trackerd.contract.model import Array, Sightline
from trackerd.geometry.gimbal import Station
from trackerd.geometry.rigid import Rigid
from trackerd.geometry.triangulate import triangulate

NO_PARAMETERS: tuple[tuple[str, ...], Array] = ((), np.zeros((0, 0)))
LOOK = {"sigma_px": 0.1, "encoder_sigma_rad": 2.0 * ARCSEC}


def made_cell(seed: int = 1) -> tuple[Cell, dict[str, Station]]:
    made = cell(np.random.default_rng(seed))
    return made, {station.name: station for station in made.true}


def test_the_random_part_is_what_sampling_finds() -> None:
    made, stations = made_cell()
    p_mm = np.repeat(np.array([(80.0, -50.0, 60.0)]), 1500, axis=0)
    noise = Noise(0.2, 3.0 * ARCSEC)
    found = measure(looks(made, np.random.default_rng(2), p_mm, noise), 1500, stations, *NO_PARAMETERS)
    claimed = predict(stations, *NO_PARAMETERS, p_mm[:1], sigma_px=0.2, encoder_sigma_rad=3.0 * ARCSEC)
    assert np.allclose(found.random_mm2[0], claimed.random_mm2[0], rtol=1e-2, atol=1e-6)
    root = np.linalg.inv(np.linalg.cholesky(claimed.random_mm2[0]))
    assert np.allclose(root @ np.cov((found.p_mm - p_mm).T) @ root.T, np.eye(3), atol=0.15)


def test_the_fixed_part_is_what_encoders_do_whose_error_is_a_function_of_the_angle() -> None:
    made, stations = made_cell()
    p_mm = np.array([(80.0, -50.0, 60.0)])
    rng = np.random.default_rng(2)
    noise = Noise(1e-6, 1e-6 * ARCSEC, 2.0 * ARCSEC)
    errors = [
        measure(looks(made, rng, p_mm, noise, encoder_maps(rng, 2, noise.fixed_rad)), 1, stations, *NO_PARAMETERS).p_mm[0]
        for _ in range(300)
    ] - p_mm
    claimed = predict(
        stations, *NO_PARAMETERS, p_mm, sigma_px=1e-6, encoder_sigma_rad=1e-6 * ARCSEC, encoder_fixed_rad=2.0 * ARCSEC
    )
    root = np.linalg.inv(np.linalg.cholesky(claimed.systematic_mm2[0]))
    assert np.allclose(root @ np.cov(errors.T) @ root.T, np.eye(3), atol=0.3)
    assert np.trace(claimed.random_mm2[0]) < 1e-9 * np.trace(claimed.fixed_mm2[0])


def test_the_calibration_part_is_what_moved_parameters_do() -> None:
    """Each parameter of the file moved a little, the same pixels (off the middle) and angles: so does the target."""
    made, stations = made_cell()
    p_mm = volume(np.random.default_rng(3), 4)
    views = probe_views(made.true, p_mm, np.array([(500.0, -300.0)]))
    seen = shoot(made.true, known_points(p_mm), *views, Noise(none=True), np.random.default_rng(4))
    angles = seen.angles_rad.reshape(2, 4, 2).transpose(1, 0, 2)
    names, cov = bound(
        *probe_data(made, np.random.default_rng(5), 6), stations, options=Options(square_pixels=False, distortion=5)
    )
    claimed = predict(stations, names, cov, p_mm, **LOOK, angles_rad=angles)
    layout = layout_of(2, known_points(p_mm), np.zeros(0, np.intp))
    state = state_of(made.true, known_points(p_mm))
    for column, name in enumerate(names):
        step = np.zeros(layout.columns)
        step[column] = 1e-5 if name.endswith("rad") else 1e-3
        there = stations_of(moved(state, step, layout), made.true)
        shift = (measure(seen, 4, there, *NO_PARAMETERS).p_mm - p_mm) / step[column]
        size = max(1e-6, float(np.abs(claimed.sensitivity[:, :, column]).max()))
        assert np.allclose(shift, claimed.sensitivity[:, :, column], atol=0.02 * size), name
    total = claimed.sensitivity @ cov @ claimed.sensitivity.transpose(0, 2, 1)
    assert np.allclose(claimed.calibration_mm2, total)
    assert np.allclose(claimed.total_mm2, claimed.random_mm2 + claimed.systematic_mm2)


def test_a_measured_point_is_the_one_that_the_fusion_triangulates() -> None:
    made, stations = made_cell()
    p_mm = volume(np.random.default_rng(3), 3)
    seen = looks(made, np.random.default_rng(4), p_mm)
    found = measure(seen, 3, stations, *NO_PARAMETERS)
    for i in range(3):
        lines = []
        for row in np.flatnonzero(seen.point == i):
            station = made.true[seen.gimbal[seen.view[row]]]
            az, el = seen.angles_rad[seen.view[row]]
            pose = station.pose(az, el)
            direction = pose.world_from_camera.rotate(station.lens.unproject(seen.q_px[row]))
            swing = pose.axes.swing(p_mm[i]) / np.linalg.norm(p_mm[i] - pose.world_from_camera.translation_mm)
            across = np.eye(3) - np.outer(direction, direction)
            cov = across @ ((2.0 * ARCSEC) ** 2 * swing @ swing.T + (0.1 / station.lens.fx_px) ** 2 * np.eye(3)) @ across
            origin = pose.world_from_camera.translation_mm
            lines.append(Sightline(station.name, HostNs(0), 0.0, origin, direction, cov, 0.0 * cov, 2000.0, 1.0, HostNs(0)))
        point = triangulate(lines)
        assert np.allclose(point.p_mm, found.p_mm[i], atol=1e-4)
        assert np.allclose(point.cov_mm2, found.random_mm2[i], rtol=0.02, atol=1e-5)


def test_the_covariance_of_targets_with_the_calibrations_part_is_true() -> None:
    """NEES over independent calibrations of few points, where the calibration's part is as large as the look's."""
    nees, bare = [], []
    for seed in range(24):
        rng = np.random.default_rng(seed)
        made = cell(rng)
        result = calibrate_cell(*probe_data(made, rng, 8), made.nominal)
        p_mm = volume(rng, 20)
        found = measure(looks(made, rng, p_mm), 20, result.stations, result.parameters, result.covariance)
        errors = found.p_mm - p_mm
        nees.append(np.einsum("mi,mij,mj->m", errors, np.linalg.inv(found.total_mm2), errors).mean() / 3.0)
        bare.append(np.einsum("mi,mij,mj->m", errors, np.linalg.inv(found.random_mm2), errors).mean() / 3.0)
    assert 0.8 < np.mean(nees) < 1.2
    assert np.mean(bare) > 1.2


def test_the_bound_of_a_design_is_what_the_calibration_of_its_data_says() -> None:
    made, stations = made_cell()
    seen, targets = probe_data(made, np.random.default_rng(2), 20)
    result = calibrate_cell(seen, targets, made.nominal)
    p_mm = volume(np.random.default_rng(3), 20)
    best = predict(stations, *bound(seen, targets, stations), p_mm, **LOOK)
    said = predict(result.stations, result.parameters, result.covariance, p_mm, **LOOK)

    def size(of: Prediction) -> float:
        return float(np.sqrt(np.trace(of.calibration_mm2, axis1=1, axis2=2).mean()))

    assert size(said) == pytest.approx(size(best), rel=0.05)


def test_a_parameter_that_no_station_has_is_named() -> None:
    _, stations = made_cell()
    with pytest.raises(ConfigError, match=r"no station has a parameter left\.focus_mm"):
        predict(stations, ("left.focus_mm",), np.eye(1), np.zeros((1, 3)), **LOOK)


def test_what_is_held_twice_over_is_refused() -> None:
    made, stations = made_cell()
    held = Held(("left.lens.cx_px", "left.lens.cy_px"), np.ones((2, 2)))
    options = Options(from_nominal=True, free={"left": frozenset()}, held=held)
    with pytest.raises(ConfigError, match="singular: some of its parameters say the same twice"):
        calibrate_cell(*probe_data(made, np.random.default_rng(2), 6), stations, options)


@pytest.mark.parametrize("call", [predict, reliability])
def test_one_station_makes_no_point(call: object) -> None:
    _, stations = made_cell()
    one = {"left": stations["left"]}
    with pytest.raises(Degenerate, match="a point needs two lines of sight, here 1"):
        _ = (
            predict(one, *NO_PARAMETERS, np.zeros((1, 3)), **LOOK)
            if call is predict
            else reliability(one, np.zeros((1, 3)), **LOOK)
        )


def test_a_point_that_one_station_saw_is_not_measured() -> None:
    made, stations = made_cell()
    seen = looks(made, np.random.default_rng(2), volume(np.random.default_rng(3), 2))
    keep = (seen.point == 0) | (seen.gimbal[seen.view] == 0)
    seen = replace(seen, view=seen.view[keep], point=seen.point[keep], q_px=seen.q_px[keep], sigma_px=seen.sigma_px[keep])
    found = measure(seen, 2, stations, *NO_PARAMETERS)
    assert np.isfinite(found.p_mm[0]).all()
    assert np.isnan(found.p_mm[1]).all()


# ---- verification ----------------------------------------------------------------------------------------------------


def checks(count: int, sigma_mm: float, seed: int = 1) -> tuple[Array, Array, Array, Array]:
    reference = volume(np.random.default_rng(seed), count)
    cov = np.tile(np.eye(3) * 0.01, (count, 1, 1))
    measured = reference + np.random.default_rng(seed + 1).normal(0.0, sigma_mm, (count, 3))
    return measured, cov, reference, 0.0 * cov


def test_check_points_within_their_uncertainty_verify() -> None:
    found = verify(*checks(8, 0.05))
    assert found.verified
    assert found.en.max() <= 1.0
    assert found.rms_mm == pytest.approx(np.sqrt((found.error_mm**2).sum(axis=1).mean()))
    assert found.max_mm == pytest.approx(np.linalg.norm(found.error_mm, axis=1).max())


@pytest.mark.parametrize(("count", "sigma_mm"), [(7, 0.05), (8, 1.0)], ids=["too few", "too far"])
def test_few_or_far_check_points_do_not_verify(count: int, sigma_mm: float) -> None:
    assert not verify(*checks(count, sigma_mm)).verified


def test_an_error_is_judged_by_the_covariance_in_its_direction() -> None:
    reference = np.zeros((1, 3))
    cov = np.diag((0.01, 0.01, 1.0))[None]
    assert verify(np.array([(0.0, 0.0, 0.6)]), cov, reference, 0 * cov).en[0] == pytest.approx(0.6 / 2.833)
    assert verify(np.array([(0.6, 0.0, 0.0)]), cov, reference, 0 * cov).en[0] == pytest.approx(6.0 / 2.833)


def test_true_covariances_verify_in_99_of_100_calibrations() -> None:
    verified = [verify(*checks(8, 0.1, 2 * seed)).verified for seed in range(400)]
    assert 0.97 < np.mean(verified) <= 1.0


def test_a_check_point_that_was_not_seen_is_an_error() -> None:
    measured, *rest = checks(8, 0.05)
    measured[3] = np.nan
    with pytest.raises(ConfigError, match="not finite, or was not seen by two stations"):
        verify(measured, *rest)


# ---- reliability -----------------------------------------------------------------------------------------------------


def test_a_bias_of_the_minimal_detectable_size_raises_chi_square_by_its_noncentrality() -> None:
    """And moves the target by the external reliability."""
    made, stations = made_cell()
    p_mm = np.array([(50.0, 40.0, -30.0)])
    found = reliability(stations, p_mm, **LOOK)
    assert found.names == ("left.az", "left.el", "right.az", "right.el")
    seen = looks(made, np.random.default_rng(1), p_mm, Noise(none=True))
    angles = seen.angles_rad.copy()
    angles[0, 0] += found.detectable_rad[0, 0]
    biased = measure(replace(seen, angles_rad=angles), 1, stations, *NO_PARAMETERS)
    assert np.linalg.norm(biased.p_mm - p_mm) == pytest.approx(found.external_mm[0, 0], rel=1e-3)
    assert found.detectable_rad[0, 0] / ARCSEC == pytest.approx(12.0, rel=0.1)


def test_two_stations_do_not_see_an_error_in_the_plane_of_their_lines() -> None:
    made, stations = made_cell()
    p_mm = np.array([(50.0, 40.0, -30.0)])
    two = reliability(stations, p_mm, **LOOK)
    assert two.detectable_rad[0, 1] > 5.0 * two.detectable_rad[0, 0]
    assert two.external_mm[0, 1] > 1.0
    third = replace(made.true[0], name="top", world_from_gimbal=third_pose(made))
    three = reliability({**stations, "top": third}, p_mm, **LOOK)
    assert three.external_mm[0, 1] < 0.3
    assert three.invisible_mm_per_arcsec[0] < two.invisible_mm_per_arcsec[0] * 1.05


def third_pose(made: Cell) -> Rigid:
    left = made.true[0].world_from_gimbal
    return replace(left, rotation=turned((-0.25, 0.0, 0.0)), translation_mm=np.array((0.0, -600.0, -1900.0)))
