"""Tables that several files have in common: poses, covariances, times."""

import re
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Annotated, Any

import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, model_validator

from trackerd.contract.model import Array
from trackerd.formats.rules import NO_VALUE
from trackerd.formats.settings import KeyRuleError
from trackerd.formats.tables import Problems
from trackerd.geometry.rigid import Rigid

NORM_TOLERANCE = 1e-6  # of a quaternion: more is a typing error, not rounding
ROTATION_TOLERANCE = 1e-8  # of R R^T - 1: nine typed digits pass, and cost 20 nm at 2 m
HEXADECIMAL_64 = re.compile(r"[0-9a-f]{64}")
PSD_TOLERANCE = 1e-9  # of a covariance's eigenvalues, relative to the largest after scaling to correlations

Vector = tuple[float, float, float]


def instant(text: str) -> datetime:
    """A time as ISO 8601 writes it; without a zone it is UTC. Raises ValueError."""
    found = datetime.fromisoformat(text)
    return found if found.tzinfo else found.replace(tzinfo=UTC)


def _time(value: str) -> str:
    try:
        instant(value)
    except ValueError:
        raise ValueError('must be a time as ISO 8601 writes it, e.g. "2025-03-01T08:00:00+00:00"') from None
    return value


def _digest(value: str) -> str:
    if not HEXADECIMAL_64.fullmatch(value):
        raise ValueError("must be 64 hexadecimal digits, as sha256sum prints them")
    return value


TimeText = Annotated[str, AfterValidator(_time)]
Sha256 = Annotated[str, AfterValidator(_digest)]


class Table(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Identity(Table):
    """What a file was made from."""

    name: str
    sha256: Sha256


class PoseTable(Table):
    """A rotation, as three rows (exact, what is written) or as a quaternion (what a person may type), and a translation."""

    rotation: tuple[Vector, Vector, Vector] | None = None
    quaternion_wxyz: tuple[float, float, float, float] | None = None
    translation_mm: Vector

    @model_validator(mode="after")
    def _one_rotation(self) -> "PoseTable":
        if (self.rotation is None) == (self.quaternion_wxyz is None):
            raise KeyRuleError("rotation", "needs either rotation, three rows, or quaternion_wxyz")
        if self.quaternion_wxyz is not None:
            norm = float(np.linalg.norm(self.quaternion_wxyz))
            if abs(norm - 1.0) > NORM_TOLERANCE:
                raise KeyRuleError("quaternion_wxyz", f"a rotation's quaternion has norm 1, not {norm:.9g}")
        elif (rule := _rotation_rule(np.array(self.rotation))) is not None:
            raise KeyRuleError("rotation", rule)
        return self

    def rigid(self) -> Rigid:
        if self.quaternion_wxyz is not None:
            return Rigid.from_quaternion(np.array(self.quaternion_wxyz), np.array(self.translation_mm))
        return Rigid(np.array(self.rotation), np.array(self.translation_mm))


def _rotation_rule(rotation: Array) -> str | None:
    with np.errstate(over="ignore", invalid="ignore"):
        off = float(np.abs(rotation @ rotation.T - np.eye(3)).max())
    if not off <= ROTATION_TOLERANCE:
        return f"is no rotation: its rows are not orthogonal units (off by {off:.2g})"
    return "is a mirror image, no rotation: its determinant is -1" if np.linalg.det(rotation) < 0.0 else None


def pose_table(pose: Rigid) -> Mapping[str, Any]:
    return {
        "rotation": np.asarray(pose.rotation, float).tolist(),
        "translation_mm": np.asarray(pose.translation_mm, float).tolist(),
    }


class CovarianceTable(Table):
    parameters: tuple[str, ...]
    matrix: tuple[tuple[float, ...], ...]

    def array(self) -> Array:
        n = len(self.parameters)
        return np.array(self.matrix, float).reshape(n, n)


def check_covariance(found: CovarianceTable, problems: Problems, table: Sequence[str] = ("covariance",)) -> None:
    """Adds what is wrong with the `table` as a whole."""
    rule = _covariance_rule(found)
    if rule is not None:
        problems.add(table, "matrix", NO_VALUE, rule)
    twice = {name for name in found.parameters if found.parameters.count(name) > 1}
    for name in sorted(twice):
        problems.add(table, "parameters", NO_VALUE, f'"{name}" is there twice')


def _covariance_rule(found: CovarianceTable) -> str | None:
    """The rule that the matrix breaks."""
    n = len(found.parameters)
    if len(found.matrix) != n or any(len(row) != n for row in found.matrix):
        return f"needs {n} rows of {n} numbers, one for each parameter"
    matrix = found.array()
    if not np.array_equal(matrix, matrix.T):
        row, column = np.argwhere(matrix != matrix.T)[0]
        return f"must be symmetric: row {row}, column {column} differs from its mirror image"
    if n and not _positive_semidefinite(matrix):
        return "must be positive semidefinite: it gives some combination of parameters a negative variance"
    return None


def _positive_semidefinite(matrix: Array) -> bool:
    """Judged on the correlations, so that radians beside pixels do not hide a wrong sign."""
    variances = np.diag(matrix)
    if variances.min() < 0.0:
        return False
    sigmas = np.sqrt(np.where(variances > 0.0, variances, 1.0))
    with np.errstate(over="ignore"):
        correlations = matrix / sigmas[:, None] / sigmas
    if not np.isfinite(correlations).all():
        return False  # a covariance without the variances that it needs
    return float(np.linalg.eigvalsh(correlations).min()) >= -PSD_TOLERANCE * len(matrix)
