"""The joint bundle adjustment of a cell: every gimbal, every view, every target at once.

    targets = known_points(p_mm, names)                # or board(), mover(), unknown_points(), and several by join()
    seen = observations(gimbal, view, az_rad, el_rad, u_px, v_px, point, targets, sigma_px=0.1, encoder_sigma_rad=1e-5)
    result = calibrate_cell(seen, targets, nominal)    # nominal: {"left": Station, "right": Station}
    prediction = predict(result.stations, result.parameters, result.covariance, p_mm, sigma_px=0.1, encoder_sigma_rad=1e-5)

Plain arrays and frozen dataclasses in and out; nothing here reads a file or prints.
"""

from trackerd.calibrate.cell.aiming import aim
from trackerd.calibrate.cell.measure import Measured, measure
from trackerd.calibrate.cell.observations import Observations, observations
from trackerd.calibrate.cell.options import ARCSEC, Group, Held, Options, Priors
from trackerd.calibrate.cell.predict import Prediction, predict
from trackerd.calibrate.cell.reliability import Reliability, Verification, reliability, verify
from trackerd.calibrate.cell.result import BodyFound, CellResult, Rejected, Residuals
from trackerd.calibrate.cell.solve import bound, calibrate_cell
from trackerd.calibrate.cell.targets import WORLD, Body, Targets, board, join, known_points, mover, unknown_points, with_bars

__all__ = [
    "ARCSEC",
    "WORLD",
    "Body",
    "BodyFound",
    "CellResult",
    "Group",
    "Held",
    "Measured",
    "Observations",
    "Options",
    "Prediction",
    "Priors",
    "Rejected",
    "Reliability",
    "Residuals",
    "Targets",
    "Verification",
    "aim",
    "board",
    "bound",
    "calibrate_cell",
    "join",
    "known_points",
    "measure",
    "mover",
    "observations",
    "predict",
    "reliability",
    "unknown_points",
    "verify",
    "with_bars",
]
