"""points.csv, flange.csv and the lists of a board's points: places as people write them. dataset.py tells the columns."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from trackerd.contract.errors import ConfigError
from trackerd.contract.model import Array
from trackerd.formats.csv_table import Findings, Row, read_rows
from trackerd.formats.dataset_tables import MoverTable
from trackerd.geometry.rigid import Rigid

POINTS, FLANGE = "points.csv", "flange.csv"
POINT_COVARIANCE = ("cxx_mm2", "cxy_mm2", "cxz_mm2", "cyy_mm2", "cyz_mm2", "czz_mm2")


@dataclass(frozen=True, slots=True)
class Point:
    """A place of the probe. `p_mm` and `cov_mm2` are None where it is not known."""

    name: str
    p_mm: Array | None  # (3,) in the mover's frame
    cov_mm2: Array | None  # (3, 3)
    use: Literal["adjust", "check"] = "adjust"


def read_points(path: Path, mover: MoverTable, findings: Findings) -> Iterator[tuple[str, Point]]:
    seen: dict[str, int] = {}
    extras = ("x_mm", "y_mm", "z_mm", "sigma_mm", *POINT_COVARIANCE, "use")
    for row in read_rows(path, ("point",), extras, findings):
        name = row.text("point")
        if name in seen:
            row.refuse("point", f"is there twice, first in line {seen[name]}")
        if "/" in name:
            row.refuse("point", 'must not hold a "/": that names a board')
        seen.setdefault(name, row.line)
        use = row.values.get("use") or "adjust"
        if use not in ("adjust", "check"):
            row.refuse("use", 'must be "adjust" or "check"')
        known = any(row.has(column) for column in ("x_mm", "y_mm", "z_mm"))
        if use == "check" and not known:
            row.refuse("use", "a check point needs its coordinates")
        p_mm = np.array([row.number(column) for column in ("x_mm", "y_mm", "z_mm")]) if known else None
        yield name, Point(name, p_mm, _point_cov(row, mover) if known else None, "check" if use == "check" else "adjust")


def _point_cov(row: Row, mover: MoverTable) -> Array:
    if any(row.has(column) for column in POINT_COVARIANCE):
        xx, xy, xz, yy, yz, zz = (row.number(column) for column in POINT_COVARIANCE)
        cov = np.array(((xx, xy, xz), (xy, yy, yz), (xz, yz, zz)))
        if not np.linalg.eigvalsh(cov).min() > 0.0:
            row.refuse("cxx_mm2", "the covariance must be positive definite")
        return cov
    if not row.has("sigma_mm") and mover.sigma_mm is None:
        row.refuse("sigma_mm", "is missing, and dataset.toml [mover] has no sigma_mm either")
    sigma_mm = row.number("sigma_mm", mover.sigma_mm or 1.0)
    if sigma_mm <= 0.0:
        row.refuse("sigma_mm", "must be above 0")
    return sigma_mm**2 * np.eye(3)


def read_flange(path: Path, points: Mapping[str, Point], findings: Findings) -> Iterator[tuple[str, Rigid]]:
    columns = ("point", "x_mm", "y_mm", "z_mm", "qw", "qx", "qy", "qz")
    for row in read_rows(path, columns, (), findings):
        name = row.text("point")
        if name not in points:
            row.refuse("point", f"is not in {POINTS}")
        quaternion = np.array([row.number(column) for column in columns[4:]])
        norm = float(np.linalg.norm(quaternion))
        if abs(norm - 1.0) > 1e-3:
            row.refuse("qw", f"a rotation's quaternion has norm 1, not {norm:.6g}")
            continue
        yield name, Rigid.from_quaternion(quaternion, np.array([row.number(column) for column in columns[1:4]]))


def read_listed(path: Path, findings: Findings) -> Array:
    """Points of a board by number, (n, 3)."""
    found: dict[int, list[float]] = {}
    for row in read_rows(path, ("feature", "x_mm", "y_mm", "z_mm"), (), findings):
        number = int(row.number("feature"))
        if number in found:
            row.refuse("feature", "is there twice")
        found[number] = [row.number(column) for column in ("x_mm", "y_mm", "z_mm")]
    if sorted(found) != list(range(len(found))):
        raise ConfigError(f"{path.name}: the features must be numbered 0, 1, 2 ... without a gap")
    return np.array([found[number] for number in range(len(found))]).reshape(-1, 3)
