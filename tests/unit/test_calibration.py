"""The calibration file survives its round trip, and a file that is wrong says where."""

import signal
import subprocess
import sys
import tomllib
from contextlib import suppress
from dataclasses import fields, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from trackerd.contract.errors import ConfigError
from trackerd.formats.calibration import (
    AssumedNoise,
    Calibration,
    DataIdentity,
    Verification,
    Volume,
    load_calibration,
    save_calibration,
)
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


texts = st.text(st.characters(exclude_categories=["Cs"]), min_size=1, max_size=20)
sizes = st.floats(0, 1e6)
limits = st.none() | st.floats(1e-6, 1e6)
verifications = st.builds(
    Verification,
    date=st.just(CREATED),
    points=st.integers(0, 1000),
    rms_mm=sizes,
    max_mm=sizes,
    en_max=sizes,
    rms_limit_mm=limits,
    max_limit_mm=limits,
    en_limit=st.floats(1e-3, 10),
    expires=st.none() | st.datetimes(timezones=st.just(UTC)).map(str),
)
volumes = st.builds(
    lambda a, b: Volume(tuple(map(min, zip(a, b, strict=True))), tuple(map(max, zip(a, b, strict=True)))), triples, triples
)
histories = st.fixed_dictionaries(
    {
        "chi2_per_dof": st.none() | st.floats(0, 1e3),
        "dof": st.none() | st.integers(0, 10**6),
        "parent": st.none() | texts,
        "data": st.none() | st.builds(DataIdentity, texts, st.binary(min_size=32, max_size=32).map(bytes.hex)),
        "noise": st.none() | st.builds(AssumedNoise, sizes, sizes, sizes),
        "volume": st.none() | volumes,
        "verification": st.none() | verifications,
        "zooms": st.just({}) | texts.map(lambda zoom: {"left": zoom}),
        "forced_because": st.just("") | texts.filter(str.strip),
    }
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
    """Bit by bit."""
    for key in (field.name for field in fields(Calibration)):
        if key not in ("stations", "covariance"):
            assert getattr(found, key) == getattr(expected, key)
    assert np.array_equal(found.covariance, expected.covariance)
    assert list(found.stations) == list(expected.stations)
    for name, station in found.stations.items():
        other = expected.stations[name]
        for key in ("name", "lens", "order", "az_sign", "el_sign", "eps_rad", "d_mm"):
            assert getattr(station, key) == getattr(other, key)
        for pose in ("world_from_gimbal", "rg_from_camera"):
            assert np.array_equal(getattr(station, pose).translation_mm, getattr(other, pose).translation_mm)
            assert np.array_equal(getattr(station, pose).rotation, getattr(other, pose).rotation)


@settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(station=stations, history=histories)
def test_any_calibration_comes_back_bit_by_bit(tmp_path: Path, station: Station, history: dict[str, Any]) -> None:
    saved = calibration(stations={"left": station}, forced=bool(history["forced_because"]), **history)
    save_calibration(saved, tmp_path / "c.toml")
    found = load_calibration(tmp_path / "c.toml")
    check_same(found, saved)
    save_calibration(found, tmp_path / "again.toml")
    assert (tmp_path / "again.toml").read_bytes() == (tmp_path / "c.toml").read_bytes()


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


def test_a_process_killed_before_the_last_step_leaves_the_old_file_whole(tmp_path: Path) -> None:
    save_calibration(calibration(id="old"), tmp_path / "c.toml")
    before = (tmp_path / "c.toml").read_bytes()
    script = (
        "import os, pathlib, signal\n"
        "from trackerd.formats.calibration import load_calibration, save_calibration\n"
        "pathlib.Path.replace = lambda *_: os.kill(os.getpid(), signal.SIGKILL)\n"
        f"save_calibration(load_calibration(pathlib.Path({str(DEMO)!r})), pathlib.Path({str(tmp_path / 'c.toml')!r}))\n"
    )
    done = subprocess.run([sys.executable, "-c", script], cwd=DEMO.parents[1], capture_output=True, check=False)
    assert done.returncode == -signal.SIGKILL, done.stderr.decode()
    assert (tmp_path / "c.toml").read_bytes() == before
    assert [path.name for path in tmp_path.iterdir() if not path.name.startswith(".")] == ["c.toml"]
    save_calibration(calibration(id="new"), tmp_path / "c.toml")
    assert load_calibration(tmp_path / "c.toml").id == "new"


def test_what_could_not_be_read_again_is_not_written(tmp_path: Path) -> None:
    save_calibration(calibration(), tmp_path / "c.toml")
    lopsided = np.array(((1.0, 0.1), (0.2, 1.0)))
    with pytest.raises(ConfigError, match=r"c\.toml \[covariance\] matrix: must be symmetric"):
        save_calibration(calibration(id="c-2", parameters=("a", "b"), covariance=lopsided), tmp_path / "c.toml")
    station = replace(load_calibration(DEMO).stations["left"], d_mm=float("nan"))
    with pytest.raises(ConfigError, match=r"c\.toml \[station\.left\] d_mm = nan: must be a finite number"):
        save_calibration(calibration(id="c-2", stations={"left": station}), tmp_path / "c.toml")
    assert load_calibration(tmp_path / "c.toml").id == "c-1"


def of_version_1(**changes: Any) -> dict[str, Any]:
    return spoilt(version=1, chi2_per_dof=1.2, **changes)


def test_version_1_is_read_as_one_that_knows_less(tmp_path: Path) -> None:
    (tmp_path / "c.toml").write_text(tomli_w.dumps(of_version_1()))
    found = load_calibration(tmp_path / "c.toml")
    check_same(replace(found, chi2_per_dof=None, parameters=(), covariance=np.zeros((0, 0))), load_calibration(DEMO))
    assert (found.chi2_per_dof, found.parameters, found.verified) == (1.2, ("left.eps_rad", "left.d_mm"), False)
    save_calibration(found, tmp_path / "new.toml")
    assert tomllib.loads((tmp_path / "new.toml").read_text())["version"] == 2
    check_same(load_calibration(tmp_path / "new.toml"), found)


def test_what_version_1_forced_stays_forced(tmp_path: Path) -> None:
    (tmp_path / "c.toml").write_text(tomli_w.dumps(of_version_1(forced=True)))
    found = load_calibration(tmp_path / "c.toml")
    assert (found.forced, found.forced_because) == (True, "version 1 of the file has no reasons")


def test_version_1_has_no_keys_of_version_2(tmp_path: Path) -> None:
    (tmp_path / "c.toml").write_text(tomli_w.dumps(of_version_1(parent="demo-0")))
    with pytest.raises(ConfigError, match=r'^c\.toml parent = "demo-0": unknown key of version 1'):
        load_calibration(tmp_path / "c.toml")


def verification(**changes: Any) -> Verification:
    return replace(Verification(CREATED, points=8, rms_mm=0.05, max_mm=0.1, en_max=0.9, max_limit_mm=0.1), **changes)


@pytest.mark.parametrize(
    ("changes", "notes"),
    [
        ({}, ()),
        ({"points": 7}, ("unverified: 7 check points, needs 8",)),
        ({"en_max": 1.01, "max_mm": 0.12}, ("unverified: maximum 0.12 mm above 0.1 mm, En 1.01 above 1",)),
        ({"rms_limit_mm": 0.04}, ("unverified: rms 0.05 mm above 0.04 mm",)),
        ({"expires": "2025-06-01"}, ("expired: 2025-06-01",)),
        ({"expires": "2025-06-01T00:00:01Z"}, ()),
        ({"expires": "2025-06-01T02:00:00+02:00"}, ("expired: 2025-06-01T02:00:00+02:00",)),
    ],
)
def test_a_calibration_is_verified_by_enough_good_check_points_until_it_expires(
    changes: dict[str, Any], notes: tuple[str, ...]
) -> None:
    june_ns = round(datetime(2025, 6, 1, tzinfo=UTC).timestamp()) * 1_000_000_000
    found = calibration(verification=verification(**changes)).standing(june_ns)
    assert (found.id, found.forced, found.verified, found.notes) == ("c-1", False, not notes, notes)
    assert found.expired == any("expired" in note for note in notes)


def test_without_check_points_a_calibration_is_unverified_and_a_forced_one_says_why() -> None:
    found = calibration(forced=True, forced_because="the fair opens at nine").standing(0)
    assert (found.forced, found.verified, found.expired) == (True, False, False)
    assert found.notes == ("forced: the fair opens at nine", "unverified: no check points outside the adjustment")


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


def checked(**changes: Any) -> dict[str, Any]:
    """A table [verification] whose status is what its figures say."""
    figures = {"date": CREATED, "points": 8, "rms_mm": 0.05, "max_mm": 0.1, "en_max": 0.9}
    return {"status": "verified", **figures, **changes}


def turned(*rows: list[float]) -> dict[str, Any]:
    return {"rotation": list(rows), "translation_mm": [0.0, -124.5, 40.0]}


WRONG: list[tuple[dict[str, Any], str]] = [
    ({"format": None}, 'format: is no calibration file: format must be "trackerd-calibration"'),
    ({"format": "camera_info"}, 'format = "camera_info": is no calibration file: format must be "trackerd-calibration"'),
    ({"version": 3}, "version = 3: this trackerd reads versions 1 and 2 of the calibration file"),
    ({"version": True}, "version = true: this trackerd reads versions 1 and 2 of the calibration file"),
    ({"version": None}, "version: this trackerd reads versions 1 and 2 of the calibration file"),
    ({"id": None}, "id: is missing and has no default"),
    ({"id": 7}, "id = 7: must be text in quotes"),
    ({"created": "yesterday"}, 'created = "yesterday": must be a time as ISO 8601 writes it, e.g. "2025-03-01T08:00:00+00:00"'),
    ({"chi2_per_dof": -1}, "chi2_per_dof = -1: must be at least 0"),
    ({"forced": "no"}, 'forced = "no": must be true or false'),
    ({"forced": True}, "forced_because: needs the reason why it was forced, in words"),
    ({"forced_because": "haste"}, "forced = false: must be true where forced_because gives a reason"),
    ({"dof": 1.5}, "dof = 1.5: must be a whole number"),
    ({"data": {"name": "day 1", "sha256": "12ab"}},
     '[data] sha256 = "12ab": must be 64 hexadecimal digits, as sha256sum prints them'),
    ({"noise": {"pixel_px": -0.1, "encoder_rad": 1e-5}}, "[noise] pixel_px = -0.1: must be at least 0"),
    ({"noise": {"pixel_px": 0.1}}, "[noise] encoder_rad: is missing and has no default"),
    ({"volume": {"min_mm": [0, 0, 0], "max_mm": [1, 1, -1]}}, "[volume] max_mm = [1, 1, -1]: must not lie below min_mm"),
    ({"verification": checked(points=7)},
     '[verification] status = "verified": its own figures say unverified: 7 check points, needs 8'),
    ({"verification": checked(status="unverified")},
     '[verification] status = "unverified": its own figures say verified: delete the table to withdraw the verification'),
    ({"verification": checked(status="good")}, '[verification] status = "good": must be one of "verified" or "unverified"'),
    ({"verification": checked(expires="soon")},
     '[verification] expires = "soon": must be a time as ISO 8601 writes it, e.g. "2025-03-01T08:00:00+00:00"'),
    ({"station__left__zoom": 3}, "[station.left] zoom = 3: must be text in quotes"),
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
    ({"station__left__rg_from_camera": {"translation_mm": [0.0, 0.0, 0.0]}},
     "[station.left.rg_from_camera] rotation: needs either rotation, three rows, or quaternion_wxyz"),
    ({"station__left__rg_from_camera__rotation": [[1, 0, 0], [0, 1, 0], [0, 0, 1]]},
     "[station.left.rg_from_camera] rotation = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]:"
     " needs either rotation, three rows, or quaternion_wxyz"),
    ({"station__left__rg_from_camera": turned([1, 0, 0], [0, 1, 0], [0, 0.001, 1])},
     "[station.left.rg_from_camera] rotation = [[1, 0, 0], [0, 1, 0], [0, 0.001, 1]]:"
     " is no rotation: its rows are not orthogonal units (off by 0.001)"),
    ({"station__left__rg_from_camera": turned([1, 0, 0], [0, 1, 0], [0, 0, -1])},
     "[station.left.rg_from_camera] rotation = [[1, 0, 0], [0, 1, 0], [0, 0, -1]]:"
     " is a mirror image, no rotation: its determinant is -1"),
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


@given(at=st.floats(0, 1), dropped=st.integers(0, 30), put=st.binary(max_size=12))
@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_a_file_that_was_damaged_anywhere_is_read_or_a_configuration_error(
    tmp_path: Path, at: float, dropped: int, put: bytes
) -> None:
    whole = DEMO.read_bytes()
    place = round(at * len(whole))
    (tmp_path / "c.toml").write_bytes(whole[:place] + put + whole[place + dropped :])
    with suppress(ConfigError):
        load_calibration(tmp_path / "c.toml")


values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=3), inner, max_size=3),
    max_leaves=8,
).filter(lambda value: value is not None)


@given(st.data(), values)
@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_value_in_any_place_is_taken_or_a_configuration_error(tmp_path: Path, data: st.DataObject, value: Any) -> None:
    save_calibration(calibration(verification=verification(), volume=Volume((0, 0, 0), (1, 1, 1))), tmp_path / "whole.toml")
    tables = tomllib.loads((tmp_path / "whole.toml").read_text())
    here = tables
    while True:
        key = data.draw(st.sampled_from(sorted(here)))
        if not isinstance(here[key], dict) or data.draw(st.booleans()):
            break
        here = here[key]
    here[key] = value
    try:
        text = tomli_w.dumps(tables)
    except (TypeError, ValueError):
        return  # TOML cannot say it: a None inside a list
    (tmp_path / "c.toml").write_text(text)
    with suppress(ConfigError):
        load_calibration(tmp_path / "c.toml")


@given(st.binary(max_size=200))
@settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_foreign_bytes_are_a_configuration_error(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "c.toml").write_bytes(data)
    with pytest.raises(ConfigError, match=r"^c\.toml"):
        load_calibration(tmp_path / "c.toml")
