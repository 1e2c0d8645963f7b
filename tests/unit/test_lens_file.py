"""The lens file survives its round trip, keeps other zoom settings, and a file that is wrong says where."""

import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w

from trackerd.contract.errors import ConfigError
from trackerd.formats import atomic
from trackerd.formats.dot_file import read_dots
from trackerd.formats.lens_file import LensRecord, UsedPicture, add_lens, load_lenses, save_lenses
from trackerd.geometry.lens import Lens

SHA = "0123456789abcdef" * 4


def record(seed: int = 1, **changes: Any) -> LensRecord:
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(9, 9)) * np.logspace(0, -6, 9)[:, None]
    lens = Lens((640, 480), *(rng.uniform(300, 400, 4)).tolist(), tuple(rng.normal(size=5).tolist()))
    known = LensRecord(
        lens=lens,
        covariance=(root @ root.T + (root @ root.T).T) / 2,
        created="2025-03-01T08:00:00+00:00",
        software="trackerd 0.1.0",
        board="chessboard 9x6, 25 mm",
        rms_px=float(rng.uniform()),
        sigma_px=0.125,
        inflation=1.5,
        pictures={"a.png": UsedPicture(0.2, 54, SHA), "b 2.png": UsedPicture(0.3, 53, SHA[::-1], (7,))},
        left_out={"c.png": 'no "chessboard"'},
        warnings=("only 2 pictures are used",),
        pixel_um=3.45,
    )
    return replace(known, **changes)


def check_same(found: LensRecord, expected: LensRecord) -> None:
    assert np.array_equal(found.covariance, expected.covariance)
    nothing = np.zeros(0)
    assert replace(found, covariance=nothing).__repr__() == replace(expected, covariance=nothing).__repr__()


def test_every_figure_comes_back_bit_by_bit(tmp_path: Path) -> None:
    file = tmp_path / "lens.toml"
    for seed in range(5):
        bare = {"pixel_um": None, "left_out": {}, "warnings": ()} if seed else {}
        save_lenses({"wide": record(seed, **bare), "f 50": record(seed + 10)}, file)
        found = load_lenses(file)
        assert list(found) == ["wide", "f 50"]
        check_same(found["wide"], record(seed, **bare))
        check_same(found["f 50"], record(seed + 10))


def test_a_zoom_setting_is_added_or_replaced_and_the_others_stay(tmp_path: Path) -> None:
    file = tmp_path / "lens.toml"
    for zoom, seed in (("wide", 1), ("tele", 2), ("wide", 3)):
        add_lens(zoom, record(seed), file)
    assert list(load_lenses(file)) == ["wide", "tele"]
    check_same(load_lenses(file)["wide"], record(3))
    check_same(load_lenses(file)["tele"], record(2))


def test_another_cameras_lens_is_not_added(tmp_path: Path) -> None:
    file = tmp_path / "lens.toml"
    add_lens("wide", record(), file)
    other = record(lens=replace(record().lens, sensor_px=(2048, 1536)))
    with pytest.raises(
        ConfigError, match=r"lens.toml \[lens.wide\] sensor_px = \[640, 480\]: these pictures have 2048 x 1536 px"
    ):
        add_lens("tele", other, file)
    check_same(load_lenses(file)["wide"], record())


def test_a_write_that_fails_leaves_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "lens.toml"
    add_lens("wide", record(), file)
    before = file.read_bytes()

    def full(_: int) -> None:
        raise OSError("no space left")

    monkeypatch.setattr(atomic.os, "fsync", full)
    with pytest.raises(OSError, match="no space left"):
        add_lens("tele", record(2), file)
    assert file.read_bytes() == before
    assert list(tmp_path.iterdir()) == [file]


@pytest.mark.parametrize("share", [0.1, 0.5, 0.98])
def test_a_truncated_file_is_refused_by_its_name(tmp_path: Path, share: float) -> None:
    file = tmp_path / "lens.toml"
    add_lens("wide", record(), file)
    text = file.read_text()
    file.write_text(text[: int(share * len(text))])
    with pytest.raises(ConfigError, match=r"lens.toml"):
        load_lenses(file)


@pytest.mark.parametrize(
    ("path", "value", "text"),
    [
        (("format",), "trackerd-calibration", 'lens.toml format = "trackerd-calibration": is no lens file: format must be'),
        (("version",), 2, "lens.toml version = 2: this trackerd reads version 1 of the lens file"),
        (("lens", "wide", "fx_px"), -1.0, "lens.toml [lens.wide] fx_px = -1.0: must be above 0"),
        (("lens", "wide", "fx_px"), None, "lens.toml [lens.wide] fx_px: is missing and has no default"),
        (("lens", "wide", "cx_px"), float("nan"), "lens.toml [lens.wide] cx_px"),
        (("lens", "wide", "focal"), 1.0, "lens.toml [lens.wide] focal = 1.0: unknown key"),
        (("lens", "wide", "created"), "yesterday", "lens.toml [lens.wide] created"),
        (("lens", "wide", "distortion"), [0.1], "lens.toml [lens.wide] distortion"),
        (("lens", "wide", "covariance", "parameters"), ["fx_px"], "[lens.wide.covariance] parameters"),
        (("lens", "wide", "covariance", "matrix"), [[1.0]], "[lens.wide.covariance] matrix: needs 9 rows of 9 numbers"),
        (("lens", "wide", "picture", "a.png", "sha256"), "12", "lens.toml [lens.wide.picture."),
        (("lens", "wide", "picture", "a.png", "sha256"), "f" * 64, "[lens.wide] sha256"),
        (("lens", "wide", "picture"), {}, "lens.toml [lens.wide.picture]"),
    ],
)
def test_a_wrong_file_says_where(tmp_path: Path, path: tuple[str, ...], value: Any, text: str) -> None:
    file = tmp_path / "lens.toml"
    add_lens("wide", record(), file)
    tables = tomllib.loads(file.read_text())
    here = tables
    for name in path[:-1]:
        here = here[name]
    if value is None:
        del here[path[-1]]
    else:
        here[path[-1]] = value
    file.write_text(tomli_w.dumps(tables))
    with pytest.raises(ConfigError) as refused:
        load_lenses(file)
    assert text in str(refused.value)


# ---- coordinates of dots ---------------------------------------------------------------------------------------------


def test_dots_are_read_from_toml_and_from_csv(tmp_path: Path) -> None:
    (tmp_path / "dots.toml").write_text(
        'format = "trackerd-dots"\nversion = 1\nfacing = [0.0, 1.0, 0.0]\ndark = true\n[point]\n'
        "a = [1.0, 2.0, 3.5]\nb = [4.0, 5, 6]\n"
    )
    (tmp_path / "dots.csv").write_text("id,x_mm,y_mm,z_mm\na,1,2,3.5\nb,4,5,6\n")
    toml, csv = read_dots(tmp_path / "dots.toml"), read_dots(tmp_path / "dots.csv")
    assert toml.ids == csv.ids == ("a", "b")
    assert np.array_equal(toml.p_mm, csv.p_mm)
    assert np.array_equal(toml.p_mm, [[1, 2, 3.5], [4, 5, 6]])
    assert (toml.facing, toml.dark) == ((0.0, 1.0, 0.0), True)
    assert (csv.facing, csv.dark) == ((0.0, 0.0, -1.0), False)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('format = "other"\n', "dots.toml format"),
        ('format = "trackerd-dots"\nversion = 7\n', "dots.toml version = 7: this trackerd reads version 1"),
        ('format = "trackerd-dots"\nversion = 1\n', "dots.toml point: is missing"),
        ('format = "trackerd-dots"\nversion = 1\n[point]\na = [1.0, 2.0]\n', "dots.toml [point] a"),
    ],
)
def test_a_wrong_file_of_dots_says_where(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "dots.toml").write_text(text)
    with pytest.raises(ConfigError) as refused:
        read_dots(tmp_path / "dots.toml")
    assert said in str(refused.value)
