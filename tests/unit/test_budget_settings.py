"""The file of `trackerd budget`: what it may hold, and what is said about what it may not."""

from pathlib import Path

import numpy as np
import pytest

from trackerd.budget.settings import BudgetSettings, load_budget
from trackerd.budget.stage import make_stage, stations_of
from trackerd.contract.errors import ConfigError
from trackerd.geometry.gimbal import AxisOrder

CONFIG = Path(__file__).parents[2] / "config"
THREE = """
trials = 2
[case.both]
pixel_3sigma_px = 0.3
encoder_arcsec = 10.0
[layout.three.gimbal.left]
position_mm = [-900.0, 100.0, -1200.0]
faces_mm = [0.0, 0.0, 0.0]
az_axis = [0.0, 1.0, 0.0]
[layout.three.gimbal.right]
position_mm = [900.0, -50.0, -1100.0]
faces_mm = [0.0, 0.0, 0.0]
az_axis = [0.0, 1.0, 0.0]
order = "el_outer"
[layout.three.gimbal.above]
position_mm = [0.0, -800.0, -1300.0]
faces_mm = [0.0, 0.0, 0.0]
aim_mm = [5.0, 5.0, 0.0]
"""


def written(folder: Path, text: str) -> Path:
    path = folder / "budget.toml"
    path.write_text(text)
    return path


def test_the_documented_file_holds_the_defaults() -> None:
    assert load_budget(CONFIG / "budget.toml") == BudgetSettings()


def test_the_levels_are_the_thesis_s() -> None:
    cases = BudgetSettings().case
    assert "".join(cases) == "ABCDEFGH"
    assert [case.pixel_sigma_px for case in cases.values()] == pytest.approx(
        [0, 0, 0, 0, 0.03125 / 3, 0.1 / 3, 0.25 / 3, 0.5 / 3]
    )
    assert np.degrees([case.encoder_sigma_rad for case in cases.values()]) == pytest.approx([0, 1 / 360, 0.01, 0.1, 0, 0, 0, 0])


def test_gimbals_stand_anywhere_and_face_what_they_are_told_to(tmp_path: Path) -> None:
    settings = load_budget(written(tmp_path, THREE))
    stations = stations_of(settings, "three")
    assert list(stations) == ["left", "right", "above"]
    assert stations["right"].order is AxisOrder.EL_OUTER
    for station in stations.values():
        base = station.world_from_gimbal
        assert np.allclose(base.rotation.T @ base.rotation, np.eye(3), atol=1e-12)
        assert np.linalg.det(base.rotation) == pytest.approx(1.0)
        assert np.allclose(base.inverse().move(np.zeros(3))[:2], 0.0, atol=1e-9)
        assert base.inverse().move(np.zeros(3))[2] > 0.0
    assert stations["left"].world_from_gimbal.rotation[1, 0] > 0.9  # x_G, the AZ axis, is as upright as it can be


def test_every_station_sees_what_it_is_aimed_at(tmp_path: Path) -> None:
    settings = load_budget(written(tmp_path, THREE))
    stage = make_stage(settings, "three", 2)
    for name, sight in stage.sights.items():
        station = stage.stations[name]
        seen = [station.pixel(p, *angles) for p, angles in zip(stage.points_mm, sight.targets_rad, strict=True)]
        assert np.allclose(seen, sight.targets_px, atol=1e-6)


def test_the_draw_alone_decides_where_the_points_are() -> None:
    settings = BudgetSettings()
    first, again, other = (make_stage(settings, "spacing-500", draw).points_mm for draw in (2, 2, 3))
    assert np.array_equal(first, again)
    assert np.array_equal(first, make_stage(settings, "spacing-1000", 2).points_mm)
    assert not np.allclose(first, other)
    assert (np.abs(first) <= settings.points.half_size_mm).all()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("tirals = 5", r"budget\.toml tirals = 5: unknown key \(did you mean trials\?\)"),
        ("trials = 0", r"budget\.toml trials = 0: must be at least 1"),
        ("[case.A]\npixel_3sigma_px = -1.0", r"budget\.toml \[case\.A\] pixel_3sigma_px = -1\.0: must be at least 0"),
        ("[case.A]\npixel_px = 1.0", r"budget\.toml \[case\.A\] pixel_px = 1\.0: unknown key"),
        ("[case]", r"budget\.toml.*case.*needs at least one table"),
        ("[points]\ncount = 5", r"budget\.toml \[points\] count = 5: must be at least 6"),
        ("[points]\nhalf_size_mm = [1.0, 0.0, 1.0]", r"budget\.toml \[points\] half_size_mm = .*: must be above 0"),
        (
            "[layout.a.gimbal.left]\nposition_mm = [0.0, 0.0, -1000.0]",
            r"budget\.toml \[layout\.a\.?.*gimbal.*: a position needs at least 2 gimbals, here 1",
        ),
        ("[layout.a.gimbal.l]\n[layout.a.gimbal.r]", r"budget\.toml \[layout\.a\.gimbal\.l\].*position_mm: is missing"),
        (
            "[layout.a.gimbal.l]\nposition_mm = [0.0, 0.0, 0.0]\nfaces_mm = [0.0, 0.0, 0.5]\n"
            "[layout.a.gimbal.r]\nposition_mm = [0.0, 900.0, 0.0]",
            r"budget\.toml \[layout\.a\.gimbal\.l\] faces_mm = \[0\.0, 0\.0, 0\.5\]: must be at least 1 mm away from",
        ),
        (
            "[layout.a.gimbal.l]\nposition_mm = [0.0, 0.0, 0.0]\naz_axis = [0.0, 0.0, 1.0]\n"
            "[layout.a.gimbal.r]\nposition_mm = [0.0, 900.0, 0.0]",
            r"budget\.toml \[layout\.a\.gimbal\.l\] az_axis = \[0\.0, 0\.0, 1\.0\]: must be a direction that is not parallel",
        ),
        ('[case."a b"]', r"budget\.toml.*a name has letters, digits, - and _ only"),
        ("[volume]\nsteps = 1", r"budget\.toml \[volume\] steps = 1: must be at least 2"),
    ],
)
def test_what_is_wrong_in_the_file_is_told_with_its_place(tmp_path: Path, text: str, words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        load_budget(written(tmp_path, text))


def test_a_value_laid_over_the_defaults_leaves_the_other_cases() -> None:
    settings = load_budget(None, ["case.A.encoder_arcsec=2.0", "trials=7"])
    assert settings.case["A"].encoder_arcsec == 2.0
    assert len(settings.case) == 8
    assert settings.trials == 7
    with pytest.raises(ConfigError, match=r"budget \[case\.A\] encoder_arcsec = -2: must be at least 0"):
        load_budget(None, ["case.A.encoder_arcsec=-2"])


def test_points_outside_the_image_are_refused_with_the_gimbal_s_name() -> None:
    settings = load_budget(None, ["camera.focal_px=20000.0"])
    with pytest.raises(ConfigError, match=r"budget \[layout\.spacing-1000\.gimbal\.left\]: .* points are outside the image"):
        make_stage(settings, "spacing-1000", 2)


def test_a_gimbal_that_cannot_be_aimed_is_refused_with_its_name(tmp_path: Path) -> None:
    text = "[layout.a.gimbal.l]\nposition_mm = [0.0, 0.0, -1000.0]\n[layout.a.gimbal.r]\nposition_mm = [0.0, 20.0, 0.0]"
    settings = load_budget(written(tmp_path, text))
    with pytest.raises(ConfigError, match=r"budget \[layout\.a\.gimbal\.r\]: "):
        make_stage(settings, "a", 2)
