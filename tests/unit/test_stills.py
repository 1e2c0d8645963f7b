"""Pictures from files: what they hold comes back unchanged, and what is none says which file and why."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from trackerd.contract.errors import ConfigError
from trackerd.formats.stills import stills

Pixels = npt.NDArray[Any]


def grey(kind: type[np.generic] = np.uint8, seed: int = 1) -> Pixels:
    return np.random.default_rng(seed).integers(0, 250, (24, 32)).astype(kind) * kind(1 if kind is np.uint8 else 257)


def store(file: Path, picture: Pixels) -> Path:
    file.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(file), picture)
    return file


def recording(folder: Path, stations: tuple[str, ...] = ("left", "right"), count: int = 3) -> Path:
    """As the twin writes it; each station's frames differ."""
    for n, name in enumerate(stations):
        for frame in range(count):
            store(folder / name / f"{frame:06d}.bmp", grey(seed=10 * n + frame))
        rows = "".join(f"{frame},{1000 * frame + n}\n" for frame in range(count))
        (folder / f"{name}.csv").write_text("frame,t_ns\n" + rows)
    (folder / "angles.csv").write_text("gimbal,frame,t_ns,az_rad,el_rad\n")
    (folder / "calibration.toml").touch()
    return folder


def refusal(path: Path) -> str:
    with pytest.raises(ConfigError) as refused:
        _ = [list(series.frames()) for series in stills(path)]
    return str(refused.value)


# ---- what comes back -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("suffix", "kind"),
    [(s, np.uint8) for s in (".png", ".bmp", ".pgm", ".tif", ".TIFF")] + [(s, np.uint16) for s in (".png", ".pgm", ".tif")],
)
def test_a_picture_comes_back_bit_by_bit_at_its_own_depth(tmp_path: Path, suffix: str, kind: type[np.generic]) -> None:
    (series,) = stills(store(tmp_path / f"one{suffix}", grey(kind)))
    ((name, image),) = series.frames()
    assert (series.count, series.name, name) == (1, f"one{suffix}", f"one{suffix}")
    assert image.dtype == kind
    np.testing.assert_array_equal(image, grey(kind))
    assert series.notes == ()


def test_a_folder_comes_in_the_order_of_its_numbers_and_can_be_read_twice(tmp_path: Path) -> None:
    for n in (10, 2, 1):
        store(tmp_path / f"frame{n}.png", grey(seed=n))
    (tmp_path / "notes.txt").touch()
    (series,) = stills(tmp_path)
    for _ in range(2):
        assert [name for name, _ in series.frames()] == ["frame1.png", "frame2.png", "frame10.png"]
    assert series.station is None
    assert series.instants_ns is None


def test_a_recording_is_one_series_a_station_with_its_instants(tmp_path: Path) -> None:
    left, right = stills(recording(tmp_path))
    assert (left.name, left.station, right.station) == ("left", "left", "right")
    assert right.instants_ns == (1, 1001, 2001)
    assert right.calibration == tmp_path / "calibration.toml"
    np.testing.assert_array_equal([image for _, image in right.frames()], [grey(seed=n) for n in (10, 11, 12)])


def test_one_stations_folder_of_a_recording_still_knows_whose_it_is(tmp_path: Path) -> None:
    (right,) = stills(recording(tmp_path) / "right")
    assert (right.station, right.instants_ns) == ("right", (1, 1001, 2001))


def test_a_table_that_only_shares_the_folders_name_is_nobodys_business(tmp_path: Path) -> None:
    store(tmp_path / "series" / "0.png", grey())
    (tmp_path / "series.csv").write_text("name,x_px\n")
    (series,) = stills(tmp_path / "series")
    assert (series.station, series.instants_ns) == (None, None)


def test_a_folder_is_listed_without_reading_its_pictures(tmp_path: Path) -> None:
    store(tmp_path / "0.png", grey())
    (tmp_path / "1.png").write_bytes(b"not a picture")
    (series,) = stills(tmp_path)
    frames = series.frames()
    assert next(frames)[0] == "0.png"
    with pytest.raises(ConfigError, match=r"1\.png: cannot be decoded"):
        next(frames)


def test_grey_in_three_equal_channels_is_grey(tmp_path: Path) -> None:
    (series,) = stills(store(tmp_path / "one.png", np.repeat(grey()[..., None], 3, axis=2)))
    np.testing.assert_array_equal(next(series.frames())[1], grey())


def test_jpeg_is_taken_with_a_warning(tmp_path: Path) -> None:
    store(tmp_path / "0.jpg", grey())
    store(tmp_path / "1.png", grey())
    (series,) = stills(tmp_path)
    (note,) = series.notes
    assert "1 of 2 pictures" in note
    assert "noise" in note
    assert [image.shape for _, image in series.frames()] == [(24, 32)] * 2


# ---- what is refused -------------------------------------------------------------------------------------------------


def test_a_colour_picture_is_refused(tmp_path: Path) -> None:
    colour = np.random.default_rng(1).integers(0, 255, (24, 32, 3)).astype(np.uint8)
    assert "one.png: a colour picture: needs a grey picture of 8 or 16 bits" in refusal(store(tmp_path / "one.png", colour))


def test_fractions_are_refused(tmp_path: Path) -> None:
    assert "its pixels are float32" in refusal(store(tmp_path / "one.tif", grey().astype(np.float32)))


def test_a_file_of_several_pages_is_refused_rather_than_read_in_part(tmp_path: Path) -> None:
    assert cv2.imwritemulti(str(tmp_path / "two.tif"), [grey(), grey()])
    assert "two.tif: holds several pictures" in refusal(tmp_path / "two.tif")


@pytest.mark.parametrize("suffix", [".png", ".bmp", ".pgm", ".tif", ".jpg"])
@pytest.mark.parametrize("kept", [0, 9, 500])
def test_a_broken_file_is_told_in_one_line_of_ours(
    tmp_path: Path, suffix: str, kept: int, capfd: pytest.CaptureFixture[str]
) -> None:
    file = store(tmp_path / f"one{suffix}", grey())
    file.write_bytes(file.read_bytes()[:kept])
    told = refusal(file)
    assert f"one{suffix}: cannot be decoded" in told
    assert len(told.splitlines()) == 1
    assert capfd.readouterr() == ("", "")


def test_what_is_not_there_is_told(tmp_path: Path) -> None:
    assert "nowhere: there is no such file or folder" in refusal(tmp_path / "nowhere")
    assert "holds no picture" in refusal(tmp_path)
    (tmp_path / "one.txt").touch()
    assert "one.txt: not a picture: its name must end in" in refusal(tmp_path / "one.txt")


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ("frame,t\n0,1\n", "needs the columns frame,t_ns"),
        ("frame,t_ns\n0,soon\n", "with whole numbers"),
        ("frame,t_ns\n0\n", "with whole numbers"),
        ("frame,t_ns\n0,1\n", "one row for each of the 3 pictures"),
        ("frame,t_ns\n0,1\n2,2\n1,3\n", "in this order"),
    ],
)
def test_a_table_of_instants_that_does_not_fit_is_refused(tmp_path: Path, table: str, words: str) -> None:
    (recording(tmp_path) / "left.csv").write_text(table)
    told = refusal(tmp_path)
    assert "left.csv" in told
    assert words in told
