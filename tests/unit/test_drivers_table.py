"""Drivers by name, those of other packages too; and the CSV tables that recordings are read from."""

import subprocess
import sys
from importlib.metadata import EntryPoint, EntryPoints
from pathlib import Path
from types import ModuleType

import pytest

import drivers
from drivers.table import read_rows
from trackerd.contract.errors import ConfigError
from trackerd.formats.settings import CameraSettings, GimbalSettings

FACES = [("camera", name, CameraSettings) for name in drivers.CAMERAS] + [
    ("gimbal", name, GimbalSettings) for name in drivers.GIMBALS
]


@pytest.mark.parametrize(("role", "name", "settings"), FACES)
def test_every_driver_has_the_same_face(role: str, name: str, settings: type) -> None:
    module = drivers.load(role, name)
    assert issubclass(module.Settings, settings)
    assert module.Settings.model_config["frozen"]
    assert callable(getattr(module, f"open_{role}"))


@pytest.mark.parametrize(("role", "words"), [("camera", "basler, replay, synthetic"), ("gimbal", "fixed, modbus, replay")])
def test_a_name_that_nobody_offers_is_refused_with_those_that_are_there(role: str, words: str) -> None:
    with pytest.raises(ConfigError, match=rf'driver = "laser": no such {role} driver \(there are: {words}\)'):
        drivers.load(role, "laser")


def test_another_packages_driver_is_found_by_its_entry_point(monkeypatch: pytest.MonkeyPatch) -> None:
    def entry_points(group: str) -> EntryPoints:
        return EntryPoints([EntryPoint("laser", "math", group)] if group == "trackerd.gimbals" else [])

    monkeypatch.setattr(drivers, "entry_points", entry_points)
    assert isinstance(drivers.load("gimbal", "laser"), ModuleType)
    with pytest.raises(ConfigError, match="fixed, laser, modbus, replay"):
        drivers.load("gimbal", "maser")
    with pytest.raises(ConfigError, match="no such camera driver"):
        drivers.load("camera", "laser")


SDKS = ("pypylon", "pymodbus", "cv2", "usb", "serial")


@pytest.mark.parametrize(("role", "name"), [(role, name) for role, name, _ in FACES])
def test_reading_a_drivers_settings_imports_no_sdk(role: str, name: str) -> None:
    code = f"import sys, drivers; drivers.load({role!r}, {name!r}); print(*(set({SDKS}) & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert done.stdout == "\n"


# ---- tables ----------------------------------------------------------------------------------------------------------


def table(folder: Path, content: bytes) -> Path:
    file = folder / "angles.csv"
    file.write_bytes(content)
    return file


def test_rows_know_their_line_and_their_cells(tmp_path: Path) -> None:
    file = table(tmp_path, b"\xef\xbb\xbfframe, note,az_rad\r\n0,x, 0.5\r\n\r\n1,,-1e-3\r\n")
    rows = list(read_rows(file, ("frame", "az_rad")))
    assert [(row.line, row.whole("frame"), row.number("az_rad")) for row in rows] == [(2, 0, 0.5), (4, 1, -0.001)]
    assert rows[0].text("nothing") == ""


def test_a_missing_column_says_what_is_there(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"angles.csv, line 1: no column az_rad: needs frame,az_rad, has 'frame,el_rad'"):
        list(read_rows(table(tmp_path, b"frame,el_rad\n"), ("frame", "az_rad")))


@pytest.mark.parametrize(
    ("cell", "rule"),
    [("", "whole number"), ("-1", "whole number"), ("1.5", "whole number"), ("\u00b2", "whole number")],
)
def test_a_wrong_whole_number_names_file_line_column_and_value(tmp_path: Path, cell: str, rule: str) -> None:
    [row] = read_rows(table(tmp_path, f"frame,x\n{cell},1\n".encode()), ("frame",))
    with pytest.raises(ConfigError, match=rf"angles.csv, line 2: frame = '{cell}': must be a {rule}"):
        row.whole("frame")


@pytest.mark.parametrize("cell", ["nan", "inf", "1,5", "one", ""])
def test_a_wrong_number_names_file_line_column_and_value(tmp_path: Path, cell: str) -> None:
    [row] = read_rows(table(tmp_path, f'frame,x\n0,"{cell}"\n'.encode()), ("frame",))
    with pytest.raises(ConfigError, match=rf"line 2: x = '{cell}': must be a finite number"):
        row.number("x")


@pytest.mark.parametrize(
    "content", [None, b"frame\n\xff\xfe\n", b"frame\n" + b"x" * 200_000], ids=["no file", "no text", "no csv"]
)
def test_a_file_that_cannot_be_read_is_a_configuration_error(tmp_path: Path, content: bytes | None) -> None:
    file = tmp_path / "angles.csv" if content is None else table(tmp_path, content)
    with pytest.raises(ConfigError, match=r"angles.csv: cannot be read"):
        list(read_rows(file, ("frame",)))
