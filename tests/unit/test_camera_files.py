"""Lenses to and from the files of OpenCV and ROS."""

from contextlib import suppress
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from trackerd.contract.errors import ConfigError
from trackerd.formats.camera_files import CameraFormat, read_lens, write_lens
from trackerd.geometry.lens import Lens

FORMATS = pytest.mark.parametrize("form", CameraFormat)
RUNS = settings(max_examples=50, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
LENS = Lens((2048, 1536), 31000.1, 31000.2, 1021.7, 1 / 3, (-0.05, 1e-5, 1e-17, -2e-4, 12345678.9))

numbers = st.floats(allow_nan=False, allow_infinity=False)
positive = st.floats(min_value=5e-324, allow_infinity=False)
lenses = st.builds(
    Lens,
    sensor_px=st.tuples(st.integers(1, 2**31 - 1), st.integers(1, 2**31 - 1)),
    fx_px=positive,
    fy_px=positive,
    cx_px=numbers,
    cy_px=numbers,
    distortion=st.tuples(*[numbers] * 5),
)

ROS = """\
image_width: 640
image_height: 480
camera_name: narrow_stereo/left
camera_matrix:
  rows: 3
  cols: 3
  data: [438.783, 0, 305.594, 0, 437.303, 243.738, 0, 0, 1]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [-0.361976, 1e-05, 0.00101, 0.00043, 0]
rectification_matrix:
  rows: 3
  cols: 3
  data: [0.999, 0.007, 0.0, -0.007, 0.999, -0.004, 0.0, 0.004, 0.999]
projection_matrix:
  rows: 3
  cols: 4
  data: [393.653, 0, 322.797, 0, 0, 393.653, 241.090, 0, 0, 0, 1, 0]
"""
OPENCV = """\
%YAML:1.0
---
calibration_time: "Mon 03 Mar 2025 08:00:00 AM UTC"
image_width: 640
image_height: 480
flags: 0
fisheye_model: 0
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 5.35e+02, 0., 3.20e+02, 0., 5.36e+02, 2.35e+02, 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 5
   cols: 1
   dt: d
   data: [ -2.6e-01, -4.6e-02, 1.8e-03, -3.1e-04, 2.5e-01 ]
avg_reprojection_error: 3.9e-01
"""


def same_bits(a: Lens, b: Lens) -> bool:
    def packed(lens: Lens) -> bytes:
        return np.array((lens.fx_px, lens.fy_px, lens.cx_px, lens.cy_px, *lens.distortion)).tobytes()

    return a.sensor_px == b.sensor_px and packed(a) == packed(b)


def read(folder: Path, text: str) -> Lens:
    (folder / "camera.yaml").write_text(text)
    return read_lens(folder / "camera.yaml")


@FORMATS
@RUNS
@given(lens=lenses, name=st.text(st.characters(codec="utf-8", exclude_categories=["Cs", "Cc"]), max_size=10))
def test_any_lens_comes_back_bit_by_bit(tmp_path: Path, form: CameraFormat, lens: Lens, name: str) -> None:
    write_lens(lens, tmp_path / "camera.yaml", form, name)
    found = read_lens(tmp_path / "camera.yaml")
    assert found == lens
    assert same_bits(found, lens) or form is CameraFormat.OPENCV  # which drops the sign of a zero, and nothing else


def test_what_we_write_is_what_opencv_reads_and_projects_alike(tmp_path: Path) -> None:
    lens = Lens((2048, 1536), 3100.0, 3101.0, 1021.7, 769.2, (-0.05, 0.01, 1e-4, -2e-4, 0.003))
    write_lens(lens, tmp_path / "camera.yml", CameraFormat.OPENCV, "left")
    storage = cv2.FileStorage(str(tmp_path / "camera.yml"), cv2.FILE_STORAGE_READ)
    matrix, distortion = storage.getNode("camera_matrix").mat(), storage.getNode("distortion_coefficients").mat()
    assert (storage.getNode("image_width").real(), storage.getNode("image_height").real()) == (2048.0, 1536.0)
    p_mm = np.array((120.0, -80.0, 900.0))
    projected, _ = cv2.projectPoints(p_mm[None], np.zeros(3), np.zeros(3), matrix, distortion)
    assert projected.ravel() == pytest.approx(lens.project(p_mm), abs=1e-9)


def test_what_we_write_has_the_fields_and_shapes_of_ros(tmp_path: Path) -> None:
    write_lens(LENS, tmp_path / "camera.yaml", CameraFormat.CAMERA_INFO, "left")
    text = (tmp_path / "camera.yaml").read_text()
    found, theirs = yaml.safe_load(text), yaml.safe_load(ROS)
    assert list(found) == list(theirs)
    for key, table in theirs.items():
        if isinstance(table, dict):
            assert (found[key]["rows"], found[key]["cols"]) == (table["rows"], table["cols"])
            assert len(found[key]["data"]) == len(table["data"])
            assert f"\n  data: [{found[key]['data'][0]!r}" in text  # in one flow, as C++ and Python there write it
    assert found["distortion_model"] == "plumb_bob"
    assert found["rectification_matrix"]["data"] == np.eye(3).ravel().tolist()
    k = np.array(found["camera_matrix"]["data"]).reshape(3, 3)
    assert np.array_equal(np.array(found["projection_matrix"]["data"]).reshape(3, 4), np.hstack((k, np.zeros((3, 1)))))
    assert "optical frame of REP 103" in text


def test_a_file_of_ros_is_read(tmp_path: Path) -> None:
    lens = read(tmp_path, ROS)
    assert lens == Lens((640, 480), 438.783, 437.303, 305.594, 243.738, (-0.361976, 1e-05, 0.00101, 0.00043, 0.0))
    assert read(tmp_path, ROS.replace("distortion_model: plumb_bob\n", "")) == lens


def test_a_file_of_opencvs_own_sample_is_read(tmp_path: Path) -> None:
    assert read(tmp_path, OPENCV) == Lens((640, 480), 535.0, 536.0, 320.0, 235.0, (-0.26, -0.046, 0.0018, -0.00031, 0.25))


@pytest.mark.parametrize("ending", ["yml", "xml", "json"])
def test_opencv_files_are_read_in_all_its_languages(tmp_path: Path, ending: str) -> None:
    path = tmp_path / f"camera.{ending}"
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    storage.write("image_width", 2048)
    storage.write("image_height", 1536)
    storage.write("camera_matrix", np.array(((31000.1, 0, 1021.7), (0, 31000.2, 1 / 3), (0, 0, 1))))
    storage.write("distortion_coefficients", np.array(LENS.distortion)[:, None])
    storage.release()
    assert same_bits(read_lens(path), LENS)


@pytest.mark.parametrize("data", ["[]", "[-0.3, 0.1, 0.0, 0.0]", "[-0.3, 0.1, 0.0, 0.0, 0, 0, 0, 0]"])
def test_fewer_coefficients_and_further_ones_of_zero_are_the_same_model(tmp_path: Path, data: str) -> None:
    text = ROS.replace("[-0.361976, 1e-05, 0.00101, 0.00043, 0]", data)
    assert read(tmp_path, text).distortion in ((-0.3, 0.1, 0.0, 0.0, 0.0), (0.0,) * 5)
    assert read(tmp_path, text.replace("plumb_bob", "rational_polynomial")) == read(tmp_path, text)


ONLY = "only k1, k2, p1, p2, k3 (plumb_bob) can be held: calibrate with that model"
RATIONAL = "[-0.3, 0.1, 0.0, 0.0, 0.0, 0.2, 0.0, 0.0]"
WRONG = [
    (ROS, "plumb_bob", "equidistant", f'distortion_model = "equidistant": is a fisheye lens: {ONLY}'),
    (ROS, "plumb_bob", "double_sphere", f'distortion_model = "double_sphere": is not known: {ONLY}'),
    (ROS, "[-0.361976, 1e-05, 0.00101, 0.00043, 0]", RATIONAL,
     f"distortion_coefficients = {RATIONAL}: belong to the rational model: {ONLY}"),
    (ROS.replace("plumb_bob", "rational_polynomial"), "[-0.361976, 1e-05, 0.00101, 0.00043, 0]", RATIONAL,
     f"distortion_coefficients = {RATIONAL}: is a rational model: {ONLY}"),
    (OPENCV, "fisheye_model: 0", "fisheye_model: 1", f"fisheye_model = 1: is a fisheye lens: {ONLY}"),
    (OPENCV, "rows: 5\n   cols: 1\n   dt: d\n   data: [ -2.6e-01,",
     "rows: 14\n   cols: 1\n   dt: d\n   data: [ 0., 0., 0., 0., 0., 0., 0., 0., 0., 1.,", "belong to the tilted sensor model"),
    (ROS, "437.303", "-437.303", "its focal lengths must be above 0"),
    (ROS, "[438.783, 0, ", "[438.783, 0.5, ", "has a skew: only cameras with right-angled pixels can be held"),
    (ROS, "243.738, 0, 0, 1]", "243.738, 0, 0, 2]", "must be [fx, 0, cx], [0, fy, cy], [0, 0, 1]"),
    (ROS, "243.738, 0, 0, 1]", "243.738, 0, 0]", "has 8 numbers, needs 9"),
    (ROS, "305.594", ".nan", "camera_matrix = nan: must be a finite number"),
    (ROS, "305.594", "wide", 'camera_matrix = "wide": must be a number'),
    (ROS, "305.594", "true", "camera_matrix = true: must be a number"),
    (ROS, "image_width: 640", "image_width: 640.5", "image_width = 640.5: must be a whole number of pixels above 0"),
    (ROS, "image_width: 640", "image_width: 0", "image_width = 0: must be a whole number of pixels above 0"),
    (ROS, "image_height: 480\n", "", "image_height: is missing"),
    (ROS, "camera_matrix:", "matrix:", "camera_matrix: is missing: is neither OpenCV's nor ROS' file of a camera"),
    (ROS, "  data: [438.783, 0, 305.594, 0, 437.303, 243.738, 0, 0, 1]\n", "",
     "camera_matrix: must have rows, cols and data: [ numbers ]"),
    (ROS, "data: [438.783", "data: {438.783", "is no YAML: "),
    (OPENCV, "camera_matrix: !!opencv-matrix", "matrix: !!opencv-matrix", "camera_matrix: is missing"),
    (OPENCV, "rows: 3\n", "rows: 4\n", "is damaged: OpenCV cannot read it"),
    (OPENCV, "---\n", "---\n:::\n", "is damaged: OpenCV cannot read it"),
]  # fmt: skip


@pytest.mark.parametrize(("text", "old", "new", "words"), WRONG, ids=range(len(WRONG)))
def test_what_cannot_be_held_is_refused_by_file_field_value_and_rule(
    tmp_path: Path, text: str, old: str, new: str, words: str
) -> None:
    assert old in text
    with pytest.raises(ConfigError) as caught:
        read(tmp_path, text.replace(old, new))
    assert str(caught.value).startswith("camera.yaml")
    assert words in str(caught.value)


@FORMATS
@RUNS
@given(at=st.floats(0, 1), dropped=st.integers(0, 40), put=st.binary(max_size=12))
def test_a_damaged_file_is_read_or_a_configuration_error(
    tmp_path: Path, form: CameraFormat, at: float, dropped: int, put: bytes
) -> None:
    write_lens(LENS, tmp_path / "camera.yaml", form, "left")
    whole = (tmp_path / "camera.yaml").read_bytes()
    place = round(at * len(whole))
    (tmp_path / "camera.yaml").write_bytes(whole[:place] + put + whole[place + dropped :])
    with suppress(ConfigError):
        read_lens(tmp_path / "camera.yaml")


@RUNS
@given(st.sampled_from((b"", b"%YAML:1.0\n---\n", b"opencv ", b"camera_matrix: ")), st.binary(max_size=100))
def test_any_bytes_are_a_lens_or_a_configuration_error(tmp_path: Path, head: bytes, data: bytes) -> None:
    (tmp_path / "camera.yaml").write_bytes(head + data)
    with pytest.raises(ConfigError, match=r"^camera\.yaml"):
        read_lens(tmp_path / "camera.yaml")


def test_a_missing_file_is_told(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"^camera\.yaml: no such file: /"):
        read_lens(tmp_path / "camera.yaml")
