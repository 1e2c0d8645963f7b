"""A lens from its pictures: right, with true sigmas, gross errors named; what the pictures do not tell is said or refused."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.stats import chi2
from unit.made_views import BOARD, NARROW, WIDE, intrinsics, moved, views

from trackerd.calibrate.board_kinds import Chessboard, Detected, DotArray, Missed
from trackerd.calibrate.boards import detect
from trackerd.calibrate.lens import LensOptions, calibrate_lens
from trackerd.calibrate.lens_model import Estimate, Views, jacobian, residuals
from trackerd.calibrate.lens_result import LensResult
from trackerd.contract.errors import ConfigError, Undetermined
from trackerd.geometry.lens import Lens

PHOTOGRAPHS = Path(__file__).parents[1] / "data" / "opencv-chessboard"
OPENCVS_F_PX = 535.9
TRIALS = 200


def matching(result: LensResult, words: str) -> list[str]:
    return [text for text in result.warnings if words in text]


# ---- the figures -----------------------------------------------------------------------------------------------------


def test_real_photographs_are_all_used_and_agree_better_than_with_opencvs_own_file() -> None:
    board = Chessboard((9, 6), 25.0)
    files = sorted(PHOTOGRAPHS.glob("*.jpg"))
    found = [(file.name, detect(board, cv2.imread(str(file), cv2.IMREAD_GRAYSCALE))) for file in files]
    result = calibrate_lens(found, board, (640, 480))
    assert (len(result.pictures), result.left_out) == (13, ())
    assert result.rms_px <= 0.24
    assert result.lens.fx_px == pytest.approx(OPENCVS_F_PX, rel=0.01)
    assert result.lens.fy_px == pytest.approx(result.lens.fx_px, abs=3 * result.sigmas["fx_px"])
    assert result.inflation > 1.5  # a board of paper
    assert matching(result, "less with each other")


def test_without_noise_the_lens_comes_back() -> None:
    result = calibrate_lens(views(sigma_px=0.0), BOARD, WIDE.sensor_px)
    np.testing.assert_allclose(result.estimate.intrinsics[:4], intrinsics(WIDE)[:4], rtol=1e-7)
    np.testing.assert_allclose(result.lens.distortion, WIDE.distortion, atol=1e-6)


def test_the_stated_covariance_is_the_scatter_of_many_calibrations() -> None:
    """NEES of eight intrinsics over 200 calibrations with 6 pictures of 30 corners each."""
    nees, widened = [], 0
    for seed in range(TRIALS):
        result = calibrate_lens(views(count=6, seed=seed), BOARD, WIDE.sensor_px, LensOptions(coefficients=4))
        error = (result.estimate.intrinsics - intrinsics(WIDE))[:8]
        nees.append(error @ np.linalg.solve(result.covariance[:8, :8], error))
        widened += result.inflation > 1.0
    low, high = chi2.ppf((0.005, 0.995), 8 * TRIALS) / TRIALS / 8
    estimated = result.freedom / (result.freedom - 2)  # sigma is estimated, too: the mean of an F distribution
    assert low < np.mean(nees) / 8 / estimated < high
    assert widened <= 2


def test_the_slopes_are_those_of_the_residuals() -> None:
    rng = np.random.default_rng(1)
    rotations = np.array([cv2.Rodrigues(rng.uniform(-0.5, 0.5, 3))[0] for _ in range(3)])
    where = Estimate(intrinsics(WIDE), rotations, rng.uniform(-20, 20, (3, 3)) + np.array((-60, -50, 400)))
    points = Views(
        np.tile(BOARD.points_mm, (3, 1)) + rng.normal(0, 9, (90, 3)), np.zeros((90, 2)), np.repeat(np.arange(3), 30), 3
    )
    by_intrinsics, by_pose = jacobian(points, where)
    for column in range(9):
        step = np.eye(9)[column] * (1e-4 if column < 4 else 1e-6)
        both = [residuals(points, where.moved(sign * step, np.zeros((3, 6)))) for sign in (1, -1)]
        np.testing.assert_allclose(by_intrinsics[:, :, column], (both[1] - both[0]) / (2 * step[column]), rtol=1e-5, atol=1e-5)
    for column in range(6):
        step = np.eye(6)[column] * (1e-6 if column < 3 else 1e-4)
        both = [residuals(points, where.moved(np.zeros(9), np.tile(sign * step, (3, 1)))) for sign in (1, -1)]
        np.testing.assert_allclose(by_pose[:, :, column], (both[1] - both[0]) / (2 * step[column]), rtol=1e-5, atol=1e-4)


def test_the_peer_finds_the_same_minimum() -> None:
    found = views(seed=4)
    points = [BOARD.points_mm.astype(np.float32)] * len(found)
    pixels = [one.q_px.astype(np.float32) for _, one in found]
    until = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 500, 1e-12)
    rms, matrix, distortion, _, _ = cv2.calibrateCamera(
        points, pixels, WIDE.sensor_px, None, None, flags=cv2.CALIB_FIX_K3, criteria=until
    )
    ours = calibrate_lens(found, BOARD, WIDE.sensor_px, LensOptions(coefficients=4))
    assert ours.rms_px <= rms * (1 + 1e-6)
    np.testing.assert_allclose(ours.estimate.intrinsics[:4], matrix[[0, 1, 0, 1], [0, 1, 2, 2]], atol=0.02)
    np.testing.assert_allclose(ours.lens.distortion, np.ravel(distortion), atol=0.001)


def test_as_many_coefficients_as_the_lens_has_are_chosen() -> None:
    none, one = (Lens((640, 480), 540.0, 540.0, 322.0, 236.0, (k1, 0, 0, 0, 0)) for k1 in (0.0, -0.2))
    for lens, coefficients in ((none, 0), (one, 1), (WIDE, 4)):
        assert calibrate_lens(views(lens, sigma_px=0.03), BOARD, lens.sensor_px).coefficients == coefficients


def test_what_is_held_has_no_variance_and_stays() -> None:
    result = calibrate_lens(views(), BOARD, WIDE.sensor_px, LensOptions(fix_aspect=True, fix_centre=True, coefficients=2))
    assert result.lens.fx_px == result.lens.fy_px
    assert (result.lens.cx_px, result.lens.cy_px) == (319.5, 239.5)
    assert result.lens.distortion[2:] == (0.0, 0.0, 0.0)
    assert result.covariance[0, 0] == result.covariance[0, 1] == result.covariance[1, 1] > 0.0
    assert not result.covariance[[2, 3, 6, 7, 8]].any()


def test_points_that_fill_space_need_no_second_kind_of_start() -> None:
    rng = np.random.default_rng(2)
    array = DotArray(rng.uniform(-70.0, 70.0, (30, 3)))
    result = calibrate_lens(views(board=array, count=8), array, WIDE.sensor_px)
    assert result.lens.fx_px == pytest.approx(540.0, abs=4 * result.sigmas["fx_px"])
    assert result.sigmas["fx_px"] < 1.0


# ---- gross errors ----------------------------------------------------------------------------------------------------


def test_gross_errors_of_corners_are_named_and_left_out() -> None:
    found = views(seed=5)
    found[2] = (found[2][0], moved(found[2][1], [7], (3.0, 2.0)))
    found[9] = (found[9][0], moved(found[9][1], [0, 19], (-40.0, 25.0)))
    result = calibrate_lens(found, BOARD, WIDE.sensor_px)
    assert {one.name: one.rejected for one in result.pictures if one.rejected} == {"02.png": (7,), "09.png": (0, 19)}
    assert result.rms_px < 0.16
    assert result.lens.fx_px == pytest.approx(540.0, abs=4 * result.sigmas["fx_px"])


def test_pictures_that_contradict_the_others_are_left_out_whole() -> None:
    found = views(count=14, seed=6)
    shuffled, order = found[3][1], np.random.default_rng(0).permutation(30)
    found[3] = ("shuffled.png", Detected(shuffled.index, shuffled.q_px[order], shuffled.sigma_px))
    counted = np.roll(found[8][1].q_px, 8, axis=0)
    found[8] = ("miscounted.png", Detected(shuffled.index, counted, shuffled.sigma_px))
    found[11] = ("other.png", Missed("no chessboard"))
    result = calibrate_lens(found, BOARD, WIDE.sensor_px)
    reasons = {one.name: one.reason for one in result.left_out}
    assert set(reasons) == {"shuffled.png", "miscounted.png", "other.png"}
    assert "contradicts the other pictures: half of its points are off by more than" in reasons["shuffled.png"]
    assert reasons["other.png"] == "no chessboard"
    assert result.lens.fx_px == pytest.approx(540.0, abs=4 * result.sigmas["fx_px"])


def test_a_board_that_is_not_flat_widens_the_sigmas() -> None:
    bent = Chessboard((6, 5), 30.0)
    x, y = (BOARD.points_mm - BOARD.points_mm.mean(0))[:, :2].T
    curved = DotArray(np.column_stack((bent.points_mm[:, :2], 1e-4 * (x**2 - y**2))))
    result = calibrate_lens(views(board=curved, count=16, sigma_px=0.02), BOARD, WIDE.sensor_px, LensOptions(coefficients=4))
    assert result.inflation > 1.5
    assert matching(result, "all sigmas are widened")


# ---- what the pictures do not tell -----------------------------------------------------------------------------------


def test_a_field_of_four_degrees_does_not_tell_the_principal_point_and_that_is_said() -> None:
    """As the source thesis's Table 4.8, whose principal points are off the sensor."""
    board = Chessboard((9, 6), 9.0)
    warned, off = 0, 0
    for seed in range(3):
        found = views(NARROW, board, 12, 1.0, seed, (1900.0, 2100.0), 0.3)
        result = calibrate_lens(found, board, NARROW.sensor_px)
        error = abs(result.lens.cy_px - NARROW.cy_px)
        assert error < 4 * result.sigmas["cy_px"]
        assert matching(result, "cx is not observable: its sigma is")
        assert matching(result, "--fix-centre")
        warned += bool(matching(result, "the principal point leaves the sensor: c"))
        off += not (0 <= result.lens.cy_px <= 1535 and 0 <= result.lens.cx_px <= 2047)
    assert warned == off > 0


def test_with_the_centre_held_a_narrow_field_tells_the_focal_length_with_its_sigma() -> None:
    board = Chessboard((9, 6), 9.0)
    found = views(NARROW, board, 20, 0.1, 1, (1900.0, 2100.0), 0.6)
    result = calibrate_lens(found, board, NARROW.sensor_px, LensOptions(fix_aspect=True, fix_centre=True, coefficients=0))
    assert not matching(result, "principal point")
    assert result.lens.fx_px == pytest.approx(31000.0, abs=4 * result.sigmas["fx_px"])


def test_pixels_that_are_not_square_are_doubted() -> None:
    stretched = Lens((640, 480), 540.0, 586.0, 322.0, 236.0)
    result = calibrate_lens(views(stretched), BOARD, stretched.sensor_px)
    assert matching(result, "fy / fx = 1.08")
    assert not matching(calibrate_lens(views(), BOARD, WIDE.sensor_px), "fy / fx")


def test_good_pictures_give_no_warning() -> None:
    assert calibrate_lens(views(count=20, ranges_mm=(200.0, 330.0), share=0.8), BOARD, WIDE.sensor_px).warnings == ()


def test_few_pictures_in_the_middle_of_the_sensor_are_warned_of() -> None:
    result = calibrate_lens(views(count=5, ranges_mm=(420.0, 450.0), share=0.05), BOARD, WIDE.sensor_px)
    assert matching(result, "only 5 pictures are used: 10 to 20")
    assert matching(result, "show the board in every part of the picture")
    assert matching(result, "of the way to the corner")


def test_parallel_boards_are_refused() -> None:
    with pytest.raises(Undetermined, match=r"do not tell the focal length.*turn and tilt the board"):
        calibrate_lens(views(tilt=0.002, ranges_mm=(300.0, 302.0)), BOARD, WIDE.sensor_px)


def test_boards_that_are_hardly_tilted_are_warned_of() -> None:
    result = calibrate_lens(views(tilt=0.05, count=20), BOARD, WIDE.sensor_px)
    assert matching(result, "all boards are nearly parallel, within")


def test_too_few_pictures_are_refused_with_the_reasons_of_those_that_are_left_out() -> None:
    found = [*views(count=2), ("dark.png", Missed("no chessboard of 6 x 5 inner corners"))]
    with pytest.raises(Undetermined, match=r"2 pictures with the board, 3 are the least.*\n  dark.png: no chessboard of 6 x 5"):
        calibrate_lens(found, BOARD, WIDE.sensor_px)


def test_points_that_cannot_be_are_left_out_by_their_picture() -> None:
    found = views(count=12)
    one = found[0][1]
    lost = one.q_px.copy()
    lost[4, 1] = np.nan
    found[0] = ("nan.png", Detected(one.index, lost, one.sigma_px))
    found[1] = ("few.png", Detected(one.index[:5], one.q_px[:5], one.sigma_px[:5]))
    found[2] = ("beyond.png", Detected(one.index + 1, one.q_px, one.sigma_px))
    found[3] = ("twice.png", Detected(one.index // 2, one.q_px, one.sigma_px))
    result = calibrate_lens(found, BOARD, WIDE.sensor_px)
    assert {left.name: left.reason for left in result.left_out} == {
        "nan.png": "a pixel is no number",
        "few.png": "5 points, 6 are needed",
        "beyond.png": "its points are not those of a board of 30",
        "twice.png": "its points are not those of a board of 30",
    }
    assert len(result.pictures) == 8


def test_a_number_of_coefficients_that_is_no_model_is_refused() -> None:
    with pytest.raises(ConfigError, match="coefficients = 3: must be one of 0, 1, 2, 4, 5"):
        LensOptions(coefficients=3)
