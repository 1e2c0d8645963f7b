"""The Monte-Carlo: the thesis's method and its orders of magnitude, the adjustment against its bound; one seed, one result."""

from dataclasses import fields, replace

import numpy as np
import pytest

from trackerd.budget.adjustment import bound_of, by_adjustment
from trackerd.budget.contributions import CAUSES, CellNoise, contributions, grid
from trackerd.budget.layout_shares import layout_shares
from trackerd.budget.outcome import Outcome, stacked
from trackerd.budget.settings import ARCSEC, BudgetSettings, Case, Volume, load_budget
from trackerd.budget.simulate import TrialKey, readings
from trackerd.budget.source_method import by_source_method, lines_of_sight, nearest_points
from trackerd.budget.source_values import SOURCE
from trackerd.budget.stage import Stage, make_stage
from trackerd.budget.summary import efficiency_of, rows_of
from trackerd.budget.tables import as_csv, as_json, efficiency_table, plain, value_tables
from trackerd.budget.trials import Trial, count_of, run
from trackerd.calibrate.cell.predict import predict
from trackerd.contract.errors import ConfigError
from trackerd.geometry.gimbal import Station

SETTINGS = BudgetSettings()


@pytest.fixture(scope="module")
def stage() -> Stage:
    return make_stage(SETTINGS, "spacing-1000", SETTINGS.points.draw)


def source_trials(stage: Stage, case: str, trials: int) -> Outcome:
    keys = [TrialKey(stage.layout, case, trial) for trial in range(trials)]
    return stacked([by_source_method(stage, readings(stage, SETTINGS.case[case], key, 1))[0] for key in keys])


def only(cases: str, trials: int, layouts: tuple[str, ...] = ("spacing-1000",)) -> BudgetSettings:
    return SETTINGS.model_copy(
        update={
            "case": {name: SETTINGS.case[name] for name in cases},
            "layout": {name: SETTINGS.layout[name] for name in layouts},
            "trials": trials,
        }
    )


def same(a: Trial, b: Trial) -> bool:
    pairs = ((a.source, b.source), (a.adjusted, b.adjusted))
    return all(np.array_equal(getattr(x, f.name), getattr(y, f.name)) for x, y in pairs for f in fields(Outcome))


# ---- the thesis's method ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("case", "EFGH")
def test_its_method_leaves_the_residual_that_the_thesis_prints(stage: Stage, case: str) -> None:
    rms_px = source_trials(stage, case, 60).rms_px.mean()
    assert rms_px == pytest.approx(SOURCE[1000].rms_px[case], rel=0.06)  # 1 sigma of 60 trials is 1.7 %


@pytest.mark.parametrize("case", "BCDEFGH")
@pytest.mark.parametrize("spacing", [1000, 500])
def test_its_method_has_the_errors_that_the_thesis_prints(case: str, spacing: int) -> None:
    stage = make_stage(SETTINGS, f"spacing-{spacing}", SETTINGS.points.draw)
    errors = source_trials(stage, case, 40).target_mm
    d_mm = np.linalg.norm(np.abs(errors).mean(axis=(0, 1)))
    assert d_mm == pytest.approx(SOURCE[spacing].target_d_mm[case], rel=0.45)  # its 30 %, and 40 trials


def test_its_method_has_the_rounding_of_single_precision_without_noise(stage: Stage) -> None:
    closed = source_trials(stage, "A", 1)
    assert closed.rms_px.max() < 1e-4
    assert 1e-5 < np.abs(closed.target_mm).max() < 0.01


def test_encoder_noise_turns_its_gimbals_but_does_not_move_them(stage: Stage) -> None:
    """Eq 3.10 does not hold the encoders at all: R_w_from_g R_g_from_rg is the camera's own rotation."""
    without, coarse = source_trials(stage, "A", 1), source_trials(stage, "D", 5)
    assert np.allclose(coarse.centre_mm, without.centre_mm, atol=1e-6)
    assert np.abs(coarse.turn_rad).mean() > 100.0 * np.abs(without.turn_rad).mean()


# ---- the adjustment and the bound ------------------------------------------------------------------------------------


def test_the_adjustment_closes_without_noise_to_a_nanometre_s_thousandth(stage: Stage) -> None:
    read = readings(stage, Case(), TrialKey("spacing-1000", "A", 0), 1)
    start = by_source_method(stage, read)[1]
    found = by_adjustment(stage, read, Case(), start)
    assert np.abs(found.target_mm).max() < 1e-9
    assert np.abs(found.centre_mm).max() < 1e-7


def test_the_adjustment_is_as_good_as_the_bound_allows_and_far_better_than_the_thesis() -> None:
    settings = only("CH", 25)
    runs = run(settings, workers=1)
    for each in (efficiency_of(settings, one) for one in runs):
        assert each.refused_adjusted == 0
        assert each.ratio is not None
        assert each.ratio == pytest.approx(1.0, abs=0.12)  # 25 trials of 12 targets: 1 sigma is 4 %
    d = {row.case: row for row in rows_of(settings, runs) if row.table == "4.4" and row.value == "d"}
    assert d["H"].adjusted is not None
    assert d["H"].method is not None
    assert d["H"].adjusted < 0.18 < 0.02 * d["H"].method
    assert d["H"].source == 15.118


def test_three_gimbals_of_both_orders_reach_their_bound_too() -> None:
    places = {"left": (-900.0, 100.0, -1200.0), "right": (900.0, -50.0, -1100.0), "above": (0.0, -800.0, -1300.0)}
    overrides = []
    for name, place in places.items():
        overrides += [
            f"layout.three.gimbal.{name}.position_mm={list(place)}",
            f"layout.three.gimbal.{name}.faces_mm=[0.0,0.0,0.0]",
        ]
    overrides.append('layout.three.gimbal.right.order="el_outer"')
    overrides += ["case.both.pixel_3sigma_px=0.3", "case.both.encoder_arcsec=20.0", "trials=20"]
    loaded = load_budget(None, overrides)
    settings = loaded.model_copy(update={"case": {"both": loaded.case["both"]}, "layout": {"three": loaded.layout["three"]}})
    (found,) = run(settings, workers=1)
    assert found.trials[0].adjusted is not None
    assert found.trials[0].adjusted.centre_mm.shape == (3, 3)
    assert efficiency_of(settings, found).ratio == pytest.approx(1.0, abs=0.13)
    assert {row.table for row in rows_of(settings, [found])} == {"reprojection", "pose", "position"}
    assert all(row.source is None for row in rows_of(settings, [found]))


def test_more_looks_leave_less_for_the_calibration(stage: Stage) -> None:
    more = make_stage(load_budget(None, ["adjustment.looks=12"]), "spacing-1000", SETTINGS.points.draw)
    few, many = (bound_of(each, SETTINGS.case["C"]).calibration_mm2.trace(axis1=1, axis2=2).mean() for each in (stage, more))
    assert many == pytest.approx(few * 37.0 / 145.0, rel=0.1)  # the encoders of 12 x 3 + 1 views, or of 12 x 12 + 1


def test_an_error_that_is_a_function_of_the_angle_is_the_same_at_the_same_angle(stage: Stage) -> None:
    case = Case(encoder_fixed_arcsec=10.0)
    errors = [readings(stage, case, TrialKey("spacing-1000", "X", trial), 1)["left"] for trial in range(40)]
    exact = stage.sights["left"]
    looks = np.array([read.looks_rad - exact.looks_rad for read in errors]) / ARCSEC
    targets = np.array([read.targets_rad - exact.targets_rad for read in errors]) / ARCSEC
    assert np.allclose(looks, looks[:, :1], atol=1e-6)
    assert np.allclose(looks[:, 0], targets, atol=1e-6)
    assert not np.allclose(targets[0], targets[1], atol=1.0)
    assert np.sqrt((targets**2).mean()) == pytest.approx(10.0, rel=0.15)


def test_a_case_with_fixed_errors_has_no_ratio_to_the_bound_of_white_ones() -> None:
    loaded = load_budget(None, ["case.A.encoder_fixed_arcsec=10.0", "trials=2"])
    settings = loaded.model_copy(update={"case": {"A": loaded.case["A"]}, "layout": only("A", 2).layout})
    (found,) = run(settings, workers=1)
    each = efficiency_of(settings, found)
    assert each.ratio is None
    assert each.encoder_fixed_arcsec == 10.0
    assert 0.0 < each.rms_mm < 0.2


# ---- one seed, one result --------------------------------------------------------------------------------------------


def test_the_result_is_the_seed_s_and_not_the_workers() -> None:
    settings = only("BH", 12)
    (alone, _), (together, _) = run(settings, workers=1), run(settings, workers=2)
    assert all(same(a, b) for a, b in zip(alone.trials, together.trials, strict=True))
    (other, _) = run(settings.model_copy(update={"seed": 2}), workers=1)
    assert not any(same(a, b) for a, b in zip(alone.trials, other.trials, strict=True))


def test_a_case_has_the_same_noise_whatever_is_run_beside_it() -> None:
    (alone,) = run(only("H", 2), workers=1)
    among = run(only("EH", 3, ("spacing-500", "spacing-1000")), workers=1)
    (again,) = (one for one in among if (one.layout, one.case) == ("spacing-1000", "H"))
    assert all(same(a, b) for a, b in zip(alone.trials, again.trials[:2], strict=True))


def test_progress_counts_up_to_what_was_announced() -> None:
    settings, done = only("AE", 3), []
    run(settings, workers=1, progress=done.append)
    assert sum(done) == count_of(settings)


def test_trials_take_turns_over_the_draws() -> None:
    settings = only("E", 4)
    settings = settings.model_copy(update={"points": settings.points.model_copy(update={"draws": 2})})
    (found,) = run(settings, workers=1)
    (first,), (second,) = run(only("E", 1), workers=1), run(only("E", 2), workers=1)
    assert same(found.trials[0], first.trials[0])
    assert not same(found.trials[1], second.trials[1])
    assert len(found.bounds) == 2


def test_a_layout_that_sees_nothing_ends_before_the_work_begins() -> None:
    blind = only("H", 1).model_copy(update={"camera": SETTINGS.camera.model_copy(update={"focal_px": 20_000.0})})
    with pytest.raises(ConfigError, match="outside the image"):
        run(blind, workers=2)


# ---- the tables ------------------------------------------------------------------------------------------------------


def test_a_refused_trial_is_counted_and_leaves_the_others() -> None:
    settings = only("H", 3)
    (found,) = run(settings, workers=1)
    damaged = replace(found, trials=(Trial(None, None), *found.trials[1:]))
    each = efficiency_of(settings, damaged)
    assert (each.refused_source, each.refused_adjusted, each.trials) == (1, 1, 3)
    assert np.isfinite(each.rms_mm)
    none = replace(found, trials=(Trial(None, None),) * 3)
    assert np.isnan(efficiency_of(settings, none).rms_mm)
    assert '"rms_mm": null' in as_json(settings, (), [efficiency_of(settings, none)], ())
    row = next(row for row in rows_of(settings, [none]) if row.value == "d")
    assert row.method is row.adjusted is None
    assert row.bound is not None


def test_the_tables_say_the_same_in_words_csv_and_json() -> None:
    settings = only("H", 2)
    runs = run(settings, workers=1)
    rows = rows_of(settings, runs)
    text = "\n".join(plain(each) for each in value_tables(rows))
    assert "Table 4.2: spacing-1000" in text
    assert "Table 4.4: spacing-1000" in text
    assert "Table 4.5" not in text
    d = next(row for row in rows if row.table == "4.4" and row.value == "d")
    assert f"{d.adjusted:.4g}" in text
    line = next(line for line in as_csv(rows).splitlines() if line.startswith("4.4,spacing-1000,H,d,mm,15.118,"))
    assert float(line.split(",")[7]) == d.adjusted
    efficiencies = [efficiency_of(settings, one) for one in runs]
    assert f'"adjusted": {d.adjusted}' in as_json(settings, rows, efficiencies, layout_shares(settings))
    assert "rms / bound" in plain(efficiency_table(efficiencies))


def test_what_the_thesis_does_not_tell_is_left_open() -> None:
    settings = only("B", 1, ("spacing-500",))
    rows = rows_of(settings, run(settings, workers=1))
    assert {row.table: row.source for row in rows if row.value in ("d", "rms")} == {"4.5": None, "4.6": None, "4.7": 0.1677}
    text = "\n".join(plain(each) for each in value_tables(rows))
    assert "B     rms    px         -" in text


# ---- the shares of a cell --------------------------------------------------------------------------------------------


def cell() -> dict[str, Station]:
    return dict(make_stage(SETTINGS, "spacing-1000", 2).stations)


def calibrated(stations: dict[str, Station]) -> tuple[tuple[str, ...], np.ndarray]:
    names = tuple(f"{name}.world_from_gimbal.{axis}" for name in stations for axis in ("x_mm", "y_mm", "z_mm", "rx_rad"))
    return names, np.diag([0.01**2, 0.02**2, 0.03**2, (3 * ARCSEC) ** 2] * len(stations))


def test_the_shares_add_up_to_what_is_predicted() -> None:
    stations, noise = cell(), CellNoise(0.1, 5 * ARCSEC, 3 * ARCSEC)
    names, cov = calibrated(stations)
    places = grid(Volume(steps=2))
    found = contributions(stations, names, cov, places, noise)
    expected = predict(stations, names, cov, places, sigma_px=0.1, encoder_sigma_rad=5 * ARCSEC, encoder_fixed_rad=3 * ARCSEC)
    assert np.allclose(found.total_mm2, expected.total_mm2, rtol=1e-9)
    assert [part.name for part in found.parts] == [*CAUSES, "all together"]
    assert sum(part.share for part in found.parts[:-1]) == pytest.approx(1.0)
    assert sum(part.rms_mm**2 for part in found.parts[:-1]) == pytest.approx(found.parts[-1].rms_mm ** 2)


def test_the_shares_of_a_layout_are_those_of_its_bound() -> None:
    shares = {(each.case, each.part): each for each in layout_shares(only("ACH", 1))}
    assert set(shares) == {
        ("C", "encoders, white"), ("C", "calibration"), ("C", "all together"),
        ("H", "pixels"), ("H", "calibration"), ("H", "all together"),
    }  # fmt: skip
    stage = make_stage(SETTINGS, "spacing-1000", SETTINGS.points.draw)
    for case in "CH":
        whole = np.sqrt(bound_of(stage, SETTINGS.case[case]).target_mm2.trace(axis1=1, axis2=2).mean())
        assert shares[case, "all together"].rms_mm == pytest.approx(whole, rel=0.1)  # the box, and the points in it


def test_each_share_grows_with_its_own_cause_alone() -> None:
    stations, places = cell(), grid(Volume(steps=2))
    names, cov = calibrated(stations)
    base = contributions(stations, names, cov, places, CellNoise(0.1, 5 * ARCSEC, 3 * ARCSEC))
    worse = contributions(stations, names, 4.0 * cov, places, CellNoise(0.1, 5 * ARCSEC, 3 * ARCSEC))
    for n, factor in enumerate((1.0, 1.0, 1.0, 4.0)):
        assert np.allclose(worse.cov_mm2[n], factor * base.cov_mm2[n])


def test_the_uncertainty_in_depth_is_the_larger_one_and_both_are_k_2() -> None:
    stations = cell()
    found = contributions(stations, (), np.zeros((0, 0)), np.zeros((1, 3)), CellNoise(0.1, 5 * ARCSEC))
    whole = found.parts[-1]
    sigmas = 2.0 * np.sqrt(np.linalg.eigvalsh(found.total_mm2[0]))
    assert whole.u_depth_mm == pytest.approx(sigmas[2], rel=0.01)
    assert whole.u_across_mm == pytest.approx(sigmas[1], rel=0.03)  # the ellipsoid is tilted by a degree or two
    assert found.parts[3].rms_mm == 0.0


def test_the_shares_are_what_sampling_finds() -> None:
    """Single looks with the noise of one cause, by unweighted lines: the ranges are alike, so that weights do not matter."""
    stage = make_stage(SETTINGS, "spacing-1000", 2)
    noise = CellNoise(0.5 / 3.0, 36.0 * ARCSEC)
    found = contributions(stage.stations, (), np.zeros((0, 0)), stage.points_mm, noise)
    for cause, case in ((0, SETTINGS.case["H"]), (1, SETTINGS.case["C"])):
        errors = np.array([single_looks(stage, case, trial) for trial in range(150)])
        sampled = np.sqrt((errors**2).mean(axis=(0, 1)))
        stated = np.sqrt(found.cov_mm2[cause].diagonal(axis1=1, axis2=2).mean(axis=0))
        assert np.allclose(sampled, stated, rtol=0.08)


def single_looks(stage: Stage, case: Case, trial: int) -> np.ndarray:
    """Errors of all targets with the true calibration."""
    read = readings(stage, case, TrialKey(stage.layout, "looks", trial), 1)
    return nearest_points(*lines_of_sight(dict(stage.stations), read)) - stage.points_mm
