"""Trials to numbers: the thesis's statistics (mean absolute errors, d the norm of three means) and ours (RMS, 95 %, U)."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import pi, sqrt

import numpy as np

from trackerd.budget.outcome import Outcome, stacked
from trackerd.budget.settings import BudgetSettings
from trackerd.budget.source_method import FREE_PARAMETERS
from trackerd.budget.source_values import SOURCE, SourceTables
from trackerd.budget.stage import draw_points, stations_of
from trackerd.budget.trials import CaseRun
from trackerd.contract.model import Array

MEAN_ABS = sqrt(2.0 / pi)  # mean |error| of a normal distribution, in sigmas
NOTHING_KNOWN = SourceTables("", "", "", {}, {}, {})
COVERAGE = 2.0  # k of the expanded uncertainty U


@dataclass(frozen=True, slots=True)
class Row:
    """One value of one table in its four columns; None: not known."""

    table: str  # "4.2", or what it holds for layouts that the thesis does not have
    layout: str
    case: str
    value: str  # x, y, z, d, ...
    unit: str
    source: float | None
    method: float | None
    adjusted: float | None
    bound: float | None


@dataclass(frozen=True, slots=True)
class Efficiency:
    """The adjustment's targets against the bound; lengths in mm, 3D unless said."""

    layout: str
    case: str
    encoder_arcsec: float  # white
    encoder_fixed_arcsec: float  # a function of the angle
    trials: int
    refused_source: int  # trials that a method ended in a refusal
    refused_adjusted: int
    rms_mm: float
    p95_mm: float
    max_mm: float
    u_across_mm: float  # k = 2, in the worst direction across the view, and
    u_depth_mm: float  # along it
    bound_rms_mm: float
    calibration_rms_mm: float  # the bound's part that the calibration has
    ratio: float | None  # RMS over the bound; None without noise, and where the encoders are not white
    ratio_sigma: float | None  # of the ratio, by the number of trials; the targets of one trial have a part in common


def rows_of(settings: BudgetSettings, runs: Sequence[CaseRun]) -> list[Row]:
    """All tables: reprojection, pose, position for each layout, in this order."""
    rows: list[Row] = []
    for layout in settings.layout:
        own = [run for run in runs if run.layout == layout]
        for part in (_reprojection, _poses, _positions):
            rows += [row for run in own for row in part(settings, run)]
    return rows


def efficiency_of(settings: BudgetSettings, run: CaseRun) -> Efficiency:
    """Errors are NaN where the adjustment refused every trial."""
    errors, depth = _errors_and_depths(settings, run)
    squares = (errors**2).sum(axis=2)  # (T, P)
    along = (errors * depth).sum(axis=2)
    bound_rms_mm = _rms_of([bound.target_mm2 for bound in run.bounds])
    rms_mm = sqrt(float(squares.mean()))
    case = settings.case[run.case]
    comparable = case.encoder_fixed_rad == 0.0 and max(case.pixel_sigma_px, case.encoder_sigma_rad) > 0.0
    return Efficiency(
        layout=run.layout,
        case=run.case,
        encoder_arcsec=case.encoder_arcsec,
        encoder_fixed_arcsec=case.encoder_fixed_arcsec,
        trials=len(run.trials),
        refused_source=sum(trial.source is None for trial in run.trials),
        refused_adjusted=sum(trial.adjusted is None for trial in run.trials),
        rms_mm=rms_mm,
        p95_mm=sqrt(float(np.quantile(squares, 0.95))),
        max_mm=sqrt(float(squares.max())),
        u_across_mm=COVERAGE * _worst_across(errors, depth),
        u_depth_mm=COVERAGE * sqrt(float((along**2).mean())),
        bound_rms_mm=bound_rms_mm,
        calibration_rms_mm=_rms_of([bound.calibration_mm2 for bound in run.bounds]),
        ratio=rms_mm / bound_rms_mm if comparable else None,
        ratio_sigma=rms_mm / bound_rms_mm * _relative_sigma(squares.mean(axis=1)) if comparable else None,
    )


def _rms_of(covariances: Sequence[Array]) -> float:
    """3D, over all places of (n, 3, 3) each."""
    return sqrt(float(np.concatenate(covariances).trace(axis1=1, axis2=2).mean()))


def _relative_sigma(mean_squares: Array) -> float:
    """Of the root of their mean: the trials are independent, what is inside one is not. NaN for one trial."""
    if len(mean_squares) < 2:
        return np.nan
    return float(mean_squares.std(ddof=1) / mean_squares.mean() / 2.0 / sqrt(len(mean_squares)))


def _errors_and_depths(settings: BudgetSettings, run: CaseRun) -> tuple[Array, Array]:
    """The adjustment's errors (T, P, 3) and unit vectors (T, P, 3) from the middle of the gimbals to the targets."""
    middle_mm = np.mean([each.world_from_gimbal.translation_mm for each in stations_of(settings, run.layout).values()], axis=0)
    errors, depths = [], []
    for number, trial in enumerate(run.trials):
        if trial.adjusted is not None:
            errors.append(trial.adjusted.target_mm)
            away = draw_points(settings, settings.points.draw + number % settings.points.draws) - middle_mm
            depths.append(away / np.linalg.norm(away, axis=1, keepdims=True))
    if not errors:
        return (np.full((1, settings.points.count, 3), np.nan),) * 2
    return np.array(errors), np.array(depths)


def _worst_across(errors: Array, depth: Array) -> float:
    """1 sigma in the worst direction across the view."""
    across = (errors - (errors * depth).sum(axis=2, keepdims=True) * depth).reshape(-1, 3)
    if not np.isfinite(across).all():
        return np.nan
    return sqrt(float(np.linalg.eigvalsh(across.T @ across / len(across))[-1]))


def _reprojection(settings: BudgetSettings, run: CaseRun) -> list[Row]:
    """The bound is what noise alone leaves of 2 P coordinates when a camera is fitted to them."""
    known = _known(settings, run)
    source, adjusted = _stacks(run)
    points = settings.points.count
    left = settings.case[run.case].pixel_sigma_px * sqrt((2 * points - FREE_PARAMETERS) / points)
    means = [None if stack is None else float(stack.rms_px.mean()) for stack in (source, adjusted)]
    name = known.reprojection or "reprojection"
    return [Row(name, run.layout, run.case, "rms", "px", known.rms_px.get(run.case), means[0], means[1], left)]


def _poses(settings: BudgetSettings, run: CaseRun) -> list[Row]:
    known, (source, adjusted) = _known(settings, run), _stacks(run)
    name = known.pose or "pose"
    centre_bound = _mean_abs_bound([bound.centre_mm2 for bound in run.bounds])
    turn_bound = np.degrees(_mean_abs_bound([bound.turn_rad2 for bound in run.bounds]))
    centres = [None if stack is None else _mean_abs(stack.centre_mm) for stack in (source, adjusted)]
    turns = [None if stack is None else np.degrees(_mean_abs(stack.turn_rad)) for stack in (source, adjusted)]
    rows = _vector_rows(name, run, "", "mm", known.centre_d_mm.get(run.case), (*centres, centre_bound))
    return rows + _vector_rows(name, run, "turn ", "deg", None, (*turns, turn_bound))


def _positions(settings: BudgetSettings, run: CaseRun) -> list[Row]:
    known, (source, adjusted) = _known(settings, run), _stacks(run)
    targets = [None if stack is None else _mean_abs(stack.target_mm) for stack in (source, adjusted)]
    least = _mean_abs_bound([bound.target_mm2 for bound in run.bounds])
    return _vector_rows(known.position or "position", run, "", "mm", known.target_d_mm.get(run.case), (*targets, least))


def _vector_rows(
    table: str,
    run: CaseRun,
    prefix: str,
    unit: str,
    source_d: float | None,
    vectors: Sequence[Array | None],
) -> list[Row]:
    """x, y, z, and d, the norm of the three, of method, adjustment and bound; of the thesis only d is known."""
    rows = []
    for n, axis in enumerate(("x", "y", "z", "d")):
        columns = [None if v is None else float(np.linalg.norm(v) if n == 3 else v[n]) for v in vectors]
        rows.append(Row(table, run.layout, run.case, prefix + axis, unit, source_d if n == 3 else None, *columns))
    return rows


def _known(settings: BudgetSettings, run: CaseRun) -> SourceTables:
    spacing = settings.layout[run.layout].source_spacing_mm
    return NOTHING_KNOWN if spacing is None else SOURCE[spacing]


def _stacks(run: CaseRun) -> tuple[Outcome | None, Outcome | None]:
    """Both methods' trials; None where all of them were refused."""
    parts = ([trial.source for trial in run.trials if trial.source], [trial.adjusted for trial in run.trials if trial.adjusted])
    source, adjusted = (stacked(part) if part else None for part in parts)
    return source, adjusted


def _mean_abs(errors: Array) -> Array:
    """Over all but the last axis, (3,)."""
    return np.asarray(np.abs(errors).reshape(-1, 3).mean(axis=0))


def _mean_abs_bound(covariances: Sequence[Array]) -> Array:
    """Mean absolute errors (3,) of normal errors with these covariances, (n, 3, 3) each."""
    variances = np.concatenate(covariances).diagonal(axis1=1, axis2=2)
    return np.asarray(MEAN_ABS * np.sqrt(variances).mean(axis=0))
