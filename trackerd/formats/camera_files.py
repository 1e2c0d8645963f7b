"""Lenses in other programs' files: OpenCV's FileStorage, and ROS' camera_info as camera_calibration_parsers has it.

Both mean what Lens means, number for number: a pinhole in px with k1, k2, p1, p2, k3 (ROS: plumb_bob) in the frame C (ROS: the
optical frame of REP 103; x right, y down, z forward), an integer is a pixel's centre, and the size is the whole sensor's.

    opencv        image_width, image_height, camera_matrix, distortion_coefficients; written as YAML, read as YAML, XML or JSON
    camera_info   image_width, image_height, camera_name, camera_matrix, distortion_model, distortion_coefficients,
                  rectification_matrix (the unit matrix) and projection_matrix [K | 0], as of one camera that is not rectified;
                  the last two say nothing of the lens, and are not looked at

Every number is read back bit by bit (but OpenCV drops the sign of a zero).
What bends further than five coefficients is refused by its name.
"""

from collections.abc import Mapping, Sequence
from enum import StrEnum
from math import isfinite
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml

from trackerd.contract.errors import ConfigError
from trackerd.formats.atomic import write_atomically
from trackerd.formats.rules import NO_VALUE, line
from trackerd.geometry.lens import Lens

CONVENTIONS = (
    "frame: x right, y down, z forward, origin at the entrance pupil (ROS: the optical frame of REP 103)",
    "pixels of the whole sensor; an integer is a pixel's centre; distortion k1, k2, p1, p2, k3",
)
OURS = "only k1, k2, p1, p2, k3 (plumb_bob) can be held: calibrate with that model"
LONGER = {8: "rational", 12: "thin prism", 14: "tilted sensor"}  # OpenCV's models by their number of coefficients
NAMED = {
    "rational_polynomial": "is a rational model",
    "equidistant": "is a fisheye lens",
    "fisheye": "is a fisheye lens",
    "kannala_brandt": "is a fisheye lens",
}
PLUMB_BOB = "plumb_bob"


class CameraFormat(StrEnum):
    OPENCV = "opencv"
    CAMERA_INFO = "camera_info"


def write_lens(lens: Lens, path: Path, form: CameraFormat, name: str) -> None:
    """`name` is the camera's. Raises OSError."""
    write_atomically(path, _opencv_text(lens, name) if form is CameraFormat.OPENCV else _camera_info_text(lens, name))


def read_lens(path: Path) -> Lens:
    """Of either kind. Raises ConfigError: file, field, value and rule."""
    try:
        text = path.read_bytes().decode()
    except FileNotFoundError:
        raise ConfigError(f"{path.name}: no such file: {path.absolute()}") from None
    except OSError as err:
        raise ConfigError(f"{path.name}: cannot be read: {err.strerror} ({path.absolute()})") from None
    except UnicodeDecodeError as err:
        raise ConfigError(f"{path.name}: byte {err.start} is not UTF-8: is no file of a camera") from None
    if text.startswith("%YAML") or "opencv" in text:  # !!opencv-matrix, <opencv_storage>, "opencv-matrix"
        return _Fields(path.name, _opencv_fields(path.name, text)).lens()
    return _Fields(path.name, _camera_info_fields(path.name, text)).lens()


# ---- writing ---------------------------------------------------------------------------------------------------------


def _matrix(lens: Lens) -> list[float]:
    return [float(x) for x in (lens.fx_px, 0, lens.cx_px, 0, lens.fy_px, lens.cy_px, 0, 0, 1)]


def _opencv_text(lens: Lens, name: str) -> str:
    storage = cv2.FileStorage("lens.yml", cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    for words in (f"lens of {name}", *CONVENTIONS):
        storage.writeComment(words)
    storage.write("image_width", lens.sensor_px[0])
    storage.write("image_height", lens.sensor_px[1])
    storage.write("camera_matrix", np.array(_matrix(lens)).reshape(3, 3))
    storage.write("distortion_coefficients", np.array([lens.distortion], float))
    return str(storage.releaseAndGetString())


def _camera_info_text(lens: Lens, name: str) -> str:
    k = _matrix(lens)
    fields = {
        "image_width": lens.sensor_px[0],
        "image_height": lens.sensor_px[1],
        "camera_name": name,
        "camera_matrix": _table(3, 3, k),
        "distortion_model": PLUMB_BOB,
        "distortion_coefficients": _table(1, 5, lens.distortion),
        "rectification_matrix": _table(3, 3, np.eye(3).ravel().tolist()),
        "projection_matrix": _table(3, 4, [*k[0:3], 0.0, *k[3:6], 0.0, *k[6:9], 0.0]),
    }
    remarks = "".join(f"# {words}\n" for words in CONVENTIONS)
    return remarks + str(yaml.safe_dump(fields, sort_keys=False, default_flow_style=None, allow_unicode=True))


def _table(rows: int, cols: int, data: Sequence[float]) -> dict[str, Any]:
    return {"rows": rows, "cols": cols, "data": [float(x) for x in data]}


# ---- reading ---------------------------------------------------------------------------------------------------------


def _opencv_fields(file: str, text: str) -> dict[str, Any]:
    """In the form that camera_info has."""
    try:
        storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
        nodes = {name: storage.getNode(name) for name in storage.root().keys()}  # noqa: SIM118 a FileNode cannot be iterated
        return {name: _node_value(node) for name, node in nodes.items()}
    except (SystemError, cv2.error, TypeError):
        raise ConfigError(f"{file}: is damaged: OpenCV cannot read it") from None


def _node_value(node: Any) -> Any:
    """A number, a text, a table of a matrix; NO_VALUE for what a lens does not need."""
    if node.isInt() or node.isReal():
        return int(node.real()) if node.isInt() else node.real()
    if node.isString():
        return node.string()
    if not node.isMap() or node.getNode("data").empty():
        return NO_VALUE
    matrix = np.asarray(node.mat(), float)
    return _table(matrix.shape[0], matrix.shape[-1], matrix.ravel().tolist())


def _camera_info_fields(file: str, text: str) -> dict[str, Any]:
    try:
        fields = yaml.safe_load(text)
    except (yaml.YAMLError, ValueError, RecursionError) as err:
        place = getattr(err, "problem_mark", None)
        where = "" if place is None else f" line {place.line + 1}, column {place.column + 1}"
        raise ConfigError(f"{file}{where}: is no YAML: {getattr(err, 'problem', None) or 'cannot be read'}") from None
    if not isinstance(fields, dict) or "camera_matrix" not in fields:
        raise ConfigError(f"{file} camera_matrix: is missing: is neither OpenCV's nor ROS' file of a camera")
    return fields


class _Fields:
    """The fields of one file; every look says what is wrong with it."""

    def __init__(self, file: str, fields: Mapping[str, Any]) -> None:
        self._file = file
        self._fields = fields

    def lens(self) -> Lens:
        size = self._size("image_width"), self._size("image_height")
        k = self._numbers("camera_matrix", (9,))
        if any(k[i] != 0.0 for i in (3, 6, 7)) or k[8] != 1.0:
            raise self._wrong("camera_matrix", k, "must be [fx, 0, cx], [0, fy, cy], [0, 0, 1]")
        if k[1] != 0.0:
            raise self._wrong("camera_matrix", k, "has a skew: only cameras with right-angled pixels can be held")
        if min(k[0], k[4]) <= 0.0:
            raise self._wrong("camera_matrix", k, "its focal lengths must be above 0")
        k1, k2, p1, p2, k3 = self._distortion()
        return Lens(size, fx_px=k[0], fy_px=k[4], cx_px=k[2], cy_px=k[5], distortion=(k1, k2, p1, p2, k3))

    def _distortion(self) -> list[float]:
        if self._fields.get("fisheye_model", 0) not in (0, NO_VALUE):
            raise self._wrong("fisheye_model", self._fields["fisheye_model"], f"is a fisheye lens: {OURS}")
        model = self._fields.get("distortion_model", PLUMB_BOB)  # which ROS, too, takes for granted
        found = self._numbers("distortion_coefficients", (0, 4, 5, *LONGER))
        if model not in (PLUMB_BOB, "rational_polynomial"):
            raise self._wrong("distortion_model", model, f"{NAMED.get(str(model), 'is not known')}: {OURS}")
        if any(found[5:]):
            kind = NAMED[model] if model in NAMED else f"belong to the {LONGER[len(found)]} model"
            raise self._wrong("distortion_coefficients", found, f"{kind}: {OURS}")
        return (found + [0.0] * 5)[:5]

    def _size(self, key: str) -> int:
        value = self._fields.get(key, NO_VALUE)
        if value is NO_VALUE:
            raise self._wrong(key, NO_VALUE, "is missing")
        if type(value) is not int or value <= 0:
            raise self._wrong(key, value, "must be a whole number of pixels above 0")
        return value

    def _numbers(self, key: str, counts: Sequence[int]) -> list[float]:
        table = self._fields.get(key, NO_VALUE)
        if table is NO_VALUE:
            raise self._wrong(key, NO_VALUE, "is missing")
        data = table.get("data") if isinstance(table, Mapping) else None
        if not isinstance(data, list):
            raise self._wrong(key, NO_VALUE, "must have rows, cols and data: [ numbers ]")
        numbers = [self._number(key, value) for value in data]
        if len(numbers) not in counts:
            raise self._wrong(key, numbers, f"has {len(numbers)} numbers, needs {' or '.join(map(str, counts))}")
        return numbers

    def _number(self, key: str, value: Any) -> float:
        """YAML calls 1e-05 a text; C++ writes it for a number."""
        try:
            number = float(value) if isinstance(value, int | float | str) and not isinstance(value, bool) else None
        except (ValueError, OverflowError):
            number = None
        if number is None:
            raise self._wrong(key, value, "must be a number")
        if not isfinite(number):
            raise self._wrong(key, value, "must be a finite number")
        return number

    def _wrong(self, key: str, value: Any, rule: str) -> ConfigError:
        return ConfigError(" ".join(line(self._file, (), key, value, rule).splitlines()))
