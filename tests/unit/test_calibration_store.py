"""Versions of a calibration: kept, activated, rolled back, and what happens to them when something goes wrong."""

import signal
import subprocess
import sys
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from trackerd.contract.errors import ConfigError, TrackerdError
from trackerd.formats import calibration_store
from trackerd.formats.calibration import Calibration, load_calibration, save_calibration
from trackerd.formats.calibration_store import CalibrationStore

ROOT = Path(__file__).parents[2]
DEMO = load_calibration(ROOT / "config" / "demo-calibration.toml")
AT = "2025-03-01T08:00:00+00:00"


def calibration(id_: str, **changes: Any) -> Calibration:
    return replace(DEMO, id=id_, **changes)


@pytest.fixture
def store(tmp_path: Path) -> CalibrationStore:
    """c-1 is active, c-2 and c-3 are there."""
    save_calibration(calibration("c-1"), tmp_path / "cell-calibration.toml")
    found = CalibrationStore(tmp_path / "cell-calibration.toml")
    found.add(calibration("c-2", created="2025-02-01"))
    found.add(calibration("c-3", created="2025-01-02"))
    return found


def activate(store: CalibrationStore, name: str, why: str = "") -> None:
    store.activate(name, "ada", why, AT)


def active(store: CalibrationStore) -> str:
    return load_calibration(store.active_path).id


def test_versions_stand_beside_the_active_file_oldest_first(store: CalibrationStore, tmp_path: Path) -> None:
    assert store.folder == tmp_path / "cell-calibration.versions"
    assert [version.name for version in store.versions()] == ["c-3", "c-2"]
    assert (active(store), store.journal()) == ("c-1", [])


def test_an_activated_version_is_copied_whole_and_what_was_active_is_kept(store: CalibrationStore) -> None:
    before = store.active_path.read_bytes()
    activate(store, "c-2", "lens touched")
    assert store.active_path.read_bytes() == store.version("c-2").path.read_bytes()
    assert not store.active_path.is_symlink()
    assert store.version("c-1").path.read_bytes() == before
    [entry] = store.journal()
    assert (entry.at, entry.who, entry.what, entry.version, entry.before, entry.why) == (
        AT, "ada", "activate", "c-2", "c-1", "lens touched",
    )  # fmt: skip


def test_rollback_goes_back_step_by_step_and_forward_again(store: CalibrationStore) -> None:
    activate(store, "c-2")
    activate(store, "c-3")
    assert store.rollback("ada", "worse", AT).name == "c-2"
    assert store.rollback("ada", "worse still", AT).name == "c-1"
    assert active(store) == "c-1"
    with pytest.raises(ConfigError, match=r"cell-calibration\.versions: the journal knows of nothing before the active"):
        store.rollback("ada", "", AT)
    activate(store, "c-3")
    assert store.rollback("ada", "", AT).name == "c-1"
    assert [entry.what for entry in store.journal()] == ["activate", "activate", "rollback", "rollback", "activate", "rollback"]


def test_a_file_that_a_person_edited_is_kept_too(store: CalibrationStore) -> None:
    activate(store, "c-2")
    text = store.active_path.read_text().replace('software = "trackerd 0.1.0"', 'software = "my hand"')
    store.active_path.write_text(text)
    edited = store.active()
    assert edited is not None
    assert edited.name.startswith("c-2@")
    activate(store, "c-3")
    assert store.rollback("ada", "", AT).name == edited.name
    assert store.active_path.read_text() == text
    assert store.version("c-2").sound().software == "trackerd 0.1.0"


def test_a_file_that_is_to_be_written_over_is_kept_first(store: CalibrationStore, tmp_path: Path) -> None:
    before = store.active_path.read_bytes()
    kept = store.keep_active()
    assert kept is not None
    assert kept.path == store.version("c-1").path
    save_calibration(calibration("c-4"), store.active_path)
    assert store.version("c-1").path.read_bytes() == before
    assert CalibrationStore(tmp_path / "none.toml").keep_active() is None


def test_an_active_file_that_cannot_be_read_is_kept_and_replaced(store: CalibrationStore) -> None:
    store.active_path.write_bytes(b"\xff not TOML")
    broken = store.active()
    assert broken is not None
    assert broken.name.startswith("unreadable@")
    activate(store, "c-2")
    assert active(store) == "c-2"
    assert store.version(broken.name).path.read_bytes() == b"\xff not TOML"
    with pytest.raises(ConfigError, match="is not UTF-8"):
        store.rollback("ada", "", AT)
    assert active(store) == "c-2"


def test_a_cell_without_a_calibration_gets_its_first_one(tmp_path: Path) -> None:
    store = CalibrationStore(tmp_path / "new" / "c.toml")
    assert (store.active(), store.versions()) == (None, [])
    store.add(calibration("c-1"))
    activate(store, "c-1")
    assert active(store) == "c-1"
    assert store.journal()[0].before is None


def test_the_same_calibration_is_kept_once_and_another_of_that_name_beside_it(store: CalibrationStore) -> None:
    assert store.add(calibration("c-2", created="2025-02-01")).name == "c-2"
    other = store.add(calibration("c-2", software="trackerd 9"))
    assert other.name == f"c-2@{other.sha256[:8]}"
    assert store.add(calibration("c-2", software="trackerd 9")).name == other.name
    activate(store, other.name)
    assert load_calibration(store.active_path).software == "trackerd 9"


def test_a_file_is_added_byte_by_byte_and_a_wrong_one_is_not(store: CalibrationStore, tmp_path: Path) -> None:
    text = (ROOT / "config" / "demo-calibration.toml").read_bytes()
    (tmp_path / "by-hand.toml").write_bytes(text)
    assert store.add_file(tmp_path / "by-hand.toml").path.read_bytes() == text
    (tmp_path / "wrong.toml").write_text('format = "camera"')
    with pytest.raises(ConfigError, match=r"wrong\.toml format"):
        store.add_file(tmp_path / "wrong.toml")
    with pytest.raises(ConfigError, match=r"gone\.toml: "):
        store.add_file(tmp_path / "gone.toml")


@pytest.mark.parametrize("name", ["a/b", "..", ".hidden", "ä ö", "50 %", "a\nb", "x" * 60])
def test_any_id_makes_a_file_inside_the_folder(store: CalibrationStore, name: str) -> None:
    added = store.add(calibration(name))
    assert added.path.parent == store.folder
    activate(store, name)
    assert store.version(name).sound().id == name
    assert store.rollback("ada", "", AT).name == "c-1"


def test_an_id_too_long_for_a_files_name_is_told(store: CalibrationStore) -> None:
    with pytest.raises(TrackerdError, match="File name too long"):
        store.add(calibration("x" * 300))
    assert [version.name for version in store.versions()] == ["c-3", "c-2"]


def test_what_cannot_be_activated_is_told(store: CalibrationStore) -> None:
    with pytest.raises(ConfigError, match=r"there is no version c-9 \(there are: c-3, c-2\)"):
        activate(store, "c-9")
    activate(store, "c-2")
    with pytest.raises(ConfigError, match="version c-2 is active already"):
        activate(store, "c-2")
    store.version("c-3").path.write_text("id = 3")
    with pytest.raises(ConfigError, match=r"c-3\.toml format"):
        activate(store, "c-3")
    assert active(store) == "c-2"


def test_a_damaged_journal_is_told_by_its_line(store: CalibrationStore) -> None:
    activate(store, "c-2")
    with (store.folder / "journal.jsonl").open("a") as journal:
        journal.write('{"at": 1}\n')
    with pytest.raises(ConfigError, match=r"journal\.jsonl line 2: is no entry"):
        store.rollback("ada", "", AT)
    assert active(store) == "c-2"


def test_an_activation_that_ends_before_its_entry_can_still_be_rolled_back(
    store: CalibrationStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    activate(store, "c-2")
    real = calibration_store.replace_file

    def full(path: Path, content: bytes) -> None:
        if path.name == "journal.jsonl":
            raise OSError(28, "No space left on device")
        real(path, content)

    with monkeypatch.context() as patched:
        patched.setattr(calibration_store, "replace_file", full)
        with pytest.raises(TrackerdError, match="No space left on device"):
            activate(store, "c-3")
    assert (active(store), store.previous().name) == ("c-3", "c-2")
    store.rollback("ada", "", AT)
    assert active(store) == "c-2"


KILLED = """
import os, pathlib, signal, sys
from trackerd.formats.calibration_store import CalibrationStore
real = pathlib.Path.replace
def replace(source, target):
    if target.name == sys.argv[2]:
        os.kill(os.getpid(), signal.SIGKILL)
    return real(source, target)
pathlib.Path.replace = replace
CalibrationStore(pathlib.Path(sys.argv[1])).activate("c-2", "ada", "", "2025-03-01")
"""


@pytest.mark.parametrize(("at", "expected"), [("c-1.toml", "c-1"), ("cell-calibration.toml", "c-1"), ("journal.jsonl", "c-2")])
def test_a_process_killed_while_it_activates_leaves_the_old_calibration_or_the_new_one_whole(
    store: CalibrationStore, at: str, expected: str
) -> None:
    """Killed before its copy of the old one, before the active file, before the journal has its final name."""
    command = [sys.executable, "-c", KILLED, str(store.active_path), at]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, check=False)
    assert done.returncode == -signal.SIGKILL, done.stderr.decode()
    assert (active(store), store.journal()) == (expected, [])
    activate(store, "c-3")  # nothing stands in the way of the next one
    assert store.rollback("ada", "", AT).name == expected


@settings(max_examples=12, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(steps=st.lists(st.sampled_from(("c-1", "c-2", "c-3", "back", "edit")), max_size=8))
def test_whatever_is_done_nothing_that_was_ever_active_is_lost(
    tmp_path_factory: pytest.TempPathFactory, steps: list[str]
) -> None:
    folder = tmp_path_factory.mktemp("cell")
    store = CalibrationStore(folder / "c.toml")
    for name in ("c-1", "c-2", "c-3"):
        store.add(calibration(name))
    activate(store, "c-1")
    replaced = set()
    for number, step in enumerate(steps):
        before = store.active_path.read_bytes()
        if step == "edit":
            store.active_path.write_bytes(before + f"# {number}\n".encode())
            continue
        replaced.add(before)
        with suppress(ConfigError):  # it is active already, or there is nothing before
            _ = store.rollback("ada", "", AT) if step == "back" else store.activate(step, "ada", "", AT)
    kept = {version.path.read_bytes() for version in store.versions()}
    assert replaced - {store.active_path.read_bytes()} <= kept
    assert all(version.calibration is not None for version in store.versions())
