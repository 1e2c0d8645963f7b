"""Whatever comes in: an outline is never invented, and bad input is a Missed or an error that says what is expected.

Ten thousand images of random size, type, contrast and content, none of which holds a circle, with guesses of every kind.
"""

from collections.abc import Callable
from math import inf, nan

import cv2
import numpy as np
import pytest
from vision_pictures import NOISE, Ball

from trackerd.contract.model import Found, Image, Missed
from trackerd.vision.locate import locate
from trackerd.vision.noise import NoiseModel

BATCHES, IMAGES = 20, 500
SEARCHED = 0.15  # share of the images that are searched without a guess: the slow way
LARGEST_PX = 300
LEAST_CORNER_PX = 14.0  # a polygon's corners are this far from its middle, or farther: a smaller hexagon blurs to a disc

Random = np.random.Generator
Light = np.ndarray  # (height, width), float64, of any range: scaled to the type afterwards
Guess = tuple[float, float, float]


# ---- images without a circle -----------------------------------------------------------------------------------------


def noise(random: Random, height: int, width: int) -> Light:
    return random.standard_normal((height, width))


def gradient(random: Random, height: int, width: int) -> Light:
    rows, columns = np.mgrid[:height, :width]
    return random.normal() * columns + random.normal() * rows + random.normal(0.0, 0.01) * columns * rows


def constant(random: Random, height: int, width: int) -> Light:
    return np.full((height, width), random.uniform(0.0, 1.0))


def stripes(random: Random, height: int, width: int) -> Light:
    rows, columns = np.mgrid[:height, :width]
    turn = random.uniform(0.0, 2.0 * np.pi)
    wave = np.sin((np.cos(turn) * columns + np.sin(turn) * rows) * 2.0 * np.pi / random.uniform(2.0, 80.0))
    return np.sign(wave) if random.random() < 0.5 else wave


def checkers(random: Random, height: int, width: int) -> Light:
    rows, columns = np.mgrid[:height, :width]
    side_y, side_x = random.integers(2, 60, 2).tolist()
    return ((rows // side_y + columns // side_x) % 2).astype(np.float64)


def lines(random: Random, height: int, width: int) -> Light:
    light = np.zeros((height, width))
    for _ in range(random.integers(1, 12)):
        begin, end = (tuple(random.integers(-20, (width + 20, height + 20)).tolist()) for _ in range(2))
        cv2.line(light, begin, end, random.uniform(-1.0, 1.0), int(random.integers(1, 12)), cv2.LINE_AA)
    return light


def polygons(random: Random, height: int, width: int) -> Light:
    """Up to six corners; with more, a regular one would be as good as round."""
    light = np.full((height, width), random.uniform(-0.2, 0.2))
    for _ in range(random.integers(1, 8)):
        count = int(random.integers(3, 7))
        turn = np.sort(random.uniform(0.0, 2.0 * np.pi, count))
        reach = random.uniform(LEAST_CORNER_PX, max(LEAST_CORNER_PX + 1.0, 0.6 * min(height, width)), count)
        corners = np.column_stack((np.cos(turn) * reach, np.sin(turn) * reach)) + random.uniform(0.0, (width, height))
        cv2.fillPoly(light, [np.rint(corners).astype(np.int32)], random.uniform(-1.0, 1.0), cv2.LINE_AA)
    return cv2.GaussianBlur(light, (0, 0), random.uniform(0.4, 1.5))


def points(random: Random, height: int, width: int) -> Light:
    """Hot pixels."""
    light = np.zeros((height, width))
    count = int(random.integers(1, 40))
    light[random.integers(0, height, count), random.integers(0, width, count)] = random.uniform(0.2, 1.0, count)
    return light


def soft(random: Random, height: int, width: int) -> Light:
    """Texture without edges; its grain is smaller than any ball."""
    return cv2.GaussianBlur(random.standard_normal((height, width)), (0, 0), random.uniform(0.6, 1.5))


CONTENTS: tuple[Callable[[Random, int, int], Light], ...] = (
    noise, gradient, constant, stripes, checkers, lines, polygons, points, soft,
)  # fmt: skip


def image_without_a_circle(random: Random) -> Image:
    """Of any contrast, from a grey level to far beyond saturation, with or without the sensor's noise."""
    height, width = random.integers(1, LARGEST_PX + 1, 2).tolist()
    light = CONTENTS[random.integers(len(CONTENTS))](random, height, width)
    light = light - light.min()
    greatest = 255.0 if random.random() < 0.6 else float(random.choice((1023.0, 4095.0, 65535.0)))
    light *= 10.0 ** random.uniform(-2.5, 0.5) * greatest / max(float(light.max()), 1e-9)
    light += random.uniform(-0.3, 1.0) * greatest * random.integers(0, 2)
    if random.random() < 0.6:
        light += random.normal(0.0, 10.0 ** random.uniform(-3.0, -1.0) * greatest, light.shape)
    kind = np.uint8 if greatest <= 255.0 else np.uint16
    return np.clip(np.rint(light), 0.0, greatest).astype(kind)


def any_guess(random: Random, image: Image) -> Guess:
    height, width = image.shape
    guess = [
        random.uniform(-0.2, 1.2) * width,
        random.uniform(-0.2, 1.2) * height,
        float(random.choice((random.uniform(3.0, 20.0), random.uniform(10.0, 0.7 * LARGEST_PX)))),
    ]
    if random.random() < 0.15:
        guess[random.integers(3)] = float(random.choice((nan, inf, -inf, -5.0, 0.0, 1e-300, 1e9, -1e300)))
    return guess[0], guess[1], guess[2]


@pytest.mark.parametrize("batch", range(BATCHES))
def test_nothing_is_raised_and_nothing_is_found_in_images_without_a_circle(batch: int) -> None:
    for n in range(IMAGES):
        random = np.random.default_rng((2024, batch, n))
        image = image_without_a_circle(random)
        guess = None if random.random() < SEARCHED else any_guess(random, image)
        sensor = NoiseModel(10.0 ** random.uniform(-1.0, 3.0), random.uniform(0.0, 20.0))
        outline = locate(image, guess, sensor)
        assert isinstance(outline, Missed), (batch, n, image.shape, image.dtype, guess, sensor, outline)
        assert outline.reason


@pytest.mark.parametrize("side_px", [16, 24, 40])
@pytest.mark.parametrize("contrast_dn", [6.0, 8.0, 12.0, 20.0])
def test_a_square_is_no_ball_however_weak_it_is(side_px: int, contrast_dn: float) -> None:
    light = np.full((120, 120), 60.0)
    begin, end = 60 - side_px // 2, 60 + side_px // 2
    light[begin:end, begin:end] += contrast_dn
    light = cv2.GaussianBlur(light, (0, 0), 0.8)
    for seed in range(40):
        random = np.random.default_rng(seed)
        image = np.rint(light + random.normal(0.0, NOISE.sigma_dn(60.0), light.shape)).astype(np.uint8)
        x, y = random.uniform(56.0, 64.0, 2).tolist()
        assert isinstance(locate(image, (x, y, 0.55 * side_px), NOISE), Missed)


# ---- bad input, by name ----------------------------------------------------------------------------------------------

BALL = Ball()
PICTURE = BALL.noisy(0)
NEAR: Guess = (BALL.x_px + 4.0, BALL.y_px - 3.0, 1.04 * BALL.r_px)


def missed(image: Image, guess: Guess | None, sensor: NoiseModel = NOISE) -> str:
    outline = locate(image, guess, sensor)
    assert isinstance(outline, Missed), outline
    assert outline.reason
    return outline.reason


def found(image: Image, guess: Guess | None, sensor: NoiseModel = NOISE) -> Found:
    outline = locate(image, guess, sensor)
    assert isinstance(outline, Found), outline
    return outline


@pytest.mark.parametrize("kind", ["int8", "int16", "int32", "uint32", "float32", "float64", "bool", ">u2"])
@pytest.mark.parametrize("guess", [None, NEAR], ids=["searched", "guessed"])
def test_another_type_of_pixel_is_an_error_that_names_the_expected_ones(kind: str, guess: Guess | None) -> None:
    with pytest.raises(TypeError, match="uint8 or uint16 is expected"):
        locate(PICTURE.astype(kind), guess, NOISE)


@pytest.mark.parametrize("shape", [(480,), (480, 640, 1), (480, 640, 3), (1, 480, 640), ()])
@pytest.mark.parametrize("guess", [None, NEAR], ids=["searched", "guessed"])
def test_another_shape_is_an_error_that_names_the_expected_one(shape: tuple[int, ...], guess: Guess | None) -> None:
    with pytest.raises(ValueError, match=r"shape \(height, width\) is expected"):
        locate(np.zeros(shape, np.uint8), guess, NOISE)


@pytest.mark.parametrize("shape", [(0, 640), (480, 0), (0, 0)])
@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_an_empty_image_is_an_error_that_names_the_expected_shape(shape: tuple[int, int], kind: type) -> None:
    with pytest.raises(ValueError, match=r"shape \(height, width\) is expected"):
        locate(np.zeros(shape, kind), NEAR, NOISE)


def strided(image: Image) -> dict[str, Image]:
    """The same picture, laid out in other ways."""
    wide = np.zeros((2 * image.shape[0], 3 * image.shape[1]), image.dtype)
    wide[::2, ::3] = image
    framed = np.pad(image, 7)
    return {
        "every third pixel of every second row": wide[::2, ::3],
        "a part of a larger one": framed[7:-7, 7:-7],
        "rows from the bottom up": np.ascontiguousarray(image[::-1])[::-1],
        "columns from the right": np.ascontiguousarray(image[:, ::-1])[:, ::-1],
        "column after column": np.asfortranarray(image),
        "one channel of three": np.dstack([image] * 3)[:, :, 1],
    }


@pytest.mark.parametrize("layout", strided(PICTURE))
@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
@pytest.mark.parametrize("guess", [None, NEAR], ids=["searched", "guessed"])
def test_the_layout_in_memory_changes_nothing(layout: str, kind: type, guess: Guess | None) -> None:
    image = PICTURE.astype(kind)
    plain, other = found(image, guess), found(strided(image)[layout], guess)
    assert (other.x_px, other.y_px, other.r_px) == pytest.approx((plain.x_px, plain.y_px, plain.r_px), abs=1e-9)


@pytest.mark.parametrize("guess", [None, NEAR], ids=["searched", "guessed"])
def test_an_image_that_may_not_be_written_to_is_measured_alike_and_no_image_is_changed(guess: Guess | None) -> None:
    locked, image = PICTURE.copy(), PICTURE.copy()
    locked.flags.writeable = False
    one, other = found(locked, guess), found(image, guess)
    assert (one.x_px, one.y_px, one.r_px) == (other.x_px, other.y_px, other.r_px)
    assert np.array_equal(image, PICTURE)


@pytest.mark.parametrize("level", [0, 1, 80, 254, 255])
@pytest.mark.parametrize("guess", [None, NEAR], ids=["searched", "guessed"])
def test_a_constant_image_is_missed(level: int, guess: Guess | None) -> None:
    missed(np.full((480, 640), level, np.uint8), guess)
    missed(np.full((480, 640), 257 * level, np.uint16), guess)


@pytest.mark.parametrize("guess", [None, NEAR], ids=["searched", "guessed"])
def test_a_ball_in_an_image_that_is_all_saturated_is_missed(guess: Guess | None) -> None:
    white = Ball(background_dn=330.0, contrast_dn=90.0)
    assert white.noisy(1).min() == 255
    missed(white.noisy(1), guess)
    missed(np.full((480, 640), 4095, np.uint16), guess, NoiseModel(2.4, 3.0, saturation_dn=4095.0))


@pytest.mark.parametrize("place", range(3))
@pytest.mark.parametrize("value", [nan, inf, -inf])
def test_a_guess_that_is_no_number_is_missed_and_says_so(place: int, value: float) -> None:
    guess = list(NEAR)
    guess[place] = value
    assert "not a number" in missed(PICTURE, (guess[0], guess[1], guess[2]))


@pytest.mark.parametrize("at", [(-1000.0, 240.0), (320.0, -90.0), (720.0, 240.0), (320.0, 1e6), (-1e12, -1e12)])
def test_a_guess_outside_the_image_is_missed_and_says_so(at: tuple[float, float]) -> None:
    assert "outside the image" in missed(PICTURE, (*at, 60.0))


@pytest.mark.parametrize("r_px", [2.0, 2000.0, 0.0, -60.0, 1e300])
def test_a_guessed_radius_that_no_ball_in_this_image_can_have_is_missed_and_says_so(r_px: float) -> None:
    assert "radius" in missed(PICTURE, (BALL.x_px, BALL.y_px, r_px))


def test_a_ball_of_two_pixels_is_missed_by_a_guess_at_the_least_radius() -> None:
    tiny = Ball(r_px=2.0)
    missed(tiny.noisy(2), (tiny.x_px, tiny.y_px, 4.0))
    missed(tiny.noisy(2), None)


def test_a_guess_of_two_thousand_pixels_in_an_image_that_could_hold_it_is_missed() -> None:
    missed(np.random.default_rng(3).integers(60, 70, (2048, 2048)).astype(np.uint8), (1024.0, 1024.0, 2000.0))


@pytest.mark.parametrize("x_px", [-45.0, -20.0, 20.0, 45.0])
def test_a_ball_cut_by_the_edge_of_the_image_is_measured_or_missed_but_never_wrong(x_px: float) -> None:
    ball = Ball(x_px=x_px)
    for seed in range(4):
        outline = locate(ball.noisy(seed), (x_px + 3.0, ball.y_px - 2.0, 62.0), NOISE)
        if isinstance(outline, Missed):
            assert outline.reason
        else:
            error_px = np.hypot(outline.x_px - ball.x_px, outline.y_px - ball.y_px)
            assert error_px < max(0.1, 6.0 * np.sqrt(np.trace(outline.cov_px2[:2, :2])))


def test_a_ball_of_which_less_than_half_is_in_the_image_is_missed() -> None:
    ball = Ball(x_px=-15.0)
    missed(ball.noisy(0), (ball.x_px, ball.y_px, 60.0))


@pytest.mark.parametrize("bits", [10, 12])
@pytest.mark.parametrize("guess", [None, NEAR], ids=["searched", "guessed"])
def test_sixteen_bit_pixels_in_a_smaller_range_are_measured_like_eight_bits(bits: int, guess: Guess | None) -> None:
    scale = 2.0 ** (bits - 8)
    sensor = NoiseModel(NOISE.gain_e_per_dn / scale, NOISE.read_noise_e, saturation_dn=2.0**bits - 1.0)
    sigma = scale * np.sqrt(BALL.clean / NOISE.gain_e_per_dn)
    deep = BALL.clean * scale + sigma * np.random.default_rng(4).standard_normal(BALL.clean.shape)
    outline = found(np.clip(np.rint(deep), 0.0, 2.0**bits - 1.0).astype(np.uint16), guess, sensor)
    assert np.hypot(outline.x_px - BALL.x_px, outline.y_px - BALL.y_px) < 0.02
    assert outline.clipped == 0.0


def test_sixteen_bit_pixels_that_all_lie_at_the_smaller_ranges_end_are_missed() -> None:
    deep = np.clip(BALL.clean * 16.0 + 4095.0, 0.0, 4095.0).astype(np.uint16)
    missed(deep, NEAR, NoiseModel(2.4, 3.0, saturation_dn=4095.0))
    missed(deep, None, NoiseModel(2.4, 3.0, saturation_dn=4095.0))
