"""`trackerd inspect` as a person runs it: on pictures, on a recording, and at a running camera (pylon's emulated one)."""

import csv
import re
from pathlib import Path

import cv2
import numpy as np
import pytest
from system.cell import DEMO, trackerd

EMULATED = DEMO.with_name("emulated.toml")
FRAMES = 55


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The probe stands still."""
    folder = tmp_path_factory.mktemp("still") / "recording"
    still = ("--set", 'twin.path.kind="still"')
    made = trackerd("twin", "--config", str(DEMO), *still, "--record", str(folder), "--duration", "1")
    assert made.returncode == 0, made.stderr
    return folder


@pytest.fixture
def working(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty working folder."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def written(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_a_recording_gives_a_page_a_table_and_the_repeatability_of_each_station(recording: Path, working: Path) -> None:
    before = written(recording)
    done = trackerd("inspect", str(recording), "--config", str(DEMO), "--csv", "series.csv")
    assert done.returncode == 0, done.stderr
    pages = ["recording.left.inspect.png", "recording.right.inspect.png"]
    assert written(working) == [*pages, "series.left.csv", "series.right.csv"]
    assert all((working / page).read_bytes().startswith(b"\x89PNG") for page in pages)
    assert all(f"written: {page}" in done.stdout for page in pages)
    assert done.stdout.count(f"frames: {FRAMES}, found in {FRAMES}, missed in 0") == 2
    ratios = [float(ratio) for ratio in re.findall(r"^[xy]: .* ratio ([\d.]+)$", done.stdout, re.MULTILINE)]
    assert len(ratios) == 4
    assert all(0.6 < ratio < 1.7 for ratio in ratios), done.stdout
    with (working / "series.left.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["found"] for row in rows] == ["1"] * FRAMES
    assert int(rows[1]["t_ns"]) - int(rows[0]["t_ns"]) == pytest.approx(1e9 / 55, abs=2)
    assert written(recording) == before


def test_one_picture_of_a_recording_is_measured_with_its_own_stations_lens(recording: Path, working: Path) -> None:
    picture = recording / "right" / "000007.bmp"
    done = trackerd("inspect", str(picture), "--config", str(DEMO), "--out", "page.svg", "--guess", "320,240,62")
    assert done.returncode == 0, done.stderr
    assert "</svg>" in (working / "page.svg").read_text()
    found = re.search(r"^range: ([\d.]+) ± ([\d.]+) mm", done.stdout, re.MULTILINE)
    assert found is not None, done.stdout
    assert float(found[1]) == pytest.approx(2000.0, rel=0.05)
    assert "39 e-/DN, read noise 3 e- (as configured)" in done.stdout


def test_pictures_without_a_ball_end_with_status_4_and_say_why(working: Path) -> None:
    random = np.random.default_rng(1)
    board = np.kron(np.indices((8, 10)).sum(axis=0) % 2, np.ones((40, 40))) * 150 + 50
    (working / "boards").mkdir()
    for n in range(2):
        noisy = np.rint(board + random.standard_normal(board.shape)).astype(np.uint8)
        assert cv2.imwrite(str(working / "boards" / f"{n}.png"), noisy)
    done = trackerd("inspect", "boards")
    assert done.returncode == 4
    assert done.stderr == "trackerd: boards: no ball in 2 of 2 pictures: nothing round in the image passes the verification\n"
    assert written(working) == ["boards", "boards.inspect.png"]


def emulated(folder: Path, recording: Path, *more: str) -> tuple[int, str, str]:
    """The live view of a folder that pylon's emulated camera plays."""
    pytest.importorskip("pypylon", reason="needs trackerd[basler]")
    folders = (f"camera.left.folder={folder}", f"camera.right.folder={recording / 'right'}")
    angles = tuple(f"gimbal.{name}.csv={recording / 'angles.csv'}" for name in ("left", "right"))
    values = [word for value in (*folders, *angles) for word in ("--set", value)]
    done = trackerd("inspect", "--live", "--config", str(EMULATED), "--camera", "left", "--plain", *values, *more)
    return done.returncode, done.stdout, done.stderr


def test_a_running_camera_is_watched_until_its_recording_ends(recording: Path) -> None:
    status, told, wrong = emulated(recording / "left", recording)
    assert status == 0, wrong
    last = told.splitlines()[-1]
    assert "ball: seen" in last
    assert re.search(r"edge width: 0\.9\d px \(sigma\), best 0\.9\d px", last)
    assert re.search(r"radius: 6\d\.\d+ px, scatter 0\.00\d+ over 30 frames", last)
    assert "exposure: good" in last
    assert re.search(r"rate: [\d.]+ Hz, ball in \d+ of \d+ frames", last)


def test_a_running_camera_is_watched_for_so_many_frames(recording: Path) -> None:
    status, told, wrong = emulated(recording / "left", recording, "--frames", "12")
    assert status == 0, wrong
    assert told.splitlines()[-1].endswith("ball in 12 of 12 frames")


def test_a_running_camera_that_sees_no_ball_says_why_and_ends_with_status_4(recording: Path, tmp_path: Path) -> None:
    for n in range(20):
        assert cv2.imwrite(str(tmp_path / f"{n:02d}.bmp"), np.full((480, 640), 9, np.uint8))
    status, told, wrong = emulated(tmp_path, recording)
    assert status == 4, wrong
    last = told.splitlines()[-1]
    assert "ball: not seen: nothing round in the image passes the verification" in last
    assert "the image is dark: lens cap, light, exposure" in last
