"""A cell's configuration file. Every error in it is reported at once, as `file [table] key = value: rule`."""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias, TypeVar

from pydantic import ConfigDict

from trackerd.contract.errors import ConfigError
from trackerd.formats.calibration import Calibration, load_calibration
from trackerd.formats.cell import CellConfig, Devices, findings
from trackerd.formats.rules import NO_VALUE, nearest
from trackerd.formats.settings import (
    CameraSettings,
    FusionSettings,
    GimbalSettings,
    ProbeSettings,
    ServiceSettings,
    Settings,
    ZenohSettings,
)
from trackerd.formats.tables import Problems, Tables, located, override, read_tables, resolved, subtable
from trackerd.formats.twin import TwinSettings

KEYS = ("name", "calibration", "probe", "camera", "gimbal", "fusion", "zenoh", "service", "twin")
NAME = re.compile(r"[a-z][a-z0-9_-]*")
NAME_RULE = "a name has small letters, digits, - and _ only, and begins with a letter"

CALIBRATION_RULE = "must be the calibration file's path in quotes"

SettingsOf: TypeAlias = Callable[[str, str], type[Settings]]
Some = TypeVar("Some", bound=Settings)

__all__ = ["CellConfig", "SettingsOf", "calibration_path", "load_cell"]


def load_cell(path: Path, overrides: Sequence[str] = (), *, settings_of: SettingsOf) -> CellConfig:
    """The cell of a configuration file, with `table.key=value` overrides laid over it.

    `settings_of(role, driver)`, role "camera" or "gimbal", gives the model of a driver's settings and raises ConfigError for a
    driver that is not there. Raises ConfigError with one line for each error.
    """
    tables = read_tables(path)
    problems = Problems(path.name)
    for text in overrides:
        _override(tables, text, problems)
    for key in tables:
        if key not in KEYS:
            problems.add((), key, tables[key], "unknown key or table" + nearest(key, KEYS))
    return _Reader(tables, path.absolute(), problems, settings_of).cell()


def calibration_path(path: Path, overrides: Sequence[str] = ()) -> Path:
    """The calibration file that a cell's file names; nothing else of it is looked at, nor whether the calibration is sound.

    Raises ConfigError.
    """
    tables = read_tables(path)
    problems = Problems(path.name)
    for text in overrides:
        _override(tables, text, problems)
    value = tables.get("calibration", NO_VALUE)
    if not isinstance(value, str) or not value:
        problems.add((), "calibration", value, CALIBRATION_RULE)
    problems.raise_any()
    return located(path.absolute().parent, value)


@dataclass(slots=True)
class _Reader:
    """Takes the tables apart; what is wrong is added to `problems`, and reading goes on."""

    tables: Tables
    path: Path
    problems: Problems
    settings_of: SettingsOf

    def cell(self) -> CellConfig:
        name = self._name()
        probe = self._table("probe", ProbeSettings)
        calibration_path, calibration = self._calibration()
        cameras, gimbals = self._devices("camera", CameraSettings), self._devices("gimbal", GimbalSettings)
        fusion, zenoh = self._table("fusion", FusionSettings), self._table("zenoh", ZenohSettings)
        service = self._table("service", ServiceSettings)
        twin = self._table("twin", TwinSettings) if "twin" in self.tables else None
        self._compare(cameras, gimbals, calibration, twin)
        self.problems.raise_any()
        assert probe is not None  # None comes with a problem
        assert fusion is not None
        assert zenoh is not None
        assert service is not None
        return CellConfig(self.path, name, probe, calibration_path, cameras, gimbals, fusion, zenoh, service, twin)

    def _name(self) -> str:
        name = self.tables.get("name", self.path.stem)
        if not isinstance(name, str) or not NAME.fullmatch(name):
            self.problems.add((), "name", name, NAME_RULE)
        return str(name)

    def _calibration(self) -> tuple[Path, Calibration | None]:
        """Where the calibration is, and what it holds where it can be read."""
        value = self.tables.get("calibration", NO_VALUE)
        if not isinstance(value, str) or not value:
            self.problems.add((), "calibration", value, CALIBRATION_RULE)
            return self.path, None
        path = located(self.path.parent, value)
        if not path.is_file():
            self.problems.add((), "calibration", value, f"no such file: {path}")
            return path, None
        try:
            return path, load_calibration(path)
        except ConfigError as err:
            self.problems.lines.extend(str(err).splitlines())
            return path, None

    def _table(self, name: str, model: type[Some]) -> Some | None:
        return self._checked(model, subtable(self.problems, self.tables, name), (name,))

    def _checked(self, model: type[Some], raw: Tables, table: tuple[str, ...]) -> Some | None:
        found = self.problems.check(model, raw, table)
        return found and resolved(found, self.path.parent, self.problems, table)

    def _devices(self, role: str, common: type[Some]) -> dict[str, Some]:
        """The devices of one role that are right, in the file's order."""
        devices: dict[str, Some] = {}
        for name, raw in subtable(self.problems, self.tables, role).items():
            if not isinstance(raw, dict):
                self.problems.add((role,), name, raw, f"must be a table: [{role}.NAME]")
                continue
            if not NAME.fullmatch(name):
                self.problems.add((role, name), None, NO_VALUE, NAME_RULE)
            settings = self._checked(self._model(role, name, raw, common), raw, (role, name))
            if settings is not None:
                devices[name] = settings
        return devices

    def _model(self, role: str, name: str, raw: Tables, common: type[Some]) -> type[Some]:
        """The driver's settings; what all drivers have in common where the driver is unknown."""
        driver = raw.get("driver")
        if not isinstance(driver, str):
            return common  # whose check says what is wrong with the key
        try:
            model = self.settings_of(role, driver)
        except ConfigError as err:
            rule = str(err).removeprefix(f'driver = "{driver}": ')
            self.problems.add((role, name), "driver", driver, rule)
            return _tolerant(common)
        if not issubclass(model, common):
            raise TypeError(f"{role} driver {driver}: Settings must be a {common.__name__}")
        return model

    def _compare(
        self,
        cameras: dict[str, CameraSettings],
        gimbals: dict[str, GimbalSettings],
        calibration: Calibration | None,
        twin: TwinSettings | None,
    ) -> None:
        camera_names, gimbal_names = (tuple(subtable(self.problems, self.tables, role)) for role in ("camera", "gimbal"))
        devices = Devices(cameras, gimbals, camera_names, gimbal_names, calibration, "twin" in self.tables, twin)
        for table, key, value, rule in findings(devices):
            self.problems.add(table, key, value, rule)


def _tolerant(common: type[Some]) -> type[Some]:
    """Lets an unknown driver's own keys pass: they are not what is wrong."""

    class Tolerant(common):  # type: ignore[valid-type, misc]
        model_config = ConfigDict(extra="ignore")

    return Tolerant


def _override(tables: Tables, text: str, problems: Problems) -> None:
    try:
        path, value = override(tables, text)
    except ConfigError as err:
        problems.lines.append(str(err))
    else:
        problems.overridden[path] = value
