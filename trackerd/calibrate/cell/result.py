"""What the adjustment of a cell found."""

from dataclasses import dataclass
from math import sqrt

import numpy as np
import numpy.typing as npt

from trackerd.contract.model import Array
from trackerd.geometry.gimbal import Station
from trackerd.geometry.rigid import Rigid


@dataclass(frozen=True, slots=True)
class Rejected:
    """One image point, or a view's angles (point is None: all of the view is left out)."""

    view: str  # GIMBAL/VIEW
    point: str | None
    sigmas: float  # how far off
    reason: str


@dataclass(frozen=True, slots=True)
class Residuals:
    """Measured minus computed, in the order of the observations; encoder corrections in the order of the views."""

    px: Array  # (n, 2) after the encoder corrections
    whitened: Array  # (n, 2) divided by the sigma that is left of it when parameters are known: unit variance
    encoder_rad: Array  # (v, 2) to be added to the encoders' az, el
    encoder_whitened: Array  # (v, 2)
    used: npt.NDArray[np.bool_]  # (n,)
    used_view: npt.NDArray[np.bool_]  # (v,)


@dataclass(frozen=True, slots=True)
class BodyFound:
    """Pose of a body; a mover has its ball in the flange."""

    world_from_body: Rigid
    covariance: Array  # (6, 6) of rx, ry, rz (rad, from the left), x, y, z (mm); 0 where fixed
    ball_mm: Array | None = None
    ball_covariance_mm2: Array | None = None  # (3, 3)


@dataclass(frozen=True, slots=True)
class CellResult:
    """Parameter names as trackerd.formats.calibration documents them; fx and fy of square pixels are fully correlated."""

    stations: dict[str, Station]
    parameters: tuple[str, ...]  # (p)
    covariance: Array  # (p, p)
    chi2: float
    dof: int
    forced: bool  # chi-square is beyond the limit, and a person wanted it nevertheless
    residuals: Residuals
    rejected: tuple[Rejected, ...]
    bodies: dict[str, BodyFound]
    points_mm: Array  # (m, 3) in W, in the order of the targets; NaN where no view showed a free one
    points_cov_mm2: Array  # (m, 3, 3), calibration included
    warnings: tuple[str, ...]
    iterations: int

    @property
    def chi2_per_dof(self) -> float:
        return self.chi2 / self.dof

    @property
    def sigmas(self) -> dict[str, float]:
        return {name: sqrt(max(v, 0.0)) for name, v in zip(self.parameters, np.diag(self.covariance).tolist(), strict=True)}

    def rms_px(self) -> float:
        """Root mean square of both coordinates of the used image points."""
        return sqrt(float((self.residuals.px[self.residuals.used] ** 2).mean()))
