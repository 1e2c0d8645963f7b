"""`trackerd calibration`: what it prints, changes and refuses."""

import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from trackerd.cli import main
from trackerd.formats.calibration import (
    AssumedNoise,
    Calibration,
    DataIdentity,
    Verification,
    Volume,
    load_calibration,
    save_calibration,
)

CONFIG = Path(__file__).parents[2] / "config"
DONE, WRONG, REFUSED = 0, 2, 3
PARAMETERS = (
    "left.world_from_gimbal.rx_rad",
    "left.world_from_gimbal.ry_rad",
    "left.world_from_gimbal.rz_rad",
    "left.lens.fx_px",
)
SIGMAS = (1e-5, 2e-5, 3e-5, 12.0)


def calibration(id_: str, **changes: Any) -> Calibration:
    """Of the demo's stations, with all that can be known."""
    known = replace(
        load_calibration(CONFIG / "demo-calibration.toml"),
        id=id_,
        method="bundle",
        parent="demo-1",
        chi2_per_dof=1.02,
        dof=1234,
        parameters=PARAMETERS,
        covariance=np.diag(np.square(SIGMAS)),
        data=DataIdentity("may", "ab" * 32),
        noise=AssumedNoise(0.1, 9.7e-6, 4.85e-6),
        volume=Volume((-100.0, -100.0, -50.0), (100.0, 100.0, 50.0)),
        verification=Verification("2025-03-01", points=12, rms_mm=0.04, max_mm=0.09, en_max=0.8, expires="2999-01-01"),
        zooms={"left": "tele"},
    )
    return replace(known, **changes)


def turned(id_: str, **changes: Any) -> Calibration:
    """The left camera's principal point is a pixel further right."""
    stations = calibration(id_).stations
    left = stations["left"]
    moved = replace(left, lens=replace(left.lens, cx_px=left.lens.cx_px + 1.0))
    return calibration(id_, stations={**stations, "left": moved}, created="2025-06-01T00:00:00+00:00", **changes)


@pytest.fixture
def cell(tmp_path: Path) -> Path:
    """The demo, with a version `june` beside its calibration."""
    for name in ("demo.toml", "demo-calibration.toml"):
        shutil.copyfile(CONFIG / name, tmp_path / name)
    save_calibration(turned("june"), tmp_path / "june.toml")
    assert run(tmp_path / "demo.toml", "add", str(tmp_path / "june.toml")) == DONE
    return tmp_path / "demo.toml"


def run(cell: Path, *words: str) -> int:
    return main(["calibration", *words, "--config", str(cell)])


def active(cell: Path) -> str:
    return load_calibration(cell.with_name("demo-calibration.toml")).id


# ---- list and show ---------------------------------------------------------------------------------------------------


def test_list_tells_every_version_its_standing_and_the_journal(cell: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run(cell, "activate", "june", "--why", "lens touched", "--who", "ada", "--yes")
    capsys.readouterr()
    assert run(cell, "list") == DONE
    first, second, entry = capsys.readouterr().out.splitlines()
    assert first == "  demo-1  2025-01-01T00:00:00+00:00  nominal; unverified: no check points outside the adjustment"
    assert second == "* june  2025-06-01T00:00:00+00:00  bundle, chi-square 1.02, from demo-1; verified"
    assert entry.endswith(" ada: activate june after demo-1: lens touched")


def test_an_active_calibration_that_is_no_version_yet_and_a_broken_version_are_listed(
    cell: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (cell.with_name("demo-calibration.versions") / "broken.toml").write_text("id = 1")
    assert run(cell, "list") == DONE
    told = capsys.readouterr().out
    assert "  broken  cannot be read: broken.toml format: is no calibration file" in told
    assert "* demo-1 " in told
    assert "(kept as a version once another one is activated)" in told


def test_show_tells_origin_trust_parameters_and_what_it_changes(cell: Path, capsys: pytest.CaptureFixture[str]) -> None:
    capsys.readouterr()
    assert run(cell, "show", "june") == DONE
    told = capsys.readouterr().out
    for words in (
        "standing: verified",
        "chi-square: 1.020 per degree of freedom, 1234 of them",
        "data: may, SHA-256 abababababababab...",
        "noise: 0.1 px, encoders 2 arcsec white and 1 angle-fixed",
        "check points: 12 on 2025-03-01, rms 0.04 mm, maximum 0.09 mm, En 0.8, good until 2999-01-01",
        "station left: az_outer, signs +1 +1, zoom tele",
        "± 2.1, 4.1, 6.2 arcsec about x, y, z",
        "fx 31000.00 ± 12, fy 31000.00, cx 1022.70",
        "against demo-1, in -100..100 x -100..100 x -50..50 mm:",
        "station left: lens fx +0, fy +0, cx +1, cy +0 px",
        "station right: as it was",
    ):
        assert words in told
    rms_mm = float(told.split("the work shifts by ")[1].split()[0])
    assert 0.05 < rms_mm < 0.2  # a pixel is 0.064 mm at 2 m; the lines cross at 31 deg


def test_show_without_a_name_shows_the_active_one(cell: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(cell, "show") == DONE
    told = capsys.readouterr().out
    assert "id: demo-1" in told
    assert "it is the active one" in told
    assert "against" not in told


def test_other_stations_axes_and_places_are_told(cell: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    left, right = calibration("x").stations.values()
    pose = right.world_from_gimbal
    other = replace(
        right,
        az_sign=-1,
        world_from_gimbal=replace(pose, translation_mm=pose.translation_mm + np.array((0.0, 0.3, 0.0))),
        d_mm=right.d_mm + 0.01,
    )
    save_calibration(
        calibration("x", stations={"left": left, "right": other, "top": replace(left, name="top")}), tmp_path / "x.toml"
    )
    save_calibration(calibration("y", stations={"left": left, "top": replace(left, name="top")}), tmp_path / "y.toml")
    run(cell, "add", str(tmp_path / "x.toml"))
    run(cell, "add", str(tmp_path / "y.toml"))
    run(cell, "show", "x")
    told = capsys.readouterr().out
    assert (
        "station right: another order or sign of the axes; gimbal moved by 0.3 mm and turned by 0 arcsec; axes +0 arcsec"
        in told
    )
    assert "station top is new" in told
    run(cell, "show", "y")
    told = capsys.readouterr().out
    assert "the shift of the work cannot be told: two calibrations are compared by two stations or more" in told
    assert "station right is gone" in told


# ---- activate and rollback -------------------------------------------------------------------------------------------


def test_activate_shows_the_shift_and_says_that_a_daemon_must_be_started_again(
    cell: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(cell, "activate", "june", "--why", "lens touched", "--yes", "--volume=-10,-10,-10,10,10,10") == DONE
    told = capsys.readouterr().out
    shift, done = told.index("the work shifts by "), told.index("active: june")
    assert shift < done
    assert "against demo-1, in -10..10 x -10..10 x -10..10 mm:" in told
    assert "it uses the old one until it is started again" in told
    assert active(cell) == "june"


@pytest.mark.parametrize(("answer", "status", "now"), [("y", DONE, "june"), ("", REFUSED, "demo-1"), ("no", REFUSED, "demo-1")])
def test_a_person_is_asked_first(
    cell: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], answer: str, status: int, now: str
) -> None:
    monkeypatch.setattr("sys.stdin.isatty", lambda: True, raising=False)
    monkeypatch.setattr("builtins.input", lambda _: answer)
    assert run(cell, "activate", "june", "--why", "x") == status
    assert active(cell) == now
    assert ("nothing was changed" in capsys.readouterr().out) == (now == "demo-1")


def test_where_nobody_can_be_asked_yes_is_needed(cell: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(cell, "activate", "june", "--why", "x") == WRONG
    assert "nobody can be asked here: look at the shift above, and say --yes" in capsys.readouterr().err
    assert active(cell) == "demo-1"


def test_rollback_goes_back(cell: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = cell.with_name("demo-calibration.toml").read_bytes()
    assert run(cell, "rollback", "--why", "x", "--yes") == WRONG
    assert "the journal knows of nothing before" in capsys.readouterr().err
    run(cell, "activate", "june", "--why", "x", "--yes")
    assert run(cell, "rollback", "--why", "worse", "--yes") == DONE
    assert "active: demo-1" in capsys.readouterr().out
    assert cell.with_name("demo-calibration.toml").read_bytes() == before


def test_a_version_that_the_cell_cannot_run_on_is_refused(
    cell: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    left, _ = calibration("x").stations.values()
    save_calibration(calibration("x", stations={"left": left}), tmp_path / "x.toml")
    run(cell, "add", str(tmp_path / "x.toml"))
    assert run(cell, "activate", "x", "--why", "x", "--yes") == WRONG
    assert 'calibration "x" has no station right (it has: left)' in capsys.readouterr().err
    assert active(cell) == "demo-1"


def test_an_active_file_that_is_broken_can_be_replaced(cell: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cell.with_name("demo-calibration.toml").write_text("broken")
    assert run(cell, "show") == WRONG
    assert run(cell, "list") == DONE
    assert run(cell, "activate", "june", "--why", "mend", "--yes") == DONE
    assert "not compared: demo-calibration.toml end of document: expected '='" in capsys.readouterr().out
    assert active(cell) == "june"


def test_a_calibration_without_a_cell_is_served_too(cell: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = str(cell.with_name("demo-calibration.toml"))
    assert main(["calibration", "show", "june", "--calibration", file]) == DONE
    assert main(["calibration", "list"]) == WRONG
    assert main(["calibration", "list", "--calibration", file, "--config", str(cell)]) == WRONG
    assert capsys.readouterr().err.count("needs either --config FILE, the cell, or --calibration FILE") == 2


def test_what_is_not_there_is_told(cell: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(cell, "show", "may") == WRONG
    assert "there is no version may (there are: june)" in capsys.readouterr().err
    gone = str(tmp_path / "gone.toml")
    assert main(["calibration", "show", "--calibration", gone]) == WRONG
    assert f"gone.toml: no such file: {gone}" in capsys.readouterr().err
    assert main(["calibration", "list", "--calibration", gone]) == DONE
    assert "gone.toml: no calibration yet" in capsys.readouterr().out


@pytest.mark.parametrize("volume", ["1,2,3", "1,1,1,0,0,0", "a,b,c,d,e,f"])
def test_a_volume_that_is_none_is_wrong_usage(cell: Path, volume: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        run(cell, "show", "june", f"--volume={volume}")
    assert ended.value.code == WRONG
    assert "needs X,Y,Z,X,Y,Z, the lower corner first" in capsys.readouterr().err


# ---- lenses of other programs ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("form", ["opencv", "camera_info"])
def test_a_lens_goes_out_and_comes_back(cell: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], form: str) -> None:
    file = tmp_path / "lens.yaml"
    assert run(cell, "export", "--id", "june", "--station", "left", "--format", form, str(file)) == DONE
    assert run(cell, "import", "--station", "left", "--id", "july", str(file)) == DONE
    told = capsys.readouterr().out
    assert f"written: {file}, the lens of left in calibration june" in told
    assert "it is unverified, and its covariance is not known" in told
    found = load_calibration(cell.with_name("demo-calibration.versions") / "july.toml")
    assert found.stations["left"].lens == turned("june").stations["left"].lens
    assert (found.parent, found.method, found.verification) == ("demo-1", "lens of left from lens.yaml", None)
    assert active(cell) == "demo-1"


def test_an_import_drops_what_was_true_of_the_old_lens(cell: Path, tmp_path: Path) -> None:
    run(cell, "activate", "june", "--why", "x", "--yes")
    run(cell, "export", "--station", "right", "--format", "opencv", str(tmp_path / "lens.yml"))
    run(cell, "import", "--station", "right", str(tmp_path / "lens.yml"))
    [path] = cell.with_name("demo-calibration.versions").glob("june+right-lens-*.toml")
    found = load_calibration(path)
    assert (found.parent, found.parameters, found.chi2_per_dof, found.dof, found.verified) == ("june", (), None, None, False)


def test_a_lens_that_does_not_fit_is_refused(cell: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "lens.yaml"
    run(cell, "export", "--station", "left", "--format", "camera_info", str(file))
    fields = yaml.safe_load(file.read_text())
    file.write_text(yaml.safe_dump(fields | {"image_width": 640, "image_height": 480}))
    assert run(cell, "import", "--station", "left", str(file)) == WRONG
    assert "image_width, image_height = 640, 480: the sensor of station left has 2048 x 1536 px" in capsys.readouterr().err
    file.write_text(yaml.safe_dump(fields | {"distortion_model": "equidistant"}))
    assert run(cell, "import", "--station", "left", str(file)) == WRONG
    assert 'distortion_model = "equidistant": is a fisheye lens' in capsys.readouterr().err
    assert run(cell, "import", "--station", "top", str(file)) == WRONG
    assert "calibration demo-1 has no station top (it has: left, right)" in capsys.readouterr().err


def test_a_file_that_cannot_be_written_is_told(cell: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "no" / "lens.yaml"
    assert run(cell, "export", "--station", "left", "--format", "opencv", str(file)) == REFUSED
    assert "cannot be written: No such file or directory" in capsys.readouterr().err
