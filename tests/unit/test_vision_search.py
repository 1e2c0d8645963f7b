"""Seeds anywhere in a picture: in clutter, in texture, in deep pixels, and nothing out of bounds."""

import cv2
import numpy as np
import pytest
from vision_pictures import NOISE, Ball

from trackerd.contract.model import Found
from trackerd.vision.arcs import circles_on
from trackerd.vision.locate import search
from trackerd.vision.noise import NoiseModel
from trackerd.vision.search import Pyramid, candidates, circles_in, eight_bits

Circle = tuple[float, float, float]


def cluttered(seed: int) -> tuple[np.ndarray, Circle]:
    """A ball of any radius and contrast among rectangles, polygons, lines and a weak texture, 1024 x 768."""
    random = np.random.default_rng(seed)
    picture = np.full((768, 1024), 70.0, np.float32)
    for _ in range(12):
        corners = random.integers((0, 0), (1024, 768), (1, 2)) + random.integers(-120, 120, (random.integers(3, 6), 2))
        cv2.fillPoly(picture, [corners.astype(np.int32)], float(random.integers(20, 180)))
        a, b = random.integers((0, 0), (1024, 768), (2, 2)).tolist()
        cv2.line(picture, a, b, float(random.integers(20, 180)), int(random.integers(1, 8)))
    picture = cv2.GaussianBlur(picture, (0, 0), 0.9)
    picture += (seed % 3) * cv2.GaussianBlur(random.standard_normal((768, 1024)).astype(np.float32), (0, 0), 2.0) * 7.0
    r = float(np.exp(random.uniform(np.log(14.0), np.log(120.0))))
    x, y = float(random.uniform(r + 5.0, 1018.0 - r)), float(random.uniform(r + 5.0, 762.0 - r))
    rows, columns = np.mgrid[:768, :1024]
    share = np.clip(r + 0.5 - np.hypot(columns - x, rows - y), 0.0, 1.0).astype(np.float32)
    level = float(np.median(picture[share > 0.0])) + float(random.uniform(16.0, 80.0))
    picture += cv2.GaussianBlur(share, (0, 0), 0.9) * (level - picture)
    noise = random.standard_normal(picture.shape) * np.sqrt(np.maximum(picture, 0.0) / 39.0)
    return np.clip(np.rint(picture + noise), 0, 255).astype(np.uint8), (x, y, r)


def nearest(seeds: list[Circle], truth: Circle) -> float:
    return min((float(np.abs(np.subtract(seed, truth)).max()) / truth[2] for seed in seeds), default=np.inf)


def test_every_ball_in_clutter_is_among_the_candidates() -> None:
    pictures = [cluttered(seed) for seed in range(24)]
    assert [
        n for n, (image, truth) in enumerate(pictures) if nearest(list(candidates(image, (12.0, 250.0))), truth) > 0.15
    ] == []


def test_a_search_of_clutter_finds_the_ball_and_not_the_clutter() -> None:
    for image, (x, y, r) in (cluttered(seed) for seed in range(8)):
        found = search(image, NOISE)
        assert isinstance(found, Found)
        assert (found.x_px, found.y_px, found.r_px) == pytest.approx((x, y, r), abs=0.35)


@pytest.mark.parametrize("side_px", [3, 5, 9])
def test_a_picture_of_small_squares_is_searched_without_harm_and_without_a_find(side_px: int) -> None:
    """OpenCV's EdgeDrawing writes beyond its buffers on these."""
    rows, columns = np.mgrid[:210, :318]
    squares = ((rows // side_px + columns // side_px) % 2 * 200).astype(np.uint8)
    assert not isinstance(search(squares, NOISE), Found)


def test_few_circles_are_proposed_in_a_picture_that_is_all_texture() -> None:
    random = np.random.default_rng(3)
    image = np.clip(cv2.GaussianBlur(random.normal(0.0, 1.0, (480, 640)), (0, 0), 1.5) * 90.0 + 120.0, 0, 255).astype(np.uint8)
    assert len(list(candidates(image, (12.0, 250.0)))) <= 12


def test_full_size_pixels_are_counted_from_the_middle_of_the_first() -> None:
    ball = Ball(301.5, 211.5, 60.0)
    for scale, within_px in ((4, 1.5), (2, 0.8)):
        off = [
            np.subtract(circles_in(Pyramid.of(ball.noisy(n)), (12.0, 250.0), scale)[0], (301.5, 211.5, 60.0)) for n in range(4)
        ]
        assert np.abs(np.mean(off, axis=0))[:2].max() < within_px


def test_chains_that_are_straight_or_too_short_propose_nothing() -> None:
    line = np.array([[[n, 10]] for n in range(300)], np.int32)
    corner = np.concatenate((line, [[[300, 10 + n]] for n in range(200)])).astype(np.int32)
    assert circles_on([line, corner, line[:5]], (3.0, 100.0), 6) == []
    assert circles_on([], (3.0, 100.0), 6) == []


def deep(ball: Ball, factor: float, seed: int) -> np.ndarray:
    """Sixteen bits: grey levels times a factor, of a sensor with 39 / factor electrons a level."""
    random = np.random.default_rng(seed)
    level = ball.clean * factor
    noisy = level + random.standard_normal(level.shape) * np.sqrt(level * factor / 39.0)
    return np.clip(np.rint(noisy), 0, 65535).astype(np.uint16)


@pytest.mark.parametrize("factor", [1.0, 16.0, 200.0], ids=["dark", "12 bits", "16 bits"])
def test_deep_pictures_are_searched_like_others(factor: float) -> None:
    ball = Ball(contrast_dn=30.0, clutter=True)
    found = search(deep(ball, factor, 1), NoiseModel(39.0 / factor, 0.0))
    assert isinstance(found, Found)
    assert (found.x_px, found.y_px) == pytest.approx((ball.x_px, ball.y_px), abs=0.1)


def test_hot_pixels_and_a_highlight_do_not_hide_a_ball_in_twelve_bits() -> None:
    ball = Ball(contrast_dn=30.0)
    image = deep(ball, 4.0, 2)
    image[::67, ::71] = 4095
    image[100:110, 500:512] = 4095
    found = search(image, NoiseModel(39.0 / 4.0, 0.0, saturation_dn=4095.0))
    assert isinstance(found, Found)
    assert (found.x_px, found.y_px) == pytest.approx((ball.x_px, ball.y_px), abs=0.1)


def test_noise_is_not_stretched_into_edges() -> None:
    flat = np.random.default_rng(5).normal(300.0, 12.0, (200, 300)).astype(np.uint16)
    assert eight_bits(flat).std() < 3.0


@pytest.mark.parametrize("shape", [(1, 1), (1, 300), (7, 9), (63, 65)])
def test_tiny_deep_images_are_scaled(shape: tuple[int, int]) -> None:
    assert eight_bits(np.zeros(shape, np.uint16)).shape == shape
