"""Pictures from files as a camera took them: one picture, a folder of them, or a recording of several stations.

A recording is a folder with one folder of pictures for each gimbal, as `trackerd twin --record` writes it: LEFT/000000.bmp ...,
LEFT.csv (frame,t_ns), angles.csv, calibration.toml. Nothing is read before it is asked for, and no grey value is changed.
"""

import csv
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from trackerd.contract.errors import ConfigError
from trackerd.contract.model import Image

JPEG = frozenset({".jpg", ".jpeg"})
PAGED = frozenset({".tif", ".tiff"})
SUFFIXES = frozenset({".png", ".bmp", ".pgm"}) | PAGED | JPEG
EXPECTED = "a grey picture of 8 or 16 bits"
JPEG_NOTE = "JPEG's compression spoils the noise of the pixels, and shifts edges: store PNG, TIFF, PGM or BMP"


@dataclass(frozen=True, slots=True)
class Stills:
    """Pictures of one camera, in the order of their names; numbers in names count as numbers, so that 2 comes before 10."""

    name: str
    files: tuple[Path, ...]
    station: str | None = None  # the gimbal's name, in a recording
    instants_ns: tuple[int, ...] | None = None  # recorded mid-exposure of each picture, where it is known
    calibration: Path | None = None  # the recording's own

    @property
    def count(self) -> int:
        return len(self.files)

    @property
    def notes(self) -> tuple[str, ...]:
        """What a person should know about these files before believing them."""
        jpegs = sum(file.suffix.lower() in JPEG for file in self.files)
        return (f"{jpegs} of {self.count} pictures: {JPEG_NOTE}",) if jpegs else ()

    def frames(self) -> Iterator[tuple[str, Image]]:
        """Each picture's file name and pixels, (height, width) uint8 or uint16, read one at a time. Raises ConfigError."""
        for file in self.files:
            yield file.name, read_still(file)


def stills(path: Path) -> tuple[Stills, ...]:
    """One series for a picture or a folder of pictures, one a station for a recording; never empty. Raises ConfigError."""
    if path.is_dir():
        return _folder(path)
    if not path.exists():
        raise ConfigError(f"{path}: there is no such file or folder")
    if path.suffix.lower() not in SUFFIXES:
        raise ConfigError(f"{path}: not a picture: its name must end in {_suffixes()}")
    return (Stills(path.name, (path,)),)


def read_still(file: Path) -> Image:
    """The pixels as they were stored, (height, width) uint8 or uint16. Raises ConfigError.

    Grey that was stored as three equal channels is taken; a colour picture is refused, because mixing channels or interpolating
    a Bayer pattern moves edges and makes the noise of neighbours alike.
    """
    try:
        with _opencv_keeps_quiet():
            image = _decoded(file)
    except OSError as error:
        raise ConfigError(f"{file}: cannot be read: {error.strerror}") from None
    except cv2.error as error:
        raise ConfigError(f"{file}: cannot be decoded: {error.err}") from None
    if image is None:
        raise ConfigError(f"{file}: cannot be decoded: needs {EXPECTED} ({_suffixes()})")
    return _grey(file, image)


def _decoded(file: Path) -> Image | None:
    if file.suffix.lower() in PAGED and cv2.imcount(str(file)) > 1:
        raise ConfigError(f"{file}: holds several pictures: store each in a file of its own")
    stored = np.fromfile(file, np.uint8)
    return cv2.imdecode(stored, cv2.IMREAD_UNCHANGED) if stored.size else None


@contextmanager
def _opencv_keeps_quiet() -> Iterator[None]:
    """It tells on standard error what we tell in our own words."""
    level = cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        yield
    finally:
        cv2.utils.logging.setLogLevel(level)


def _grey(file: Path, image: Image) -> Image:
    if image.dtype.type not in (np.uint8, np.uint16):
        raise ConfigError(f"{file}: its pixels are {image.dtype.name}: needs {EXPECTED}")
    if image.ndim == 2:
        return image
    first = image[..., 0]
    if image.shape[2] < 3 or any(np.any(first != image[..., channel]) for channel in (1, 2)):
        raise ConfigError(f"{file}: a colour picture: needs {EXPECTED}, from a camera without a colour filter")
    return np.ascontiguousarray(first)


def _folder(folder: Path) -> tuple[Stills, ...]:
    files = _pictures(folder)
    if files:
        recorded = _is_recording(folder.parent) and (folder.parent / f"{folder.name}.csv").is_file()
        return (_station(folder, files) if recorded else Stills(folder.name or str(folder), files),)
    stations = tuple(_station(inner, pictures) for inner in sorted(folder.iterdir()) if (pictures := _pictures(inner)))
    if not stations:
        raise ConfigError(f"{folder}: holds no picture ({_suffixes()}), and no folder that does")
    return stations


def _is_recording(folder: Path) -> bool:
    return (folder / "angles.csv").is_file()


def _station(folder: Path, files: tuple[Path, ...]) -> Stills:
    table, calibration = folder.parent / f"{folder.name}.csv", folder.parent / "calibration.toml"
    instants_ns = _instants(table, len(files)) if table.is_file() else None
    return Stills(folder.name, files, folder.name, instants_ns, calibration if calibration.is_file() else None)


def _pictures(folder: Path) -> tuple[Path, ...]:
    """Raises ConfigError where the folder may not be looked into."""
    try:
        found = [file for file in folder.iterdir() if file.suffix.lower() in SUFFIXES] if folder.is_dir() else []
    except OSError as error:
        raise ConfigError(f"{folder}: cannot be read: {error.strerror}") from None
    return tuple(sorted(found, key=_by_number))


def _by_number(file: Path) -> tuple[list[tuple[int, str]], str]:
    parts = re.split(r"(\d+)", file.stem)
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in parts], file.name


def _instants(table: Path, count: int) -> tuple[int, ...]:
    """Raises ConfigError where the table does not tell one instant for each picture."""
    try:
        with table.open(encoding="utf-8-sig", newline="") as text:
            rows = [(int(row["frame"]), int(row["t_ns"])) for row in csv.DictReader(text)]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise ConfigError(f"{table}: cannot be read: {error}") from None
    except (KeyError, TypeError, ValueError):
        raise ConfigError(f"{table}: needs the columns frame,t_ns, with whole numbers in every row") from None
    return _complete(table, rows, count)


def _complete(table: Path, rows: Sequence[tuple[int, int]], count: int) -> tuple[int, ...]:
    if [frame for frame, _ in rows] != list(range(count)):
        raise ConfigError(f"{table}: needs one row for each of the {count} pictures, frame = 0 to {count - 1} in this order")
    return tuple(instant_ns for _, instant_ns in rows)


def _suffixes() -> str:
    return ", ".join(sorted(SUFFIXES))
