"""Datum transfer: best fit and 3-2-1, their covariance against Monte-Carlo, and what speaks against a set of points."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from trackerd.calibrate.align import Alignment, ThreeTwoOne, best_fit, in_common, three_two_one
from trackerd.contract.errors import ConfigError, TrackerdError, Undetermined
from trackerd.contract.model import Array
from trackerd.formats.points import Points
from trackerd.geometry.rigid import Rigid, quaternion_from_matrix

NAMES = ("A", "B", "C", "D", "E", "F")
NOMINAL_MM = np.array(((0, 0, 0), (400, 0, 0), (0, 300, 0), (400, 300, 20), (100, 50, 250), (350, 200, 200)), float)
WORLD_FROM_CELL = Rigid.from_quaternion(np.array((0.7, 0.1, -0.6, 0.3)), np.array((1500.0, -200.0, 900.0)))
ROLES = ThreeTwoOne(("A", "B", "C"), ("A", "B"), "A")
TRIALS = 250

Aligner = Callable[[Points, Points], Alignment]


def by_321(measured: Points, nominal: Points) -> Alignment:
    return three_two_one(measured, nominal, ROLES)


ALIGNERS = pytest.mark.parametrize("align", [best_fit, by_321])


def nominal(cov_mm2: Array | None = None) -> Points:
    return Points(NAMES, NOMINAL_MM, cov_mm2)


def measured(errors_mm: Array | float = 0.0, cov_mm2: Array | None = None) -> Points:
    """In the cell's frame; the errors are the measurement's."""
    return Points(NAMES, WORLD_FROM_CELL.inverse().move(NOMINAL_MM) + errors_mm, cov_mm2)


def covariances(rng: np.random.Generator, sigma_mm: float) -> Array:
    """As lines of sight make them: long in one direction."""
    roots = rng.normal(size=(6, 3, 3)) * np.array((1.0, 1.0, 3.0)) * sigma_mm / 2.0
    return np.asarray(roots @ roots.transpose(0, 2, 1) + np.eye(3) * (sigma_mm / 5.0) ** 2)


def drawn(rng: np.random.Generator, cov_mm2: Array) -> Array:
    return np.array([rng.multivariate_normal(np.zeros(3), c) for c in cov_mm2])


def deviation(found: Rigid, true: Rigid) -> Array:
    """(rx, ry, rz, x, y, z) with R_found = exp([r]x) R_true."""
    q = quaternion_from_matrix(found.rotation @ true.rotation.T)
    return np.concatenate((2.0 * q[1:], found.translation_mm - true.translation_mm))


def with_point(points: Points, name: str, shift_mm: tuple[float, float, float]) -> Points:
    p_mm = points.p_mm.copy()
    p_mm[points.ids.index(name)] += shift_mm
    return replace(points, p_mm=p_mm)


# ---- what it finds ---------------------------------------------------------------------------------------------------


@ALIGNERS
@settings(max_examples=50, deadline=None)
@given(
    q=st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda q: float(np.linalg.norm(q)) > 0.1),
    t_mm=st.tuples(*[st.floats(-1e4, 1e4)] * 3),
)
def test_without_noise_the_datum_comes_back_whatever_it_is(
    align: Aligner, q: tuple[float, ...], t_mm: tuple[float, ...]
) -> None:
    true = Rigid.from_quaternion(np.array(q), np.array(t_mm))
    found = align(Points(NAMES, true.inverse().move(NOMINAL_MM)), nominal())
    assert np.allclose(found.world_from_cell.rotation, true.rotation, rtol=0, atol=1e-12)
    assert found.max_mm < 1e-8
    assert found.suspect is None
    assert found.scale == pytest.approx(1.0, abs=1e-11)


@ALIGNERS
@pytest.mark.parametrize("both", [False, True])
def test_the_covariance_is_that_of_many_trials(align: Aligner, both: bool) -> None:
    """Within the two-sided 99 % interval of chi-square, the rotation, the translation and all six together."""
    rng = np.random.default_rng(5)
    cov = covariances(rng, 0.1)
    nominal_cov = covariances(rng, 0.05) if both else None
    deviations, chi2s, sizes = [], [], []
    for _ in range(TRIALS):
        points = measured(drawn(rng, cov), cov)
        reference = nominal(nominal_cov)
        if nominal_cov is not None:
            reference = replace(reference, p_mm=NOMINAL_MM + drawn(rng, nominal_cov))
        found = align(points, reference)
        deviations.append(deviation(found.world_from_cell, WORLD_FROM_CELL))
        sizes.append((found.scale - 1.0) / found.scale_sigma)
        chi2s.append(found.chi2)
    off = np.array(deviations)
    for part in (slice(0, 3), slice(3, 6), slice(0, 6)):
        d = off[:, part]
        nees = float(np.einsum("ni,ij,nj->", d, np.linalg.inv(found.cov[part, part]), d))
        low, high = stats.chi2.interval(0.99, TRIALS * d.shape[1])
        assert low < nees < high
    low, high = stats.chi2.interval(0.99, TRIALS * found.dof)
    assert low < sum(chi2s) < high
    low, high = stats.chi2.interval(0.99, TRIALS)
    assert low < float((np.array(sizes) ** 2).sum()) < high


@ALIGNERS
def test_without_sigmas_the_scatter_tells_them(align: Aligner) -> None:
    rng = np.random.default_rng(6)
    variances = []
    for _ in range(TRIALS):
        found = align(measured(rng.normal(0.0, 0.08, (6, 3))), nominal())
        assert found.chi2 is None
        assert found.sigma_mm is not None
        variances.append(found.sigma_mm**2 / 0.08**2)
    low, high = stats.chi2.interval(0.99, TRIALS * found.dof)
    assert low < sum(variances) * found.dof < high


def test_a_point_counts_by_its_covariance() -> None:
    cov = np.broadcast_to(np.eye(3) * 0.01**2, (6, 3, 3)).copy()
    cov[2] = np.eye(3) * 10.0**2
    found = best_fit(with_point(measured(cov_mm2=cov), "C", (5.0, 0.0, 0.0)), nominal())
    assert np.abs(deviation(found.world_from_cell, WORLD_FROM_CELL)).max() < 1e-4
    assert found.errors_mm[2] == pytest.approx(WORLD_FROM_CELL.rotate(np.array((5.0, 0.0, 0.0))), abs=1e-3)


def test_3_2_1_puts_six_coordinates_right_and_leaves_the_rest_to_be_seen() -> None:
    rng = np.random.default_rng(7)
    errors = by_321(measured(rng.normal(0.0, 0.1, (6, 3))), nominal()).errors_mm
    assert np.abs(errors[:3, 2]).max() < 1e-9  # A, B, C in the plane z = 0
    assert np.abs(errors[:2, 1]).max() < 1e-9  # A and B on the line
    assert abs(errors[0, 0]) < 1e-9
    assert np.abs(errors[3:]).min() > 1e-4


def test_errors_are_measured_minus_nominal_in_the_world() -> None:
    points = with_point(nominal(), "F", (0.0, 0.0, 0.6))
    found = by_321(replace(points, p_mm=WORLD_FROM_CELL.inverse().move(points.p_mm)), nominal())
    assert found.errors_mm[5] == pytest.approx((0.0, 0.0, 0.6), abs=1e-9)
    assert (found.max_mm, found.rms_mm) == (pytest.approx(0.6), pytest.approx(0.6 / np.sqrt(6.0)))


@ALIGNERS
def test_a_scale_is_told_and_never_applied(align: Aligner) -> None:
    found = align(replace(measured(), p_mm=measured().p_mm / 1.0005), nominal())
    assert found.scale == pytest.approx(1.0005, abs=1e-9)
    assert np.allclose(found.world_from_cell.rotation @ found.world_from_cell.rotation.T, np.eye(3), rtol=0, atol=1e-14)
    assert found.max_mm > 0.05


# ---- what speaks against it ------------------------------------------------------------------------------------------


@ALIGNERS
@pytest.mark.parametrize("known", [False, True])
def test_a_gross_outlier_is_named(align: Aligner, known: bool) -> None:
    rng = np.random.default_rng(8)
    cov = np.broadcast_to(np.eye(3) * 0.05**2, (6, 3, 3))
    points = with_point(measured(drawn(rng, cov), cov if known else None), "E", (3.0, -4.0, 0.0))
    found = align(points, nominal())
    assert found.suspect is not None
    assert found.suspect.id == "E"


@pytest.mark.parametrize("known", [False, True])
def test_honest_noise_is_hardly_ever_suspected(known: bool) -> None:
    rng = np.random.default_rng(9)
    cov = np.broadcast_to(np.eye(3) * 0.05**2, (6, 3, 3))
    trials = [best_fit(measured(drawn(rng, cov), cov if known else None), nominal()) for _ in range(400)]
    assert sum(found.suspect is not None for found in trials) <= 3  # 0.4 are expected


def test_exchanged_names_are_refused() -> None:
    cov = np.broadcast_to(np.eye(3) * 0.05**2, (6, 3, 3))
    with pytest.raises(Undetermined, match=r"a rotation is only determined to 2\d deg \(1 sigma\): .* or scatter too much"):
        best_fit(replace(measured(cov_mm2=cov), p_mm=measured().p_mm[[1, 0, 2, 3, 4, 5]]), nominal())


def test_a_covariance_is_no_smaller_than_the_errors_say() -> None:
    cov = np.broadcast_to(np.eye(3) * 0.05**2, (6, 3, 3))
    errors = np.random.default_rng(13).normal(0.0, 0.05, (6, 3))
    honest, worse = (best_fit(measured(errors * factor, cov), nominal()) for factor in (1.0, 10.0))
    assert (honest.beyond_chance, worse.beyond_chance) == (False, True)
    assert worse.chi2 is not None
    assert np.allclose(worse.cov, honest.cov * worse.chi2 / worse.dof, rtol=0.05, atol=1e-7)
    assert worse.suspect is None  # all are off alike


@pytest.mark.parametrize(("factor", "words"), [(25.4, "inches are taken for mm"), (1e-3, "metres"), (1.3, "other points")])
def test_other_units_are_refused_with_the_likely_cause(factor: float, words: str) -> None:
    with pytest.raises(ConfigError, match=rf"times as far apart as the measured ones: .*{words}"):
        best_fit(measured(), replace(nominal(), p_mm=NOMINAL_MM * factor))


@ALIGNERS
def test_a_mirror_image_is_refused(align: Aligner) -> None:
    mirrored = measured(np.random.default_rng(10).normal(0.0, 0.05, (6, 3)))
    with pytest.raises(ConfigError, match=r"mirror image .* an axis has the wrong sign, or two are exchanged"):
        align(replace(mirrored, p_mm=mirrored.p_mm * (1.0, 1.0, -1.0)), nominal())


@pytest.mark.parametrize("noise_mm", [0.0, 0.05])
def test_points_in_a_plane_are_no_mirror_image(noise_mm: float) -> None:
    rng, flat = np.random.default_rng(11), replace(nominal(), p_mm=NOMINAL_MM * (1.0, 1.0, 0.0))
    for _ in range(50):
        points = WORLD_FROM_CELL.inverse().move(flat.p_mm) + rng.normal(0.0, 1.0, (6, 3)) * noise_mm
        assert best_fit(Points(NAMES, points), flat).max_mm < 10.0 * noise_mm + 1e-8


def test_points_in_one_line_are_refused_by_name() -> None:
    line = Points(("A", "B", "C"), np.outer((0.0, 100.0, 250.0), (1.0, 1.0, 0.2)))
    with pytest.raises(Undetermined, match=r"the measured points A, B, C lie in one line .* add a point off the line"):
        best_fit(line, line)


def test_points_nearly_in_one_line_are_refused_for_what_their_noise_allows() -> None:
    p_mm = np.array(((0.0, 0.0, 0.0), (500.0, 0.0, 0.0), (250.0, 2.0, 0.0)))
    cov = np.broadcast_to(np.eye(3) * 0.1**2, (3, 3, 3))
    with pytest.raises(
        Undetermined, match=r"a rotation is only determined to 3.* deg \(1 sigma\): the points lie nearly in one line"
    ):
        best_fit(Points(("A", "B", "C"), p_mm, cov), Points(("A", "B", "C"), p_mm))


def test_points_that_are_all_one_are_refused() -> None:
    one = Points(("A", "B", "C"), np.ones((3, 3)))
    with pytest.raises(Undetermined, match="lie in one line"):
        best_fit(one, one)


def test_two_points_are_refused() -> None:
    with pytest.raises(Undetermined, match="a datum needs 3 points, there are 2"):
        best_fit(measured().only(("A", "B")), nominal().only(("A", "B")))


def test_three_points_are_enough_and_name_no_suspect() -> None:
    found = best_fit(measured(np.random.default_rng(12).normal(0.0, 0.05, (6, 3))).only("ABC"), nominal().only("ABC"))
    assert (found.dof, found.suspect) == (3, None)


coordinates = st.sampled_from((0.0, 1.0, -1.0, 100.0)) | st.floats(-1e9, 1e9) | st.floats(-500.0, 500.0)
clouds = st.lists(st.tuples(*[coordinates] * 3), min_size=0, max_size=6)


@ALIGNERS
@settings(max_examples=120, deadline=None)
@given(cloud=clouds, other=st.none() | clouds, sigma_mm=st.none() | st.floats(1e-6, 1e3))
def test_any_points_are_aligned_with_a_finite_result_or_refused_in_words(
    align: Aligner, cloud: list[Any], other: list[Any] | None, sigma_mm: float | None
) -> None:
    p_mm = np.array(cloud).reshape(-1, 3)
    names = NAMES[: len(p_mm)]
    cov = None if sigma_mm is None else np.broadcast_to(np.eye(3) * sigma_mm**2, (len(p_mm), 3, 3))
    to_mm = WORLD_FROM_CELL.move(p_mm) if other is None or len(other) != len(cloud) else np.array(other).reshape(-1, 3)
    try:
        found = align(Points(names, p_mm, cov), Points(names, to_mm))
    except TrackerdError as refusal:
        assert len(str(refusal)) > 10  # noqa: PT017
        return
    assert np.isfinite(found.cov).all()
    assert np.linalg.eigvalsh(found.cov).min() >= -1e-9 * np.linalg.eigvalsh(found.cov).max()
    assert np.isfinite([found.rms_mm, found.max_mm, found.scale, found.scale_sigma]).all()
    assert np.allclose(found.world_from_cell.rotation @ found.world_from_cell.rotation.T, np.eye(3), rtol=0, atol=1e-12)
    assert np.linalg.det(found.world_from_cell.rotation) > 0.0


def test_points_are_matched_by_name_and_lone_ones_are_told() -> None:
    some, others, notes = in_common(measured().only("FABCE"), nominal().only("ABCDF"))
    assert some.ids == others.ids == ("F", "A", "B", "C")
    assert notes == ("measured, but not nominal: E", "nominal, but not measured: D")
    assert best_fit(some, others).max_mm < 1e-9


def test_too_few_names_in_common_are_told_with_the_names() -> None:
    with pytest.raises(Undetermined, match="needs 3 points in common, there are 2; measured, but not nominal: X, Y"):
        in_common(Points(("A", "B", "X", "Y"), np.zeros((4, 3))), nominal())
    with pytest.raises(Undetermined, match="not the same ones in the same order"):
        best_fit(measured().only("ABC"), nominal().only("ACB"))


@pytest.mark.parametrize(
    ("roles", "words"),
    [
        (ThreeTwoOne(("A", "B", "X"), ("A", "B"), "A"), "there is no point X in both files"),
        (ThreeTwoOne(("A", "B", "B"), ("A", "B"), "A"), "the plane needs three different points"),
        (ThreeTwoOne(("A", "B", "G"), ("A", "C"), "A"), "A, B, G lie in one line, and make no plane"),
        (ThreeTwoOne(("A", "B", "C"), ("A", "H"), "A"), "A, H lie across the plane, and give no direction in it"),
    ],
)
def test_roles_that_make_no_datum_are_refused(roles: ThreeTwoOne, words: str) -> None:
    more = np.vstack((NOMINAL_MM, ((200.0, 0.0, 0.0), (0.0, 0.0, 90.0))))
    names = (*NAMES, "G", "H")
    with pytest.raises(TrackerdError, match=words):
        three_two_one(Points(names, WORLD_FROM_CELL.inverse().move(more)), Points(names, more), roles)
