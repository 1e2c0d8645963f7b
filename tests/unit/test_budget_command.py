"""`trackerd budget` as a person types it."""

import csv
import json
from html.parser import HTMLParser
from pathlib import Path

import cv2
import numpy as np
import pytest

from trackerd.calibrate.cell.known import names_of
from trackerd.cli import main
from trackerd.cli.statuses import DONE, REFUSED, WRONG_INPUT
from trackerd.formats.calibration import load_calibration, save_calibration

CONFIG = Path(__file__).parents[2] / "config"


def budget(*arguments: object) -> int:
    return main(["budget", *map(str, arguments)])


class Pictures(HTMLParser):
    """The names of a page's pictures."""

    def __init__(self, page: Path) -> None:
        super().__init__()
        self.names: list[str] = []
        self.feed(page.read_text())

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag == "img":
            self.names.append(dict(attrs)["src"] or "")


def drawn(picture: Path) -> bool:
    """More than a white sheet."""
    image = cv2.imread(str(picture))
    return image is not None and min(image.shape[:2]) > 400 and bool((image.min(axis=2) < 128).mean() > 0.003)


def test_the_documented_file_runs_and_tells_everything_thrice(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    options = ("--trials", 2, "--seed", 5, "--workers", 1, "--cases", "A,C,H", "--layouts", "spacing-1000", "--out", out)
    assert budget(CONFIG / "budget.toml", *options) == DONE
    text = capsys.readouterr().out
    assert text.startswith("simulated: 2 trials a case, seed 5")
    for number in ("4.1", "4.2", "4.3", "4.4"):
        assert f"Table {number}: " in text
    assert "case  value  unit  thesis  its method  adjustment  bound" in text
    with (out / "budget.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert {row["case"] for row in rows} == {"A", "C", "H"}
    found = json.loads((out / "budget.json").read_text())
    assert found["simulated"] is True
    assert found["settings"]["seed"] == 5
    assert len(found["tables"]) == len(rows)
    assert {(share["case"], share["part"]) for share in found["shares"]} >= {("C", "encoders, white"), ("H", "pixels")}
    assert "Where it comes from" in text
    pictures = Pictures(out / "index.html").names
    assert pictures == ["overview.png", "layout-spacing-1000.png", "errors-spacing-1000.png"]
    assert all(drawn(out / name) for name in pictures)


def test_a_cell_with_a_calibration_has_all_four_shares(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    calibration = load_calibration(CONFIG / "demo-calibration.toml")
    names = names_of(list(calibration.stations.values()))
    chosen = tuple(name for name in names if name.endswith(("gimbal.x_mm", "gimbal.y_mm", "gimbal.z_mm")))
    save_calibration(
        type(calibration)(
            **{key: getattr(calibration, key) for key in ("id", "created", "software", "method", "stations")},
            parameters=chosen,
            covariance=np.eye(len(chosen)) * 0.02**2,
        ),
        tmp_path / "mine.toml",
    )
    text = (CONFIG / "demo.toml").read_text().replace("demo-calibration.toml", "mine.toml")
    (tmp_path / "cell.toml").write_text(text)
    fixed = "gimbal.left.encoder_fixed_arcsec=1.5"
    assert budget("--cell", tmp_path / "cell.toml", "--set", fixed, "--pixel-sigma", 0.2, "--out", tmp_path / "out") == DONE
    printed = capsys.readouterr()
    assert printed.err == ""
    with (tmp_path / "out" / "cell.csv").open(newline="") as file:
        parts = {row["name"]: float(row["share"]) for row in csv.DictReader(file)}
    assert min(parts.values()) > 0.01
    assert parts.pop("all together") == pytest.approx(1.0)
    assert sum(parts.values()) == pytest.approx(1.0)
    assert "U across" in printed.out
    volume = np.loadtxt(tmp_path / "out" / "volume.csv", delimiter=",", skiprows=1)
    assert volume.shape == (729, 15)
    assert all(drawn(tmp_path / "out" / name) for name in Pictures(tmp_path / "out" / "cell.html").names)


def test_a_calibration_without_covariance_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    assert budget("--cell", CONFIG / "demo.toml") == DONE
    printed = capsys.readouterr()
    assert "note: calibration demo-1 states no covariance: its part is not known, and left out" in printed.err
    assert "calibration" in printed.out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--cases", "A,Z"), r"--cases Z: there is no [case.Z] (there are: A, B, C, D, E, F, G, H)"),
        (("--layouts", "mine"), r"--layouts mine: there is no [layout.mine] (there are: spacing-1000, spacing-500)"),
        (("--pixel-sigma", "0.1"), "--pixel-sigma: needs --cell CELL"),
        (("nowhere.toml",), "nowhere.toml: no such file"),
        (("--set", "points.count=2"), "[points] count = 2: must be at least 6"),
    ],
)
def test_what_a_person_mends_is_told_in_a_line(
    arguments: tuple[str, ...], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert budget(*arguments) == WRONG_INPUT
    error = capsys.readouterr().err
    assert words in error
    assert len(error.splitlines()) == 1


@pytest.mark.parametrize(("option", "value"), [("--trials", "0"), ("--seed", "-1"), ("--workers", "x"), ("--cases", "A,,B")])
def test_an_option_that_makes_no_sense_is_wrong_usage(option: str, value: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        budget(option, value)
    assert ended.value.code == WRONG_INPUT
    assert f"argument {option}" in capsys.readouterr().err


def test_a_folder_that_cannot_be_made_ends_before_the_work(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").touch()
    assert budget("--out", tmp_path / "file" / "out") == REFUSED
    assert "cannot be made" in capsys.readouterr().err
