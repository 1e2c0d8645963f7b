"""The calibration file survives its round trip, and a file that is wrong says where."""

import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from trackerd.contract.errors import ConfigError
from trackerd.formats.calibration import Calibration, load_calibration, save_calibration
from trackerd.geometry.gimbal import AxisOrder, Station
from trackerd.geometry.lens import Lens
from trackerd.geometry.rigid import Rigid

DEMO = Path(__file__).parents[2] / "config" / "demo-calibration.toml"
CREATED = "2025-03-01T08:00:00+00:00"

numbers = st.floats(allow_nan=False, allow_infinity=False)
lengths = st.floats(-1e5, 1e5)
positive = st.floats(1e-3, 1e6)
triples = st.tuples(lengths, lengths, lengths)
quaternions = st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda q: np.linalg.norm(q) > 0.1)
poses = st.builds(lambda q, t: Rigid.from_quaternion(np.array(q), np.array(t)), quaternions, triples)
lenses = st.builds(
    Lens,
    sensor_px=st.tuples(st.integers(1, 20_000), st.integers(1, 20_000)),
    fx_px=positive,
    fy_px=positive,
    cx_px=lengths,
    cy_px=lengths,
    distortion=st.tuples(*[numbers] * 5),
)
signs = st.sampled_from((1, -1))
stations = st.builds(
    Station,
    name=st.just("left"),
    world_from_gimbal=poses,
    rg_from_camera=poses,
    lens=lenses,
    order=st.sampled_from(AxisOrder),
    az_sign=signs,
    el_sign=signs,
    eps_rad=st.floats(-0.1, 0.1),
    d_mm=lengths,
)


def covariance(n: int, seed: int = 1) -> np.ndarray[Any, Any]:
    """Of parameters whose sigmas differ by ten orders of magnitude, as radians, mm and pixels do."""
    root = np.random.default_rng(seed).normal(size=(n, n)) * np.logspace(-7, 3, n)[:, None]
    product = root @ root.T
    return (product + product.T) / 2


def calibration(**changes: Any) -> Calibration:
    demo = load_calibration(DEMO)
    known = Calibration("c-1", CREATED, "trackerd 0.1.0", "bundle", demo.stations, chi2_per_dof=1.03)
    return replace(known, **changes)


def check_same(found: Calibration, expected: Calibration) -> None:
    for key in ("id", "created", "software", "method", "parameters", "chi2_per_dof", "forced"):
        assert getattr(found, key) == getattr(expected, key)
    assert np.array_equal(found.covariance, expected.covariance)
    assert list(found.stations) == list(expected.stations)
    for name, station in found.stations.items():
        other = expected.stations[name]
        for key in ("name", "lens", "order", "az_sign", "el_sign", "eps_rad", "d_mm"):
            assert getattr(station, key) == getattr(other, key)
        for pose in ("world_from_gimbal", "rg_from_camera"):
            assert np.array_equal(getattr(station, pose).translation_mm, getattr(other, pose).translation_mm)
            assert np.allclose(getattr(station, pose).rotation, getattr(other, pose).rotation, rtol=0, atol=2e-15)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(station=stations, chi2=st.none() | st.floats(0, 1e3), forced=st.booleans())
def test_any_calibration_comes_back_as_it_was_saved(tmp_path: Path, station: Station, chi2: float | None, forced: bool) -> None:
    saved = calibration(stations={"left": station}, chi2_per_dof=chi2, forced=forced)
    save_calibration(saved, tmp_path / "c.toml")
    check_same(load_calibration(tmp_path / "c.toml"), saved)


@pytest.mark.parametrize("n", [0, 1, 2, 36])
def test_a_covariance_comes_back_bit_by_bit(tmp_path: Path, n: int) -> None:
    saved = calibration(parameters=tuple(f"left.p{i}" for i in range(n)), covariance=covariance(n))
    save_calibration(saved, tmp_path / "c.toml")
    check_same(load_calibration(tmp_path / "c.toml"), saved)


def test_lists_of_numbers_stand_on_one_line_for_the_reader(tmp_path: Path) -> None:
    save_calibration(calibration(parameters=("a", "b"), covariance=covariance(2)), tmp_path / "c.toml")
    assert "\ntranslation_mm = [-550.0, 0.0, -1920.0]\n" in (tmp_path / "c.toml").read_text()


def test_saving_replaces_the_file_and_leaves_nothing_beside_it(tmp_path: Path) -> None:
    (tmp_path / "c.toml").write_text("old")
    save_calibration(calibration(), tmp_path / "c.toml")
    assert [path.name for path in tmp_path.iterdir()] == ["c.toml"]
    assert load_calibration(tmp_path / "c.toml").id == "c-1"


def test_a_failed_save_leaves_the_old_file_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "c.toml").write_text("old")

    def full(_: int) -> None:
        raise OSError("no space left on device")

    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(OSError, match="no space left"):
        save_calibration(calibration(), tmp_path / "c.toml")
    assert [path.name for path in tmp_path.iterdir()] == ["c.toml"]
    assert (tmp_path / "c.toml").read_text() == "old"


def test_a_quaternion_is_normalised_on_reading(tmp_path: Path) -> None:
    text = DEMO.read_text().replace("0.990286227959,", "0.990286228500,")
    (tmp_path / "c.toml").write_text(text)
    rotation = load_calibration(tmp_path / "c.toml").stations["left"].world_from_gimbal.rotation
    assert np.allclose(rotation @ rotation.T, np.eye(3), rtol=0, atol=1e-15)


def spoilt(**changes: Any) -> dict[str, Any]:
    """The demo's tables with a covariance, and then each `path__to__key=value` laid over them (None deletes)."""
    tables = tomllib.loads(DEMO.read_text())
    tables["covariance"] = {"parameters": ["left.eps_rad", "left.d_mm"], "matrix": [[1e-10, 0.0], [0.0, 1e-4]]}
    for path, value in changes.items():
        *names, key = path.split("__")
        place = tables
        for name in names:
            place = place[name]
        if value is None:
            del place[key]
        else:
            place[key] = value
    return tables


WRONG: list[tuple[dict[str, Any], str]] = [
    ({"format": None}, 'format: is no calibration file: format must be "trackerd-calibration"'),
    ({"format": "camera_info"}, 'format = "camera_info": is no calibration file: format must be "trackerd-calibration"'),
    ({"version": 2}, "version = 2: this trackerd reads version 1 of the calibration file: calibrate again"),
    ({"version": None}, "version: this trackerd reads version 1 of the calibration file: calibrate again"),
    ({"id": None}, "id: is missing and has no default"),
    ({"id": 7}, "id = 7: must be text in quotes"),
    ({"created": "yesterday"}, 'created = "yesterday": must be a time as ISO 8601 writes it, e.g. "2025-03-01T08:00:00+00:00"'),
    ({"chi2_per_dof": -1}, "chi2_per_dof = -1: must be at least 0"),
    ({"forced": "no"}, 'forced = "no": must be true or false'),
    ({"metod": "bundle"}, 'metod = "bundle": unknown key (did you mean method?)'),
    ({"station": None, "covariance": None}, "station: is missing and has no default"),
    ({"station__left": 3}, "[station] left = 3: must be a table"),
    ({"station__left__order": "elaz"}, '[station.left] order = "elaz": must be one of "az_outer" or "el_outer"'),
    ({"station__left__az_sign": 0}, "[station.left] az_sign = 0: must be one of 1 or -1"),
    ({"station__left__eps_rad": 60.0}, "[station.left] eps_rad = 60.0: must be above -0.2 and below 0.2"),
    ({"station__left__d_mm": None, "station__left__dmm": 0.1}, "[station.left] dmm = 0.1: unknown key (did you mean d_mm?)"),
    ({"station__left__lens": None}, "[station.left] lens: is missing and has no default"),
    ({"station__left__lens__fx_px": -31000}, "[station.left.lens] fx_px = -31000: must be above 0"),
    ({"station__left__lens__fx_px": float("nan")}, "[station.left.lens] fx_px = nan: must be a finite number"),
    ({"station__left__lens__distortion": [0.1, 0.2]}, "[station.left.lens] distortion = [0.1, 0.2]: needs 5 values"),
    ({"station__left__lens__sensor_px": [2048]}, "[station.left.lens] sensor_px = [2048]: needs 2 values"),
    ({"station__right__world_from_gimbal__translation_mm": [1, 2, 3, 4]},
     "[station.right.world_from_gimbal] translation_mm = [1, 2, 3, 4]: needs 3 values"),
    ({"station__right__rg_from_camera__quaternion_wxyz": [1.0, 0.01, 0.0, 0.0]},
     "[station.right.rg_from_camera] quaternion_wxyz = [1.0, 0.01, 0.0, 0.0]: a rotation's quaternion has norm 1, not 1.00005"),
    ({"covariance__matrix": [[1.0, 0.0]]}, "[covariance] matrix: needs 2 rows of 2 numbers, one for each parameter"),
    ({"covariance__matrix": [[1.0, 0.1], [0.0, 1.0]]},
     "[covariance] matrix: must be symmetric: row 0, column 1 differs from its mirror image"),
    ({"covariance__matrix": [[1.0, 2.0], [2.0, 1.0]]},
     "[covariance] matrix: must be positive semidefinite: it gives some combination of parameters a negative variance"),
    ({"covariance__matrix": [[-1e-12, 0.0], [0.0, 1.0]]},
     "[covariance] matrix: must be positive semidefinite: it gives some combination of parameters a negative variance"),
    ({"covariance__parameters": ["left.d_mm", "left.d_mm"]}, '[covariance] parameters: "left.d_mm" is there twice'),
    ({"covariance__parameters": None}, "[covariance] parameters: is missing and has no default"),
]  # fmt: skip


@pytest.mark.parametrize(("changes", "line"), WRONG, ids=[line.partition(": ")[0] for _, line in WRONG])
def test_a_wrong_file_is_told_by_table_key_value_and_rule(tmp_path: Path, changes: dict[str, Any], line: str) -> None:
    (tmp_path / "c.toml").write_text(tomli_w.dumps(spoilt(**changes)))
    with pytest.raises(ConfigError) as caught:
        load_calibration(tmp_path / "c.toml")
    assert f"c.toml {line}" in str(caught.value).splitlines()


def test_all_errors_of_a_file_are_told_at_once(tmp_path: Path) -> None:
    tables = spoilt(id=7, station__left__az_sign=0, station__right__lens__fy_px=0)
    (tmp_path / "c.toml").write_text(tomli_w.dumps(tables))
    with pytest.raises(ConfigError) as caught:
        load_calibration(tmp_path / "c.toml")
    assert len(str(caught.value).splitlines()) == 3


def test_a_file_cut_anywhere_is_refused_or_lacks_nothing(tmp_path: Path) -> None:
    save_calibration(calibration(parameters=("a", "b"), covariance=covariance(2)), tmp_path / "whole.toml")
    whole = (tmp_path / "whole.toml").read_bytes()
    expected = load_calibration(tmp_path / "whole.toml")
    for length in range(0, len(whole), 7):
        (tmp_path / "cut.toml").write_bytes(whole[:length])
        try:
            found = load_calibration(tmp_path / "cut.toml")
        except ConfigError:
            continue
        assert set(found.stations) <= set(expected.stations)


@given(st.binary(max_size=200))
@settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_foreign_bytes_are_a_configuration_error(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "c.toml").write_bytes(data)
    with pytest.raises(ConfigError, match=r"^c\.toml"):
        load_calibration(tmp_path / "c.toml")
