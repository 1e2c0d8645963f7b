"""Many images of one camera through the detector: each frame's outline starts the next one's search."""

import csv
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from trackerd.contract.model import Array, Found, Image, Missed, Outline
from trackerd.inspection.camera import Camera
from trackerd.inspection.detector import Detector, detector_for, place
from trackerd.inspection.examine import edges
from trackerd.vision.convergence import CircleFit
from trackerd.vision.curve import angles
from trackerd.vision.rays import Circle

COLUMNS = (
    "frame", "name", "t_ns", "found", "x_px", "y_px", "r_px", "sigma_x_px", "sigma_y_px", "sigma_r_px", "correlation_xy",
    "coverage", "chi2", "clipped", "blur_px", "inside_dn", "outside_dn", "reason",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Sample:
    """One frame of a series."""

    name: str
    t_ns: int | None  # mid-exposure, where the recording tells it
    outline: Outline
    offset_px: Array | None  # (S,) of the edge from the outline; NaN in sectors that do not speak for it


@dataclass(frozen=True, slots=True)
class Shape:
    """What is left over round the outline, averaged over a series, (S,): not round, a stem, a shadow."""

    angle_rad: Array
    offset_px: Array
    sigma_px: Array  # of the mean, from the scatter


class Locator:
    """The outline in each image, near the one before; near the guess or everywhere where that fails."""

    def __init__(self, detector: Detector, guess: Circle | None = None) -> None:
        self._detector = detector
        self._guess = guess
        self._last: Circle | None = None

    def locate(self, image: Image) -> Outline:
        outline = self._detector.locate(image, self._last or self._guess)
        if isinstance(outline, Missed) and self._last is not None:
            outline = self._detector.locate(image, self._guess)
        self._last = place(outline) if isinstance(outline, Found) else None
        return outline


def samples(
    frames: Iterable[tuple[str, int | None, Image]], guess: Circle | None = None, camera: Camera | None = None
) -> Iterator[Sample]:
    """Frames are (name, mid-exposure in ns or None, image); the first tells the depth of all. Raises as `detector_for`."""
    detector: Detector | None = None
    for name, t_ns, image in frames:
        if detector is None:
            detector = detector_for(image, camera)
            locator = Locator(detector, guess)
        outline = locator.locate(image)
        fit = detector.fit(image, outline) if isinstance(outline, Found) else None
        yield Sample(name, t_ns, outline, None if fit is None else _offsets(fit, detector))


def shape(series: list[Sample]) -> Shape | None:
    """Over the frames that have as many sectors as most; None where no frame has any."""
    rows = [sample.offset_px for sample in series if sample.offset_px is not None]
    if not rows:
        return None
    count = Counter(len(row) for row in rows).most_common(1)[0][0]
    offsets = np.array([row for row in rows if len(row) == count])
    there = np.isfinite(offsets)
    n = there.sum(axis=0)
    mean = np.where(there, offsets, 0.0).sum(axis=0) / np.maximum(n, 1)
    squares = (np.where(there, offsets - mean, 0.0) ** 2).sum(axis=0)
    sigma = np.sqrt(squares / np.maximum(n - 1, 1) / np.maximum(n, 1))
    left = (np.where(n > least, part, np.nan) for least, part in ((0, mean), (1, sigma)))
    return Shape(angles(count), *(np.asarray(part, np.float64) for part in left))


def write_csv(path: Path, series: list[Sample]) -> None:
    """One row a frame. Raises OSError."""
    with path.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(COLUMNS)
        writer.writerows(_row(number, sample) for number, sample in enumerate(series))


def _offsets(fit: CircleFit, detector: Detector) -> Array:
    return np.where(edges(fit, detector.noise).kept, fit.sectors.offset_px, np.nan)


def _row(number: int, sample: Sample) -> list[object]:
    t_ns, outline = "" if sample.t_ns is None else sample.t_ns, sample.outline
    if not isinstance(outline, Found):
        return [number, sample.name, t_ns, 0, *[""] * (len(COLUMNS) - 5), outline.reason]
    sigma = np.sqrt(outline.cov_px2.diagonal())
    numbers = (
        *(f"{value:.6f}" for value in (outline.x_px, outline.y_px, outline.r_px, *sigma.tolist())),
        f"{outline.cov_px2[0, 1] / (sigma[0] * sigma[1]):.4f}",
        *(f"{value:.4f}" for value in (outline.coverage, outline.chi2, outline.clipped, outline.blur_px)),
        f"{outline.inside_dn:.2f}",
        f"{outline.outside_dn:.2f}",
    )
    return [number, sample.name, t_ns, 1, *numbers, outline.inflated]
