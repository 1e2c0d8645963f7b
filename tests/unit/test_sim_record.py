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
