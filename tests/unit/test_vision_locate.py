"""The outline near a guess: precise, robust, with a covariance that is true, and silent where there is no ball."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from vision_pictures import NOISE, Ball

from trackerd.contract.model import Found, Missed
from trackerd.vision.fit import fit_circle
from trackerd.vision.locate import locate
from trackerd.vision.noise import NoiseModel
from trackerd.vision.verify import LEAST_COVERAGE, verified


def errors(ball: Ball, found: Found) -> np.ndarray:
    return np.array((found.x_px - ball.x_px, found.y_px - ball.y_px, found.r_px - ball.r_px))


def near(ball: Ball, dx: float = 4.0, dy: float = -3.0, grown: float = 1.04) -> tuple[float, float, float]:
    return ball.x_px + dx, ball.y_px + dy, ball.r_px * grown


def found(ball: Ball, seed: int, guess: tuple[float, float, float] | None = None) -> Found:
    outline = locate(ball.noisy(seed), near(ball) if guess is None else guess, NOISE)
    assert isinstance(outline, Found), outline
    return outline


def test_a_ball_with_stem_and_clutter_is_measured_to_a_hundredth_of_a_pixel() -> None:
    balls = [Ball(300.0 + 7.31 * n, 230.0 + 2.77 * n, 58.0 + 0.43 * n, stem=True, clutter=True) for n in range(8)]
    all_errors = np.array([errors(ball, found(ball, seed)) for ball in balls for seed in range(4)])
    assert np.sqrt((all_errors**2).mean(axis=0)).max() < 0.012


@pytest.mark.parametrize(
    ("ball", "rms_px"),
    [
        (Ball(r_px=12.0), 0.012),
        (Ball(r_px=150.0), 0.004),
        (Ball(contrast_dn=12.0), 0.035),
        (Ball(contrast_dn=-45.0), 0.012),
        (Ball(blur_px=2.5), 0.012),
    ],
    ids=["small", "large", "weak", "darker than its background", "out of focus"],
)
def test_the_error_stays_near_the_noise_floor(ball: Ball, rms_px: float) -> None:
    all_errors = np.array([errors(ball, found(ball, seed)) for seed in range(12)])
    assert np.sqrt((all_errors**2).mean(axis=0)).max() < rms_px


def test_the_radius_carries_no_bias_from_the_curvature_of_the_edge() -> None:
    ball = Ball(r_px=20.0, blur_px=1.1)
    bias = np.mean([errors(ball, found(ball, seed))[2] for seed in range(40)])
    assert abs(bias) < 0.004  # without the curvature's term: -1.1**2 / 40 = -0.03


def test_the_covariance_is_true() -> None:
    balls = [Ball(320.0 + 0.137 * n, 240.0 + 0.291 * n, 60.0 + 0.173 * n) for n in range(8)]
    nees = []
    for ball in balls:
        for seed in range(25):
            outline = found(ball, seed)
            e = errors(ball, outline)
            nees.append(e @ np.linalg.solve(outline.cov_px2, e) / 3.0)
    assert 0.7 < np.mean(nees) < 1.4


def test_chi2_is_one_on_a_clean_picture_and_the_whole_outline_is_covered() -> None:
    outline = found(Ball(), 1)
    assert outline.chi2 == pytest.approx(1.0, abs=0.1)
    assert outline.coverage == 1.0
    assert outline.clipped == 0.0


@pytest.mark.parametrize("off", [(12.0, 0.0, 1.0), (-8.0, 8.0, 1.1), (0.0, -12.0, 0.92)])
def test_a_guess_may_be_off_by_twelve_pixels_and_a_tenth_of_the_radius(off: tuple[float, float, float]) -> None:
    ball = Ball(stem=True, clutter=True)
    assert np.abs(errors(ball, found(ball, 3, near(ball, *off)))).max() < 0.03


def test_a_third_of_the_outline_may_be_hidden() -> None:
    ball = Ball()
    picture = ball.noisy(2)
    picture[:, 350:] = 60
    outline = locate(picture, near(ball), NOISE)
    assert isinstance(outline, Found)
    assert np.abs(errors(ball, outline)).max() < 0.05
    assert 0.5 <= outline.coverage < 0.75


def test_a_ball_that_is_mostly_out_of_the_picture_is_missed_and_says_so() -> None:
    ball = Ball(x_px=-15.0)
    outline = locate(ball.noisy(0), near(ball), NOISE)
    assert isinstance(outline, Missed)
    assert outline.reason


def test_a_ball_cut_by_the_edge_of_the_picture_is_still_measured() -> None:
    ball = Ball(x_px=38.4)
    assert np.abs(errors(ball, found(ball, 4))).max() < 0.03


@pytest.mark.parametrize("towards", [(1.0, 0.0), (0.6, 0.8)])
def test_a_ball_smeared_over_eight_pixels_is_still_measured(towards: tuple[float, float]) -> None:
    middle = Ball()
    ways = np.linspace(-4.0, 4.0, 17)
    smeared = np.mean([Ball(middle.x_px + w * towards[0], middle.y_px + w * towards[1]).clean for w in ways], axis=0)
    picture = np.rint(smeared + np.random.default_rng(13).normal(0.0, 1.7, smeared.shape)).astype(np.uint8)
    outline = locate(picture, near(middle), NOISE)
    assert isinstance(outline, Found), outline
    assert np.abs(errors(middle, outline)).max() < 0.04


def test_overexposure_is_reported_and_moves_the_outline_little() -> None:
    ball = Ball(background_dn=90.0, contrast_dn=190.0)
    outline = found(ball, 5)
    assert outline.clipped > 0.3
    assert np.abs(errors(ball, outline)[:2]).max() < 0.02


def test_sixteen_bits_are_measured_like_eight() -> None:
    ball = Ball()
    deep = np.clip(ball.clean * 16.0 + np.random.default_rng(1).normal(0.0, 24.0, ball.clean.shape), 0, 4095).astype(np.uint16)
    outline = locate(deep, near(ball), NoiseModel(39.0 / 16.0, 3.0, saturation_dn=4095.0))
    assert isinstance(outline, Found)
    assert np.abs(errors(ball, outline)).max() < 0.015


def test_equal_pictures_give_equal_answers() -> None:
    a, b = found(Ball(), 6), found(Ball(), 6)
    assert (a.x_px, a.y_px, a.r_px) == (b.x_px, b.y_px, b.r_px)


def empty_pictures() -> dict[str, np.ndarray]:
    random = np.random.default_rng(8)
    rows, columns = np.mgrid[:480, :640]
    soft = cv2.GaussianBlur(random.normal(0.0, 1.0, (480, 640)), (0, 0), 8.0)
    return {
        "flat": np.full((480, 640), 80, np.uint8),
        "noise": np.clip(random.normal(80.0, 1.5, (480, 640)), 0, 255).astype(np.uint8),
        "strong noise": random.integers(0, 255, (480, 640)).astype(np.uint8),
        "blobs": ((soft > 0.0) * 90 + 60).astype(np.uint8),
        "soft texture": np.clip(soft * 900.0 + 100.0, 0, 255).astype(np.uint8),
        "checkerboard": (((rows // 40 + columns // 40) % 2) * 100 + 60).astype(np.uint8),
        "clutter": Ball(contrast_dn=0.0, clutter=True).noisy(9),
        "black": np.zeros((480, 640), np.uint8),
        "white": np.full((480, 640), 255, np.uint8),
    }


@pytest.mark.parametrize("name", empty_pictures())
def test_nothing_is_found_where_there_is_no_ball(name: str) -> None:
    picture = empty_pictures()[name]
    random = np.random.default_rng(10)
    assert isinstance(locate(picture, None, NOISE), Missed)
    for _ in range(30):
        guess = (random.uniform(60, 580), random.uniform(60, 420), random.uniform(12, 120))
        assert isinstance(locate(picture, guess, NOISE), Missed)


@pytest.mark.parametrize("r_px", [14.0, 30.0, 60.0, 120.0])
@pytest.mark.parametrize("contrast_dn", [20.0, 100.0])
def test_a_ball_anywhere_is_found_without_a_guess(r_px: float, contrast_dn: float) -> None:
    ball = Ball(213.7, 188.2, r_px, contrast_dn=contrast_dn, stem=True, clutter=True)
    outline = locate(ball.noisy(11), None, NOISE)
    assert isinstance(outline, Found), outline
    assert np.abs(errors(ball, outline)).max() < 0.3


@pytest.mark.parametrize(
    ("guess", "reason"),
    [
        ((float("nan"), 240.0, 60.0), "not a number"),
        ((320.0, 240.0, float("inf")), "not a number"),
        ((320.0, 240.0, 0.5), "absurd"),
        ((320.0, 240.0, -60.0), "absurd"),
        ((320.0, 240.0, 5000.0), "absurd"),
        ((900.0, 240.0, 60.0), "outside the image"),
    ],
)
def test_a_useless_guess_is_missed_in_plain_words(guess: tuple[float, float, float], reason: str) -> None:
    outline = locate(Ball().noisy(0), guess, NOISE)
    assert isinstance(outline, Missed)
    assert reason in outline.reason


@pytest.mark.parametrize("image", [np.zeros((480, 640)), np.zeros((480, 640), np.int32), [[1, 2], [3, 4]]])
def test_pixels_of_another_type_are_refused(image: object) -> None:
    with pytest.raises(TypeError, match="uint8 or uint16"):
        locate(image, None)  # type: ignore[arg-type]


@pytest.mark.parametrize("shape", [(480, 640, 3), (0, 640), (640,)])
def test_images_of_another_shape_are_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match="height, width"):
        locate(np.zeros(shape, np.uint8), None)


@pytest.mark.parametrize("shape", [(1, 1), (5, 640), (16, 16), (17, 40)])
def test_tiny_images_are_missed(shape: tuple[int, int]) -> None:
    image = np.random.default_rng(12).integers(0, 255, shape).astype(np.uint8)
    assert isinstance(locate(image, None), Missed)
    assert isinstance(locate(image, (shape[1] / 2, shape[0] / 2, 5.0)), Missed)


def test_half_an_outline_that_fits_badly_is_none() -> None:
    """A glossy ball whose mirrored lamps spoil a half of the rim: what is left may be a part of them."""
    fit = fit_circle(Ball(160.2, 120.4, 40.0, size_px=(320, 240)).noisy(3), (160.0, 120.0, 40.0), NoiseModel())
    assert fit is not None
    seen = np.arange(len(fit.weight)) < round(0.6 * len(fit.weight))
    contrast = np.where(seen, fit.sectors.contrast_dn, 0.0)
    good = replace(fit, sectors=replace(fit.sectors, contrast_dn=contrast))
    assert isinstance(verified(good, NoiseModel(), LEAST_COVERAGE), Found)
    bad = replace(good, sectors=replace(good.sectors, chi2=np.full(len(seen), 9.0)))
    missed = verified(bad, NoiseModel(), LEAST_COVERAGE)
    assert isinstance(missed, Missed)
    assert "and fit badly (chi-square 9.0)" in missed.reason
