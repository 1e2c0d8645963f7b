"""The dataset of a calibration: what it holds, and every way in which a person may have spoilt it."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from unit.made_dataset import TRUE, gimbal_table, spread, write_dataset

from trackerd.contract.errors import ConfigError
from trackerd.formats.dataset import read_dataset
from trackerd.formats.dataset_file import DatasetFile, NewView, flange_text, points_text
from trackerd.formats.mover import Stop
from trackerd.geometry.rigid import rotation_about

Spoil = Callable[[Path], None]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return write_dataset(tmp_path / "data", spread(3), check=1)


def test_a_dataset_is_read_as_it_was_written(folder: Path) -> None:
    data = read_dataset(folder)
    assert list(data.gimbals) == ["left", "right"]
    assert [point.use for point in data.points.values()] == ["adjust", "adjust", "check"]
    np.testing.assert_array_equal([point.p_mm for point in data.points.values()], spread(3))
    np.testing.assert_allclose(data.points["P00"].cov_mm2, 0.005**2 * np.eye(3))
    assert len(data.image_points) == 3 * 2 * 5
    first = data.image_points[0]
    assert (first.view, first.gimbal, first.target, first.face) == ("P00.0", "left", "P00", 1)
    np.testing.assert_allclose(first.cov_px2, 0.01 * np.eye(2))


def test_its_identity_changes_with_any_byte(folder: Path) -> None:
    before = read_dataset(folder).identity
    (folder / "points.csv").write_text((folder / "points.csv").read_text() + "# a remark\n")
    assert read_dataset(folder).identity != before


def edit(file: str, old: str, new: str) -> Spoil:
    def spoil(folder: Path) -> None:
        text = (folder / file).read_text()
        assert old in text
        (folder / file).write_text(text.replace(old, new, 1))

    return spoil


def cell(line: int, column: str, value: str, file: str = "views.csv") -> Spoil:
    def spoil(folder: Path) -> None:
        lines = (folder / file).read_text().splitlines()
        cells = lines[line - 1].split(",")
        cells[lines[0].split(",").index(column)] = value
        lines[line - 1] = ",".join(cells)
        (folder / file).write_text("\n".join(lines) + "\n")

    return spoil


def repeat(line: int, file: str = "views.csv") -> Spoil:
    def spoil(folder: Path) -> None:
        lines = (folder / file).read_text().splitlines()
        (folder / file).write_text("\n".join([*lines, lines[line - 1]]) + "\n")

    return spoil


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (cell(4, "az_rad", "-14.9"), r"views.csv line 4 az_rad = -14.9: is more than a turn: angles are in radians"),
        (cell(4, "u_px", "nan"), r"views.csv line 4 u_px = nan: must be a finite number"),
        (cell(4, "v_px", "upper"), r"views.csv line 4 v_px = upper: must be a number"),
        (cell(4, "v_px", ""), r"views.csv line 4 v_px: is missing"),
        (cell(4, "u_px", "4000"), r"views.csv line 4 u_px = 4000: is not on the sensor of 2048 x 1536 px"),
        (cell(4, "gimbal", "lefd"), r"views.csv line 4 gimbal = lefd: there is no \[gimbal.lefd\].*did you mean left"),
        (cell(4, "target", "P77"), r"views.csv line 4 target = P77: is not in points.csv"),
        (cell(4, "target", "grid/1"), r"views.csv line 4 target = grid/1: is BOARD/PLACEMENT; there is no \[board.grid\]"),
        (cell(4, "face", "3"), r"views.csv line 4 face = 3: must be 1 or 2"),
        (cell(4, "image", "gone.png"), r"views.csv line 4 image = gone.png: no such file"),
        (cell(4, "cuv_px2", "1"), r"views.csv line 4 cuu_px2 = 0.01: the covariance must be positive definite"),
        (cell(4, "view", "P00.1"), r"views.csv line 4 az_rad.*: a view has one pair of angles: line 3 has others"),
        (repeat(2), r"views.csv line 32 target = P00: is there twice in view P00.0, first in line 2"),
        (edit("views.csv", "az_rad", "az_deg"), r"views.csv line 1: has no column az_rad"),
        (edit("views.csv", "el_rad", "el_rad,speed"), r"views.csv line 1: column 'speed' is unknown"),
        (edit("views.csv", ",1,1,", ",1,1"), r"views.csv line 2: has 13 values, the header has 14"),
        (cell(2, "x_mm", "inf", "points.csv"), r"points.csv line 2 x_mm = inf: must be a finite number"),
        (cell(2, "use", "maybe", "points.csv"), r'points.csv line 2 use = maybe: must be "adjust" or "check"'),
        (repeat(2, "points.csv"), r"points.csv line 5 point = P00: is there twice, first in line 2"),
        (edit("dataset.toml", "focal_px = 30500.0", "focal_px = -1.0"), r"\[gimbal.left\] focal_px = -1.0: must be above 0"),
        (edit("dataset.toml", "trackerd-dataset", "other"), r'dataset.toml format = "other": is no dataset'),
        (edit("dataset.toml", 'kind = "cnc"', 'kind = "robot"'), r"\[mover\] kind = \"robot\": needs flange.csv"),
        (edit("dataset.toml", "sigma_mm = 0.005", ""), r"points.csv line 2 sigma_mm: is missing, and dataset.toml \[mover\]"),
        (edit("dataset.toml", "[mover]", "[priors]\nf_relativ = 0.1\n[mover]"), r"\[priors\] f_relativ.*mean f_relative"),
        (lambda folder: (folder / "views.csv").unlink(), r"views.csv: no such file"),
        (lambda folder: (folder / "views.csv").write_bytes(b"\xff\xfe"), r"views.csv: byte 0 is not UTF-8"),
        (lambda folder: (folder / "views.csv").write_text(""), r"views.csv: is empty"),
        (lambda folder: (folder / "dataset.toml").unlink(), r"is no dataset: there is no dataset.toml in it"),
    ],
)  # fmt: skip
def test_a_spoilt_dataset_is_refused_by_file_line_field_and_rule(folder: Path, spoil: Spoil, words: str) -> None:
    spoil(folder)
    with pytest.raises(ConfigError, match=words):
        read_dataset(folder)


def test_many_errors_of_one_kind_are_told_shortly(folder: Path) -> None:
    lines = (folder / "views.csv").read_text().replace(",left,", ",wrong,").replace(",right,", ",wrong,")
    (folder / "views.csv").write_text(lines)
    with pytest.raises(ConfigError, match=r"and 10 more of the kind"):
        read_dataset(folder)


def new_view(name: str, gimbal: str = "left") -> NewView:
    return NewView(name, gimbal, 1, 0.1, 0.2, "P00", np.array((10.0, 20.0)), 0.01 * np.eye(2), 12, np.zeros((4, 4), np.uint8))


def opened(folder: Path) -> DatasetFile:
    tables = {
        "format": "trackerd-dataset",
        "version": 1,
        "gimbal": {name: gimbal_table(one, 0.1, 2.0) for name, one in TRUE.items()},
    }
    tables["mover"] = {"kind": "cnc", "sigma_mm": 0.005}
    return DatasetFile(folder, tables, {"points.csv": points_text([Stop("P00", np.array((1.0, 2.0, 3.0)), 1.0)])})


def test_what_was_captured_before_an_interruption_is_not_captured_again(tmp_path: Path) -> None:
    opened(tmp_path / "data").append(new_view("P00.1.0"))
    again = opened(tmp_path / "data")
    assert again.taken == {("P00.1.0", "left")}
    again.append(new_view("P00.1.0", "right"))
    data = read_dataset(tmp_path / "data")
    assert [(point.view, point.gimbal) for point in data.image_points] == [("P00.1.0", "left"), ("P00.1.0", "right")]
    image = data.image_points[0].image
    assert image is not None
    assert image.is_file()


def test_a_line_that_was_torn_by_a_power_cut_is_taken_again(tmp_path: Path) -> None:
    opened(tmp_path / "data").append(new_view("P00.1.0"))
    opened(tmp_path / "data").append(new_view("P00.1.1"))
    path = tmp_path / "data" / "views.csv"
    path.write_bytes(path.read_bytes()[:-7])
    assert opened(tmp_path / "data").taken == {("P00.1.0", "left")}
    assert len(read_dataset(tmp_path / "data").image_points) == 1


def test_another_dataset_is_not_written_over(tmp_path: Path) -> None:
    write_dataset(tmp_path / "data", spread(2))
    with pytest.raises(ConfigError, match=r"holds a dataset with another points\.csv"):
        opened(tmp_path / "data")


def test_a_robots_stops_become_flange_poses_and_a_bars_ends_unknown_places(tmp_path: Path) -> None:
    turn = rotation_about(np.array((0.0, 0.6, 0.8)), 0.4)
    stops = [
        Stop("P01", np.array((1.0, 2.0, 3.0)), 5.0, turn),
        Stop("C01", np.array((4.0, 5.0, 6.0)), 5.0, turn.T),
        Stop("B1a", np.array((7.0, 8.0, 9.0)), 5.0),
    ]
    tables = {
        "format": "trackerd-dataset",
        "version": 1,
        "mover": {"kind": "robot", "sigma_mm": 0.65},
        "gimbal": {name: gimbal_table(one, 0.1, 2.0) for name, one in TRUE.items()},
    }
    DatasetFile(tmp_path, tables, {"points.csv": points_text(stops), "flange.csv": flange_text(stops)})
    data = read_dataset(tmp_path)
    assert data.points["B1a"].p_mm is None
    assert data.points["C01"].use == "check"
    assert set(data.flange) == {"P01", "C01"}
    np.testing.assert_allclose(data.flange["P01"].rotation, turn, atol=1e-8)
    np.testing.assert_allclose(data.flange["P01"].translation_mm, (1.0, 2.0, 3.0))
