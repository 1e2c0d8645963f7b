"""A recording of the twin is a dataset, too: frames are views, and the way of the probe tells the places."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from trackerd.calibrate.shift import grid, shift_between
from trackerd.cli import main
from trackerd.formats.calibration import load_calibration

DEMO = str(Path(__file__).parents[2] / "config" / "demo.toml")
WRONG = 2
TWIN = ("--set", 'twin.path.kind="random"', "--set", "twin.path.radius_mm=150", "--set", "twin.path.speed_mm_s=400")


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("recorded") / "recording"
    assert main(["--config", DEMO, *TWIN, "twin", "--record", str(folder), "--duration", "2.2"]) == 0
    return folder


def test_a_recording_calibrates_the_cell_within_its_covariance(recording: Path, tmp_path: Path) -> None:
    output = tmp_path / "cell.toml"
    assert main(["--config", DEMO, "calibrate", "cell", str(recording), "--output", str(output)]) == 0
    found, true = load_calibration(output), load_calibration(recording / "calibration.toml")
    assert found.verified
    assert found.volume is not None
    moved = shift_between(true.stations, found.stations, grid(found.volume.min_mm, found.volume.max_mm, 3))
    assert moved.rms_mm < 0.15  # some seconds of a short way, the probe in the middle of every image
    assert np.isfinite(found.covariance).all()


def test_a_recording_without_its_cell_or_the_way_of_the_probe_says_what_is_missing(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    asked = ["calibrate", "cell", str(recording), "--output", str(tmp_path / "cell.toml")]
    assert main(asked) == WRONG
    assert "a recording needs --config FILE" in capsys.readouterr().err
    blind = tmp_path / "blind"
    shutil.copytree(recording, blind)
    (blind / "truth.csv").unlink()
    assert main(["--config", DEMO, "calibrate", "cell", str(blind), "--output", str(tmp_path / "cell.toml")]) == WRONG
    assert "truth.csv: is missing: t_ns,x_mm,y_mm,z_mm" in capsys.readouterr().err
