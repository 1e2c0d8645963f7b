"""The calibration file, version 2: poses, lenses, their covariance and what they are worth, as TOML for people and programs.

    format = "trackerd-calibration"
    version = 2
    id = "..."                      # every published position names it
    created = "..."                 # ISO 8601
    software, method
    parent                          # the calibration that this one began with, where part of it was held
    chi2_per_dof, dof
    forced, forced_because          # accepted although chi-square refused it, and why
    [data]                          # name, sha256: what it was made from
    [noise]                         # pixel_px, encoder_rad, encoder_fixed_rad: 1 sigma, as the adjustment weighed them
    [volume]                        # min_mm, max_mm: the box of W that the data filled
    [verification]                  # status: "verified" or "unverified", as these figures say; no table: unverified
                                    # date, expires, points, rms_mm, max_mm, en_max, rms_limit_mm, max_limit_mm, en_limit
    [station.NAME]                  # order, signs, eps_rad, d_mm, zoom (the name of its setting)
    [station.NAME.world_from_gimbal]    rotation (rows) or quaternion_wxyz, translation_mm
    [station.NAME.rg_from_camera]       rotation or quaternion_wxyz, translation_mm (the lever arm)
    [station.NAME.lens]                 sensor_px, fx_px, fy_px, cx_px, cy_px, distortion (k1, k2, p1, p2, k3)
    [covariance]                    # parameters: names; matrix: rows, in the parameters' own units squared

A parameter is named station.group.element: left.world_from_gimbal.rx_rad, left.world_from_gimbal.x_mm, left.eps_rad, left.d_mm,
left.rg_from_camera.z_mm, left.lens.fx_px and so on. Rotations are perturbed from the left: R = exp([r]x) R_file. Every float is
written so that it is read back bit by bit; rotations are written as matrices, which need no arithmetic to come back.

Version 1 had no parent, dof, forced_because, [data], [noise], [volume], [verification] and zoom, and wrote quaternions. It is
read as a version 2 that does not know them; what it forced, it forced without a reason.
"""

from pathlib import Path

from trackerd.formats.atomic import toml_text, write_atomically
from trackerd.formats.calibration_model import (
    FEWEST_CHECK_POINTS,
    AssumedNoise,
    Calibration,
    DataIdentity,
    Standing,
    Verification,
    Volume,
)
from trackerd.formats.calibration_tables import FileTable, tables_of
from trackerd.formats.file_parts import check_covariance
from trackerd.formats.rules import NO_VALUE, nearest
from trackerd.formats.tables import Problems, Tables, read_tables

FORMAT = "trackerd-calibration"
VERSION = 2
KEYS_OF_1 = ("format", "version", "id", "created", "software", "method", "chi2_per_dof", "forced", "station", "covariance")
NO_REASON_IN_1 = "version 1 of the file has no reasons"

__all__ = [
    "FEWEST_CHECK_POINTS",
    "AssumedNoise",
    "Calibration",
    "DataIdentity",
    "Standing",
    "Verification",
    "Volume",
    "load_calibration",
    "save_calibration",
]


def load_calibration(path: Path) -> Calibration:
    """Of a file of version 1 or 2. Raises ConfigError with every error of the file: file, table, key, value, rule."""
    tables = read_tables(path)
    problems = Problems(path.name)
    _refuse_foreign(problems, tables)
    return _checked(problems, _upgraded(problems, tables)).calibration()


def save_calibration(calibration: Calibration, path: Path) -> None:
    """Replaces the file in one step: a reader, or a power cut, sees the old one or the new one, whole.

    What could not be read again is not written: raises ConfigError as `load_calibration` would. Raises OSError.
    """
    tables = tables_of(calibration, {"format": FORMAT, "version": VERSION})
    _checked(Problems(path.name), tables)
    write_atomically(path, toml_text(tables))


def _checked(problems: Problems, tables: Tables) -> FileTable:
    file = problems.check(FileTable, tables)
    if file is not None and file.covariance is not None:
        check_covariance(file.covariance, problems)
    problems.raise_any()
    assert file is not None
    return file


def _refuse_foreign(problems: Problems, tables: Tables) -> None:
    """Another file, or another version of this one, is one error: its keys would only be noise."""
    found, version = tables.get("format", NO_VALUE), tables.get("version", NO_VALUE)
    if found != FORMAT:
        problems.add((), "format", found, f'is no calibration file: format must be "{FORMAT}"')
    elif type(version) is not int or version not in (1, VERSION):
        problems.add((), "version", version, f"this trackerd reads versions 1 and {VERSION} of the calibration file")
    problems.raise_any()


def _upgraded(problems: Problems, tables: Tables) -> Tables:
    """Version 1 in the form of version 2."""
    if tables["version"] == VERSION:
        return tables
    for key in tables.keys() - set(KEYS_OF_1):
        problems.add((), key, tables[key], f"unknown key of version 1{nearest(key, KEYS_OF_1)}")
    forced = {"forced_because": NO_REASON_IN_1} if tables.get("forced") is True else {}
    return {key: value for key, value in tables.items() if key in KEYS_OF_1} | forced | {"version": VERSION}
