"""Photon transfer: gain and read noise with true sigmas, whatever light and scene do; or a refusal that says what it needs."""

import re
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from unit.made_stacks import Levels, Pixels, Sensor, Stack, named, shaking_scene

from trackerd.calibrate.noise import CameraNoise, measure_noise
from trackerd.calibrate.photon_plot import draw
from trackerd.cli import main
from trackerd.contract.errors import ConfigError, TrackerdError, Undetermined

CONFIG = Path(__file__).parents[2] / "config"
DONE, WRONG, REFUSED = 0, 2, 3
RAMP = Stack()
TWELVE = Sensor(2.44, 12.0, 12)


def measured(stack: Stack) -> CameraNoise:
    return measure_noise(named(stack.pictures()))


def deviation(found: CameraNoise, sensor: Sensor) -> Levels:
    return np.array([found.gain_e_per_dn - sensor.gain_e_per_dn, found.read_noise_e - sensor.read_noise_e])


def off(found: CameraNoise, sensor: Sensor = RAMP.sensor) -> float:
    """How far gain and read noise are off, the larger in its own sigmas."""
    return float(np.max(np.abs(deviation(found, sensor)) / np.sqrt(np.diag(found.cov))))


# ---- the figures -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "sensor", [RAMP.sensor, Sensor(39.0, 25.0), TWELVE, Sensor(0.15, 6.0, 16)], ids=lambda s: f"{s.bits} bit"
)
def test_gain_and_read_noise_are_found(sensor: Sensor) -> None:
    found = measured(Stack(sensor))
    assert off(found, sensor) < 3.5
    assert found.gain_sigma_e_per_dn < 0.02 * sensor.gain_e_per_dn
    assert found.read_below_e is None
    assert found.frames == 16
    assert found.used > 0.9
    assert found.notes == ()


@pytest.mark.parametrize("sensor", [RAMP.sensor, TWELVE], ids=lambda s: f"{s.bits} bit")
def test_the_stated_covariance_is_the_scatter_of_many_stacks(sensor: Sensor) -> None:
    nees, chi2 = [], []
    for seed in range(200):
        found = measured(Stack(sensor, seed=seed, frames=8, size_px=(88, 64)))
        error = deviation(found, sensor)
        nees.append(error @ np.linalg.solve(found.cov, error) / 2.0)
        chi2.append(found.line.chi2 / found.line.freedom)
    assert 0.8 < np.mean(nees) < 1.25
    assert 0.9 < np.mean(chi2) < 1.1


def test_a_read_noise_below_what_rounding_lets_see_is_a_bound_that_holds() -> None:
    sensor = Sensor(39.0, 3.0)
    found = [measured(Stack(sensor, seed=seed, frames=8, size_px=(88, 64))) for seed in range(40)]
    bounds = [one.read_below_e for one in found if one.read_below_e is not None]
    assert len(bounds) > 30
    assert np.mean([bound > sensor.read_noise_e for bound in bounds]) > 0.9
    assert all(one.read_sigma_e > 0.5 * sensor.read_noise_e for one in found)


def test_levels_whose_noise_is_lost_in_rounding_are_left_out() -> None:
    found = measured(Stack(Sensor(400.0, 10.0), frames=24))
    assert off(found, Sensor(400.0, 10.0)) < 3.5
    assert found.points.level_dn[0] > 0.9 * 0.16 * 400.0  # where the noise is 0.4 of a grey level


def test_twelve_bits_in_the_upper_ones_of_sixteen_are_rounded_to_their_own_steps() -> None:
    found = measure_noise(named([picture << 4 for picture in Stack(TWELVE).pictures()]))
    assert off(found, Sensor(TWELVE.gain_e_per_dn / 16.0, TWELVE.read_noise_e)) < 3.5
    assert (found.step_dn, found.rounding_dn2) == (16, 256.0 / 12.0)
    assert any("steps of 16 DN" in note for note in found.notes)


# ---- what does not disturb it ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(("flicker", "drift"), [(0.0, 0.0), (0.05, 0.0), (0.0, 0.15)])
def test_light_that_flickers_or_drifts_is_told_and_does_no_harm(flicker: float, drift: float) -> None:
    found = measured(RAMP.with_(flicker=flicker, drift=drift))
    assert off(found) < 3.5
    assert found.flicker == pytest.approx(flicker, rel=0.5, abs=0.001 + 0.01 * drift)
    assert found.drift == pytest.approx(drift, abs=0.003 + 2.0 * flicker)


def test_hot_stuck_and_flickering_pixels_do_no_harm() -> None:
    random = np.random.default_rng(5)
    pictures = RAMP.pictures()
    for picture in pictures:
        picture[::17, ::13] = random.integers(0, 255, picture[::17, ::13].shape)
        picture[5::17, 6::13], picture[9::17, 3::13] = 255, 0
    assert off(measure_noise(named(pictures))) < 3.5


def test_edges_that_shake_are_left_out() -> None:
    sensor = Sensor(39.0, 25.0)
    pictures = Stack(sensor, scene=shaking_scene(0.05)).pictures()
    naive = np.diff(np.array(pictures, float), axis=0).var(axis=0).mean() / 2.0
    assert naive > 1.2 * (80.0 / 39.0 + (25.0 / 39.0) ** 2)
    found = measure_noise(named(pictures))
    assert off(found, sensor) < 3.5
    assert found.shake_px > 0.03
    assert found.used < 0.9


def test_something_small_that_moves_is_left_out() -> None:
    pictures = RAMP.with_(size_px=(320, 240)).pictures()
    for n, picture in enumerate(pictures):
        cv2.circle(picture, (60 + 2 * n, 60), 12, 200, -1)
    found = measure_noise(named(pictures))
    assert off(found) < 3.5
    assert any("something moves" in note for note in found.notes)


def test_clipped_pixels_are_left_out_and_saturation_is_told() -> None:
    found = measured(RAMP.with_(low=0.1, high=1.3, frames=40))
    assert off(found) < 3.5
    assert found.saturation_dn == 255
    assert found.points.level_dn[-1] < 240.0
    assert measured(RAMP.with_(high=0.6)).saturation_dn is None


def test_levels_where_the_well_is_full_are_left_out() -> None:
    sensor = Sensor(10.0, 8.0, well_e=1800.0)
    found = measured(Stack(sensor, frames=24, flicker=0.0, high=0.85))
    assert off(found, sensor) < 3.5
    assert found.points.level_dn[-1] < 190.0
    assert any("wells are full" in note for note in found.notes)


# ---- what is told ----------------------------------------------------------------------------------------------------


def test_a_black_level_is_told() -> None:
    found = measured(Stack(Sensor(black_dn=20.0)))
    assert found.gain_e_per_dn == pytest.approx(10.0, abs=4.0 * found.gain_sigma_e_per_dn)
    assert found.read_noise_e == 0.0
    (note,) = found.notes
    assert "black level of 1" in note


def test_a_filter_that_makes_neighbours_alike_is_told() -> None:
    found = measure_noise(named([cv2.GaussianBlur(picture, (3, 3), 0.5) for picture in RAMP.pictures()]))
    assert any("neighbouring pixels is correlated by +0." in note for note in found.notes)


def test_a_line_that_is_bent_has_the_sigmas_of_its_scatter() -> None:
    bent = [np.rint(255.0 * (picture / 255.0) ** 0.9).astype(np.uint8) for picture in RAMP.with_(frames=60).pictures()]
    found = measure_noise(named(bent))
    assert any("no straight line" in note for note in found.notes)
    straight = measured(RAMP.with_(frames=60))
    assert found.gain_sigma_e_per_dn > 1.5 * straight.gain_sigma_e_per_dn


# ---- what is refused -------------------------------------------------------------------------------------------------


def refusal(pictures: list[Pixels], error: type[TrackerdError] = Undetermined) -> str:
    with pytest.raises(error) as refused:
        measure_noise(named(pictures))
    return str(refused.value)


def ball_on_the_way(n: int) -> Levels:
    scene = np.linspace(20.0, 200.0, 320) * np.ones((240, 1))
    return np.asarray(cv2.circle(scene, (100 + 6 * n, 120), 30, 230.0, -1))


@pytest.mark.parametrize(
    ("stack", "words"),
    [
        (RAMP.with_(frames=7), "7 frames: the noise needs at least 8"),
        (RAMP.with_(low=0.4, high=0.4), "tell the gain to"),
        (RAMP.with_(low=0.4, high=0.44), "times as many frames"),
        (RAMP.with_(low=0.4, high=0.5, frames=100), "the highest must be at least 1.5 times the lowest"),
        (RAMP.with_(low=1.5, high=2.0), "0.png and 1.png are 255 DN all over"),
        (RAMP.with_(low=0.97, high=1.5), "saturated at 255 DN"),
        (RAMP.with_(low=0.0, high=0.01), "the picture is black"),
        (RAMP.with_(flicker=0.3, seed=2), "the light changes from"),
        (Stack(scene=ball_on_the_way), "moves or changes, within x "),
        (Stack(scene=shaking_scene(3.0)), "the scene is not still"),
        (RAMP.with_(size_px=(31, 64)), "0.png: 31 x 64 px of uint8: the noise needs pictures of at least 32 x 32 px"),
        (Stack(Sensor(4000.0, 10.0)), "with a noise below 0.4 grey levels"),
    ],
)
def test_pictures_that_do_not_tell_the_noise_are_refused_in_words(stack: Stack, words: str) -> None:
    assert words in refusal(stack.pictures())


def test_the_place_of_what_moves_is_told() -> None:
    told = refusal(Stack(scene=ball_on_the_way).pictures())
    found = re.search(r"within x (\d+) to (\d+), y (\d+) to (\d+) px", told)
    assert found is not None
    np.testing.assert_allclose([int(place) for place in found.groups()], [70, 220, 90, 150], atol=24)  # blocks have 16 px


def test_copies_of_a_picture_are_refused() -> None:
    pictures = RAMP.pictures()
    assert "5.png and 6.png are identical" in refusal([*pictures[:6], *pictures[5:]])


def test_pictures_of_several_sizes_or_depths_are_a_wrong_input() -> None:
    pictures = RAMP.pictures()
    told = refusal([*pictures[:9], pictures[9][:-1]], ConfigError)
    assert "9.png: 160 x 119 px of uint8, but 8.png is 160 x 120 px of uint8" in told
    assert "9.png: 160 x 120 px of uint16" in refusal([*pictures[:9], pictures[9].astype(np.uint16)], ConfigError)


def test_noise_alike_in_all_pixels_of_unrelated_pictures_is_refused() -> None:
    random = np.random.default_rng(1)
    scenes = [128.0 + 8.0 * cv2.GaussianBlur(random.uniform(-60, 60, (96, 128)), (0, 0), 6.0) for _ in range(10)]
    assert "the scene is not still" in refusal([Sensor().expose(scene, random) for scene in scenes])


def test_no_stack_ends_in_anything_but_figures_or_a_refusal() -> None:
    refused = 0
    for seed in range(60):
        random = np.random.default_rng(seed)
        height, width = random.integers(24, 90, 2).tolist()
        greatest = int(random.choice([1, 3, 255, 4095, 65535]))
        scene = cv2.GaussianBlur(random.uniform(0, greatest, (height, width)), (0, 0), float(random.uniform(0.3, 8.0)))
        scene = random.choice([0.0, 0.5, 1.0, 3.0]) * scene + random.choice([0.0, 0.5, 1.0]) * greatest
        noise_dn = random.choice([0.0, 0.3, 2.0, 0.2 * greatest])
        frames = scene + noise_dn * random.standard_normal((int(random.integers(1, 16)), height, width))
        pictures = list(np.clip(np.rint(frames), 0, greatest).astype(np.uint8 if greatest < 256 else np.uint16))
        try:
            assert np.all(np.linalg.eigvalsh(measure_noise(named(pictures)).cov) > 0.0)
        except Undetermined:
            refused += 1
    assert refused > 40  # nothing here has photons


# ---- the plot --------------------------------------------------------------------------------------------------------


def test_the_plot_is_written_and_the_same_every_time(tmp_path: Path) -> None:
    found = measured(RAMP.with_(high=1.2))
    for name in ("one.svg", "two.svg", "one.png"):
        draw(found, "left", tmp_path / name)
    text = (tmp_path / "one.svg").read_text()
    assert text == (tmp_path / "two.svg").read_text()
    for words in ("e⁻/DN", "read noise", "photons", "saturation", "level, DN"):
        assert words in text
    assert min(cv2.imread(str(tmp_path / "one.png")).shape[:2]) > 500


def test_a_plot_that_cannot_be_written_is_told(tmp_path: Path) -> None:
    with pytest.raises(TrackerdError, match="cannot be written: No such file"):
        draw(measured(RAMP), "left", tmp_path / "nowhere" / "noise.svg")


# ---- the command -----------------------------------------------------------------------------------------------------


@pytest.fixture(autouse=True)
def process_as_it_was(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Commands set what belongs to a process of their own."""
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "1")
    monkeypatch.setenv("COLUMNS", "200")
    handler = signal.getsignal(signal.SIGTERM)
    yield
    signal.signal(signal.SIGTERM, handler)


def stored(folder: Path, pictures: list[Pixels], suffix: str = ".png") -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    for n, picture in enumerate(pictures):
        assert cv2.imwrite(str(folder / f"{n}{suffix}"), picture)
    return folder


def cell_that_plays(folder: Path, driver: str) -> Path:
    tables = [f'calibration = "{CONFIG}/demo-calibration.toml"', "[probe]", "radius_mm = 4.0"]
    for n, name in enumerate(("left", "right")):
        tables += [
            f"[camera.{name}]",
            f'driver = "{driver}"',
            f'folder = "{folder / name}"',
            "width_px = 160",
            "height_px = 120",
        ]
        tables += ["frame_rate_hz = 100.0", "exposure_us = 500.0"]
        tables += [f'serial = "0815-000{n}"'] if driver == "basler" else []
        tables += [f"[gimbal.{name}]", 'driver = "fixed"', f'camera = "{name}"']
    file = folder / "cell.toml"
    file.write_text("\n".join(tables))
    return file


def lines_for_the_cell(told: str) -> dict[str, Any]:
    import tomllib

    return tomllib.loads(told[told.index("\n[camera.") :])["camera"]  # type: ignore[no-any-return]


def test_a_folder_of_pictures_gives_the_lines_for_the_cells_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder, plot = stored(tmp_path / "stack", RAMP.pictures()), tmp_path / "noise.png"
    assert main(["calibrate", "noise", str(folder), "--out", str(plot)]) == DONE
    told = capsys.readouterr().out
    assert plot.exists()
    lines = lines_for_the_cell(told)["NAME"]
    assert lines["gain_e_per_dn"] == pytest.approx(10.0, rel=0.02)
    assert lines["read_noise_e"] == pytest.approx(8.0, rel=0.1)
    for words in (
        "gain: ",
        "read noise: ",
        "rounding: 0.0833 DN²",
        "chi2 ",
        "levels: ",
        "saturation: not reached",
        "flickers by",
    ):
        assert words in told


def test_a_recording_gives_the_lines_of_each_camera_beside_what_the_file_says(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for seed, name in enumerate(("left", "right")):
        stored(tmp_path / "recording" / name, RAMP.with_(seed=seed).pictures(), ".bmp")
    plot = tmp_path / "noise.svg"
    config = str(CONFIG / "demo.toml")
    assert main(["calibrate", "noise", str(tmp_path / "recording"), "--config", config, "--out", str(plot)]) == DONE
    told = capsys.readouterr().out
    assert told.count("the file says: gain_e_per_dn = 39, read_noise_e = 3") == 2
    for name in ("left", "right"):
        assert f"\n[camera.{name}]\n" in told
        assert (tmp_path / f"noise.{name}.svg").exists()


@pytest.mark.parametrize("driver", ["replay", "basler"])
def test_frames_of_a_cells_camera_are_measured_without_its_gimbal(
    driver: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    if driver == "basler":
        pytest.importorskip("pypylon", reason="needs trackerd[basler]")
    for name in ("left", "right"):
        stored(tmp_path / name, RAMP.with_(frames=30).pictures(), ".bmp")
    config = cell_that_plays(tmp_path, driver)
    command = ["calibrate", "noise", "--config", str(config), "--camera", "right", "--frames", "12"]
    assert main([*command, "--out", str(tmp_path / "noise.svg")]) == DONE
    told = capsys.readouterr().out
    assert "12 frames" in told
    assert lines_for_the_cell(told)["right"]["gain_e_per_dn"] == pytest.approx(10.0, rel=0.03)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], "needs PATH, pictures of a still scene, or --config FILE and --camera NAME"),
        (["--camera", "left"], "needs PATH"),
        (["nowhere"], "nowhere: there is no such file or folder"),
        (["nowhere", "--out", "noise.xls"], "--out noise.xls: must end in .svg, .png, .pdf"),
        (["--config", str(CONFIG / "demo.toml"), "--camera", "top"], "--camera top: no such camera (there are: left, right)"),
        (["--config", str(CONFIG / "demo.toml"), "--camera", "left", "--frames", "7"], "--frames 7: needs at least 8"),
    ],
)
def test_wrong_input_is_status_2_and_one_line(arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["calibrate", "noise", *arguments]) == WRONG
    told = capsys.readouterr().err
    assert words in told
    assert len(told.splitlines()) == 1


def test_pictures_that_do_not_tell_it_are_status_3(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = stored(tmp_path / "stack", RAMP.with_(low=0.4, high=0.42).pictures(), ".jpg")
    assert main(["calibrate", "noise", str(folder)]) == REFUSED
    told = capsys.readouterr().err.splitlines()
    assert "JPEG's compression spoils the noise" in told[0]
    assert told[1].startswith("trackerd: ")
