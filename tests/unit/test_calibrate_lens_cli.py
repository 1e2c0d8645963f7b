"""`trackerd calibrate lens`: figures, file and report; pictures that are left out are named; wrong input is told in words."""

import re
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from unit import made_boards
from unit.made_boards import Picture, pose

from trackerd.calibrate.board_kinds import Charuco, CircleGrid, DotArray
from trackerd.cli import main
from trackerd.formats.lens_file import load_lenses
from trackerd.geometry.lens import Lens

PHOTOGRAPHS = Path(__file__).parents[1] / "data" / "opencv-chessboard"
DONE, WRONG, REFUSED = 0, 2, 3
LENS = Lens((240, 180), 210.0, 210.0, 121.0, 88.0, (-0.1, 0.0, 0.0, 0.0, 0.0))
TILTS = ((0.5, 0.0, 0.1), (-0.5, 0.1, 0.0), (0.1, 0.5, 0.2), (0.0, -0.5, -0.2), (0.3, 0.3, 0.0))


def photographs(folder: Path, *numbers: int) -> Path:
    folder.mkdir(exist_ok=True)
    for n in numbers:
        shutil.copy(PHOTOGRAPHS / f"left{n:02d}.jpg", folder)
    return folder


def lens(*arguments: object) -> int:
    return main(["calibrate", "lens", *map(str, arguments)])


def chessboard(*arguments: object) -> int:
    return lens(*arguments, "--board", "9x6", "--square-mm", 25)


def test_the_photographs_give_figures_a_file_and_a_page(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pictures = photographs(tmp_path / "wide", 1, 6, 11, 12, 13)
    cv2.imwrite(str(pictures / "black.png"), np.zeros((480, 640), np.uint8))
    cv2.imwrite(str(pictures / "small.png"), np.zeros((240, 320), np.uint8))
    (pictures / "torn.png").write_bytes((pictures / "black.png").read_bytes()[:40])
    output = tmp_path / "lens.toml"
    assert chessboard(pictures, "--output", output, "--pixel-um", 6, "--range-mm", 1000) == DONE
    out, err = capsys.readouterr()
    assert re.search(r"residuals: rms 0\.1\d\d px", out)
    assert re.search(r"fx: 53\d\.\d\d ± \d\.\d\d px", out)
    assert re.search(r"focal length: 3\.[12]\d* ± 0\.0\d+ mm along x", out)
    assert re.search(r"angle of view: 6\d\.\d+° x 5\d\.\d+°", out)
    assert re.search(r"field of view at 1000 mm: 13\d\d\.\d\d x 9\d\d\.\d\d mm", out)
    assert "left13.jpg: rms" in out
    assert "left out: black.png: no chessboard of 9 x 6 inner corners" in out
    assert "left out: small.png: is 320 x 240 px, the others are 640 x 480 px" in out
    assert "left out: torn.png: cannot be decoded" in out
    assert "warning: only 5 pictures are used" in err
    record = load_lenses(output)["default"]
    assert record.lens.fx_px == pytest.approx(533.0, abs=5.0)
    assert set(record.pictures) == {f"left{n:02d}.jpg" for n in (1, 6, 11, 12, 13)}
    assert set(record.left_out) == {"black.png", "small.png", "torn.png"}
    check_page((tmp_path / "lens.html").read_text())


def check_page(html: str) -> None:
    """Whole, self-contained, with four figures and five pictures."""
    assert html.endswith("</html>\n")
    assert html.count("<svg") == 4
    assert html.count('src="data:image/jpeg;base64,') == 5
    links = re.findall(r"(?:src|href)=[\"']([^\"']{0,60})", html)
    assert all(link.startswith(("data:", "#")) for link in links)
    assert not re.search(r"@import|<script|<link", html)
    for words in ("rms of the distances", "only 5 pictures", "left12.jpg", "torn.png", "correlation with a pose"):
        assert words in html


def test_several_folders_are_zoom_settings_of_one_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    wide, tele = photographs(tmp_path / "wide", 1, 3, 6), photographs(tmp_path / "tele", 2, 12, 13)
    output = tmp_path / "lens.toml"
    assert chessboard(wide, tele, "--output", output, "--fix-aspect", "--coefficients", 2) == DONE
    assert chessboard(f"{tmp_path}/t*/left*.jpg", "--output", output, "--zoom", "again", "--coefficients", 1) == DONE
    assert list(load_lenses(output)) == ["wide", "tele", "again"]
    assert load_lenses(output)["wide"].lens.fx_px == load_lenses(output)["wide"].lens.fy_px
    assert (tmp_path / "lens.wide.html").exists()
    assert (tmp_path / "lens.tele.html").exists()
    assert "as asked" in capsys.readouterr().out


@pytest.mark.parametrize("kind", ["charuco", "asymmetric", "leds"])
def test_every_kind_of_board_goes_from_pictures_to_a_lens(tmp_path: Path, kind: str) -> None:
    charuco, grid = Charuco((6, 5), 20.0, 14.0, "5X5_50"), CircleGrid((4, 7), 12.0, asymmetric=True)
    jitter = np.random.default_rng(3).uniform(-5.0, 5.0, (16, 2))
    array = DotArray(np.array([[25.0 * (n % 4) + jitter[n, 0], 25.0 * (n // 4) + jitter[n, 1], 0.0] for n in range(16)]))
    (tmp_path / "leds.csv").write_text(
        "id,x_mm,y_mm,z_mm\n" + "".join(f"{n},{x},{y},0\n" for n, (x, y, _) in enumerate(array.points_mm))
    )
    board, pattern, options = {
        "charuco": (charuco, made_boards.charuco(charuco), "--board 6x5 --square-mm 20 --marker-mm 14 --dictionary 5X5_50"),
        "asymmetric": (grid, made_boards.circles(grid, 9.0), "--board 4x7 --square-mm 12"),
        "leds": (array, made_boards.leds(array, 6.0), f"--points {tmp_path / 'leds.csv'}"),
    }[kind]
    (tmp_path / "pictures").mkdir()
    for n, tilt in enumerate(TILTS):
        image = Picture(LENS, samples=3, seed=n).of(pattern, pose(board.points_mm, 150.0, tilt))
        cv2.imwrite(str(tmp_path / "pictures" / f"{n}.png"), image)
    output = tmp_path / "lens.toml"
    assert lens(tmp_path / "pictures", "--output", output, "--board-type", kind, *options.split(), "--fix-aspect") == DONE
    record = load_lenses(output)["default"]
    assert len(record.pictures) == len(TILTS)
    assert record.lens.fx_px == pytest.approx(210.0, abs=max(2.0, 4 * record.covariance[0, 0] ** 0.5))
    assert record.rms_px < 0.15


def test_pictures_that_do_not_tell_the_lens_are_refused_with_their_reasons(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pictures = photographs(tmp_path / "few", 1, 2)
    cv2.imwrite(str(pictures / "black.png"), np.zeros((480, 640), np.uint8))
    assert chessboard(pictures, "--output", tmp_path / "lens.toml") == REFUSED
    said = capsys.readouterr().err
    assert "2 pictures with the board, 3 are the least" in said
    assert "black.png: no chessboard" in said
    assert not (tmp_path / "lens.toml").exists()


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (("--square-mm", 25), "a board of type chessboard needs --board COLUMNSxROWS"),
        (("--board", "9x6"), "a board of type chessboard needs --square-mm MM"),
        (("--board", "9x6", "--square-mm", 25, "--board-type", "charuco"), "a board of type charuco needs --marker-mm MM"),
        (("--board-type", "leds"), "a board of type leds needs --points FILE"),
        (("--board", "9x1", "--square-mm", 25), "chessboard 9x1: needs at least 3 along each side"),
    ],
)
def test_what_a_board_lacks_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: tuple[object, ...], text: str
) -> None:
    assert lens(PHOTOGRAPHS, "--output", tmp_path / "lens.toml", *arguments) == WRONG
    assert text in capsys.readouterr().err


def test_a_foreign_output_is_not_written_over(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    output = tmp_path / "cell.toml"
    output.write_text('format = "trackerd-calibration"\n')
    assert chessboard(PHOTOGRAPHS, "--output", output) == WRONG
    assert "cell.toml format" in capsys.readouterr().err
    assert output.read_text() == 'format = "trackerd-calibration"\n'


@pytest.mark.parametrize("option", ["--output", "--report"])
def test_a_folder_that_is_not_there_is_told_before_the_work(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], option: str
) -> None:
    places = {"--output": tmp_path / "lens.toml", "--report": tmp_path / "lens.html"} | {
        option: tmp_path / "none" / "lens.toml"
    }
    assert chessboard(PHOTOGRAPHS, *(one for pair in places.items() for one in pair)) == WRONG
    assert f"{option} {tmp_path / 'none' / 'lens.toml'}: there is no folder" in capsys.readouterr().err


def test_a_pattern_or_a_folder_without_pictures_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert chessboard(tmp_path / "*.png", "--output", tmp_path / "lens.toml") == WRONG
    assert "*.png: no file is named so" in capsys.readouterr().err
    assert chessboard(tmp_path, "--output", tmp_path / "lens.toml") == WRONG
    assert "holds no picture" in capsys.readouterr().err
