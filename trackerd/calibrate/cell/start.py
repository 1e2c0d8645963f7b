"""Start values without a guess: station after station from what is known in W, body after body from the stations found."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from trackerd.calibrate.cell.adjust import Adjusted, adjust
from trackerd.calibrate.cell.known import STAGES, Flags, freed, known_of, station_columns, target_columns
from trackerd.calibrate.cell.normal import Weights, evaluate
from trackerd.calibrate.cell.observations import Observations
from trackerd.calibrate.cell.options import EVERYTHING, Options
from trackerd.calibrate.cell.problem import Problem, part_of, problem_of, thinned
from trackerd.calibrate.cell.rays import nearest_point, rays
from trackerd.calibrate.cell.resection import ALIKE, distinct, flat, poses
from trackerd.calibrate.cell.state import BODY_COLUMNS, Indices, State, points_in_world, state_of, with_poses
from trackerd.calibrate.cell.targets import Targets
from trackerd.calibrate.cell.weights import Loss, everyone, offsets
from trackerd.contract.errors import Undetermined
from trackerd.geometry.gimbal import AxisOrder, Station
from trackerd.geometry.rigid import Rigid

FEWEST_POINTS = 4  # different ones, to place a station or a body
STEPS = 15
FEW_STEPS, FEW_ROUGHLY = 6, 0.01  # enough to tell a body's two poses apart
FITS_BADLY = 3.0  # median of its points' squared offsets; 1.4 is chance
ENOUGH, ROUGHLY = 0.1, 1e-3  # of chi-square, absolute and relative: a start need not be better
MOST_ROWS = 500  # image points that place a station
BODY_ROWS = 160  # or a body


@dataclass(frozen=True, slots=True)
class Start:
    stations: tuple[Station, ...]  # orders, signs and poses as found
    state: State


@dataclass(slots=True)
class _Progress:
    """What has a place so far."""

    stations: list[Station]
    placed: set[int]
    state: State
    bodies: set[int]


def find_start(observations: Observations, targets: Targets, stations: Sequence[Station], options: Options) -> Start:
    """`stations` in the order of the observations' gimbals, further ones behind. Raises Undetermined: what has no place."""
    bodies = {b for b, body in enumerate(targets.bodies) if body.world_from_body is not None}
    placed = set(range(len(stations))) if options.from_nominal else set(range(len(observations.gimbals), len(stations)))
    progress = _Progress(list(stations), placed, state_of(stations, targets), bodies)
    if options.from_nominal and options.find_axes:
        for k in range(len(observations.gimbals)):
            _place_station(progress, observations, targets, k, options)
    while _one_more(progress, observations, targets, options):
        pass
    _refuse_unplaced(progress, observations, targets)
    state = _free_points(progress.state, observations, targets)
    return Start(tuple(progress.stations), state)


def _one_more(progress: _Progress, observations: Observations, targets: Targets, options: Options) -> bool:
    """Places the station, or else the body, that sees or shows most of what has a place."""
    stations = {
        k: len(_rows_of_station(progress, observations, targets, k))
        for k in range(len(observations.gimbals))
        if k not in progress.placed
    }
    for k in sorted(stations, key=lambda k: -stations[k]):
        if _place_station(progress, observations, targets, k, options):
            return True
    for b in np.unique(targets.body[observations.point]).tolist():
        if b not in progress.bodies and _place_body(progress, observations, targets, b, options):
            return True
    return False


def _rows_of_station(progress: _Progress, observations: Observations, targets: Targets, k: int) -> Indices:
    known = np.isin(targets.body[observations.point], sorted(progress.bodies))
    known &= ~(targets.free & np.isnan(targets.p_mm).any(axis=1))[observations.point]
    return np.flatnonzero(known & (observations.gimbal[observations.view] == k))


def _place_station(progress: _Progress, observations: Observations, targets: Targets, k: int, options: Options) -> bool:
    rows = _rows_of_station(progress, observations, targets, k)
    if len(np.unique(observations.point[rows])) < FEWEST_POINTS:
        return False
    best: tuple[float, Station, State] | None = None
    for station in _hypotheses(progress.stations[k], options):
        for found in _resections(progress, observations, targets, (k, station, rows), options):
            if best is None or found[0] < best[0]:
                best = found
    if best is None:
        return False
    progress.stations[k], progress.state = best[1], best[2]
    progress.placed.add(k)
    return True


def _hypotheses(station: Station, options: Options) -> Iterator[Station]:
    if not options.find_axes:
        yield station
        return
    for order, az, el in product(AxisOrder, (1, -1), (1, -1)):
        yield replace(station, order=order, az_sign=az, el_sign=el)


def _resections(
    progress: _Progress, observations: Observations, targets: Targets, given: tuple[int, Station, Indices], options: Options
) -> Iterator[tuple[float, Station, State]]:
    """Each pose that fits the rays, adjusted alone, with its chi-square and the state that it leads to."""
    k, station, rows = given
    rows = thinned(observations, rows, MOST_ROWS)
    state = _with_station(progress.state, k, station)
    p_world, _ = points_in_world(state, targets, observations.point[rows])
    candidates = [station.world_from_gimbal.inverse()]
    if not options.from_nominal:
        face = _larger_face(observations, rows)
        candidates = poses(*rays(state, observations, rows[face], in_world=False), p_world[face], options.seed)
    stages = len(STAGES) if options.find_axes or len(candidates) > 1 else 1
    mine = part_of(observations, rows)
    for gimbal_from_world in candidates:
        placed = replace(station, world_from_gimbal=gimbal_from_world.inverse())
        stations = [*progress.stations[:k], placed, *progress.stations[k + 1 :]]
        alone = replace(options, free={station.name: EVERYTHING}, held=None)
        allowed, held = freed(stations, alone, options.distortion)
        problem = problem_of(mine, targets, known_of(stations, targets, alone, allowed, held), options.square_pixels)
        at = _with_station(state, k, placed)
        done = in_stages(problem, at, allowed, exact=frozenset(range(len(targets.bodies))), last=stages)
        yield _robust_cost(done), placed, replace(done.state, delta_mm=state.delta_mm)


def _larger_face(observations: Observations, rows: Indices) -> Flags:
    """Turned over, an error of the nominal mount has the other sign: both faces together have no pose."""
    first = np.cos(observations.angles_rad[observations.view[rows], 1]) > 0.0
    return np.asarray(first if 2 * int(first.sum()) >= len(rows) else ~first)


def in_stages(
    problem: Problem,
    state: State,
    allowed: Flags,
    *,
    exact: frozenset[int] = frozenset(),
    last: int = len(STAGES),
    loss: Loss = Loss.COARSE,
) -> Adjusted:
    """Pose; focal length; pupil; mount; all: everything at once falls into false valleys."""
    others = target_columns(problem, exact)
    weights = Weights(np.isfinite(evaluate(problem, state).q_px[:, 0]).astype(float), np.ones(problem.v))
    for stage in range(last):
        free = np.concatenate([station_columns(allowed, stage), others])
        done = adjust(problem, state, free, weights, loss=loss, steps=STEPS, tolerance=ENOUGH, relative=ROUGHLY)
        state, weights = done.state, done.weights
    return done


def _robust_cost(done: Adjusted) -> float:
    """Chi-square over the weights' sum: a hypothesis that calls everything an outlier does not win."""
    weight = float(done.weights.point.sum())
    return float(done.normal.cost) / max(weight, 1e-9) if np.isfinite(done.normal.cost) else np.inf


def _place_body(progress: _Progress, observations: Observations, targets: Targets, b: int, options: Options) -> bool:
    """From the rays of each station that has a place; of all candidates, the one with the lowest chi-square in all views."""
    gimbal = observations.gimbal[observations.view]
    rows = np.flatnonzero((targets.body[observations.point] == b) & np.isin(gimbal, sorted(progress.placed)))
    if len(np.unique(observations.point[rows])) < FEWEST_POINTS:
        return False
    best = place_body(progress.state, observations, targets, progress.stations, b, options)
    if best is None:
        return False
    progress.state = with_poses(progress.state, {b: best[1]})
    progress.bodies.add(b)
    return True


def place_body(
    state: State, observations: Observations, targets: Targets, stations: Sequence[Station], b: int, options: Options
) -> tuple[float, Rigid] | None:
    """Chi-square and pose of a body, the stations being where `state` has them."""
    gimbal = observations.gimbal[observations.view]
    of_body = targets.body[observations.point] == b
    at_origin = with_poses(state, {b: Rigid.identity()})
    candidates = []
    for k in np.unique(gimbal[of_body]).tolist():
        rows = thinned(observations, np.flatnonzero(of_body & (gimbal == k)), BODY_ROWS)
        if len(np.unique(observations.point[rows])) >= FEWEST_POINTS:
            in_body, _ = points_in_world(at_origin, targets, observations.point[rows])
            candidates += poses(*rays(state, observations, rows, in_world=True), in_body, options.seed)
    none = np.zeros(23 * len(stations), bool)
    part = part_of(observations, thinned(observations, np.flatnonzero(of_body), BODY_ROWS))
    problem = problem_of(part, targets, known_of(stations, targets, options, none, none), options.square_pixels)
    columns = problem.layout.bodies_at + BODY_COLUMNS * b + np.arange(6)
    best: tuple[float, Rigid] | None = None
    for pose in distinct(candidates):
        at = with_poses(state, {b: pose})
        done = adjust(
            problem, at, columns, everyone(problem), loss=Loss.COARSE, steps=FEW_STEPS, tolerance=1.0, relative=FEW_ROUGHLY
        )
        if best is None or _robust_cost(done) < best[0]:
            best = (_robust_cost(done), _poses_of(done.state, [b])[b])
    return best


def unmirror(coarse: Adjusted, problem: Problem, stations: Sequence[Station], options: Options) -> State | None:
    """A planar body that fits badly in its other pose, if that one fits better now that the stations are nearly right."""
    o, targets = problem.observations, problem.targets
    off = offsets(problem, coarse.linear, coarse.weights).point
    state = coarse.state
    for b in np.unique(targets.body[o.point]).tolist():
        rows = np.flatnonzero(targets.body[o.point] == b)
        body = targets.bodies[b]
        if body.fixed or float(np.median(off[rows])) < FITS_BADLY or not flat(targets.p_mm[np.unique(o.point[rows])]):
            continue
        other = place_body(coarse.state, o, targets, stations, b, options)
        if other is not None and np.abs(other[1].rotation - state.r_world_from_body[b]).max() > ALIKE:
            state = with_poses(state, {b: other[1]})
    return None if state is coarse.state else state


def _poses_of(state: State, bodies: Sequence[int] | range) -> dict[int, Rigid]:
    return {b: Rigid(state.r_world_from_body[b], state.t_world_from_body[b]) for b in bodies}


def _with_station(state: State, k: int, station: Station) -> State:
    lens = station.lens
    rows = {
        "r_world_from_gimbal": station.world_from_gimbal.rotation,
        "t_world_from_gimbal": station.world_from_gimbal.translation_mm,
        "axes": (station.eps_rad, station.d_mm),
        "r_rg_from_camera": station.rg_from_camera.rotation,
        "t_rg_from_camera": station.rg_from_camera.translation_mm,
        "lens": (lens.fx_px, lens.fy_px, lens.cx_px, lens.cy_px, *lens.distortion),
        "az_outer": station.order is AxisOrder.AZ_OUTER,
        "signs": (station.az_sign, station.el_sign),
    }
    changed = {name: getattr(state, name).copy() for name in rows}
    for name, row in rows.items():
        changed[name][k] = row
    return replace(state, **changed)


def _free_points(state: State, observations: Observations, targets: Targets) -> State:
    """Unknown points that have no start value: where the rays of all stations are nearest to each other."""
    delta = state.delta_mm.copy()
    wanted = np.unique(observations.point)
    wanted = wanted[targets.free[wanted] & np.isnan(targets.p_mm[wanted]).any(axis=1)]
    for point in wanted.tolist():
        rows = np.flatnonzero(observations.point == point)
        gimbals = np.unique(observations.gimbal[observations.view[rows]])
        if len(gimbals) < 2:
            raise Undetermined(
                f"point {targets.names[point]} is unknown, and only gimbal {observations.gimbals[gimbals[0]]} saw it:"
                " show it to another gimbal, or leave it out"
            )
        b = targets.body[point]
        p_world = nearest_point(*rays(state, observations, rows, in_world=True))
        delta[point] = (p_world - state.t_world_from_body[b]) @ state.r_world_from_body[b]
    return replace(state, delta_mm=delta)


def _refuse_unplaced(progress: _Progress, observations: Observations, targets: Targets) -> None:
    stations = [name for k, name in enumerate(observations.gimbals) if k not in progress.placed]
    bodies = [targets.bodies[b].name for b in np.unique(targets.body[observations.point]).tolist() if b not in progress.bodies]
    if not stations and not bodies:
        return
    what = " and ".join(
        text for text in (f"gimbal {', '.join(stations)}" * bool(stations), f"body {', '.join(bodies)}" * bool(bodies)) if text
    )
    raise Undetermined(
        f"nothing tells where {what} is: a gimbal needs views of {FEWEST_POINTS} or more points that are known in the world or"
        " shared with another gimbal, a body as many points seen by a gimbal that has a place; or give approximate poses"
    )
