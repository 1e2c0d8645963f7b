"""Recorded frames through the real camera driver: pylon's emulated cameras play them, and every valid fix is judged."""

import csv
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from system.cell import DEADLINE_S, DEMO, Cell, Message, rms, running_cell, trackerd

EMULATED = DEMO.with_name("emulated.toml")
SECONDS = 4
FRAMES = 55 * SECONDS
CAMERAS = ("left", "right")


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The demo's probe stands still for a second, and then runs on its circle."""
    folder = tmp_path_factory.mktemp("recording")
    made = trackerd("twin", "--config", str(DEMO), "--record", str(folder), "--duration", str(SECONDS))
    assert made.returncode == 0, made.stderr
    return folder


@pytest.fixture(scope="module")
def played(recording: Path) -> Iterator[Cell]:
    """The cell after its run, which ended by itself."""
    pytest.importorskip("pypylon", reason="needs trackerd[basler]")
    folders = (f"camera.{name}.folder={recording / name}" for name in CAMERAS)
    angles = (f"gimbal.{name}.csv={recording / 'angles.csv'}" for name in CAMERAS)
    with running_cell(*folders, *angles, prefix="replay", config=EMULATED) as cell:
        cell.process.wait(SECONDS + DEADLINE_S)
        yield cell


def valid_fixes(cell: Cell) -> list[Message]:
    return [m for m in cell.post.all("position") if m["valid"]]


def reference(recording: Path) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.float64]]:
    """Recorded instants (n,) ns and the probe's true positions there (n, 3) mm."""
    with (recording / "truth.csv").open() as file:
        rows = list(csv.DictReader(file))
    return np.array([int(row["t_ns"]) for row in rows]), np.array([[float(row[f"{k}_mm"]) for k in "xyz"] for row in rows])


def test_the_run_ends_by_itself_when_the_folders_have_been_played(played: Cell) -> None:
    assert played.process.returncode == 0, played.words()
    last = played.post.all("status")[-1]
    for name in CAMERAS:
        station = last["stations"][name]
        assert station["camera"] == {
            "state": "ended", "reason": f"camera {name}: all {FRAMES} images were played", "restarts": 0,
        }  # fmt: skip
        frames = station["frames"]
        assert frames["processed"] + frames["skipped"] + frames["dropped"] == FRAMES
        assert frames["no_angle"] == 0


def test_every_valid_fix_of_a_recording_is_on_the_reference_at_its_own_instant(played: Cell, recording: Path) -> None:
    fixes = valid_fixes(played)
    assert len(fixes) > FRAMES / 2, played.words()  # players and daemon share two cores: a busy machine skips frames
    (offset_ns,) = {s["recording_offset_ns"] for s in played.post.all("status")} - {None}
    recorded_ns = np.array([m["t_unix_ns"] - offset_ns for m in fixes])
    instants_ns, positions_mm = reference(recording)
    nearest = np.abs(recorded_ns[:, None] - instants_ns).argmin(axis=1)
    assert np.abs(recorded_ns - instants_ns[nearest]).max() <= 1000  # recorded angles are stamped in whole us
    assert np.ptp(positions_mm[nearest], axis=0)[:2].min() > 100.0  # it has moved
    errors_mm = np.linalg.norm(np.array([m["position_mm"] for m in fixes]) - positions_mm[nearest], axis=1)
    assert rms(errors_mm) < 0.12
    assert errors_mm.max() < 0.5


def test_what_is_played_says_so_and_stays_off_the_live_key(played: Cell) -> None:
    assert {m["source"] for m in played.post.all("position")} == {"replay"}
    assert {s["source"] for s in played.post.all("status")} == {"replay"}
    assert {s["stations"][name]["axes"]["state"] for s in played.post.all("status") for name in CAMERAS} <= {"offline", "fixed"}
