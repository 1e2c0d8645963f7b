"""Boards in rendered pictures: every point where it is, with a true sigma; what cannot be told is said."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from unit import made_boards
from unit.made_boards import Picture, pose, seen

from trackerd.calibrate.board_kinds import Board, Charuco, Chessboard, CircleGrid, Detected, DotArray, Missed
from trackerd.calibrate.boards import detect
from trackerd.calibrate.dot_match import match_dots
from trackerd.contract.errors import ConfigError
from trackerd.geometry.lens import Lens
from trackerd.geometry.rigid import Rigid

LENS = Lens((320, 240), 270.0, 270.0, 161.0, 118.0, (-0.1, 0.02, 0.0, 0.0, 0.0))
PICTURE = Picture(LENS, samples=4)
CHESS = Chessboard((7, 4), 20.0)
CHARUCO = Charuco((6, 5), 26.0, 18.0, "4X4_50")
GRID = CircleGrid((7, 5), 20.0)
ASYMMETRIC = CircleGrid((4, 9), 12.0, asymmetric=True)
PLACES = np.random.default_rng(4).uniform(-3.0, 3.0, (20, 2))
ARRAY = DotArray(np.array([[28.0 * (n % 5) + PLACES[n, 0] * 2, 28.0 * (n // 5) + PLACES[n, 1] * 2, 0.0] for n in range(20)]))
CASES: list[tuple[Board, Any]] = [
    (CHESS, made_boards.chessboard(CHESS)),
    (CHARUCO, made_boards.charuco(CHARUCO)),
    (GRID, made_boards.circles(GRID, 9.0)),
    (ASYMMETRIC, made_boards.circles(ASYMMETRIC, 9.0, bright=True)),
    (ARRAY, made_boards.leds(ARRAY, 5.0)),
]
TILTS = ((0.35, -0.3, 0.1), (-0.4, 0.2, -0.25))


def ids(value: object) -> str:
    return type(value).__name__ + (" asymmetric" if value is ASYMMETRIC else "") if not callable(value) else ""


def errors(board: Board, pattern: Any, picture: Picture) -> tuple[Any, Any]:
    """Measured minus true, (n, 2), and in sigmas."""
    off, sigmas = [], []
    for n, tilt in enumerate(TILTS):
        where = pose(board.points_mm, 195.0, tilt, (3.0 - 5 * n, 2.0))
        found = detect(board, replace(picture, seed=n).of(pattern, where))
        assert isinstance(found, Detected), found
        assert list(found.index) == list(range(len(board.points_mm)))
        off.append(found.q_px - seen(picture.lens, where, board.points_mm))
        sigmas.append(found.sigma_px)
    all_off = np.concatenate(off)
    return all_off, all_off / np.concatenate(sigmas)[:, None]


@pytest.mark.parametrize(("board", "pattern"), CASES, ids=ids)
def test_points_are_found_without_bias_and_with_a_true_sigma(board: Board, pattern: Any) -> None:
    off, in_sigmas = errors(board, pattern, PICTURE)
    assert np.abs(off.mean(0)).max() < 0.02
    assert np.sqrt(np.square(off).mean()) < 0.06
    assert 0.4 < np.sqrt(np.square(in_sigmas).mean()) < 1.8


@pytest.mark.parametrize("depth", [np.uint8, np.uint16], ids=["8 bits", "16 bits"])
def test_a_picture_of_16_bits_tells_the_same(depth: type[np.generic]) -> None:
    where = pose(GRID.points_mm, 195.0, TILTS[0])
    image = PICTURE.of(made_boards.circles(GRID, 9.0), where)
    found = detect(GRID, image.astype(depth) * depth(200 if depth is np.uint16 else 1))
    assert isinstance(found, Detected)
    np.testing.assert_allclose(found.q_px, seen(LENS, where, GRID.points_mm), atol=0.1)


def test_a_large_picture_is_searched_small_and_measured_large() -> None:
    lens = Lens((1420, 460), 640.0, 640.0, 700.0, 225.0)
    where = pose(CHESS.points_mm, 195.0, TILTS[0])
    image = replace(PICTURE, lens=lens, samples=2).of(made_boards.chessboard(CHESS), where)
    found = detect(CHESS, image)
    assert isinstance(found, Detected)
    off = found.q_px - seen(lens, where, CHESS.points_mm)
    assert np.abs(off.mean(0)).max() < 0.03
    assert np.sqrt(np.square(off).mean()) < 0.1


# ---- which corner is which -------------------------------------------------------------------------------------------


def turned(board: Board, degrees: float, tilt: float = 0.0) -> Rigid:
    return pose(board.points_mm, 210.0, (0.0, tilt, np.radians(degrees)))


@pytest.mark.parametrize("degrees", [0, 120, 180, 300])
def test_the_colour_of_the_squares_tells_corner_0_however_the_board_is_turned(degrees: float) -> None:
    assert CHESS.turns_alike == 1
    where = turned(CHESS, degrees)
    found = detect(CHESS, PICTURE.of(made_boards.chessboard(CHESS), where))
    assert isinstance(found, Detected)
    np.testing.assert_allclose(found.q_px, seen(LENS, where, CHESS.points_mm), atol=0.3)


@pytest.mark.parametrize("degrees", [10, 190])
def test_a_board_that_looks_alike_begins_at_the_upper_left_and_says_that_it_is_ambiguous(degrees: float) -> None:
    board = Chessboard((6, 4), 22.0)
    assert board.turns_alike == 2
    found = detect(board, PICTURE.of(made_boards.chessboard(board), turned(board, degrees)))
    assert isinstance(found, Detected)
    np.testing.assert_allclose(found.q_px, seen(LENS, turned(board, 10), board.points_mm), atol=0.3)


@pytest.mark.parametrize("degrees", [0, 180])
def test_an_asymmetric_grid_with_an_odd_number_of_rows_is_never_mistaken(degrees: float) -> None:
    assert ASYMMETRIC.turns_alike == 1
    where = turned(ASYMMETRIC, degrees, tilt=0.2)
    found = detect(ASYMMETRIC, PICTURE.of(made_boards.circles(ASYMMETRIC, 9.0), where))
    assert isinstance(found, Detected)
    np.testing.assert_allclose(found.q_px, seen(LENS, where, ASYMMETRIC.points_mm), atol=0.2)


def test_how_often_a_board_looks_alike_is_told() -> None:
    assert [CircleGrid(size, 1.0).turns_alike for size in ((7, 5), (5, 5))] == [2, 4]
    assert [CircleGrid(size, 1.0, asymmetric=True).turns_alike for size in ((4, 11), (4, 10))] == [1, 2]


# ---- a part of a board -----------------------------------------------------------------------------------------------


def test_a_part_of_a_charuco_board_is_enough() -> None:
    where = pose(CHARUCO.points_mm, 150.0, (0.2, 0.1, 0.0), (55.0, 0.0))
    found = detect(CHARUCO, PICTURE.of(made_boards.charuco(CHARUCO), where))
    assert isinstance(found, Detected)
    assert 6 <= len(found.index) < len(CHARUCO.points_mm)
    np.testing.assert_allclose(found.q_px, seen(LENS, where, CHARUCO.points_mm)[found.index], atol=0.3)


def test_a_part_of_a_chessboard_or_of_a_grid_is_named_not_guessed() -> None:
    for board, pattern in CASES[:3:2]:
        where = pose(board.points_mm, 150.0, (0.2, 0.1, 0.0), (60.0, 0.0))
        found = detect(board, PICTURE.of(pattern, where))
        assert isinstance(found, Missed)
        assert "no chessboard of 7 x 4 inner corners" in found.reason or "dots" in found.reason


def test_an_array_is_matched_with_leds_missing_and_reflections_added() -> None:
    lit = DotArray(np.delete(ARRAY.points_mm, [3, 11, 17], axis=0))
    stray = np.array([[70.0, 14.0, 0.0], [12.0, 70.0, 0.0]])
    where = pose(ARRAY.points_mm, 195.0, TILTS[0])
    found = detect(ARRAY, PICTURE.of(made_boards.dots(np.concatenate((lit.points_mm, stray)), 7.0, True), where))
    assert isinstance(found, Detected)
    assert list(found.index) == [n for n in range(20) if n not in (3, 11, 17)]
    np.testing.assert_allclose(found.q_px, seen(LENS, where, ARRAY.points_mm)[found.index], atol=0.2)


def test_a_mirrored_array_is_refused() -> None:
    image = PICTURE.of(made_boards.leds(ARRAY, 7.0), pose(ARRAY.points_mm, 195.0, TILTS[0]))
    for wrong in (DotArray(ARRAY.points_mm * (-1, 1, 1)), replace(ARRAY, facing=(0.0, 0.0, 1.0))):
        found = detect(wrong, image)
        assert isinstance(found, Missed)
        assert "match only mirrored, as if seen from behind" in found.reason


def test_a_regular_array_is_refused_because_it_looks_alike() -> None:
    regular = DotArray(np.array([[30.0 * (n % 4), 30.0 * (n // 4), 0.0] for n in range(16)]))
    found = detect(regular, PICTURE.of(made_boards.leds(regular, 8.0), pose(regular.points_mm, 195.0, TILTS[0])))
    assert isinstance(found, Missed)
    assert "looks alike in" in found.reason


def test_dots_that_are_not_the_arrays_are_refused() -> None:
    other = DotArray(np.random.default_rng(9).permutation(ARRAY.points_mm.ravel()).reshape(-1, 3) * (1, 1, 0))
    found = detect(other, PICTURE.of(made_boards.leds(ARRAY, 7.0), pose(ARRAY.points_mm, 195.0, TILTS[0])))
    assert isinstance(found, Missed)


@pytest.mark.parametrize("seed", range(4))
def test_an_array_in_two_planes_is_matched_and_refused_where_it_is_mirrored(seed: int) -> None:
    rng = np.random.default_rng(seed)
    grid = np.stack(np.meshgrid(np.arange(4), np.arange(4)), axis=-1).reshape(-1, 2) * 100.0
    places = np.concatenate((grid + rng.uniform(-25, 25, grid.shape), grid + rng.uniform(5, 55, grid.shape)))
    points = np.column_stack((places, np.repeat((0.0, 100.0), 16)))
    lens = Lens((2048, 1536), 3000.0, 3000.0, 1020.0, 770.0, (-0.1, 0.1, 0.0, 0.0, 0.0))
    q = seen(lens, pose(points, 2000.0, (rng.uniform(-0.4, 0.4), rng.uniform(-0.4, 0.4), rng.uniform(-3, 3))), points)
    lit = np.sort(rng.permutation(32)[:27])
    dots = np.concatenate((q[lit] + rng.normal(0, 0.1, (27, 2)), rng.uniform(300, 1200, (3, 2))))
    order = rng.permutation(len(dots))
    facing = np.array((0.0, 0.0, -1.0))
    (found,) = match_dots(points, facing, dots[order], 20)
    assert found.front
    real = order[found.dots] < 27
    assert np.count_nonzero(real) == 27
    assert np.array_equal(lit[order[found.dots][real]], found.points[real])
    mirrored = match_dots(points * (-1, 1, 1), facing, dots[order], 20)
    assert [one.front for one in mirrored] == [False]


# ---- no board --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("board", [board for board, _ in CASES], ids=ids)
@pytest.mark.parametrize("what", ["black", "white", "noise"])
def test_a_picture_without_a_board_is_missed_with_a_reason(board: Board, what: str) -> None:
    noise = np.random.default_rng(1).integers(0, 256, (240, 320)).astype(np.uint8)
    image = {"black": np.zeros_like(noise), "white": np.full_like(noise, 255), "noise": noise}[what]
    found = detect(board, image)
    assert isinstance(found, Missed)
    assert found.reason


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (lambda: Chessboard((2, 6), 25.0), "chessboard 2x6: needs at least 3 along each side"),
        (lambda: Chessboard((9, 6), 0.0), "square_mm = 0: must be a positive number of millimetres"),
        (lambda: Charuco((8, 6), 20.0, 20.0), "marker_mm = 20: must be below square_mm = 20"),
        (lambda: Charuco((8, 6), 20.0, 15.0, "9X9"), 'dictionary = "9X9": must be one of'),
        (lambda: Charuco((12, 10), 20.0, 15.0), "has 50 markers, too few for 12x10 squares"),
        (lambda: CircleGrid((7, 5), float("nan")), "spacing_mm = nan"),
        (lambda: DotArray(np.zeros((3, 3))), "needs 6 points or more"),
        (lambda: DotArray(np.zeros((101, 3))), "has 101 points, at most 100 are matched"),
        (lambda: DotArray(np.full((8, 3), np.nan)), "a coordinate is no number"),
        (lambda: DotArray(np.zeros((8, 3)), facing=(0.0, 0.0, 0.0)), "must be a direction"),
    ],
)
def test_a_board_that_cannot_be_is_refused_in_words(make: Any, text: str) -> None:
    with pytest.raises(ConfigError, match=text.replace("(", r"\(")):
        make()
