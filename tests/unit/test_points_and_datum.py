"""Files of points, and the datum's own file."""

import hashlib
import tomllib
from contextlib import suppress
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from trackerd.contract.errors import ConfigError
from trackerd.formats.calibration import DataIdentity
from trackerd.formats.datum import Datum, load_datum, save_datum
from trackerd.formats.points import Points, read_points
from trackerd.geometry.rigid import Rigid

SHORT = settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


def read(folder: Path, text: str) -> Points:
    (folder / "p.csv").write_text(text)
    return read_points(folder / "p.csv")


@pytest.mark.parametrize("header", ["id,x,y,z", "point,x_mm,y_mm,z_mm", "id, x , y, z"])
def test_points_are_read_by_name(tmp_path: Path, header: str) -> None:
    found = read(tmp_path, f"# the plate of May\n{header}\nA,1,2,3\n\nB,-0.5,1e2,0\n")
    assert found.ids == ("A", "B")
    assert found.p_mm.tolist() == [[1.0, 2.0, 3.0], [-0.5, 100.0, 0.0]]
    assert found.cov_mm2 is None


@pytest.mark.parametrize(
    ("columns", "values", "cov"),
    [
        ("sigma", "0.1", np.eye(3) * 0.01),
        ("sigma_x_mm,sigma_y_mm,sigma_z_mm", "1,2,3", np.diag((1.0, 4.0, 9.0))),
        ("cxx,cxy,cxz,cyy,cyz,czz", "4,1,0,3,0.5,2", ((4.0, 1.0, 0.0), (1.0, 3.0, 0.5), (0.0, 0.5, 2.0))),
    ],
)
def test_an_uncertainty_is_one_three_or_six_numbers(tmp_path: Path, columns: str, values: str, cov: Any) -> None:
    found = read(tmp_path, f"id,{columns},x,y,z\nA,{values},1,2,3\n")
    assert found.cov_mm2 is not None
    assert np.allclose(found.cov_mm2, [cov], rtol=1e-15)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "p.csv: is empty: its first line names the columns: id,x_mm,y_mm,z_mm"),
        ("id,x,y\nA,1,2\n", "p.csv line 1: has no column z_mm"),
        ("id,x,y,z,sgima\nA,1,2,3,4\n", "p.csv line 1: column 'sgima' is unknown (did you mean sigma_mm?)"),
        ("id,x,x_mm,y,z\n", "p.csv line 1: column 'x_mm' is there twice"),
        ("id,x,y,z\n", "p.csv: holds no point"),
        ("id,x,y,z\nA,1,2\n", "p.csv line 2: has 3 values, the header has 4"),
        ("id,x,y,z\nA,1,2,high\n", "p.csv line 2 z_mm = high: must be a number"),
        ("id,x,y,z\nA,1,2,nan\n", "p.csv line 2 z_mm = nan: must be a finite number"),
        ("id,x,y,z\n,1,2,3\n", "p.csv line 2 id: is missing"),
        ("id,x,y,z\nA,1,2,3\nA,4,5,6\n", "p.csv line 3 id = A: is there twice, first in line 2"),
        ("id,x,y,z,sigma\nA,1,2,3,0\n", "p.csv line 2 sigma_mm = 0: must be above 0"),
        ("id,x,y,z,sigma\nA,1,2,3,1\nB,1,2,3,\n", "p.csv: point B has no uncertainty, others have: all need one, or none"),
        (
            "id,x,y,z,sigma,sigma_x,sigma_y,sigma_z\nA,1,2,3,1,1,1,1\n",
            "p.csv line 2 sigma_x_mm = 1: says again what sigma_mm says",
        ),
        (
            "id,x,y,z,cxx,cxy,cxz,cyy,cyz,czz\nA,1,2,3,1,2,0,1,0,1\n",
            "p.csv line 2 cxx_mm2 = 1: the covariance must be positive definite",
        ),
    ],
)
def test_what_is_wrong_with_points_is_told_by_line_column_value_and_rule(tmp_path: Path, text: str, words: str) -> None:
    with pytest.raises(ConfigError) as caught:
        read(tmp_path, text)
    assert words in str(caught.value).splitlines()


@SHORT
@given(st.binary(max_size=200))
def test_any_bytes_are_points_or_a_configuration_error(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "p.csv").write_bytes(b"id,x,y,z\n" + data)
    with suppress(ConfigError):
        read_points(tmp_path / "p.csv")


# ---- the datum -------------------------------------------------------------------------------------------------------


def identity(name: str) -> DataIdentity:
    return DataIdentity(name, hashlib.sha256(name.encode()).hexdigest())


def datum(**changes: Any) -> Datum:
    root = np.random.default_rng(3).normal(size=(6, 6)) * np.array((1e-6, 1e-6, 1e-6, 0.01, 0.01, 0.01))[:, None]
    known = Datum(
        name="mill 3",
        created="2025-03-01T08:00:00+00:00",
        software="trackerd 0.1.0",
        method="best fit",
        world_from_cell=Rigid.from_quaternion(np.array((0.7, 0.1, -0.6, 0.3)), np.array((1 / 3, -200.0, 900.0))),
        covariance=(root @ root.T + (root @ root.T).T) / 2.0,
        errors_mm={"A": (0.01, -0.02, 0.1), "B": (0.0, 0.0, -0.03)},
        rms_mm=0.07,
        max_mm=0.1,
        dof=3,
        scale=1.00001,
        scale_sigma=2e-5,
        measured=identity("measured.csv"),
        nominal=identity("nominal.csv"),
    )
    return replace(known, **changes)


@SHORT
@given(
    q=st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda q: float(np.linalg.norm(q)) > 0.1),
    t_mm=st.tuples(*[st.floats(-1e6, 1e6)] * 3),
    chi2=st.none() | st.floats(0, 1e9),
    calibration=st.none() | st.just("c-7"),
)
def test_any_datum_comes_back_bit_by_bit(
    tmp_path: Path, q: Any, t_mm: Any, chi2: float | None, calibration: str | None
) -> None:
    pose = Rigid.from_quaternion(np.array(q), np.array(t_mm))
    saved = datum(world_from_cell=pose, chi2_per_dof=chi2, calibration_id=calibration)
    save_datum(saved, tmp_path / "d.toml")
    found = load_datum(tmp_path / "d.toml")
    for key in (field.name for field in fields(Datum)):
        if key not in ("world_from_cell", "covariance"):
            assert getattr(found, key) == getattr(saved, key)
    assert np.array_equal(found.covariance, saved.covariance)
    assert np.array_equal(found.world_from_cell.rotation, pose.rotation)
    assert np.array_equal(found.world_from_cell.translation_mm, pose.translation_mm)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"format": "x"}, 'd.toml format = "x": is no datum: format must be "trackerd-datum"'),
        ({"version": 2}, "d.toml version = 2: this trackerd reads version 1 of the datum"),
        ({"scale": 0.0}, "d.toml scale = 0.0: must be above 0"),
        ({"world_from_cell": 7}, "d.toml world_from_cell = 7: must be a table"),
        ({"measured": {"name": "a", "sha256": "0"}},
         'd.toml [measured] sha256 = "0": must be 64 hexadecimal digits, as sha256sum prints them'),
        ({"covariance": {"parameters": ["x_mm"], "matrix": [[1.0]]}},
         'd.toml [covariance] parameters = ["x_mm"]: must be rx_rad, ry_rad, rz_rad, x_mm, y_mm, z_mm'),
    ],
)  # fmt: skip
def test_a_wrong_datum_is_told_by_table_key_value_and_rule(tmp_path: Path, changes: dict[str, Any], words: str) -> None:
    save_datum(datum(), tmp_path / "d.toml")
    tables = tomllib.loads((tmp_path / "d.toml").read_text()) | changes
    (tmp_path / "d.toml").write_text(tomli_w.dumps(tables))
    with pytest.raises(ConfigError) as caught:
        load_datum(tmp_path / "d.toml")
    assert words in str(caught.value).splitlines()


def test_what_could_not_be_read_again_is_not_written(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"d\.toml rms_mm = nan: must be a finite number"):
        save_datum(datum(rms_mm=float("nan")), tmp_path / "d.toml")
    assert not list(tmp_path.iterdir())
