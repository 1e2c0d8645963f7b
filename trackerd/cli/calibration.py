"""`trackerd calibration`: the versions of a cell's calibration."""

import getpass
import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from trackerd.cli.calibration_page import calibration_lines, difference_lines, standing_words
from trackerd.cli.statuses import DONE, REFUSED
from trackerd.contract.errors import ConfigError
from trackerd.formats.calibration import Volume
from trackerd.formats.calibration_store import CalibrationStore, Version
from trackerd.formats.config import calibration_path
from trackerd.wiring.cell import load

Box = tuple[tuple[float, float, float], tuple[float, float, float]]


@dataclass(frozen=True, slots=True)
class Place:
    """Whose calibration it is. `config`: the cell's file, where it was given."""

    store: CalibrationStore
    config: Path | None
    overrides: Sequence[str]

    @classmethod
    def of(cls, config: Path | None, calibration: Path | None, overrides: Sequence[str]) -> "Place":
        if (config is None) == (calibration is None):
            raise ConfigError("calibration: needs either --config FILE, the cell, or --calibration FILE, its calibration")
        path = calibration if config is None else calibration_path(config, overrides)
        assert path is not None
        return cls(CalibrationStore(path.absolute()), config, overrides)

    def chosen(self, name: str | None) -> Version:
        """A version by its name; the active one without. Raises ConfigError."""
        if name is not None:
            return self.store.version(name)
        active = self.store.active()
        if active is None:
            raise ConfigError(f"{self.store.active_path.name}: no such file: {self.store.active_path}")
        return active

    def check_fits(self, version: Version) -> None:
        """Raises ConfigError where the cell cannot run on that version: a missing station, another sensor."""
        version.sound()
        if self.config is not None:
            load(self.config, [*self.overrides, f"calibration={json.dumps(str(version.path.absolute()))}"])


@dataclass(frozen=True, slots=True)
class Change:
    """What is asked for. `name`: the version; None: the one before."""

    name: str | None
    why: str
    who: str | None
    yes: bool
    volume: Box | None


def now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")


def list_versions(place: Place) -> int:
    active, versions = place.store.active(), place.store.versions()
    for version in versions:
        print(_row(version, active is not None and version.name == active.name))
    if active is not None and active.name not in [version.name for version in versions]:
        print(f"{_row(active, True)} (kept as a version once another one is activated)")
    if active is None and not versions:
        print(f"{place.store.active_path.name}: no calibration yet")
    for entry in place.store.journal():
        before = "" if entry.before is None else f" after {entry.before}"
        print(f"{entry.at} {entry.who}: {entry.what} {entry.version}{before}: {entry.why}")
    return DONE


def _row(version: Version, active: bool) -> str:
    mark = "*" if active else " "
    if version.calibration is None:
        return f"{mark} {version.name}  cannot be read: {version.trouble.splitlines()[0]}"
    c = version.calibration
    chi2 = "" if c.chi2_per_dof is None else f", chi-square {c.chi2_per_dof:.3g}"
    return (
        f"{mark} {version.name}  {c.created}  {c.method}{chi2}{f', from {c.parent}' if c.parent else ''}; {standing_words(c)}"
    )


def show(place: Place, name: str | None, volume: Box | None) -> int:
    version = place.chosen(name)
    for line in calibration_lines(version.sound()):
        print(line)
    active = place.store.active()
    if active is not None and active.name == version.name:
        print("it is the active one")
    else:
        _print_difference(place, version, volume)
    return DONE


def add(place: Place, file: Path) -> int:
    added = place.store.add_file(file)
    print(f"kept as version {added.name}: {added.path}")
    return DONE


def change(place: Place, wanted: Change) -> int:
    """Activates a version, or the one before, after the shift was shown and a person agreed."""
    version = place.store.previous() if wanted.name is None else place.store.version(wanted.name)
    place.check_fits(version)
    print(f"version {version.name} of {version.sound().created}: {standing_words(version.sound())}")
    _print_difference(place, version, wanted.volume)
    if not wanted.yes and not _agreed(version.name):
        print("nothing was changed")
        return REFUSED
    who = wanted.who or getpass.getuser()
    if wanted.name is None:
        place.store.rollback(who, wanted.why, now())
    else:
        place.store.activate(version.name, who, wanted.why, now())
    print(f"active: {version.name}")
    print("a daemon that runs is not touched by this: it uses the old one until it is started again")
    return DONE


def _agreed(name: str) -> bool:
    if not sys.stdin.isatty():
        raise ConfigError("calibration: nobody can be asked here: look at the shift above, and say --yes")
    return input(f"make {name} the active calibration? [y/N] ").strip().lower() in ("y", "yes")


def _print_difference(place: Place, version: Version, volume: Box | None) -> None:
    active = place.store.active()
    if active is None or active.calibration is None:
        print("there is no active calibration to compare with" if active is None else f"not compared: {active.trouble}")
        return
    for line in difference_lines(active.calibration, version.sound(), None if volume is None else Volume(*volume)):
        print(line)
