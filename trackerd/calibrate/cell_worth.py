"""What a calibrated cell is worth: targets over the volume, check points, and errors that nothing would show."""

from dataclasses import dataclass

import numpy as np

from trackerd.calibrate.cell import (
    CellResult,
    Measured,
    Prediction,
    Reliability,
    Verification,
    measure,
    predict,
    reliability,
    verify,
)
from trackerd.calibrate.cell_data import CellData
from trackerd.calibrate.plan.volume import Box
from trackerd.calibrate.uncertainty import Spread, spread
from trackerd.contract.errors import Undetermined
from trackerd.contract.model import Array
from trackerd.formats.dataset import Dataset

STEPS = 9  # of the map along each side of the volume
RELIABILITY_STEPS = 3


@dataclass(frozen=True, slots=True)
class Frame:
    """1 sigma of one frame of the running cell."""

    pixel_px: float
    encoder_rad: float
    encoder_fixed_rad: float


@dataclass(frozen=True, slots=True)
class Checked:
    """The check points that two stations or more have seen."""

    names: tuple[str, ...]
    verification: Verification
    p_mm: Array  # (m, 3)


@dataclass(frozen=True, slots=True)
class Worth:
    box: Box
    frame: Frame
    p_mm: Array  # (STEPS^3, 3)
    prediction: Prediction
    total: Spread  # of a target in one frame
    calibration: Spread  # the calibration's part
    reliability: Reliability
    checked: Checked | None


def worth(dataset: Dataset, data: CellData, result: CellResult, box: Box | None = None) -> Worth:
    """Over `box`, else over the volume that the data fill. Raises Undetermined where that is none, Degenerate as `predict`."""
    frame = frame_of(dataset, data)
    volume = box or volume_of(data, result)
    p_mm = volume.grid(STEPS)
    prediction = predict(
        result.stations,
        result.parameters,
        result.covariance,
        p_mm,
        sigma_px=frame.pixel_px,
        encoder_sigma_rad=frame.encoder_rad,
        encoder_fixed_rad=frame.encoder_fixed_rad,
    )
    total, calibration = (spread(cov, p_mm, result.stations) for cov in (prediction.total_mm2, prediction.calibration_mm2))
    coarse = volume.grid(RELIABILITY_STEPS)
    unseen = reliability(result.stations, coarse, sigma_px=frame.pixel_px, encoder_sigma_rad=frame.encoder_rad)
    return Worth(volume, frame, p_mm, prediction, total, calibration, unseen, check(data, result))


def frame_of(dataset: Dataset, data: CellData) -> Frame:
    """As the dataset says of its gimbals; of the pixels what its views were weighed with, brought back to one frame."""
    frames = {(line.gimbal, line.view): line.frames for line in dataset.image_points}
    o = data.observations
    of_view = np.array([frames[gimbal, view.partition("/")[2]] for view, gimbal in zip(o.views, _gimbals(data), strict=True)])
    pixel_px = float(np.median(o.sigma_px * np.sqrt(of_view[o.view])))
    tables = dataset.gimbals.values()
    return Frame(pixel_px, max(table.encoder_sigma_rad for table in tables), max(table.encoder_fixed_rad for table in tables))


def _gimbals(data: CellData) -> list[str]:
    return [data.observations.gimbals[index] for index in data.observations.gimbal]


def volume_of(data: CellData, result: CellResult) -> Box:
    """The least box that holds all points that were seen."""
    seen = result.points_mm[np.unique(data.observations.point)]
    seen = seen[np.isfinite(seen).all(axis=1)]
    if len(seen) < 2 or not (box := Box.of(seen)).size_mm.max() > 0.0:
        raise Undetermined("the points that were seen fill no volume: give one with --volume")
    return box


def check(data: CellData, result: CellResult) -> Checked | None:
    """None: there are no check points that two stations saw."""
    if data.check_observations is None:
        return None
    measured = measured_of(data, result)
    known = np.asarray(np.isfinite(measured.p_mm).all(axis=1))
    if not known.any():
        return None
    reference = np.array([point.p_mm for point in data.checks])[known]
    reference_cov = np.array([point.cov_mm2 for point in data.checks])[known]
    names = tuple(point.name for point, seen in zip(data.checks, known, strict=True) if seen)
    return Checked(
        names, verify(measured.p_mm[known], measured.total_mm2[known], reference, reference_cov), measured.p_mm[known]
    )


def measured_of(data: CellData, result: CellResult) -> Measured:
    assert data.check_observations is not None
    return measure(data.check_observations, len(data.checks), result.stations, result.parameters, result.covariance)
