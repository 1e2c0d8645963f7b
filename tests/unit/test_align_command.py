"""`trackerd align`: what it prints, writes and refuses."""

from pathlib import Path

import numpy as np
import pytest

from trackerd.cli import main
from trackerd.formats.datum import load_datum

CONFIG = Path(__file__).parents[2] / "config"
DONE, WRONG, REFUSED = 0, 2, 3
SHIFT_MM = np.array((100.0, -50.0, 20.0))
NOMINAL = {"A": (0, 0, 0), "B": (400, 0, 0), "C": (0, 300, 0), "D": (400, 300, 20), "E": (0, 0, 250)}
THREE_TWO_ONE = ("--plane", "A,B,C", "--line", "A,B", "--origin", "A")


def written(path: Path, points: dict[str, tuple[float, ...]], sigma: str = "") -> None:
    rows = [f"{name},{','.join(map(str, p))}{sigma and ',' + sigma}" for name, p in points.items()]
    path.write_text("\n".join((f"id,x,y,z{sigma and ',sigma'}", *rows, "")))


@pytest.fixture
def measured(tmp_path: Path) -> dict[str, tuple[float, ...]]:
    """Shifted and off by some hundredths, both files written."""
    rng = np.random.default_rng(4)
    points = {name: tuple((p - SHIFT_MM + rng.normal(0.0, 0.02, 3)).tolist()) for name, p in NOMINAL.items()}
    written(tmp_path / "measured.csv", points, "0.02")
    written(tmp_path / "nominal.csv", NOMINAL)
    return points


def align(folder: Path, *more: str) -> int:
    files = [str(folder / "measured.csv"), str(folder / "nominal.csv")]
    return main(["align", *files, "--name", "mill 3", "--output", str(folder / "datum.toml"), *more])


@pytest.mark.usefixtures("measured")
@pytest.mark.parametrize(("more", "method"), [((), "best fit"), (THREE_TWO_ONE, "3-2-1")])
def test_the_datum_is_written_and_every_points_error_printed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], more: tuple[str, ...], method: str
) -> None:
    assert align(tmp_path, "--config", str(CONFIG / "demo.toml"), *more) == DONE
    told = capsys.readouterr()
    found = load_datum(tmp_path / "datum.toml")
    assert (found.name, found.method, found.calibration_id, found.dof) == ("mill 3", method, "demo-1", 9)
    assert found.chi2_per_dof is not None
    sigmas = np.sqrt(np.diag(found.covariance))
    assert np.all(np.abs(found.world_from_cell.translation_mm - SHIFT_MM) < 4.0 * sigmas[3:])
    assert list(found.errors_mm) == list(NOMINAL)
    assert f"datum: mill 3, {method} of 5 points" in told.out
    assert f"errors: rms {found.rms_mm:.4g} mm, maximum {found.max_mm:.4g} mm" in told.out
    assert "ppm (1 sigma), not applied" in told.out
    assert "E " in told.out
    assert told.err == ""


def test_what_is_odd_is_told_and_what_would_be_without_the_odd_point(
    tmp_path: Path, measured: dict[str, tuple[float, ...]], capsys: pytest.CaptureFixture[str]
) -> None:
    written(tmp_path / "measured.csv", measured | {"D": (305.0, 350.0, 0.0), "X": (1.0, 2.0, 3.0)}, "0.02")
    assert align(tmp_path) == DONE
    told = capsys.readouterr().err
    assert "note: measured, but not nominal: X" in told
    assert "note: chi-square " in told
    assert "note: point D does not fit: off by " in told
    assert "(--leave-out D)" in told
    assert align(tmp_path, "--leave-out", "D", "--leave-out", "X") == DONE
    assert capsys.readouterr().err == ""
    assert set(load_datum(tmp_path / "datum.toml").errors_mm) == {"A", "B", "C", "E"}


def test_a_scale_is_told_where_it_is_no_chance(
    tmp_path: Path, measured: dict[str, tuple[float, ...]], capsys: pytest.CaptureFixture[str]
) -> None:
    written(tmp_path / "measured.csv", {name: tuple(0.9995 * x for x in p) for name, p in measured.items()}, "0.02")
    assert align(tmp_path) == DONE
    assert "ppm further apart than the measured ones (not applied): temperature" in capsys.readouterr().err


@pytest.mark.usefixtures("measured")
def test_without_sigmas_the_scatter_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    written(tmp_path / "measured.csv", NOMINAL)
    assert align(tmp_path) == DONE
    assert "(the files tell no sigma)" in capsys.readouterr().out
    assert load_datum(tmp_path / "datum.toml").chi2_per_dof is None


@pytest.mark.usefixtures("measured")
@pytest.mark.parametrize(
    ("more", "status", "words"),
    [
        (("--plane", "A,B,C"), WRONG, "3-2-1 needs --plane, --line and --origin: --line A,B is missing"),
        (("--plane", "A,B", "--line", "A,B", "--origin", "A"), WRONG, "--plane A,B: needs the names of 3 points: A,B,C"),
        (("--leave-out", "Q"), WRONG, "--leave-out Q: there is no such point in measured.csv or nominal.csv"),
        (("--leave-out", "A", "--leave-out", "B", "--leave-out", "C"), REFUSED, "needs 3 points in common, there are 2"),
        (("--config", "nowhere.toml"), WRONG, "nowhere.toml: no such file"),
    ],
)
def test_what_is_wrong_is_told_and_nothing_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], more: tuple[str, ...], status: int, words: str
) -> None:
    assert align(tmp_path, *more) == status
    assert words in capsys.readouterr().err
    assert not (tmp_path / "datum.toml").exists()


@pytest.mark.usefixtures("measured")
def test_a_folder_that_cannot_be_written_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert align(tmp_path, "--output", str(tmp_path / "no" / "datum.toml")) == REFUSED
    assert "cannot be written: No such file or directory" in capsys.readouterr().err
