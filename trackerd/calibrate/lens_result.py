"""What the pictures of one zoom setting say of a lens."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from trackerd.calibrate.lens_model import INTRINSICS, Estimate, Views
from trackerd.contract.model import Array
from trackerd.geometry.lens import Lens


@dataclass(frozen=True, slots=True)
class PictureFit:
    """`rms_px`: of the distances between corners and their reprojections, those that are used; `rejected`: points by number."""

    name: str
    rms_px: float
    points: int
    rejected: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True)
class LeftOut:
    name: str
    reason: str


@dataclass(frozen=True, slots=True)
class Coverage:
    """Of the sensor by points: how many fall in each cell (rows, columns), and how far out the outermost is."""

    cells: npt.NDArray[np.intp]
    radius_px: float  # from the image's centre
    corner_px: float  # the sensor's corner from there

    @property
    def share(self) -> float:
        return float(np.mean(self.cells > 0))

    @property
    def radius_share(self) -> float:
        return self.radius_px / self.corner_px


@dataclass(frozen=True, slots=True)
class Ladder:
    """One set of coefficients that was tried: BIC is lower for the better one."""

    coefficients: int
    rms_px: float
    bic: float


@dataclass(frozen=True, slots=True)
class LensResult:
    """`covariance` (9, 9) of INTRINSICS, 0 where one was held; it is that of the scatter of the residuals, times `inflation`
    where pictures agree less with each other than the corners of one picture do."""

    lens: Lens
    covariance: Array
    correlation: Array  # (9,), largest with any parameter of a pose; 0 where held
    rms_px: float  # of the distances, as OpenCV has it
    sigma_px: float  # of a coordinate, by the degrees of freedom
    freedom: int
    inflation: float
    coefficients: int  # of distortion: 0, 1 (k1), 2 (k1, k2), 4 (with p1, p2), 5 (with k3)
    tried: tuple[Ladder, ...]
    pictures: tuple[PictureFit, ...]
    left_out: tuple[LeftOut, ...]
    coverage: Coverage
    warnings: tuple[str, ...]
    views: Views  # the points that are used
    residuals_px: Array  # (n, 2), measured minus projected
    estimate: Estimate

    @property
    def sigmas(self) -> dict[str, float]:
        return dict(zip(INTRINSICS, np.sqrt(np.diag(self.covariance)).tolist(), strict=True))

    @property
    def rejected(self) -> int:
        return sum(len(picture.rejected) for picture in self.pictures)
