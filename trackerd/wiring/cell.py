"""A cell's configuration with the drivers' own settings in it. Light: no engine and no SDK is imported."""

from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from types import ModuleType

from trackerd.contract.model import Source
from trackerd.formats.config import CellConfig, load_cell
from trackerd.formats.settings import Settings


def driver(role: str, name: str) -> ModuleType:
    """The module of a driver; ConfigError where nobody offers it."""
    module: ModuleType = import_module("drivers").load(role, name)
    return module


def settings_of(role: str, name: str) -> type[Settings]:
    model: type[Settings] = driver(role, name).Settings
    return model


def load(path: Path, overrides: Sequence[str] = ()) -> CellConfig:
    """Raises ConfigError with every error at once."""
    return load_cell(path, overrides, settings_of=settings_of)


def source_of(cell: CellConfig) -> Source:
    """A cell is as real as its least real device."""
    sources = {camera.source for camera in cell.cameras.values()} | {gimbal.source for gimbal in cell.gimbals.values()}
    if cell.twin is not None or Source.TWIN in sources:
        return Source.TWIN
    return Source.REPLAY if Source.REPLAY in sources else Source.LIVE
