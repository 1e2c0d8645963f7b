"""A cell that is not what its file says, calibrated as a person would, by real processes: plan, capture, calibrate, measure."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from system.cell import DEMO, PATIENT, free_port, listen, trackerd

from trackerd.calibrate.shift import shift_between
from trackerd.formats.calibration import Calibration, load_calibration
from trackerd.formats.dataset import read_dataset
from trackerd.geometry.gimbal import Station
from trackerd.sim.gimbal import true_station
from trackerd.wiring.cell import load

OFF = (  # what the gimbals really are, against the nominal file
    "twin.error.left.lever_mm=[0.4,-0.3,25.0]",
    "twin.error.left.stand_tilt_arcsec=[300.0,-200.0]",
    "twin.error.right.lever_mm=[-0.5,0.2,-18.0]",
    "twin.error.right.eps_arcsec=40.0",
)
SMALL = tuple(
    f"camera.{name}.{key}"
    for name in ("left", "right")
    for key in ("width_px=420", "height_px=420", "offset_x_px=814", "offset_y_px=558", "frame_rate_hz=40")
)
VALUES = (*OFF, *SMALL, *PATIENT, "twin.path.kind=external", "twin.path.speed_mm_s=1000", "twin.path.acceleration_mm_s2=5000")
STOPS, CHECKS, LOOKS = 6, 1, 5


def options() -> list[str]:
    return [word for value in (*VALUES, listen(free_port())) for word in ("--set", value)]


def calibrate(*words: str) -> str:
    done = trackerd("calibrate", *words)
    assert done.returncode == 0, done.stderr + done.stdout
    return done.stdout


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A plan, and the dataset of a capture that was interrupted once."""
    folder = tmp_path_factory.mktemp("calibrate")
    volume = ("--volume", "260x260x180", "--points", str(STOPS), "--check", str(CHECKS), "--frames", "6")
    calibrate("plan", "--config", str(DEMO), *options(), *volume, "--output", str(folder / "plan.nc"))
    interrupted(folder)
    capture = ("--plan", str(folder / "plan.nc"), "--output", str(folder / "data"), "--frames", "6", "--deg-s", "30")
    told = calibrate("capture", "--config", str(DEMO), *options(), *capture)
    assert f"left: {LOOKS * (STOPS + CHECKS)} views of {LOOKS * (STOPS + CHECKS)}, 1 face, az over" in told
    return folder


def interrupted(folder: Path) -> None:
    """A capture that is ended, as by a hand on the keyboard, after its first stop."""
    command = [sys.executable, "-m", "trackerd", "calibrate", "capture", "--config", str(DEMO), *options()]
    command += ["--plan", str(folder / "plan.nc"), "--output", str(folder / "data"), "--frames", "6", "--deg-s", "30"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        heard = []
        for line in process.stderr:
            heard.append(line)
            if ": 11 of " in line:
                process.terminate()
        assert process.wait(30) == 0, heard


@pytest.fixture(scope="module")
def found(folder: Path) -> Calibration:
    calibrate("cell", str(folder / "data"), "--output", str(folder / "cell.toml"))
    return load_calibration(folder / "cell.toml")


def true_stations() -> dict[str, Station]:
    cell = load(DEMO, VALUES)
    assert cell.twin is not None
    nominal = load_calibration(cell.calibration).stations
    return {name: true_station(one, cell.twin.error_of(name)) for name, one in nominal.items()}


def test_every_look_of_the_plan_is_in_the_dataset_once(folder: Path) -> None:
    data = read_dataset(folder / "data")
    assert len(data.image_points) == 2 * LOOKS * (STOPS + CHECKS)
    assert all(point.frames == 6 and point.image is not None for point in data.image_points)
    assert sum(point.use == "check" for point in data.points.values()) == CHECKS


def test_the_calibration_measures_where_its_covariance_says(found: Calibration) -> None:
    assert found.chi2_per_dof is not None
    assert 0.5 < found.chi2_per_dof < 1.5
    assert found.volume is not None
    grid = np.array([(x, y, z) for x in (-100, 0, 100) for y in (-100, 0, 100) for z in (-70, 0, 70)], float)
    nominal = load_calibration(DEMO.parent / "demo-calibration.toml").stations
    before, after = (shift_between(one, true_stations(), grid) for one in (nominal, found.stations))
    assert before.rms_mm > 1.0
    assert after.rms_mm < 0.08  # 6 stops of 5 looks: 0.01 to 0.02 mm
    assert found.verification is not None
    assert found.verification.rms_mm < 0.3
    assert not found.verified  # one check point is too few


def test_the_report_needs_no_other_file(folder: Path, found: Calibration) -> None:
    page = (folder / "cell.html").read_text()
    assert page.count("data:image/png;base64,") >= 5
    assert 'src="http' not in page
    assert found.id in page
