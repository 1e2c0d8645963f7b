"""Named points from a CSV file, and what is known of their uncertainty.

    id,x_mm,y_mm,z_mm                                           # or point,x,y,z
    ...,sigma_mm                                                # 1 sigma of each axis, or
    ...,sigma_x_mm,sigma_y_mm,sigma_z_mm                        # or the whole covariance:
    ...,cxx_mm2,cxy_mm2,cxz_mm2,cyy_mm2,cyz_mm2,czz_mm2

A line that begins with # is a remark. Either every point has an uncertainty, or none.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from trackerd.contract.errors import ConfigError
from trackerd.contract.model import Array
from trackerd.formats.csv_table import Findings, Row, read_rows

PLACE = ("x_mm", "y_mm", "z_mm")
SIGMAS = ("sigma_x_mm", "sigma_y_mm", "sigma_z_mm")
COVARIANCE = ("cxx_mm2", "cxy_mm2", "cxz_mm2", "cyy_mm2", "cyz_mm2", "czz_mm2")
UNCERTAINTIES = (("sigma_mm",), SIGMAS, COVARIANCE)
ALSO = {"point": "id"} | {
    name.removesuffix("_mm2").removesuffix("_mm"): name for name in (*PLACE, "sigma_mm", *SIGMAS, *COVARIANCE)
}


@dataclass(frozen=True, slots=True)
class Points:
    ids: tuple[str, ...]
    p_mm: Array  # (n, 3)
    cov_mm2: Array | None = None  # (n, 3, 3); None: not known

    def __len__(self) -> int:
        return len(self.ids)

    def only(self, ids: Sequence[str]) -> "Points":
        """These, in this order. Raises KeyError."""
        index = {name: row for row, name in enumerate(self.ids)}
        rows = [index[name] for name in ids]
        return Points(tuple(ids), self.p_mm[rows], None if self.cov_mm2 is None else self.cov_mm2[rows])


def read_points(path: Path) -> Points:
    """Raises ConfigError: file, line, column, value and rule of everything that is wrong."""
    findings = Findings()
    rows = list(read_rows(path, ("id", *PLACE), tuple(name for names in UNCERTAINTIES for name in names), findings, ALSO))
    first: dict[str, int] = {}
    for row in rows:
        if row.text("id") in first:
            row.refuse("id", f"is there twice, first in line {first[row.text('id')]}")
        first.setdefault(row.text("id"), row.line)
    places = [[row.number(column) for column in PLACE] for row in rows]
    covariances = [_covariance(row) for row in rows]
    findings.raise_any()
    if not rows:
        raise ConfigError(f"{path.name}: holds no point")
    known = [cov for cov in covariances if cov is not None]
    if known and len(known) < len(rows):
        bare = next(name for name, cov in zip(first, covariances, strict=True) if cov is None)
        raise ConfigError(f"{path.name}: point {bare} has no uncertainty, others have: all need one, or none")
    return Points(tuple(first), np.array(places), np.array(known) if known else None)


def _covariance(row: Row) -> Array | None:
    """(3, 3), by whichever columns of one kind are filled in."""
    kinds = [names for names in UNCERTAINTIES if any(row.has(name) for name in names)]
    if not kinds:
        return None
    if len(kinds) > 1:
        row.refuse(kinds[1][0], f"says again what {kinds[0][0]} says")
    numbers = [row.number(name) for name in kinds[0]]
    if kinds[0] is not COVARIANCE:
        for name, number in zip(kinds[0], numbers, strict=True):
            if number <= 0.0:
                row.refuse(name, "must be above 0")
        return np.asarray(np.eye(3) * np.array(numbers) ** 2)
    xx, xy, xz, yy, yz, zz = numbers
    cov = np.array(((xx, xy, xz), (xy, yy, yz), (xz, yz, zz)))
    if not np.linalg.eigvalsh(cov).min() > 0.0:
        row.refuse("cxx_mm2", "the covariance must be positive definite")
    return cov
