"""The files in config/ load, and say what the code does."""

import re
from pathlib import Path

import numpy as np
import pytest
from pydantic import BaseModel

import drivers
from trackerd.formats.calibration import load_calibration
from trackerd.formats.config import CellConfig, load_cell
from trackerd.formats.settings import Settings

CONFIG = Path(__file__).parents[2] / "config"


def settings_of(role: str, driver: str) -> type[Settings]:
    model: type[Settings] = drivers.load(role, driver).Settings
    return model


@pytest.fixture
def recording(tmp_path: Path) -> list[str]:
    """Overrides that stand in for a recording."""
    (tmp_path / "left").mkdir()
    (tmp_path / "right").mkdir()
    (tmp_path / "angles.csv").touch()
    folders = [f"camera.{name}.folder={tmp_path / name}" for name in ("left", "right")]
    return folders + [f"gimbal.{name}.csv={tmp_path}/angles.csv" for name in ("left", "right")]


def load(name: str, overrides: list[str] | None = None) -> CellConfig:
    return load_cell(CONFIG / name, overrides or [], settings_of=settings_of)


def test_every_file_in_the_folder_is_tested_here() -> None:
    known = {"cell.toml", "demo.toml", "emulated.toml", "demo-calibration.toml", "budget.toml"}
    assert {path.name for path in CONFIG.iterdir() if path.is_file()} == known


def test_the_users_cell_loads() -> None:
    cell = load("cell.toml")
    assert {camera.driver for camera in cell.cameras.values()} == {"basler"}
    assert cell.twin is None
    assert cell.zenoh.key == "probe/position"


def test_the_demo_loads() -> None:
    cell = load("demo.toml")
    assert cell.twin is not None
    assert cell.twin.path.kind == "circle"
    assert cell.calibration == CONFIG / "demo-calibration.toml"


def test_the_recorded_cell_loads_once_there_is_a_recording(recording: list[str], tmp_path: Path) -> None:
    cell = load("emulated.toml", recording)
    assert cell.cameras["left"].model_dump()["folder"] == tmp_path / "left"
    assert cell.gimbals["right"].model_dump()["csv"] == tmp_path / "angles.csv"


def test_relative_paths_start_at_the_file(tmp_path: Path) -> None:
    (tmp_path / "cell.toml").write_bytes((CONFIG / "cell.toml").read_bytes())
    (tmp_path / "demo-calibration.toml").write_bytes((CONFIG / "demo-calibration.toml").read_bytes())
    (tmp_path / "zenoh.json5").touch()
    cell = load_cell(tmp_path / "cell.toml", ["zenoh.overlay=zenoh.json5"], settings_of=settings_of)
    assert cell.calibration == tmp_path / "demo-calibration.toml"
    assert cell.zenoh.overlay == tmp_path / "zenoh.json5"


YOURS = {("probe", "radius_mm"), ("camera.left", "serial"), ("gimbal.left", "host")}


@pytest.mark.parametrize(
    ("table", "part"),
    [
        ("probe", lambda cell: cell.probe),
        ("camera.left", lambda cell: cell.cameras["left"]),
        ("gimbal.left", lambda cell: cell.gimbals["left"]),
        ("fusion", lambda cell: cell.fusion),
        ("zenoh", lambda cell: cell.zenoh),
        ("service", lambda cell: cell.service),
    ],
)
def test_the_users_file_documents_every_key_with_its_default(table: str, part) -> None:
    check_documented("cell.toml", table, part(load("cell.toml")), YOURS)


def test_the_demo_documents_every_key_of_the_twin_with_its_default() -> None:
    check_documented("demo.toml", "twin", load("demo.toml").twin, {("twin.encoder", "white_arcsec")})


def check_documented(file: str, table: str, settings: BaseModel | None, special: set[tuple[str, str]]) -> None:
    assert settings is not None
    text = (CONFIG / file).read_text()
    section = re.search(rf"^\[{re.escape(table)}\].*?(?=^\[|\Z)", text, re.MULTILINE | re.DOTALL)
    for key, info in type(settings).model_fields.items():
        value = getattr(settings, key)
        if isinstance(value, BaseModel):
            check_documented(file, f"{table}.{key}", value, special)
        elif isinstance(value, dict):
            for name, item in value.items():
                check_documented(file, f"{table}.{key}.{name}", item, special)
        else:
            assert section is not None
            assert re.search(rf"^(# )?{key} = ", section[0], re.MULTILINE), f"[{table}] {key} is not documented"
            assert info.is_required() or (table, key) in special or value == info.default, f"[{table}] {key}"


def test_both_stations_of_the_demo_reach_the_whole_work() -> None:
    stations = load_calibration(CONFIG / "demo-calibration.toml").stations
    corners = np.stack(np.meshgrid(*[(-300.0, 0.0, 300.0)] * 3), axis=-1).reshape(-1, 3)
    for station in stations.values():
        angles_deg = np.degrees([station.aim(corner, np.array((1023.5, 767.5))) for corner in corners])
        assert np.abs(angles_deg).max() < 30.0


def test_the_demos_cameras_stand_upright_two_metres_away() -> None:
    for station in load_calibration(CONFIG / "demo-calibration.toml").stations.values():
        az, el = station.aim(np.zeros(3))
        middle = station.pixel(np.zeros(3), az, el)
        right, down = (station.pixel(p, az, el) - middle for p in np.array(((10.0, 0.0, 0.0), (0.0, 10.0, 0.0))))
        assert right[0] == pytest.approx(153.0, abs=2.0)
        assert down[1] == pytest.approx(158.0, abs=2.0)
