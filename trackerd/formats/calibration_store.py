"""Every version of a cell's calibration, in a folder beside the active file: NAME.toml has NAME.versions/.

    NAME.toml                       what the daemon reads when it starts: a whole copy of one version
    NAME.versions/ID.toml           the versions, never changed; ID@12345678.toml where two have one id, by the file's SHA-256
    NAME.versions/journal.jsonl     who made which version the active one, when and why: one JSON object a line

Activation replaces the active file in one step. What was active before is kept first, also where a person has edited it:
nothing is ever lost. A daemon that runs has read its file already: it is not touched.
"""

import fcntl
import hashlib
import json
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from urllib.parse import quote, unquote

from trackerd.contract.errors import ConfigError, TrackerdError
from trackerd.formats.atomic import replace_file
from trackerd.formats.calibration import Calibration, load_calibration, save_calibration

JOURNAL, LOCK, NEW = "journal.jsonl", ".lock", ".new.toml"
UNREADABLE = "unreadable"


@dataclass(frozen=True, slots=True)
class Version:
    """One file of the folder. `calibration` is None where it cannot be read, and `trouble` says why."""

    name: str
    path: Path
    sha256: str
    calibration: Calibration | None
    trouble: str = ""

    def sound(self) -> Calibration:
        """Raises ConfigError."""
        if self.calibration is None:
            raise ConfigError(self.trouble)
        return self.calibration


@dataclass(frozen=True, slots=True)
class Entry:
    """One line of the journal."""

    at: str  # ISO 8601
    who: str
    what: str  # activate | rollback
    version: str
    before: str | None  # what was active until then
    why: str


@dataclass(frozen=True, slots=True)
class CalibrationStore:
    active_path: Path

    @property
    def folder(self) -> Path:
        return self.active_path.with_name(f"{self.active_path.stem}.versions")

    def versions(self) -> list[Version]:
        """Oldest first; those that cannot be read last."""
        found = [_version(unquote(path.stem), path) for path in self._files()]
        return sorted(found, key=lambda v: (v.calibration is None, v.calibration.created if v.calibration else "", v.name))

    def version(self, name: str) -> Version:
        """Raises ConfigError where there is no such one."""
        versions = self.versions()
        for version in versions:
            if version.name == name:
                return version
        names = ", ".join(version.name for version in versions) or "none yet"
        raise ConfigError(f"{self.folder.name}: there is no version {name} (there are: {names})")

    def active(self) -> Version | None:
        """The active file by the name that it has, or would get, among the versions. None where there is no such file."""
        if not self.active_path.exists():
            return None
        return self._named(_version("", self.active_path))

    def add(self, calibration: Calibration) -> Version:
        """A new version, not yet the active one. Raises ConfigError as `save_calibration` does, TrackerdError from the disk."""
        with self._locked():
            new = self.folder / NEW
            try:
                save_calibration(calibration, new)
                return self._keep(_version("", new))
            finally:
                new.unlink(missing_ok=True)

    def add_file(self, path: Path) -> Version:
        """As `add`, byte by byte."""
        found = _version("", path)
        found.sound()
        with self._locked():
            return self._keep(found)

    def keep_active(self) -> Version | None:
        """For who is about to write over the active file: it becomes a version, as it is. None where there is no such file."""
        with self._locked():
            return self._keep(_version("", self.active_path)) if self.active_path.exists() else None

    def activate(self, name: str, who: str, why: str, at: str) -> Version:
        """Makes a version the active one. Raises ConfigError where it is none, cannot be read, or is active already."""
        with self._locked():
            return self._replace(self.version(name), "activate", who, why, at)

    def rollback(self, who: str, why: str, at: str) -> Version:
        """Goes back to what was active before. Raises ConfigError where the journal knows of nothing before."""
        with self._locked():
            return self._replace(self.previous(), "rollback", who, why, at)

    def previous(self) -> Version:
        """Where `rollback` would go. Raises ConfigError."""
        stack: list[str] = []
        for entry in self.journal():
            if entry.what == "rollback":
                while stack and stack[-1] != entry.version:
                    stack.pop()
                continue
            if entry.before is not None and (not stack or stack[-1] != entry.before):
                stack.append(entry.before)
            stack.append(entry.version)
        current = self.active()
        if current is not None and stack and stack[-1] == current.name:
            stack.pop()
        if not stack:
            raise ConfigError(f"{self.folder.name}: the journal knows of nothing before the active calibration")
        return self.version(stack[-1])

    def journal(self) -> list[Entry]:
        """Oldest first. Raises ConfigError with the line that is no entry."""
        path = self.folder / JOURNAL
        try:
            lines = path.read_bytes().decode().splitlines() if path.exists() else []
        except (OSError, UnicodeDecodeError) as err:
            raise ConfigError(f"{JOURNAL}: cannot be read: {err}") from None
        return [_entry(number, line) for number, line in enumerate(lines, start=1) if line.strip()]

    # ---- inside ------------------------------------------------------------------------------------------------------

    def _files(self) -> list[Path]:
        return sorted(path for path in self.folder.glob("*.toml") if not path.name.startswith("."))

    def _named(self, found: Version) -> Version:
        """As it is called in the folder; else by the id, or by id and digest where another version has that name."""
        for path in self._files():
            if _digest(path) == found.sha256:
                return Version(unquote(path.stem), path, found.sha256, found.calibration, found.trouble)
        name = UNREADABLE if found.calibration is None else found.calibration.id
        path = self._path(name)
        if found.calibration is None or path.exists():
            name = f"{name}@{found.sha256[:8]}"
            path = self._path(name)
        return Version(name, path, found.sha256, found.calibration, found.trouble)

    def _path(self, name: str) -> Path:
        """A name may hold what a file's may not."""
        file = quote(name, safe="@+ ")
        return self.folder / f"{'%2E' + file[1:] if file.startswith('.') else file}.toml"

    def _keep(self, found: Version) -> Version:
        """Copies a file into the folder, unless it is there."""
        kept = self._named(found)
        if not kept.path.exists():
            replace_file(kept.path, found.path.read_bytes())
        return kept

    def _replace(self, version: Version, what: str, who: str, why: str, at: str) -> Version:
        version.sound()
        before = self._keep(_version("", self.active_path)) if self.active_path.exists() else None
        if before is not None and before.sha256 == version.sha256:
            raise ConfigError(f"{self.active_path.name}: version {version.name} is active already")
        replace_file(self.active_path, version.path.read_bytes())
        entry = Entry(at, who, what, version.name, None if before is None else before.name, why)
        lines = [json.dumps(asdict(one), ensure_ascii=False) for one in (*self.journal(), entry)]
        replace_file(self.folder / JOURNAL, "".join(f"{line}\n" for line in lines).encode(errors="replace"))
        return version

    @contextmanager
    def _locked(self) -> Iterator[None]:
        """One change at a time; what the disk refuses is told in words."""
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            with (self.folder / LOCK).open("w") as lock:
                fcntl.flock(lock, fcntl.LOCK_EX)
                yield
        except OSError as err:
            raise TrackerdError(f"{self.folder}: {err.strerror or err}") from err


def _version(name: str, path: Path) -> Version:
    with suppress(OSError):
        try:
            return Version(name, path, _digest(path), load_calibration(path))
        except ConfigError as err:
            return Version(name, path, _digest(path), None, str(err))
    raise ConfigError(f"{path.name}: cannot be read: {path.absolute()}")


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _entry(number: int, line: str) -> Entry:
    try:
        return Entry(**json.loads(line))
    except (ValueError, TypeError):
        raise ConfigError(f"{JOURNAL} line {number}: is no entry: delete the line") from None
