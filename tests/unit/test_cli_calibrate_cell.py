"""The commands round a cell's calibration, as a person types them."""

import re
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from unit.made_dataset import ARCSEC, TRUE, spread, write_board_dataset, write_dataset

from trackerd.calibrate.shift import shift_between
from trackerd.cli import calibrate_cell, calibrate_plan
from trackerd.cli.main import main
from trackerd.cli.statuses import DONE, REFUSED, WRONG_INPUT
from trackerd.contract.clock import HostNs
from trackerd.contract.model import AxisAngles, Found
from trackerd.formats.calibration import Calibration, load_calibration
from trackerd.formats.calibration_store import CalibrationStore
from trackerd.formats.mover import read_program
from trackerd.geometry.sightline import Instants, sightline
from trackerd.geometry.sphere import outline
from trackerd.geometry.triangulate import triangulate

DEMO = Path(__file__).parents[2] / "config" / "demo.toml"
Capture = pytest.CaptureFixture[str]


def run(*words: object) -> int:
    return main(["calibrate", *map(str, words)])


@pytest.fixture(autouse=True)
def drawn(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Pictures take seconds: only the test that looks at them has them drawn."""
    if "page" not in request.node.name:
        monkeypatch.setattr(calibrate_cell, "report", lambda *arguments: _words(arguments[3]))
        monkeypatch.setattr(calibrate_plan, "draw", lambda *_: None)


def _words(calibration: Calibration) -> str:
    return f"{calibration.id} {calibration.forced_because}"


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset of 24 points and 8 check points, and the calibration from it."""
    folder = tmp_path_factory.mktemp("made")
    write_dataset(folder / "data", spread(32, seed=3), check=8, seed=3)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(calibrate_cell, "report", lambda *arguments: _words(arguments[3]))
        assert run("cell", folder / "data", "--output", folder / "cell.toml") == DONE
    return folder


def test_fresh_points_are_measured_within_the_covariance_that_the_file_holds(made: Path) -> None:
    """From the file alone: parameters' covariance by differences, the noise of the moment from the lines of sight."""
    found = load_calibration(made / "cell.toml")
    rng = np.random.default_rng(11)
    distances = []
    for p_mm in spread(40, seed=12, half_mm=(150.0, 150.0, 100.0)):
        lines = [_line(name, found.stations[name], TRUE[name], p_mm, rng) for name in TRUE]
        point = triangulate(lines)
        error, cov = point.p_mm - p_mm, point.cov_mm2
        distances.append(error @ np.linalg.solve(cov + 0.012**2 * np.eye(3), error))
    assert 1.2 < np.mean(distances) < 5.0  # of 3; one calibration's error is common to all 40


def _line(name: str, believed: object, true: object, p_mm: np.ndarray, rng: np.random.Generator) -> object:
    az, el = true.aim(p_mm)  # type: ignore[attr-defined]
    camera = true.world_from_camera(az, el).inverse().move(p_mm)  # type: ignore[attr-defined]
    seen = outline(camera, 4.0, true.lens)  # type: ignore[attr-defined]
    x, y = np.array((seen.x_px, seen.y_px)) + rng.normal(0.0, 0.1, 2)
    found = Found(x, y, seen.r_px, np.diag((0.01, 0.01, 0.01)), 1.0, 1.0, 0.0)
    angles = AxisAngles(*(np.array((az, el)) + rng.normal(0.0, 2.0 * ARCSEC, 2)), 2.0 * ARCSEC, 0.0, HostNs(0), 0.0, "latch")
    return sightline(believed, found, angles, 4.0, Instants(HostNs(0), 0.0, HostNs(0)))  # type: ignore[arg-type]


def test_the_file_knows_what_it_was_made_from_and_what_it_is_worth(made: Path) -> None:
    found = load_calibration(made / "cell.toml")
    assert found.method == "bundle"
    assert found.data is not None
    assert len(found.data.sha256) == 64
    assert found.chi2_per_dof == pytest.approx(1.0, abs=0.2)
    assert found.noise is not None
    assert (found.noise.pixel_px, found.noise.encoder_rad) == pytest.approx((0.1, 2.0 * ARCSEC))
    assert found.verification is not None
    assert found.verification.points == 8
    assert found.verification.rms_mm < 0.1
    assert found.volume is not None
    assert not found.forced
    assert [version.calibration.id for version in CalibrationStore(made / "cell.toml").versions() if version.calibration] == [
        found.id
    ]


def test_the_summary_and_the_page_tell_what_a_person_asks_first(made: Path, tmp_path: Path, capsys: Capture) -> None:
    assert run("cell", made / "data", "--output", tmp_path / "cell.toml") == DONE
    out = capsys.readouterr().out
    for words in ("chi2/dof: ", "rms ", "left: az_outer", "rejected: none", "U (k = 2): at worst", "check points: 8:"):
        assert words in out
    for name in ("left.az", "left.el", "right.az", "right.el"):
        assert f"bias of {name}: found from" in out
    assert "what no chi-square sees: " in out
    page = (tmp_path / "cell.html").read_text()
    assert page.count("<img") >= 6
    assert "http://" not in page.replace("http://www.w3.org", "")


def test_without_check_points_it_is_unverified(made: Path, tmp_path: Path, capsys: Capture) -> None:
    folder = Path(shutil.copytree(made / "data", tmp_path / "data"))
    text = (folder / "points.csv").read_text().replace(",check", ",adjust")
    (folder / "points.csv").write_text(text)
    assert run("cell", folder, "--output", tmp_path / "cell.toml") == DONE
    assert "check points: none outside the adjustment: UNVERIFIED" in capsys.readouterr().out
    assert not load_calibration(tmp_path / "cell.toml").verified


def test_what_chi_square_refuses_is_not_written_and_what_is_forced_says_so(tmp_path: Path, capsys: Capture) -> None:
    folder, output = write_dataset(tmp_path / "data", spread(8, seed=6), seed=6), tmp_path / "cell.toml"
    text = (folder / "dataset.toml").read_text().replace("encoder_sigma_arcsec = 2.0", "encoder_sigma_arcsec = 0.8")
    (folder / "dataset.toml").write_text(text)
    output.write_text("what was there before")
    assert run("cell", folder, "--output", output) == REFUSED
    assert "chi-square per degree of freedom" in capsys.readouterr().err
    assert output.read_text() == "what was there before"
    output.unlink()
    assert run("cell", folder, "--output", output, "--force", "old encoders") == DONE
    found = load_calibration(output)
    assert (found.forced, found.forced_because) == (True, "old encoders")
    assert "old encoders" in output.with_suffix(".html").read_text()


def test_after_a_touched_lens_only_that_one_and_its_mount_are_adjusted(made: Path, tmp_path: Path, capsys: Capture) -> None:
    lens = TRUE["left"].lens
    longer = replace(lens, fx_px=lens.fx_px + 400.0, fy_px=lens.fy_px + 400.0)
    touched = replace(TRUE["left"], lens=longer)
    write_dataset(tmp_path / "data", spread(12, seed=8), {"left": touched, "right": TRUE["right"]}, seed=8)
    shutil.copy(made / "cell.toml", tmp_path / "cell.toml")
    request = ("cell", tmp_path / "data", "--output", tmp_path / "cell.toml", "--parent", tmp_path / "cell.toml")
    assert run(*request, "--only", "left", "--free", "lens,hand-eye") == DONE
    out = capsys.readouterr().out
    before = load_calibration(made / "cell.toml")
    assert re.search(rf"against {before.id}: targets move by \d", out)
    assert "stays as it is until `trackerd calibration activate" in out
    assert load_calibration(tmp_path / "cell.toml").id == before.id
    (new,) = [v.sound() for v in CalibrationStore(tmp_path / "cell.toml").versions() if v.sound().id != before.id]
    assert new.parent == before.id
    assert new.stations["left"].lens.fx_px == pytest.approx(31400.0, abs=150.0)
    assert new.stations["right"].lens.fx_px == pytest.approx(before.stations["right"].lens.fx_px, abs=60.0)
    true = {"left": touched, "right": TRUE["right"]}
    grid = spread(10, seed=2, half_mm=(120.0, 120.0, 80.0))
    assert shift_between(true, new.stations, grid).rms_mm < 0.5 * shift_between(true, before.stations, grid).rms_mm + 0.03


def test_what_is_believed_beforehand_is_a_setting_of_the_dataset(tmp_path: Path) -> None:
    folder = write_dataset(tmp_path / "data", spread(8, seed=5), seed=5)
    with (folder / "dataset.toml").open("a") as file:
        file.write("\n[priors]\nf_relative = 0.0001\n")
    assert run("cell", folder, "--output", tmp_path / "cell.toml", "--force", "a wrong belief, on purpose") == DONE
    assert load_calibration(tmp_path / "cell.toml").stations["left"].lens.fx_px == pytest.approx(30500.0, rel=0.001)


def test_the_order_and_the_signs_of_the_axes_are_found(tmp_path: Path, capsys: Capture) -> None:
    flipped = {"left": replace(TRUE["left"], az_sign=-1), "right": replace(TRUE["right"], el_sign=-1)}
    write_dataset(tmp_path / "data", spread(8, seed=4), flipped, seed=4)
    assert run("cell", tmp_path / "data", "--output", tmp_path / "cell.toml", "--signs", "auto") == DONE
    found = load_calibration(tmp_path / "cell.toml").stations
    assert (found["left"].az_sign, found["left"].el_sign) == (-1, 1)
    assert (found["right"].az_sign, found["right"].el_sign) == (1, -1)
    assert {str(station.order) for station in found.values()} == {"az_outer"}
    assert "signs -1 +1" in capsys.readouterr().out


def test_the_thesis_method_is_printed_beside(tmp_path: Path, capsys: Capture) -> None:
    write_board_dataset(tmp_path / "data", views=6, loose=2)
    assert run("cell", tmp_path / "data", "--output", tmp_path / "cell.toml", "--method", "thesis") == DONE
    out = capsys.readouterr().out
    assert re.search(r"left: rms \d\.\d{3} px; x -\d+\.\d\d ± \d+\.\d\d mm, .* psi .* ± .*° \(6 views\)", out)
    assert not (tmp_path / "cell.toml").exists()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--only", "left"), "--only, --free: need --parent FILE"),
        (("--parent", "{made}/cell.toml", "--only", "lefd"), "--only lefd: the dataset has no gimbal of this name.*left"),
        (("--parent", "{made}/none.toml"), "none.toml: no such file"),
        (("--check-points", "Q7"), "--check-points Q7: the dataset has no point of this name"),
    ],
)
def test_what_a_person_mistypes_is_told(
    made: Path, tmp_path: Path, capsys: Capture, words: tuple[str, ...], message: str
) -> None:
    typed = [word.format(made=made) for word in words]
    assert run("cell", made / "data", "--output", tmp_path / "cell.toml", *typed) == WRONG_INPUT
    assert re.search(message, capsys.readouterr().err)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--free", "lense"), "'lense': needs some of pose, axes, hand-eye, lens"),
        (("--signs", "+"), "needs auto, or two signs"),
        (("--volume", "400x400"), "needs a size in mm"),
    ],
)
def test_options_that_mean_nothing_are_wrong_usage(made: Path, capsys: Capture, words: tuple[str, ...], message: str) -> None:
    with pytest.raises(SystemExit):
        run("cell", made / "data", "--output", "cell.toml", *words)
    assert message in capsys.readouterr().err


# ---- plan and capture ------------------------------------------------------------------------------------------------


def plan(tmp_path: Path, name: str, *more: str) -> int:
    volume = ("--volume", "300x300x200@0,0,20", "--points", "6", "--check", "2")
    return run("plan", "--config", DEMO, *volume, "--output", tmp_path / name, *more)


PROGRAMS = [("gcode", "plan.nc"), ("csv", "plan.csv"), ("krl", "plan.src"), ("rapid", "plan.mod")]


@pytest.mark.parametrize(("kind", "name"), PROGRAMS)
def test_a_plan_is_a_program_and_tells_what_it_will_be_worth(tmp_path: Path, capsys: Capture, kind: str, name: str) -> None:
    assert plan(tmp_path, name, "--format", kind) == DONE
    stops = read_program(tmp_path / name)
    assert sum(stop.is_check for stop in stops) == 2
    assert len(stops) == 8
    assert np.abs(np.array([stop.p_mm for stop in stops]) - (0.0, 0.0, 20.0)).max() <= 150.0
    out = capsys.readouterr().out
    assert "left: 40 looks, in two faces at 0 of 8 stops" in out
    worth = re.search(r"predicted: (\d\.\d+) mm rms .* in depth", out)
    assert worth is not None
    assert (float(worth[1]) > 0.1) is (kind in ("krl", "rapid"))  # a robot is coarse, as long as no bars are planned with it
    assert ("bars give it the scale" in out) is (kind in ("krl", "rapid"))


def test_the_predicted_error_is_a_page_beside_the_program(tmp_path: Path) -> None:
    assert plan(tmp_path, "plan.nc") == DONE
    picture = cv2.imread(str(tmp_path / "plan.predicted.png"))
    assert picture is not None
    assert picture.shape[1] > 1200
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 100  # a map in colours


def test_a_plan_that_cannot_be_seen_is_refused(tmp_path: Path, capsys: Capture) -> None:
    assert (
        run("plan", "--config", DEMO, "--volume", "100x100x100@5000,0,-1900", "--output", tmp_path / "plan.nc") == WRONG_INPUT
    )
    assert "cannot be seen: gimbal left" in capsys.readouterr().err
    assert not (tmp_path / "plan.nc").exists()


def test_a_program_with_a_foreign_ending_is_refused(tmp_path: Path, capsys: Capture) -> None:
    assert plan(tmp_path, "plan.txt") == WRONG_INPUT
    assert "a gcode program ends in .nc, .ngc, .gcode, .tap" in capsys.readouterr().err


def test_nothing_is_captured_from_a_real_cell_before_it_is_armed(tmp_path: Path, capsys: Capture) -> None:
    (tmp_path / "plan.csv").write_text("point,x_mm,y_mm,z_mm,dwell_s\nP1,0,0,0,5\n")
    left, right = DEMO.read_text().split("[twin]")[0].split("[camera.right]")
    camera = re.compile(r'driver = "synthetic".*')
    left = camera.sub('driver = "basler"\nserial = "1"', left)
    right = camera.sub('driver = "basler"\nserial = "2"', right)
    ports = iter(("port = 502", "port = 503"))
    text = re.sub(r"port = 0", lambda _: next(ports), f"{left}[camera.right]{right}")
    (tmp_path / "cell.toml").write_text(text)
    shutil.copy(DEMO.parent / "demo-calibration.toml", tmp_path)
    request = ("capture", "--config", tmp_path / "cell.toml", "--plan", tmp_path / "plan.csv", "--output", tmp_path / "data")
    assert run(*request) == WRONG_INPUT
    assert "THE AXES MOVE" in capsys.readouterr().err
    assert not (tmp_path / "data").exists()
