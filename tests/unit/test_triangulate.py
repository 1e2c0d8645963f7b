from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from looking_cells import CELLS, cell
from made_lines import ARCSEC, CENTRE, STATIONS, line, nees, still

from trackerd.contract.errors import Degenerate
from trackerd.contract.model import Array, Sightline
from trackerd.geometry.triangulate import Method, triangulate

PAIR = ("left", "right")


def lines_of(stations: Sequence[str], rng: np.random.Generator | None = None) -> list[Sightline]:
    return [line(still, station, 0, rng) for station in stations]


@pytest.mark.parametrize("stations", [PAIR, tuple(STATIONS)])
def test_lines_without_noise_meet_in_the_target(stations: Sequence[str]) -> None:
    point = triangulate(lines_of(stations))
    assert np.allclose(point.p_mm, CENTRE, atol=1e-8)
    assert point.miss_mm < 1e-8
    assert point.chi2 < 1e-6
    assert point.dof == 2 * len(stations) - 3


@pytest.mark.parametrize("stations", [PAIR, tuple(STATIONS)])
def test_the_covariance_and_chi2_are_what_sampling_finds(stations: Sequence[str]) -> None:
    rng = np.random.default_rng(11)
    points = [triangulate(lines_of(stations, rng)) for _ in range(3000)]
    errors = np.array([point.p_mm - CENTRE for point in points])
    assert 0.95 < nees(errors, np.array([point.cov_mm2 for point in points])) < 1.05
    assert 0.93 < np.mean([point.chi2 / point.dof for point in points]) < 1.07
    assert np.all(np.abs(errors.mean(axis=0)) < 4 * errors.std(axis=0) / np.sqrt(len(errors)))
    if len(stations) == 2:
        assert 0.93 < np.mean([(point.miss_mm / point.miss_sigma_mm) ** 2 for point in points]) < 1.07


@pytest.mark.parametrize("stations", [2, 3, 4, 6])
@pytest.mark.parametrize("kind", list(CELLS))
def test_each_method_states_the_covariance_that_it_has(kind: str, stations: int) -> None:
    """And the chi-square of the lines, which is the same by all of them: how well they meet is not the estimator's."""
    made = cell(kind, stations)
    draws = made.draws(np.random.default_rng(stations), 2000)
    ratio, chi2 = {}, {}
    for method in Method:
        points = [triangulate(lines, method) for lines in draws]
        errors = np.array([point.p_mm - made.target_mm for point in points])
        assert 0.95 < nees(errors, np.array([point.cov_mm2 for point in points])) < 1.05
        ratio[method] = np.sqrt((errors**2).sum(axis=1).mean() / made.bound.trace())
        chi2[method] = np.array([point.chi2 for point in points])
        assert chi2[method].mean() / points[0].dof == pytest.approx(1.0, abs=0.11)
    for each in chi2.values():
        assert np.allclose(each, chi2[Method.MAXIMUM_LIKELIHOOD], rtol=1e-3, atol=1e-3)
    assert ratio[Method.MAXIMUM_LIKELIHOOD] == pytest.approx(1.0, abs=0.03)
    assert ratio[Method.RANGE_WEIGHTED] < ratio[Method.UNWEIGHTED] + 0.01


def test_lines_of_unequal_range_are_worth_weighting() -> None:
    made = cell("5 x 5 m", 6)
    draws = made.draws(np.random.default_rng(5), 800)
    rms = {
        method: np.sqrt(np.mean([((triangulate(lines, method).p_mm - made.target_mm) ** 2).sum() for lines in draws]))
        for method in Method
    }
    assert rms[Method.UNWEIGHTED] > 1.1 * rms[Method.RANGE_WEIGHTED]
    assert rms[Method.RANGE_WEIGHTED] < 1.05 * rms[Method.MAXIMUM_LIKELIHOOD]


@pytest.mark.parametrize("method", list(Method))
def test_the_unweighted_point_is_the_one_nearest_to_the_lines_and_all_methods_close_without_noise(method: Method) -> None:
    left, right = lines_of(PAIR)
    assert np.allclose(triangulate([left, right], method).p_mm, CENTRE, atol=1e-8)
    raised = replace(right, origin_mm=right.origin_mm + np.array((0.0, 3.0, 0.0)), cov_rad2=100.0 * right.cov_rad2)
    shares = {Method.UNWEIGHTED: 0.5, Method.RANGE_WEIGHTED: 0.01, Method.MAXIMUM_LIKELIHOOD: 0.01}
    assert triangulate([left, raised], method).p_mm[1] - CENTRE[1] == pytest.approx(3.0 * shares[method], rel=0.02)


def test_a_method_may_be_told_by_its_name_and_another_word_is_no_method() -> None:
    lines = lines_of(PAIR, np.random.default_rng(4))
    assert np.array_equal(triangulate(lines, "unweighted").p_mm, triangulate(lines, Method.UNWEIGHTED).p_mm)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="best"):
        triangulate(lines, "best")  # type: ignore[arg-type]


def test_unequal_lines_are_weighted_by_their_covariance() -> None:
    """An anisotropic and a ten times worse line: NEES stays 1, and the point lies on the good lines."""
    rng = np.random.default_rng(12)
    shape = np.diag((25.0, 1.0, 1.0)) * ARCSEC**2
    errors, covs = [], []
    for _ in range(2000):
        lines = []
        for station, sigma in (("left", 1.0), ("right", 2.0), ("top", 10.0)):
            exact = line(still, station, 0)
            across = np.eye(3) - np.outer(exact.direction, exact.direction)
            cov = sigma**2 * across @ shape @ across
            noise = across @ rng.multivariate_normal(np.zeros(3), sigma**2 * shape)
            seen = exact.direction + noise
            lines.append(replace(exact, direction=seen / np.linalg.norm(seen), cov_rad2=cov))
        point = triangulate(lines)
        errors.append(point.p_mm - CENTRE)
        covs.append(point.cov_mm2)
    assert 0.93 < nees(np.array(errors), np.array(covs)) < 1.07


def test_the_fixed_part_is_carried_into_a_systematic_covariance() -> None:
    rng = np.random.default_rng(13)
    exact = [line(still, station, 0, fixed_rad=3 * ARCSEC) for station in PAIR]
    shifted = [line(still, station, 0, rng, sigma_rad=3 * ARCSEC) for _ in range(1500) for station in PAIR]
    pairs = [[replace(seen, cov_rad2=exact[0].cov_rad2) for seen in shifted[i : i + 2]] for i in range(0, len(shifted), 2)]
    errors = np.array([triangulate(pair).p_mm - CENTRE for pair in pairs])
    systematic = triangulate(exact).systematic_cov_mm2
    assert 0.93 < nees(errors, np.broadcast_to(systematic, (len(errors), 3, 3))) < 1.07


def test_a_line_that_is_sharp_one_way_only_does_not_blow_the_fixed_part_up() -> None:
    """Random parts 100 times sharper upwards than sidewards (the instants of a target that moves sidewards), a fixed part alike
    all round, and a target below the stations: what is upwards there tells of the depth, four times worse than sidewards."""

    def below(t_s: float) -> Array:
        return still(t_s) - np.array((0.0, 150.0, 0.0))

    def systematic(sharp: float) -> float:
        lines = []
        for station in PAIR:
            exact = line(below, station, 0)
            across = np.eye(3) - np.outer(exact.direction, exact.direction)
            random = 0.05**2 * ARCSEC**2 * across @ np.diag((1.0, sharp**2, 1.0)) @ across
            lines.append(replace(exact, cov_rad2=random, fixed_cov_rad2=4.0 * ARCSEC**2 * across))
        return float(np.sqrt(triangulate(lines).systematic_cov_mm2.trace()))

    assert systematic(0.01) < 1.01 * systematic(1.0)


def test_the_miss_distance_of_two_lines_is_the_gap_between_them() -> None:
    left, right = lines_of(PAIR)
    raised = replace(right, origin_mm=right.origin_mm + np.array((0.0, 3.0, 0.0)))
    point = triangulate([left, raised])
    assert point.miss_mm == pytest.approx(3.0, abs=1e-9)
    assert point.chi2 == pytest.approx((3.0 / point.miss_sigma_mm) ** 2, rel=1e-3)


def test_a_share_of_the_covariance_along_the_line_does_not_pull_the_point() -> None:
    left, right = lines_of(PAIR)
    tilted = left.cov_rad2 + 1e-3 * left.cov_rad2[0, 0] * np.outer(left.direction, (0.0, 1.0, 0.0))
    point = triangulate([replace(left, cov_rad2=(tilted + tilted.T) / 2), right])
    assert np.allclose(point.p_mm, CENTRE, atol=1e-6)


@pytest.mark.parametrize("method", list(Method))
def test_less_than_two_lines_are_refused(method: Method) -> None:
    for stations in ((), ("left",)):
        with pytest.raises(Degenerate, match=f"needs two lines of sight, here {len(stations)}"):
            triangulate(lines_of(stations), method)


@pytest.mark.parametrize("method", list(Method))
def test_nearly_parallel_lines_are_refused(method: Method) -> None:
    left, _ = lines_of(PAIR)
    with pytest.raises(Degenerate, match="within 1 deg of parallel"):
        triangulate([left, replace(left, station="right", origin_mm=left.origin_mm + np.array((10.0, 0.0, 0.0)))], method)


@pytest.mark.parametrize("method", list(Method))
def test_a_point_behind_a_camera_is_refused_and_the_camera_named(method: Method) -> None:
    left, right = lines_of(PAIR)
    with pytest.raises(Degenerate, match="behind the camera of station right"):
        triangulate([left, replace(right, direction=-right.direction)], method)


@pytest.mark.parametrize("name", ["origin_mm", "direction", "cov_rad2", "fixed_cov_rad2"])
def test_lines_that_are_not_finite_are_refused(name: str) -> None:
    left, right = lines_of(PAIR)
    with pytest.raises(Degenerate, match="not finite"):
        triangulate([left, replace(right, **{name: getattr(right, name) * np.nan})])


def test_a_line_without_covariance_is_refused() -> None:
    left, right = lines_of(PAIR)
    with pytest.raises(Degenerate, match="covariance"):
        triangulate([left, replace(right, cov_rad2=np.zeros((3, 3)))])
