"""The joint adjustment of a simulated cell: right results from no guess, or a refusal in words."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from made_cells import (
    Cell,
    Noise,
    board_data,
    calibration_error_mm,
    cell,
    looks,
    predicted_mm,
    probe_data,
    probe_views,
    shoot,
    turned,
    volume,
)

from trackerd.calibrate.cell import (
    ARCSEC,
    Group,
    Held,
    Observations,
    Options,
    Priors,
    Targets,
    calibrate_cell,
    join,
    known_points,
    measure,
    mover,
    unknown_points,
    with_bars,
)
from trackerd.calibrate.cell.problem import part_of
from trackerd.calibrate.cell.state import exponentials
from trackerd.contract.errors import ConfigError, Undetermined
from trackerd.contract.model import Array
from trackerd.geometry.gimbal import AxisOrder
from trackerd.geometry.rigid import Rigid

ENOUGH = 4.0  # times what the calibration says of itself: one seed's error is one draw


def made_probe(seed: int = 1, count: int = 20) -> tuple[Cell, Observations, Targets]:
    rng = np.random.default_rng(seed)
    made = cell(rng)
    return (made, *probe_data(made, rng, count))


# ---- right results ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(3))
def test_noise_free_data_close_to_a_billionth_of_a_millimetre(seed: int) -> None:
    """Lens and mount are nominal; where the gimbals are is found without a guess."""
    rng = np.random.default_rng(seed)
    made = cell(rng)
    nominal = {s.name: replace(s, world_from_gimbal=made.nominal[s.name].world_from_gimbal) for s in made.true}
    seen, targets = probe_data(made, rng, 20, Noise(none=True))
    result = calibrate_cell(seen, targets, nominal)
    assert calibration_error_mm(made, result) < 1e-9
    assert result.chi2 < 1e-9


@pytest.mark.parametrize("seed", range(3))
def test_a_probe_at_known_points_calibrates_the_cell_without_a_guess(seed: int) -> None:
    made, seen, targets = made_probe(seed, 40)
    result = calibrate_cell(seen, targets, made.nominal)
    assert 0.8 < result.chi2_per_dof < 1.2
    assert predicted_mm(result) < 0.02
    assert calibration_error_mm(made, result) < 2.5 * predicted_mm(result)
    for station in made.true:
        for name in ("fx_px", "cx_px", "cy_px"):
            off = getattr(result.stations[station.name].lens, name) - getattr(station.lens, name)
            assert abs(off) < 5.0 * result.sigmas[f"{station.name}.lens.{name}"]


def test_the_covariance_has_the_names_of_the_calibration_file() -> None:
    made, seen, targets = made_probe(count=12)
    result = calibrate_cell(seen, targets, made.nominal)
    assert {"left.world_from_gimbal.rx_rad", "left.eps_rad", "right.d_mm", "right.rg_from_camera.z_mm", "left.lens.k1"} <= set(
        result.parameters
    )
    assert "left.lens.k2" not in result.parameters
    i, j = (result.parameters.index(f"left.lens.{name}") for name in ("fx_px", "fy_px"))
    assert result.covariance[i, j] == pytest.approx(result.covariance[i, i], rel=1e-9)
    scale = np.sqrt(np.diag(result.covariance))
    assert np.linalg.eigvalsh(result.covariance / np.outer(scale, scale)).min() > -1e-9


def test_pixels_that_are_not_square_are_found_where_they_are_asked_for() -> None:
    rng = np.random.default_rng(3)
    made = cell(rng)
    true = tuple(replace(s, lens=replace(s.lens, fy_px=s.lens.fx_px * 1.002)) for s in made.true)
    made = Cell(true, made.nominal)
    seen, targets = probe_data(made, rng, 20)
    result = calibrate_cell(seen, targets, made.nominal, Options(square_pixels=False))
    for station in true:
        lens = result.stations[station.name].lens
        assert lens.fy_px / lens.fx_px == pytest.approx(1.002, abs=3e-4)


def test_both_faces_are_one_calibration() -> None:
    rng = np.random.default_rng(3)
    made = cell(rng)
    seen, targets = probe_data(made, rng, 20, faces=(False, True))
    result = calibrate_cell(seen, targets, made.nominal)
    one_face = calibrate_cell(*probe_data(made, rng, 20), made.nominal)
    assert calibration_error_mm(made, result) < 2.5 * predicted_mm(result)
    assert result.sigmas["left.rg_from_camera.y_mm"] < 0.3 * one_face.sigmas["left.rg_from_camera.y_mm"]


@pytest.mark.parametrize("seed", range(2))
def test_chessboards_alone_calibrate_the_cell(seed: int) -> None:
    rng = np.random.default_rng(seed)
    made = cell(rng)
    seen, targets, poses = board_data(made, rng, fixed=16, loose=5, each=4)
    result = calibrate_cell(seen, targets, made.nominal)
    assert 0.9 < result.chi2_per_dof < 1.1
    assert calibration_error_mm(made, result) < 2.5 * predicted_mm(result)
    for name, pose in poses.items():
        assert np.allclose(result.bodies[name].world_from_body.translation_mm, pose.translation_mm, atol=2.0)
        assert np.allclose(result.bodies[name].world_from_body.rotation, pose.rotation, atol=0.05)


@pytest.mark.parametrize(
    ("order", "signs", "lever_mm"),
    [
        (AxisOrder.AZ_OUTER, (1, -1), -124.5),
        (AxisOrder.EL_OUTER, (-1, -1), -124.5),
        (AxisOrder.AZ_OUTER, (-1, -1), 0.0),
    ],
)
def test_the_order_of_the_axes_and_the_signs_are_found_from_the_data(
    order: AxisOrder, signs: tuple[int, int], lever_mm: float
) -> None:
    rng = np.random.default_rng(4)
    made = cell(rng, order=order, signs=signs, lever_mm=lever_mm)
    seen, targets = probe_data(made, rng, 8)
    result = calibrate_cell(seen, targets, made.nominal, Options(find_axes=True))
    assert [(s.order, s.az_sign, s.el_sign) for s in result.stations.values()] == [(order, *signs)] * 2
    assert calibration_error_mm(made, result) < ENOUGH * predicted_mm(result)


def test_a_second_coefficient_of_the_distortion_is_freed_where_chi_square_asks() -> None:
    """Five radii: with two, focal length and k1 take its place."""
    rng = np.random.default_rng(5)
    made = cell(rng)
    bent = tuple(replace(s, lens=replace(s.lens, distortion=(-3.0, 60000.0, 0.0, 0.0, 0.0))) for s in made.true)
    made = Cell(bent, made.nominal)
    targets = known_points(volume(rng, 20))
    at_px = np.array([(0.0, 0.0), (300.0, -200.0), (-600.0, 400.0), (850.0, 600.0), (-350.0, -400.0)])
    seen = shoot(made.true, targets, *probe_views(made.true, targets.p_mm, at_px), Noise(px=0.05), rng)
    result = calibrate_cell(seen, targets, made.nominal)
    assert "left.lens.k2" in result.parameters
    assert result.chi2_per_dof < 1.2
    assert calibration_error_mm(made, result) < ENOUGH * predicted_mm(result)
    with pytest.raises(Undetermined, match="chi-square per degree of freedom"):
        calibrate_cell(seen, targets, made.nominal, Options(more_distortion=False))


# ---- outliers --------------------------------------------------------------------------------------------------------


def far_pixels(seen: Observations, bad: Array, rng: np.random.Generator) -> Observations:
    q = seen.q_px.copy()
    q[bad] = rng.uniform(0.0, 1500.0, (len(bad), 2))
    return replace(seen, q_px=q)


def other_points(seen: Observations, bad: Array, rng: np.random.Generator) -> Observations:
    point = seen.point.copy()
    point[bad] = np.roll(point[bad], 1)
    return replace(seen, point=point)


def other_angles(seen: Observations, bad: Array, rng: np.random.Generator) -> Observations:
    angles = seen.angles_rad.copy()
    angles[seen.view[bad]] += rng.normal(0.0, 0.01, (len(bad), 2))
    return replace(seen, angles_rad=angles)


@pytest.mark.parametrize("spoil", [far_pixels, other_points, other_angles])
def test_gross_outliers_of_a_fifth_are_rejected_one_by_one(
    spoil: Callable[[Observations, Array, np.random.Generator], Observations],
) -> None:
    made, seen, targets = made_probe(2, 30)
    rng = np.random.default_rng(9)
    bad = rng.choice(len(seen), len(seen) // 5, replace=False)
    result = calibrate_cell(spoil(seen, bad, rng), targets, made.nominal)
    assert calibration_error_mm(made, result) < 2.5 * predicted_mm(result)
    assert set(np.flatnonzero(~result.residuals.used)) <= set(bad)
    assert len(result.rejected) >= len(bad) - 3
    assert result.rejected[0].sigmas > 4.5
    assert "off what the rest says" in result.rejected[0].reason


def test_a_view_of_a_board_with_wrong_angles_is_rejected_whole() -> None:
    rng = np.random.default_rng(1)
    made = cell(rng)
    seen, targets, _ = board_data(made, rng, fixed=12, loose=3, each=4)
    angles = seen.angles_rad.copy()
    angles[3] += 20.0 * ARCSEC
    result = calibrate_cell(replace(seen, angles_rad=angles), targets, made.nominal)
    assert [(r.view, r.point) for r in result.rejected if r.point is None] == [(seen.views[3], None)]
    assert not result.residuals.used_view[3]
    assert calibration_error_mm(made, result) < 3.0 * predicted_mm(result)


def test_a_fifth_of_all_corners_of_many_boards_may_be_gross_outliers() -> None:
    """More image points than the stages take: they run on thinned data, the rejection on all."""
    rng = np.random.default_rng(1)
    made = cell(rng)
    seen, targets, _ = board_data(made, rng, fixed=15, loose=4, each=4)
    assert len(seen) > 3000
    q = seen.q_px.copy()
    bad = rng.choice(len(seen), len(seen) // 5, replace=False)
    q[bad] += rng.normal(0.0, 30.0, (len(bad), 2))
    result = calibrate_cell(replace(seen, q_px=q), targets, made.nominal)
    assert calibration_error_mm(made, result) < 2.5 * predicted_mm(result)
    assert set(np.flatnonzero(~result.residuals.used)) <= set(bad)


# ---- movers, bars, points with a covariance of their own -------------------------------------------------------------


def robot(rng: np.random.Generator, count: int, sigma_mm: float, world_from_base: Rigid, fixed: bool) -> tuple[Targets, Array]:
    """Poses as a controller reports them, and where the ball really was; its place in the flange is guessed 20 mm off."""
    turns, p_mm = exponentials(rng.normal(0.0, 0.4, (count, 3))), volume(rng, count)
    flange = world_from_base.inverse().move(p_mm) - turns @ np.array((5.0, -3.0, 120.0))
    reported = flange + rng.normal(0.0, sigma_mm, (count, 3))
    base = world_from_base if fixed else None
    targets = mover("robot", turns, reported, (0.0, 0.0, 100.0), sigma_mm=sigma_mm, world_from_base=base, fixed=fixed)
    return targets, p_mm


def test_a_machine_as_mover_has_its_ball_in_the_flange_found() -> None:
    rng = np.random.default_rng(2)
    made = cell(rng)
    targets, p_mm = robot(rng, 20, 0.005, Rigid.identity(), True)
    station_of, angles, shown = probe_views(made.true, p_mm)
    seen = shoot(made.true, known_points(p_mm), station_of, angles, shown, Noise(), rng)
    result = calibrate_cell(seen, targets, made.nominal)
    found = result.bodies["robot"]
    assert found.ball_mm is not None
    assert found.ball_covariance_mm2 is not None
    assert np.allclose(found.ball_mm, (5.0, -3.0, 120.0), atol=0.03)
    assert (np.abs(found.ball_mm - (5.0, -3.0, 120.0)) < 5.0 * np.sqrt(np.diag(found.ball_covariance_mm2))).all()
    assert calibration_error_mm(made, result) < ENOUGH * predicted_mm(result)


def test_a_robot_beside_known_points_has_its_base_found_and_its_points_corrected() -> None:
    rng = np.random.default_rng(4)
    made = cell(rng)
    base = Rigid(turned((0.1, 0.2, -0.3)), np.array((30.0, -20.0, 10.0)))
    targets, p_mm = robot(rng, 25, 0.65, base, False)
    known = known_points(volume(rng, 12))
    truth = join(known, known_points(p_mm, targets.names))
    station_of, angles, shown = probe_views(made.true, truth.p_mm)
    seen = shoot(made.true, truth, station_of, angles, shown, Noise(), rng)
    result = calibrate_cell(seen, join(known, targets), made.nominal)
    found = result.bodies["robot"]
    off = found.world_from_body.translation_mm - base.translation_mm
    assert off @ np.linalg.solve(found.covariance[3:, 3:], off) < 20.0
    errors = result.points_mm[12:] - p_mm
    assert np.linalg.norm(errors, axis=1).max() < 0.15  # the robot was 0.65 mm off in each axis
    nees = np.einsum("mi,mij,mj->m", errors, np.linalg.inv(result.points_cov_mm2[12:]), errors).mean() / 3.0
    assert 0.4 < nees < 2.0
    assert calibration_error_mm(made, result) < ENOUGH * predicted_mm(result)


def test_bars_give_scale_to_points_that_are_unknown() -> None:
    rng = np.random.default_rng(3)
    made = cell(rng)
    count = 12
    ends = volume(rng, count)
    other = ends + 150.0 * exponentials(rng.normal(0.0, 2.0, (count, 3)))[:, :, 2]
    names = [f"u{i}" for i in range(2 * count)]
    bars = with_bars(unknown_points(names), [(f"u{i}", f"u{i + count}") for i in range(count)], 150.0, 0.005)
    known = known_points(volume(rng, 5))
    truth = join(known, known_points(np.concatenate([ends, other]), names))
    station_of, angles, shown = probe_views(made.true, truth.p_mm)
    seen = shoot(made.true, truth, station_of, angles, shown, Noise(), rng)
    result = calibrate_cell(seen, join(known, bars), made.nominal)
    without = calibrate_cell(seen, join(known, unknown_points(names)), made.nominal)
    assert calibration_error_mm(made, result) < ENOUGH * predicted_mm(result)
    assert predicted_mm(result) < 0.9 * predicted_mm(without)


def test_known_points_with_a_covariance_weigh_by_it() -> None:
    rng = np.random.default_rng(6)
    made = cell(rng)
    true = known_points(volume(rng, 20))
    seen, _ = probe_data(made, rng, targets=true)
    rough = known_points(true.p_mm + rng.normal(0.0, 0.2, (20, 3)), true.names, 0.04)
    result = calibrate_cell(seen, rough, made.nominal)
    assert 0.8 < result.chi2_per_dof < 1.2
    off = np.linalg.norm(result.points_mm - true.p_mm, axis=1)
    assert np.sqrt((off**2).mean()) < 0.5 * np.sqrt(((rough.p_mm - true.p_mm) ** 2).sum(axis=1).mean())


# ---- only some parameters --------------------------------------------------------------------------------------------


def test_after_a_swapped_camera_only_its_mount_and_lens_are_found_and_the_covariance_is_true() -> None:
    """NEES over independent runs: what is held counts with its covariance."""
    ratios = []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        made = cell(rng)
        before = calibrate_cell(*probe_data(made, rng, 12), made.nominal)
        left = made.true[0]
        camera = Rigid(turned(rng.normal(0, 0.003, 3)) @ left.rg_from_camera.rotation, left.rg_from_camera.translation_mm + 0.2)
        swapped = Cell(
            (replace(left, rg_from_camera=camera, lens=replace(left.lens, cx_px=1000.0)), made.true[1]), made.nominal
        )
        seen, targets = probe_data(swapped, rng, 8)
        only = part_of(seen, np.flatnonzero(seen.gimbal[seen.view] == 0))
        nominal = {
            **before.stations,
            "left": replace(before.stations["left"], rg_from_camera=made.nominal["left"].rg_from_camera),
        }
        free = {"left": frozenset((Group.HAND_EYE, Group.LENS))}
        options = Options(from_nominal=True, free=free, held=Held(before.parameters, before.covariance))
        result = calibrate_cell(replace(only, gimbals=("left",)), targets, nominal, options)
        p_mm = volume(rng, 20)
        found = measure(looks(swapped, rng, p_mm), 20, result.stations, result.parameters, result.covariance)
        errors = found.p_mm - p_mm
        ratios.append(np.einsum("mi,mij,mj->m", errors, np.linalg.inv(found.total_mm2), errors).mean() / 3.0)
    assert 0.75 < np.mean(ratios) < 1.25


def test_what_is_held_without_a_covariance_does_not_move() -> None:
    made, seen, targets = made_probe()
    true = {s.name: s for s in made.true}
    result = calibrate_cell(seen, targets, true, Options(from_nominal=True, free={"left": frozenset((Group.LENS,))}))
    assert {name.rsplit(".", 1)[0] for name in result.parameters} == {"left.lens"}
    assert result.stations["right"].lens == true["right"].lens
    assert np.array_equal(result.stations["left"].rg_from_camera.translation_mm, true["left"].rg_from_camera.translation_mm)


# ---- refusals --------------------------------------------------------------------------------------------------------


def spoilt(change: str, seen: Observations, targets: Targets) -> tuple[Observations, Targets]:
    rng = np.random.default_rng(8)
    within = np.concatenate([rng.permutation(100), 100 + rng.permutation(100)])
    angles, q = seen.angles_rad, seen.q_px
    still = np.where(np.arange(len(angles))[:, None] >= 0, angles, angles).copy()
    still[:, 0] = still[0, 0]
    changed = {
        "degrees": replace(seen, angles_rad=np.degrees(angles)),
        "radians twice": replace(seen, angles_rad=np.radians(angles)),
        "views shuffled": replace(seen, angles_rad=angles[within]),
        "points shuffled": replace(seen, point=seen.point[within]),
        "an angle constant": replace(seen, angles_rad=still),
        "not a number": replace(seen, q_px=np.where(np.arange(len(q))[:, None] == 7, np.nan, q)),
        "one gimbal": part_of(seen, np.flatnonzero(seen.gimbal[seen.view] == 0)),
        "too few views": part_of(seen, np.flatnonzero(seen.view % 100 < 5)),
        "signs": replace(seen, angles_rad=-angles),
    }
    return changed.get(change, seen), replace(targets, p_mm=targets.p_mm / 25.4) if change == "inches" else targets


@pytest.mark.parametrize(
    ("change", "error", "text"),
    [
        ("degrees", ConfigError, "beyond a turn: angles are radians, not degrees"),
        ("radians twice", Undetermined, "az turns by .* give radians"),
        ("views shuffled", Undetermined, "refused: .*Likely causes: a wrong order of the axes or a wrong sign"),
        ("points shuffled", Undetermined, "refused: .*a wrong square or point list"),
        ("an angle constant", Undetermined, "gimbal left: az turns by 0 rad"),
        ("not a number", ConfigError, "q_px holds a value that is not finite"),
        ("one gimbal", Undetermined, "only gimbal left has views"),
        ("too few views", Undetermined, "gimbal left has 5 views, 6 are the least"),
        ("signs", Undetermined, "refused: "),
        ("inches", Undetermined, "refused: .*off its nominal value"),
    ],
)
def test_data_that_cannot_be_right_are_refused_in_words(change: str, error: type[Exception], text: str) -> None:
    made, seen, targets = made_probe()
    with pytest.raises(error, match=text):
        calibrate_cell(*spoilt(change, seen, targets), made.nominal)


def test_a_wrong_order_of_the_axes_is_loud_and_can_be_forced() -> None:
    made, seen, targets = made_probe(1, 8)
    wrong = {name: replace(s, order=AxisOrder.EL_OUTER) for name, s in made.nominal.items()}
    forced = calibrate_cell(seen, targets, wrong, Options(more_distortion=False, force=True))
    assert forced.forced
    assert "forced: " in forced.warnings[0]


def test_points_in_a_plane_are_right_within_their_covariance_and_warned_of() -> None:
    rng = np.random.default_rng(1)
    made = cell(rng)
    seen, targets = probe_data(made, rng, targets=known_points(volume(rng, 30) * (1.0, 1.0, 0.0)))
    result = calibrate_cell(seen, targets, made.nominal)
    assert "all points lie in a plane" in result.warnings[0]
    assert calibration_error_mm(made, result) < ENOUGH * predicted_mm(result)


def test_unknown_points_alone_have_no_place() -> None:
    made, seen, targets = made_probe()
    with pytest.raises(Undetermined, match="nothing tells where gimbal left, right is"):
        calibrate_cell(seen, unknown_points(targets.names), made.nominal)


def test_without_a_datum_the_normal_matrix_is_singular_and_says_what_is_loose() -> None:
    made, seen, targets = made_probe()
    nominal = {s.name: s for s in made.true}
    with pytest.raises(Undetermined, match=r"do not determine .*hold one station's pose"):
        calibrate_cell(seen, unknown_points(targets.names, targets.p_mm), nominal, Options(from_nominal=True))


def test_an_unknown_point_that_one_gimbal_alone_saw_is_named() -> None:
    made, seen, targets = made_probe()
    lonely = part_of(seen, np.flatnonzero((seen.point != 0) | (seen.gimbal[seen.view] == 0)))
    free = targets.free.copy()
    free[0] = True
    p_mm = targets.p_mm.copy()
    p_mm[0] = np.nan
    with pytest.raises(Undetermined, match="point world:0 is unknown, and only gimbal left saw it"):
        calibrate_cell(lonely, replace(targets, free=free, p_mm=p_mm), made.nominal)


def test_a_gimbal_without_a_nominal_station_is_named() -> None:
    made, seen, targets = made_probe(count=6)
    with pytest.raises(ConfigError, match="gimbal right has views, but no nominal station"):
        calibrate_cell(seen, targets, {"left": made.nominal["left"]})


@pytest.mark.parametrize(
    ("options", "text"),
    [
        (Options(Priors(mount_xy_mm=0.0)), r"priors\.mount_xy_mm = 0\.0: must be above 0"),
        (Options(distortion=6), "distortion = 6: 0 to 5 coefficients"),
        (Options(reject_sigma=0.5), r"reject_sigma = 0\.5: must be above 1"),
        (Options(stand_tilt_rad=-1.0), r"stand_tilt_rad = -1\.0: must be 0 or more"),
        (Options(free={"top": frozenset()}), "free names gimbal top, which has no nominal station"),
        (Options(held=Held(("left.d_mm",), np.eye(2))), r"held has 1 parameters and a covariance \(2, 2\)"),
        (Options(held=Held(("left.d_mm",), np.full((1, 1), np.nan))), "held has a covariance that is not finite"),
    ],
)
def test_options_that_contradict_themselves_are_named(options: Options, text: str) -> None:
    made, seen, targets = made_probe(count=6)
    with pytest.raises(ConfigError, match=text):
        calibrate_cell(seen, targets, made.nominal, options)


def test_a_stand_that_may_tilt_widens_the_covariance() -> None:
    made, seen, targets = made_probe(count=12)
    firm = calibrate_cell(seen, targets, made.nominal)
    loose = calibrate_cell(seen, targets, made.nominal, Options(stand_tilt_rad=1e-5))
    name = "left.world_from_gimbal.ry_rad"
    assert loose.sigmas[name] ** 2 - firm.sigmas[name] ** 2 == pytest.approx(1e-10, rel=1e-3)
    assert predicted_mm(loose) > 1.5 * predicted_mm(firm)


def test_a_lens_far_off_the_nominal_one_is_refused_by_name_or_found_with_a_wider_prior() -> None:
    made, seen, targets = made_probe(1, 40)
    wrong = {n: replace(s, lens=replace(s.lens, fx_px=24000.0, fy_px=24000.0)) for n, s in made.nominal.items()}
    with pytest.raises(Undetermined, match=r"left\.lens\.fx_px would be .* off its nominal value"):
        calibrate_cell(seen, targets, wrong, Options(more_distortion=False))
    result = calibrate_cell(seen, targets, wrong, Options(Priors(f_relative=0.3)))
    assert calibration_error_mm(made, result) < ENOUGH * predicted_mm(result)
