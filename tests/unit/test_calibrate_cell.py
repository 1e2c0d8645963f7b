"""From a dataset to a calibration file: simulated data, and every way in which data may not tell what is asked."""

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from unit.made_dataset import ARCSEC, BALL_MM, TRUE, spread, write_board_dataset, write_dataset, write_robot_dataset

from trackerd.calibrate.board_views import board_points, find_board
from trackerd.calibrate.cell.result import CellResult
from trackerd.calibrate.cell.solve import calibrate_cell
from trackerd.calibrate.cell_data import CellData, cell_data
from trackerd.calibrate.cell_worth import frame_of
from trackerd.calibrate.plan.volume import Box
from trackerd.calibrate.shift import shift_between
from trackerd.calibrate.thesis import by_thesis
from trackerd.contract.errors import ConfigError, Undetermined
from trackerd.formats.dataset import read_dataset


def data_of(folder: Path, checks: tuple[str, ...] | None = None) -> CellData:
    return cell_data(read_dataset(folder), find_board, board_points, checks)


def adjusted(data: CellData) -> CellResult:
    return calibrate_cell(data.observations, data.targets, data.nominal)


# ---- what the dataset becomes ----------------------------------------------------------------------------------------


def test_check_points_stay_outside_the_adjustment(tmp_path: Path) -> None:
    write_dataset(tmp_path / "data", spread(12), check=4)
    data = data_of(tmp_path / "data")
    assert set(data.targets.names) == {f"P{i:02d}" for i in range(8)}
    assert [point.name for point in data.checks] == ["C08", "C09", "C10", "C11"]
    assert data.check_observations is not None
    assert len(data.check_observations) == 4 * 2 * 5
    other = data_of(tmp_path / "data", ("P00", "P01"))
    assert [point.name for point in other.checks] == ["P00", "P01"]
    assert "C08" in other.targets.names
    with pytest.raises(ConfigError, match="--check-points P99: the dataset has no point of this name"):
        data_of(tmp_path / "data", ("P99",))


def test_a_view_of_many_frames_has_so_much_less_encoder_noise(tmp_path: Path) -> None:
    folder = write_dataset(tmp_path / "data", spread(3))
    text = (folder / "views.csv").read_text()
    (folder / "views.csv").write_text(text.replace(",1,1,", ",1,16,"))
    data = data_of(folder)
    np.testing.assert_allclose(data.observations.encoder_sigma_rad, 2.0 * ARCSEC / 4.0)
    frame = frame_of(read_dataset(folder), data)
    assert frame.encoder_rad == pytest.approx(2.0 * ARCSEC)
    assert frame.pixel_px == pytest.approx(0.1 * 4.0)


def test_a_picture_without_a_board_is_named_and_left_out(tmp_path: Path) -> None:
    folder = write_board_dataset(tmp_path / "data", views=3, loose=0)
    cv2.imwrite(str(folder / "small.png"), np.full((100, 100), 90, np.uint8))
    (folder / "broken.png").write_bytes(b"no picture")
    with (folder / "views.csv").open("a") as file:
        for name in ("small", "broken"):
            file.write(f"{name},left,0.1,0.2,grid/fixed,,,,,,,1,1,{name}.png\n")
    data = data_of(folder)
    assert [line.partition(":")[0] for line in data.left_out] == [
        f"{name}.png (line {len(data.observations) + 2 + i}, left)" for i, name in enumerate(("small", "broken"))
    ]
    assert "100 x 100 px, the sensor 2048 x 1536" in data.left_out[0]
    assert "is no picture" in data.left_out[1]


def test_a_rendered_chessboard_is_found_in_its_picture(tmp_path: Path) -> None:
    folder = write_board_dataset(tmp_path / "data", views=1, loose=0)
    squares = np.kron(np.indices((7, 10)).sum(axis=0) % 2, np.ones((60, 60))) * 180.0 + 40.0
    picture = np.full((1536, 2048), 220, np.uint8)
    picture[300 : 300 + 420, 500 : 500 + 600] = squares
    cv2.imwrite(str(folder / "board.png"), cv2.GaussianBlur(picture, (0, 0), 1.0))
    lines = (folder / "views.csv").read_text().splitlines()
    (folder / "views.csv").write_text(f"{lines[0]}\nb1,left,0.1,0.2,grid/fixed,,,,,,,1,1,board.png\n")
    data = data_of(folder)
    assert not data.left_out
    assert len(data.observations) == 54
    found = np.sort(data.observations.q_px[:, 0].round(1))
    np.testing.assert_allclose(np.unique(found.round()), np.arange(560, 1099, 60) - 0.5, atol=0.6)


# ---- whole calibrations ----------------------------------------------------------------------------------------------


def test_known_points_give_stations_that_measure_fresh_points_within_their_covariance(tmp_path: Path) -> None:
    data = data_of(write_dataset(tmp_path / "data", spread(30)))
    result = adjusted(data)
    assert 0.85 < result.chi2_per_dof < 1.15
    moved = shift_between(TRUE, result.stations, Box.around(np.zeros(3), np.array((300.0, 300.0, 200.0))).grid(3))
    assert 0.0 < moved.rms_mm < 0.04  # 30 points by 5 looks: 0.016 mm from the calibration
    assert moved.max_mm < 0.1


def test_a_robot_with_bars_gives_its_ball_in_the_flange_and_the_scale(tmp_path: Path) -> None:
    result = adjusted(data_of(write_robot_dataset(tmp_path / "data")))
    assert 0.8 < result.chi2_per_dof < 1.2
    body = result.bodies["mover"]
    assert body.ball_mm is not None
    assert body.ball_covariance_mm2 is not None
    off = body.ball_mm - BALL_MM
    assert off @ np.linalg.solve(body.ball_covariance_mm2, off) < 16.3  # 99.9 % of chi-square of 3
    base = {name: one.world_from_gimbal.translation_mm for name, one in result.stations.items()}
    true = {name: one.world_from_gimbal.translation_mm for name, one in TRUE.items()}
    length = np.linalg.norm(base["left"] - base["right"])
    assert length == pytest.approx(np.linalg.norm(true["left"] - true["right"]), abs=3.0)


def test_a_robot_without_a_bar_has_no_scale(tmp_path: Path) -> None:
    folder = write_robot_dataset(tmp_path / "data", count=5, bars=1)
    text = (folder / "dataset.toml").read_text()
    (folder / "dataset.toml").write_text(text[: text.index("[[bar]]")])
    with pytest.raises(ConfigError, match=r"kind = \"robot\": needs \[\[bar\]\]"):
        data_of(folder)


def test_boards_give_what_the_thesis_method_misses(tmp_path: Path) -> None:
    """The pupil, 40 mm off the drawing, stays in its poses; the joint adjustment finds it."""
    data = data_of(write_board_dataset(tmp_path / "data", views=10, loose=4))
    result, thesis = adjusted(data), by_thesis(data)
    box = Box.around(np.zeros(3), np.array((200.0, 200.0, 150.0)))
    ours = shift_between(TRUE, result.stations, box.grid(3))
    theirs = shift_between(TRUE, {name: found.station for name, found in thesis.items()}, box.grid(3))
    assert ours.rms_mm < 0.4
    assert theirs.rms_mm > 3.0 * ours.rms_mm
    assert all(found.place_sd_mm.max() > 0.3 for found in thesis.values())


def test_the_thesis_method_needs_boards(tmp_path: Path) -> None:
    data = data_of(write_dataset(tmp_path / "data", spread(4)))
    with pytest.raises(Undetermined, match="gimbal left: the thesis's method needs 3 views of 6 points or more"):
        by_thesis(data)


# ---- data that mislead -----------------------------------------------------------------------------------------------


def one_gimbal(folder: Path) -> None:
    lines = (folder / "views.csv").read_text().splitlines()
    (folder / "views.csv").write_text("\n".join(line for line in lines if ",right," not in line) + "\n")


def few_views(folder: Path) -> None:
    lines = (folder / "views.csv").read_text().splitlines()
    (folder / "views.csv").write_text("\n".join(lines[:9]) + "\n")


def constant_angle(folder: Path) -> None:
    rewrite(folder, lambda cells: [*cells[:3], "0.05", *cells[4:]])


def shuffled_pixels(folder: Path) -> None:
    lines = (folder / "views.csv").read_text().splitlines()
    cells = [line.split(",") for line in lines[1:]]
    order = np.random.default_rng(3).permutation(len(cells))
    mixed = [[*a[:6], *cells[j][6:8], *a[8:]] for a, j in zip(cells, order, strict=True)]
    (folder / "views.csv").write_text("\n".join([lines[0], *map(",".join, mixed)]) + "\n")


def rewrite(folder: Path, change: Callable[[list[str]], list[str]]) -> None:
    lines = (folder / "views.csv").read_text().splitlines()
    (folder / "views.csv").write_text("\n".join([lines[0], *(",".join(change(line.split(","))) for line in lines[1:])]) + "\n")


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_dataset(tmp_path_factory.mktemp("whole") / "data", spread(16))


@pytest.mark.parametrize("spoil", [few_views, constant_angle, shuffled_pixels], ids=lambda spoil: spoil.__name__)
def test_data_that_do_not_tell_the_cell_are_refused(whole: Path, tmp_path: Path, spoil: Callable[[Path], None]) -> None:
    folder = Path(shutil.copytree(whole, tmp_path / "data"))
    spoil(folder)
    with pytest.raises(Undetermined):
        adjusted(data_of(folder))


def test_one_gimbal_alone_is_refused_or_right(whole: Path, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(whole, tmp_path / "data"))
    one_gimbal(folder)
    data = data_of(folder)
    data = replace(data, nominal={"left": data.nominal["left"]})
    try:
        found = adjusted(data).stations["left"]
    except Undetermined:
        return
    az, el = TRUE["left"].aim(np.zeros(3))
    direction, true = (one.world_from_camera(az, el).rotation[:, 2] for one in (found, TRUE["left"]))
    assert np.linalg.norm(direction - true) < 2e-3


def test_gross_outliers_are_rejected_and_named(whole: Path, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(whole, tmp_path / "data"))
    rng = np.random.default_rng(5)
    bad = set(rng.choice(160, 16, replace=False).tolist())
    number = iter(range(160))

    def spoil(cells: list[str]) -> list[str]:
        if next(number) in bad:
            cells[6] = repr(min(2000.0, float(cells[6]) + 30.0))
        return cells

    rewrite(folder, spoil)
    result = adjusted(data_of(folder))
    assert len(result.rejected) >= 14
    moved = shift_between(TRUE, result.stations, Box.around(np.zeros(3), np.array((300.0, 300.0, 200.0))).grid(3))
    assert moved.rms_mm < 0.06


# ---- boards ----------------------------------------------------------------------------------------------------------

KINDS = (
    ('kind = "chessboard"\ncolumns = 9\nrows = 6\nsquare_mm = 8.0', 54),
    ('kind = "charuco"\ncolumns = 9\nrows = 6\nsquare_mm = 8.0\nmarker_mm = 6.0\ndictionary = "4X4_50"', 40),
    ('kind = "circles"\ncolumns = 9\nrows = 6\nsquare_mm = 8.0', 54),
    ('kind = "acircles"\ncolumns = 4\nrows = 11\nsquare_mm = 8.0', 44),
    ('kind = "points"\nfile = "leds.csv"', 7),
)


def with_board(folder: Path, table: str) -> Path:
    write_board_dataset(folder, views=1, loose=0)
    text = (folder / "dataset.toml").read_text()
    begin, end = text.index("[board.grid]"), text.index("[placement")
    (folder / "dataset.toml").write_text(f"{text[:begin]}[board.grid]\n{table}\n\n{text[end:]}")
    leds = [f"{i},{10 * i},{i * i},{3 * (i % 3)}" for i in range(7)]
    (folder / "leds.csv").write_text("\n".join(("feature,x_mm,y_mm,z_mm", *leds)) + "\n")
    lines = (folder / "views.csv").read_text().splitlines()
    (folder / "views.csv").write_text("\n".join(lines[:6]) + "\n")
    return folder


@pytest.mark.parametrize(("table", "count"), KINDS, ids=lambda part: str(part)[8:15])
def test_every_kind_of_board_has_its_points(tmp_path: Path, table: str, count: int) -> None:
    data = read_dataset(with_board(tmp_path / "data", table))
    assert board_points(data, "grid").shape == (count, 3)


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ('kind = "chessboard"\ncolumns = 9\nrows = 6', r"\[board.grid\] square_mm: is missing: a board of kind \"chessboard\""),
        ('kind = "points"', r"\[board.grid\] file: is missing"),
        ('kind = "hexagons"', r"\[board.grid\] kind = \"hexagons\": must be one of"),
        ('kind = "points"\nfile = "none.csv"', "none.csv: no such file"),
    ],
)  # fmt: skip
def test_a_board_that_lacks_something_is_refused(tmp_path: Path, table: str, words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        read_dataset(with_board(tmp_path / "data", table))


def test_a_board_that_cannot_be_is_told_by_its_table(tmp_path: Path) -> None:
    table = 'kind = "charuco"\ncolumns = 9\nrows = 6\nsquare_mm = 8.0\nmarker_mm = 9.0\ndictionary = "4X4_50"'
    data = read_dataset(with_board(tmp_path / "data", table))
    with pytest.raises(ConfigError, match=r"dataset.toml \[board.grid\]: marker_mm = 9: must be below square_mm = 8"):
        board_points(data, "grid")
