"""The joint bundle adjustment of a cell."""

from collections.abc import Mapping

import numpy as np
from scipy.stats import chi2 as chi_square

from trackerd.calibrate.cell.adjust import Adjusted, adjust
from trackerd.calibrate.cell.checks import MOST_REJECTED, check_data, check_options, check_result
from trackerd.calibrate.cell.covariance import covariance_of
from trackerd.calibrate.cell.known import (
    STAGES,
    check_nominal,
    freed,
    known_of,
    names_of,
    station_columns,
    target_columns,
)
from trackerd.calibrate.cell.normal import Weights, assemble, columns_of, evaluate
from trackerd.calibrate.cell.observations import Observations
from trackerd.calibrate.cell.options import Options
from trackerd.calibrate.cell.outcome import Solved, result_of
from trackerd.calibrate.cell.problem import Problem, part_of, problem_of, thinned
from trackerd.calibrate.cell.result import CellResult
from trackerd.calibrate.cell.start import Start, find_start, in_stages, unmirror
from trackerd.calibrate.cell.state import Indices, State, state_of, with_poses
from trackerd.calibrate.cell.targets import Targets
from trackerd.calibrate.cell.weights import Flags, Loss, everyone, hard, offsets
from trackerd.contract.model import Array
from trackerd.geometry.gimbal import Station
from trackerd.geometry.rigid import Rigid

DEFAULT = Options()
FINAL_STEPS = 40
SETTLED, SETTLED_EACH = 0.1, 1e-5  # of chi-square, and for each image point: the weights are good enough
EXACT, ROUNDING = 1e-16, 1e-13  # of chi-square, absolute and relative
NEARLY_THERE = 1e-9  # damping
FEW, MOST = 0.05, 0.7  # rejected: no reason to try another way; kept: a second way to the same is enough
MANY = 3000  # image points: the stages need no more, spread over all views
REJECTIONS = 6  # rounds, at most
ASKED = 0.999  # chi-square beyond this quantile asks for one more distortion coefficient
WORTH = 15.0  # chi-square that a coefficient must save


def calibrate_cell(
    observations: Observations, targets: Targets, nominal: Mapping[str, Station], options: Options = DEFAULT
) -> CellResult:
    """All gimbals jointly; the encoders' corrections of each view, shared by all of its points, are eliminated.

    `nominal` has every gimbal of the observations; sensor, lens, mount and axes are the priors' centres. Stations that are
    in `nominal` but have no view come back as they are. Raises ConfigError for input that contradicts itself, and
    Undetermined where the data do not determine the cell, or where chi-square refuses the result; its text names causes.
    """
    check_nominal(observations.gimbals, nominal)
    check_options(options, nominal)
    stations = [nominal[name] for name in observations.gimbals]
    stations += [station for name, station in nominal.items() if name not in observations.gimbals]
    warnings = check_data(observations, targets, options)
    start = find_start(observations, targets, stations, options)
    solved = _solve(observations, targets, start, options)
    if options.more_distortion and options.free is None:
        solved = _with_more_distortion(observations, targets, start, options, solved)
    warnings += check_result(solved.problem, solved.adjusted, solved.dof, solved.allowed, options)
    return result_of(solved, start.stations, options.stand_tilt_rad, warnings)


def _problem(
    observations: Observations, targets: Targets, start: Start, options: Options, coefficients: int
) -> tuple[Problem, Flags]:
    """And which station columns are free in it."""
    allowed, held = freed(start.stations, options, coefficients)
    known = known_of(start.stations, targets, options, allowed, held)
    return problem_of(observations, targets, known, options.square_pixels), allowed | held


def _solve(observations: Observations, targets: Targets, start: Start, options: Options) -> Solved:
    problem, allowed = _problem(observations, targets, start, options, options.distortion)
    few = problem
    if problem.n > MANY:
        part = part_of(observations, thinned(observations, np.arange(problem.n), MANY))
        few, _ = _problem(part, targets, start, options, options.distortion)
    best: Solved | None = None
    for loss in (Loss.EQUAL, Loss.FINE, Loss.COARSE):
        coarse = _coarse(few, start, allowed, options, loss)
        if few is not problem:
            coarse = _softly(few, coarse.state, coarse.weights, allowed)
        weights = coarse.weights if few is problem else everyone(problem)
        solved = _settle(problem, _softly(problem, coarse.state, weights, allowed), allowed, options)
        again = best is not None and _rank(solved, options) == _rank(best, options)
        if best is None or _rank(solved, options) > _rank(best, options):
            best = solved
        if _rank(best, options) > (True, 1.0 - FEW) or (again and _rank(best, options) > (True, MOST)):
            break
    assert best is not None
    return best


def _rank(solved: Solved, options: Options) -> tuple[bool, float]:
    """A result that fits before one that does not; then, the one that leaves out less."""
    fits = solved.dof > 0 and solved.adjusted.normal.cost < options.worst_chi2_per_dof * solved.dof
    return fits, float(solved.adjusted.weights.point.mean())


def _coarse(problem: Problem, start: Start, allowed: Flags, options: Options, loss: Loss) -> Adjusted:
    coarse = in_stages(problem, start.state, allowed, loss=loss)
    state = unmirror(coarse, problem, start.stations, options)
    return coarse if state is None else in_stages(problem, state, allowed, loss=loss)


def _settle(problem: Problem, soft: Adjusted, allowed: Flags, options: Options) -> Solved:
    """Rejects after robust weights; and where that rejects much, also after equal ones."""
    first = _reject(problem, soft, allowed, options)
    if _rank(first, options) > (True, MOST):
        return first
    free, tolerance = _all_free(problem, allowed), max(SETTLED, SETTLED_EACH * problem.n)
    even = adjust(problem, soft.state, free, everyone(problem), loss=Loss.EQUAL, steps=FINAL_STEPS, tolerance=tolerance)
    second = _reject(problem, even, allowed, options)
    return max(first, second, key=lambda solved: _rank(solved, options))


def _softly(problem: Problem, state: State, weights: Weights, allowed: Flags) -> Adjusted:
    tolerance = max(SETTLED, SETTLED_EACH * problem.n)
    return adjust(problem, state, _all_free(problem, allowed), weights, loss=Loss.FINE, steps=FINAL_STEPS, tolerance=tolerance)


def _all_free(problem: Problem, allowed: Flags) -> Indices:
    return np.concatenate([station_columns(allowed, len(STAGES)), target_columns(problem)])


def _reject(problem: Problem, coarse: Adjusted, allowed: Flags, options: Options) -> Solved:
    """What is far off is left out, and taken back where the rest no longer says so."""
    free, done = _all_free(problem, allowed), coarse
    weights, bad_views = hard(offsets(problem, done.linear, done.weights), options.reject_sigma, problem)
    for _ in range(REJECTIONS):
        done = _exactly(problem, done.state, free, weights)
        again, bad_views = hard(offsets(problem, done.linear, weights), options.reject_sigma, problem)
        if np.array_equal(again.point, weights.point):
            break
        weights = again
    return Solved(problem, done, allowed, bad_views, _dof(problem, done.weights, free))


def _exactly(problem: Problem, state: State, free: Indices, weights: Weights) -> Adjusted:
    return adjust(
        problem,
        state,
        free,
        weights,
        loss=Loss.EQUAL,
        steps=FINAL_STEPS,
        tolerance=EXACT,
        relative=ROUNDING,
        damping=NEARLY_THERE,
    )


def _dof(problem: Problem, weights: Weights, free: Indices) -> int:
    """Encoders count as observations of their own corrections: nothing. So do points with a covariance of theirs."""
    known_points = int((np.abs(problem.point_information).max(axis=(1, 2), initial=0.0) > 0.0).sum())
    observed = 2 * int(weights.point.sum()) + problem.known.count + len(problem.targets.bar_mm) + 3 * known_points
    return observed - len(free)


def _with_more_distortion(
    observations: Observations, targets: Targets, start: Start, options: Options, solved: Solved
) -> Solved:
    """k2, p1, p2, k3, one after the other, while chi-square is too large to be chance, but most of the data fit."""
    for coefficients in range(options.distortion + 1, 6):
        adjusted, dof = solved.adjusted, solved.dof
        if dof < 1 or adjusted.normal.cost < chi_square.ppf(ASKED, dof) or adjusted.weights.point.mean() < 1.0 - MOST_REJECTED:
            break
        problem, allowed = _problem(observations, targets, start, options, coefficients)
        more = _settle(problem, _softly(problem, adjusted.state, adjusted.weights, allowed), allowed, options)
        if adjusted.normal.cost / dof - more.adjusted.normal.cost / more.dof > WORTH / dof:
            solved = more
    return solved


def bound(
    observations: Observations,
    targets: Targets,
    stations: Mapping[str, Station],
    bodies: Mapping[str, Rigid] | None = None,
    options: Options = DEFAULT,
) -> tuple[tuple[str, ...], Array]:
    """Cramér-Rao bound of a design: parameter names and the inverse Fisher information, with the priors, at true values.

    Only views, angles, points and sigmas of the observations count, not the pixels; `bodies` are the true poses of bodies that
    are not fixed. With `predict` it gives the bound of a target.
    """
    check_nominal(observations.gimbals, stations)
    cell = [stations[name] for name in observations.gimbals]
    allowed, held = freed(cell, options, options.distortion)
    known = known_of(cell, targets, options, allowed, held)
    problem = problem_of(observations, targets, known, options.square_pixels)
    places = {b: (bodies or {})[body.name] for b, body in enumerate(targets.bodies) if body.name in (bodies or {})}
    state = with_poses(state_of(cell, targets), places)
    return names_of(cell), _covariance_at(problem, state, allowed | held)


def _covariance_at(problem: Problem, state: State, allowed: Flags) -> Array:
    free = _all_free(problem, allowed)
    columns = columns_of(free, problem)
    normal = assemble(problem, state, evaluate(problem, state), everyone(problem), columns)
    end = problem.layout.bodies_at
    return covariance_of(problem, normal, free)[:end, :end]
