import csv

import cv2
import numpy as np
import pytest
from sim_cell import PLAIN, scene

from trackerd.sim.record import record


def rows(path):
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def make(folder, **twin):
    made = scene(camera=PLAIN, path={"dwell_s": 3.0}, **twin)
    return made, record(made, folder, 1.5)


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    folder = tmp_path_factory.mktemp("recording")
    return folder, *make(folder)


def test_every_frame_has_an_image_an_instant_and_angles(recording):
    folder, _, count = recording
    assert count == 2 * 83
    angles = rows(folder / "angles.csv")
    for name in ("left", "right"):
        images = sorted(path.name for path in (folder / name).iterdir())
        assert images == [f"{frame:06d}.bmp" for frame in range(83)]
        instants = [(row["frame"], row["t_ns"]) for row in rows(folder / f"{name}.csv")]
        assert instants == [(row["frame"], row["t_ns"]) for row in angles if row["gimbal"] == name]


def test_the_truth_is_told_at_every_mid_exposure_and_the_probe_starts_within_it(recording):
    folder, made, _ = recording
    truth = rows(folder / "truth.csv")
    assert [row["t_ns"] for row in truth] == [row["t_ns"] for row in rows(folder / "left.csv")]
    assert [row["x_mm"] for row in truth[:54]] == ["150.000000"] * 54
    last = [float(truth[-1][key]) for key in ("x_mm", "y_mm", "z_mm")]
    np.testing.assert_allclose(last, made.truth(int(truth[-1]["t_ns"]))[0], atol=1e-6)
    assert last[1] > 10.0


@pytest.mark.parametrize("name", ["left", "right"])
def test_the_images_show_the_true_probe_where_the_recorded_angles_look(recording, name):
    folder, made, _ = recording
    mount, radius_px = made.mounts[name], 62.0
    truth = {row["t_ns"]: np.array([float(row[key]) for key in ("x_mm", "y_mm", "z_mm")]) for row in rows(folder / "truth.csv")}
    for row in [row for row in rows(folder / "angles.csv") if row["gimbal"] == name][::9]:
        image = cv2.imread(str(folder / name / f"{int(row['frame']):06d}.bmp"), cv2.IMREAD_UNCHANGED)
        assert image.dtype == np.uint8
        assert image.shape == (240, 320)
        y, x = np.nonzero(image > 120)
        assert len(x) == pytest.approx(np.pi * radius_px**2, rel=0.1)
        seen = x.mean() + mount.camera.offset_x_px, y.mean() + mount.camera.offset_y_px
        expected = mount.station.pixel(truth[row["t_ns"]], float(row["az_rad"]), float(row["el_rad"]))
        assert seen == pytest.approx(expected, abs=0.05)


def test_a_recording_is_repeatable_brings_its_calibration_and_tells_its_progress(recording, tmp_path):
    folder, *_ = recording
    (tmp_path / "cell.toml").write_text("calibration\n")
    told = []
    record(
        scene(camera=PLAIN, path={"dwell_s": 3.0}),
        tmp_path / "again",
        0.1,
        tmp_path / "cell.toml",
        lambda done, total: told.append((done, total)),
    )
    assert told[-1] == (len(told), len(told))
    assert (tmp_path / "again" / "calibration.toml").read_text() == "calibration\n"
    for frame in ("left/000003.bmp", "right/000004.bmp"):
        assert (tmp_path / "again" / frame).read_bytes() == (folder / frame).read_bytes()


def test_free_cameras_are_recorded_at_their_own_instants(tmp_path):
    made = scene(camera=PLAIN, trigger="free", path={"dwell_s": 0.0})
    record(made, tmp_path, 0.2)
    left, right = ({row["t_ns"] for row in rows(tmp_path / f"{name}.csv")} for name in ("left", "right"))
    assert not left & right
    assert {row["t_ns"] for row in rows(tmp_path / "truth.csv")} == left | right


def test_a_sweep_swings_both_axes_about_the_probe_and_its_angles_are_the_latched_ones(tmp_path):
    swing = {"az_deg": 0.1, "el_deg": 0.05, "az_hz": 3.0, "el_hz": 4.0}
    late = scene(camera=PLAIN, path={"kind": "still"}, sweep=swing, encoder={"latch_skew_us": 300.0})
    prompt = scene(camera=PLAIN, path={"kind": "still"}, sweep=swing)
    tables = []
    for name, made in (("late", late), ("prompt", prompt)):
        record(made, tmp_path / name, 1.0)
        table = [row for row in rows(tmp_path / name / "angles.csv") if row["gimbal"] == "left"]
        tables.append(np.array([[float(row["az_rad"]), float(row["el_rad"])] for row in table]))
    aim = np.array(prompt.gimbals["left"].aim(prompt.truth(0)[0], prompt.mounts["left"].kept_at_px))
    swung = np.abs(tables[1] - aim).max(axis=0)
    assert np.degrees(swung) == pytest.approx((0.1, 0.05), rel=0.1)
    speeds = np.gradient(tables[1], 1.0 / 55.0, axis=0)[2:-2]
    ahead = (tables[0] - tables[1])[2:-2]
    assert (ahead * speeds).sum(axis=0) / (speeds**2).sum(axis=0) == pytest.approx((300e-6, 300e-6), rel=0.05)


def test_a_triangle_keeps_its_speed_but_at_the_turns():
    made = scene(path={"kind": "still"}, sweep={"kind": "triangle", "az_deg": 1.0, "el_deg": 0.5, "az_hz": 0.5, "el_hz": 1.0})
    made.place()
    speeds = []
    for t_ms in range(0, 4000, 10):
        made.follow(t_ms * 1_000_000, (t_ms + 10) * 1_000_000)
        speeds.append(made.gimbals["left"].rates((t_ms + 5) * 1_000_000))
    for speed in np.degrees(np.abs(speeds)).T:  # 4 x 1 deg x 0.5 Hz, 4 x 0.5 deg x 1 Hz
        assert np.mean(np.abs(speed - 2.0) < 0.05) > 0.7
