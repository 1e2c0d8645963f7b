"""Writes a dataset: once its tables, then view after view, so that an interruption loses one view at most."""

import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import cv2

from trackerd.contract.errors import ConfigError, TrackerdError
from trackerd.contract.model import Array, Image
from trackerd.formats.atomic import toml_text, write_atomically
from trackerd.formats.csv_table import Findings, Row, read_rows
from trackerd.formats.dataset_tables import TABLES
from trackerd.formats.dataset_views import PIXEL_COVARIANCE, VIEW_COLUMNS, VIEW_EXTRAS, VIEWS
from trackerd.formats.mover import Stop
from trackerd.formats.tables import Tables
from trackerd.geometry.rigid import quaternion_from_matrix

IMAGES = "images"
COLUMNS = (*VIEW_COLUMNS, "feature", "u_px", "v_px", *PIXEL_COVARIANCE, "face", "frames", "image")


@dataclass(frozen=True, slots=True)
class NewView:
    """A target in one view; `image` is a crop that shows what was measured."""

    view: str
    gimbal: str
    face: int
    az_rad: float
    el_rad: float
    target: str
    q_px: Array  # (2,)
    cov_px2: Array  # (2, 2)
    frames: int
    image: Image | None = None


class DatasetFile:
    """An open dataset. What is there already is kept: `taken` tells the views (view, gimbal) that need not be taken again."""

    def __init__(self, folder: Path, tables: Tables, files: Mapping[str, str]) -> None:
        """`tables` is dataset.toml; `files` are the texts of what it needs beside it, by name.

        Raises ConfigError where the folder holds a dataset with other tables, TrackerdError where it cannot be written.
        """
        self.folder = folder
        self._views = folder / VIEWS
        try:
            self._begin(toml_text(tables), files)
        except OSError as error:
            raise TrackerdError(f"{folder}: cannot be written: {error.strerror}") from error
        self.taken = {(row.values["view"], row.values["gimbal"]) for row in self._rows()}

    def append(self, view: NewView) -> None:
        """The picture first, then one line, in one write that is on the disk when this returns. Raises TrackerdError."""
        try:
            self._append(view)
        except OSError as error:
            raise TrackerdError(f"{self.folder}: view {view.view} cannot be written: {error.strerror}") from error
        self.taken.add((view.view, view.gimbal))

    def _begin(self, tables: str, files: Mapping[str, str]) -> None:
        self.folder.mkdir(parents=True, exist_ok=True)
        path = self.folder / TABLES
        for name, text in {**files, TABLES: tables}.items() if path.exists() else ():
            other = self.folder / name
            if not other.exists() or other.read_text(encoding="utf-8") != text:
                raise ConfigError(f"{self.folder}: holds a dataset with another {name}: choose another folder")
        for name, text in files.items():
            write_atomically(self.folder / name, text)
        if not self._views.exists():
            write_atomically(self._views, ",".join(COLUMNS) + "\n")
        _drop_torn_line(self._views)
        write_atomically(path, tables)  # last: with it the folder is a dataset

    def _rows(self) -> list[Row]:
        findings = Findings()
        rows = list(read_rows(self._views, VIEW_COLUMNS, VIEW_EXTRAS, findings))
        findings.raise_any()
        return rows

    def _append(self, view: NewView) -> None:
        name = ""
        if view.image is not None:
            name = f"{IMAGES}/{view.gimbal}-{view.view}.png"
            (self.folder / IMAGES).mkdir(exist_ok=True)
            if not cv2.imwrite(str(self.folder / name), view.image):
                raise TrackerdError(f"{self.folder / name}: cannot be written")
        (uu, uv), (_, vv) = view.cov_px2.tolist()
        angles, pixel = (f"{view.az_rad:.12f}", f"{view.el_rad:.12f}"), (f"{view.q_px[0]:.6f}", f"{view.q_px[1]:.6f}")
        cov = (f"{uu:.6e}", f"{uv:.6e}", f"{vv:.6e}")
        cells = (view.view, view.gimbal, *angles, view.target, "0", *pixel, *cov, str(view.face), str(view.frames), name)
        with self._views.open("ab", buffering=0) as file:
            file.write((",".join(cells) + "\n").encode())
            os.fsync(file.fileno())


def _drop_torn_line(path: Path) -> None:
    """A last line without its end was not written whole: its view is taken again."""
    content = path.read_bytes()
    end = content.rfind(b"\n") + 1
    if end < len(content):
        os.truncate(path, end)


def points_text(stops: Iterable[Stop]) -> str:
    """points.csv of a mover's stops."""
    rows = (
        f"{stop.name},{',,' if stop.is_bar_end else _numbers(stop.p_mm)},{'check' if stop.is_check else 'adjust'}"
        for stop in stops
    )
    return "\n".join(("point,x_mm,y_mm,z_mm,use", *rows)) + "\n"


def flange_text(stops: Iterable[Stop]) -> str:
    """flange.csv of a robot's stops: the tool's frame, whose origin is nearly the ball."""
    turned = ((stop, stop.base_from_tool) for stop in stops if not stop.is_bar_end)
    rows = (f"{s.name},{_numbers(s.p_mm)},{_numbers(quaternion_from_matrix(t))}" for s, t in turned if t is not None)
    return "\n".join(("point,x_mm,y_mm,z_mm,qw,qx,qy,qz", *rows)) + "\n"


def _numbers(values: Array) -> str:
    return ",".join(f"{value:.9g}" for value in values.tolist())
