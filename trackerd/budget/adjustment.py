"""The same cell by bundle adjustment, and the Cramér-Rao bound of both: the one view and the looks, jointly, at known points.

The kinematics are believed as the source thesis believes them (lever arm, mount, square axes); what it calibrates is free:
pose, focal length and principal point of every gimbal, without prior knowledge of any.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import inf

import numpy as np

from trackerd.budget.outcome import Outcome, outcome
from trackerd.budget.settings import Case
from trackerd.budget.simulate import Readings
from trackerd.budget.stage import Sight, Stage
from trackerd.calibrate.cell import (
    CellResult,
    Group,
    Observations,
    Options,
    Priors,
    Targets,
    bound,
    calibrate_cell,
    known_points,
    measure,
    observations,
    predict,
)
from trackerd.contract.model import Array
from trackerd.formats.settings import ARCSEC
from trackerd.geometry.gimbal import Station

LEAST_PIXEL_SIGMA_PX = 1e-4  # a case without noise is weighed with it: pixels are rounded by as much in single precision
LEAST_PIXEL_SHARE = 3e-4  # of what the encoders move the image by: below it the encoders' second order is what weighs
LEAST_ENCODER_SIGMA_RAD = 1e-3 * ARCSEC
NO_NOISE = 1e-6  # px and arcsec: what the bound takes for none
VIEW = "view"


@dataclass(frozen=True, slots=True)
class Bound:
    """Least covariances that any unbiased estimate from these data can have, at the truth."""

    centre_mm2: Array  # (K, 3, 3)
    turn_rad2: Array  # (K, 3, 3)
    target_mm2: Array  # (P, 3, 3)
    calibration_mm2: Array  # (P, 3, 3), the part of it that is not the one look's


@dataclass(frozen=True, slots=True)
class Noise:
    """What the adjustment is told of the noise."""

    pixel_sigma_px: float
    encoder_sigma_rad: float
    encoder_fixed_rad: float  # it is believed to be independent from view to view, as it is where the angles differ

    @classmethod
    def weighing(cls, case: Case, focal_px: float) -> "Noise":
        """With the least sigmas that a sum of squares is sound with in double precision."""
        least_px = max(LEAST_PIXEL_SIGMA_PX, LEAST_PIXEL_SHARE * focal_px * case.encoders_rad)
        white_rad = max(case.encoder_sigma_rad, LEAST_ENCODER_SIGMA_RAD)
        return cls(max(case.pixel_sigma_px, least_px), white_rad, case.encoder_fixed_rad)

    @classmethod
    def of(cls, case: Case) -> "Noise":
        white_rad = max(case.encoder_sigma_rad, NO_NOISE * ARCSEC)
        return cls(max(case.pixel_sigma_px, NO_NOISE), white_rad, case.encoder_fixed_rad)


def by_adjustment(stage: Stage, readings: Readings, case: Case, start: Mapping[str, Station] | None) -> Outcome:
    """Adjusts from `start` (None: without a guess of the poses), then measures the targets by maximum likelihood.

    Raises Undetermined and Degenerate as the adjustment does.
    """
    focal_px = next(iter(stage.stations.values())).lens.fx_px
    targets, noise = known_points(stage.points_mm), Noise.weighing(case, focal_px)
    seen = _calibration_views(readings, targets, noise)
    options = replace(_options(stage), from_nominal=start is not None)
    result = calibrate_cell(seen, targets, start or stage.stations, options)
    looks = _target_looks(readings, targets, noise)
    measured = measure(looks, len(targets), result.stations, result.parameters, result.covariance)
    return outcome(stage, _view_rms_px(result, seen, stage), result.stations, measured.p_mm)


def calibration_bound(stage: Stage, case: Case) -> tuple[tuple[str, ...], Array]:
    """Parameters (p) of the stations, and their least covariance (p, p)."""
    targets = known_points(stage.points_mm)
    design = _calibration_views(stage.sights, targets, Noise.of(case))
    return bound(design, targets, stage.stations, options=_options(stage))


def bound_of(stage: Stage, case: Case) -> Bound:
    noise = Noise.of(case)
    names, cov = calibration_bound(stage, case)
    prediction = predict(
        stage.stations,
        names,
        cov,
        stage.points_mm,
        sigma_px=noise.pixel_sigma_px,
        encoder_sigma_rad=noise.encoder_sigma_rad,
        encoder_fixed_rad=noise.encoder_fixed_rad,
    )
    return Bound(
        centre_mm2=_blocks(names, cov, stage, ("x_mm", "y_mm", "z_mm")),
        turn_rad2=_blocks(names, cov, stage, ("rx_rad", "ry_rad", "rz_rad")),
        target_mm2=prediction.total_mm2,
        calibration_mm2=prediction.calibration_mm2,
    )


def _options(stage: Stage) -> Options:
    """Nothing is rejected, refused or assumed: the noise is what the model says, and every trial counts."""
    return Options(
        priors=Priors(f_relative=inf, centre_px=inf),
        free=dict.fromkeys(stage.stations, frozenset((Group.POSE, Group.LENS))),
        distortion=0,
        more_distortion=False,
        reject_sigma=inf,
        force=True,
    )


def _calibration_views(readings: Readings, targets: Targets, noise: Noise) -> Observations:
    columns = [_view_columns(name, sight, targets.names) for name, sight in readings.items()]
    columns += [_look_columns(name, "look", sight.looks_rad, sight.looks_px, targets.names) for name, sight in readings.items()]
    return _observed(columns, targets, noise)


def _target_looks(readings: Readings, targets: Targets, noise: Noise) -> Observations:
    columns = [
        _look_columns(name, "target", sight.targets_rad[None], sight.targets_px[None], targets.names)
        for name, sight in readings.items()
    ]
    return _observed(columns, targets, noise)


@dataclass(frozen=True, slots=True)
class _Columns:
    """n image points of one station."""

    gimbal: str
    views: tuple[str, ...]
    angles_rad: Array  # (n, 2)
    q_px: Array  # (n, 2)
    points: tuple[str, ...]


def _view_columns(name: str, sight: Sight, points: tuple[str, ...]) -> _Columns:
    count = len(points)
    return _Columns(name, (VIEW,) * count, np.tile(sight.view_rad, (count, 1)), sight.view_px, points)


def _look_columns(name: str, kind: str, angles_rad: Array, q_px: Array, points: tuple[str, ...]) -> _Columns:
    """Looks (L, P, 2), one point a view."""
    repeats = len(angles_rad)
    views = tuple(f"{kind} {n} {point}" for n in range(repeats) for point in points)
    return _Columns(name, views, angles_rad.reshape(-1, 2), q_px.reshape(-1, 2), points * repeats)


def _observed(columns: list[_Columns], targets: Targets, noise: Noise) -> Observations:
    angles_rad = np.concatenate([each.angles_rad for each in columns])
    q_px = np.concatenate([each.q_px for each in columns])
    return observations(
        gimbal=[each.gimbal for each in columns for _ in each.views],
        view=[view for each in columns for view in each.views],
        az_rad=angles_rad[:, 0],
        el_rad=angles_rad[:, 1],
        u_px=q_px[:, 0],
        v_px=q_px[:, 1],
        point=[point for each in columns for point in each.points],
        targets=targets,
        sigma_px=noise.pixel_sigma_px,
        encoder_sigma_rad=noise.encoder_sigma_rad,
        encoder_fixed_rad=noise.encoder_fixed_rad,
    )


def _view_rms_px(result: CellResult, seen: Observations, stage: Stage) -> list[float]:
    """Of each station's one view, as calibrateCamera states it."""
    views = [seen.views.index(f"{name}/{VIEW}") for name in stage.stations]
    return [float(np.sqrt((result.residuals.px[seen.of_view(view)] ** 2).sum(axis=1).mean())) for view in views]


def _blocks(names: tuple[str, ...], cov: Array, stage: Stage, elements: tuple[str, ...]) -> Array:
    """Covariances of one vector of every station's base pose, (K, 3, 3)."""
    rows = [[names.index(f"{name}.world_from_gimbal.{element}") for element in elements] for name in stage.stations]
    return np.array([cov[np.ix_(row, row)] for row in rows])
