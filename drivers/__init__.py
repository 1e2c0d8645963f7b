"""Devices by name: a table of the drivers that ship with trackerd, and a look-up of those that other packages add.

A driver's module is imported when a configuration names it, so a missing SDK never breaks a cell that does without.
"""

from importlib import import_module
from importlib.metadata import entry_points
from types import ModuleType

from trackerd.contract.errors import ConfigError

CAMERAS = {name: f"drivers.camera.{name}" for name in ("basler", "replay", "synthetic")}
GIMBALS = {name: f"drivers.gimbal.{name}" for name in ("modbus", "replay", "fixed")}


def load(role: str, name: str) -> ModuleType:
    """The module of a driver; `role` is "camera" or "gimbal". Raises ConfigError for a name that nobody offers."""
    table = CAMERAS if role == "camera" else GIMBALS
    if name in table:
        return import_module(table[name])
    added = {point.name: point for point in entry_points(group=f"trackerd.{role}s")}
    if name in added:
        module: ModuleType = added[name].load()
        return module
    known = ", ".join(sorted(table | dict.fromkeys(added, "")))
    raise ConfigError(f'driver = "{name}": no such {role} driver (there are: {known})')
