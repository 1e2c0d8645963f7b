"""What is known beforehand, as information about columns; which columns are free, and when they are released."""

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt
import scipy.linalg

from trackerd.calibrate.cell.options import EVERYTHING, Group, Options, Priors
from trackerd.calibrate.cell.problem import Known, Problem
from trackerd.calibrate.cell.state import (
    AXES_AT,
    BODY_COLUMNS,
    FX,
    K1,
    LENS_AT,
    MOUNT_AT,
    POSE_AT,
    STATION_COLUMNS,
    STATION_NAMES,
    Indices,
    state_of,
)
from trackerd.calibrate.cell.targets import Targets
from trackerd.contract.errors import ConfigError
from trackerd.contract.model import Array
from trackerd.geometry.gimbal import Station

PARTS = {Group.POSE: POSE_AT, Group.AXES: AXES_AT, Group.HAND_EYE: MOUNT_AT, Group.LENS: LENS_AT}
PUPIL_Z = 13
DISTORTION_ORDER = (18, 19, 20, 21, 22)
STAGES: tuple[tuple[int, ...], ...] = (
    tuple(range(6)),
    (FX, FX + 1),
    (PUPIL_Z,),
    (8, 9, 10, 11, 12),
    tuple(range(STATION_COLUMNS)),
)
Flags = npt.NDArray[np.bool_]


def names_of(stations: Sequence[Station]) -> tuple[str, ...]:
    """Of all stations' columns, as the calibration file has them."""
    return tuple(f"{station.name}.{name}" for station in stations for name in STATION_NAMES)


def sigmas_of(station: Station, priors: Priors, square_pixels: bool) -> Array:
    """1 sigma (23,) about the nominal values; inf where nothing is known."""
    lens = station.lens
    corner = float(np.hypot(*lens.sensor_px)) / 2.0 / lens.fx_px
    share = priors.distortion_at_corner
    f = priors.f_relative * lens.fx_px
    return np.array(
        [
            *[np.inf] * 6,
            priors.eps_rad,
            priors.d_mm,
            *[priors.mount_rotation_rad] * 3,
            *(priors.mount_xy_mm, priors.mount_xy_mm, priors.mount_z_mm),
            *(f, np.inf if square_pixels else f, priors.centre_px, priors.centre_px),
            *(share / corner**2, share / corner**4, share / corner, share / corner, share / corner**6),
        ]
    )


def freed(stations: Sequence[Station], options: Options, coefficients: int) -> tuple[Flags, Flags]:
    """Of all stations' columns: those that are asked for, and those that are held within a covariance."""
    asked = np.zeros((len(stations), STATION_COLUMNS), bool)
    for k, station in enumerate(stations):
        groups = EVERYTHING if options.free is None else options.free.get(station.name, frozenset())
        for group in groups:
            asked[k, PARTS[Group(group)]] = True
    asked[:, K1 + coefficients :] = False
    held = np.zeros_like(asked)
    if options.held is not None:
        index = {name: i for i, name in enumerate(options.held.parameters)}
        variance = np.diag(options.held.covariance)
        for at, name in enumerate(names_of(stations)):
            held.flat[at] = name in index and variance[index[name]] > 0.0
        held &= ~asked
    if options.square_pixels:
        asked[:, FX + 1] = held[:, FX + 1] = False
    return asked.ravel(), held.ravel()


def known_of(stations: Sequence[Station], targets: Targets, options: Options, asked: Flags, held: Flags) -> Known:
    """About the nominal stations."""
    sigmas = np.concatenate([sigmas_of(s, options.priors, options.square_pixels) for s in stations])
    information = np.zeros((len(sigmas), len(sigmas)))
    usual = np.flatnonzero(asked & np.isfinite(sigmas))
    information[usual, usual] = 1.0 / sigmas[usual] ** 2
    if options.held is not None and held.any():
        names = names_of(stations)
        index = {name: i for i, name in enumerate(options.held.parameters)}
        at = np.flatnonzero(held)
        rows = [index[names[i]] for i in at]
        information[np.ix_(at, at)] = _inverse(options.held.covariance[np.ix_(rows, rows)])
    ball_sigmas = np.array([body.ball_sigma_mm if body.ball_mm is not None else np.inf for body in targets.bodies])
    ball = np.where(np.isfinite(ball_sigmas) & (ball_sigmas > 0.0), 1.0 / np.maximum(ball_sigmas, 1e-12) ** 2, 0.0)
    count = len(usual) + int(held.sum()) + 3 * int((ball > 0.0).sum())
    return Known(state_of(stations, targets), information, ball, count)


def _inverse(covariance: Array) -> Array:
    """Of a covariance, scaled to correlations first."""
    scale = 1.0 / np.sqrt(np.diag(covariance))
    correlation = covariance * np.outer(scale, scale)
    try:
        factor = scipy.linalg.cho_factor(correlation)
    except scipy.linalg.LinAlgError as err:
        raise ConfigError("the covariance of what is held is singular: some of its parameters say the same twice") from err
    inverse = scipy.linalg.cho_solve(factor, np.eye(len(scale)))
    return np.asarray((inverse + inverse.T) / 2.0 * np.outer(scale, scale))


def target_columns(problem: Problem, exact_bodies: frozenset[int] = frozenset()) -> Indices:
    """Of bodies and points that are not known: poses of bodies that are not fixed, balls of movers, points."""
    layout, targets = problem.layout, problem.targets
    seen = set(np.unique(targets.body[problem.observations.point]).tolist())
    columns: list[int] = []
    for b, body in enumerate(targets.bodies):
        if b not in seen or b in exact_bodies:
            continue
        first = layout.bodies_at + BODY_COLUMNS * b
        columns += [] if body.fixed else range(first, first + 6)
        columns += range(first + 6, first + 9) if body.ball_mm is not None and body.ball_sigma_mm > 0.0 else []
    columns += range(layout.points_at, layout.columns)
    return np.array(columns, np.intp)


def station_columns(allowed: Flags, stage: int) -> Indices:
    """Of what may be free, what the stages up to `stage` have released."""
    released = np.zeros(STATION_COLUMNS, bool)
    for columns in STAGES[: stage + 1]:
        released[list(columns)] = True
    return np.flatnonzero(allowed & np.tile(released, len(allowed) // STATION_COLUMNS))


def check_nominal(gimbals: Sequence[str], nominal: Mapping[str, Station]) -> None:
    missing = [name for name in gimbals if name not in nominal]
    if missing:
        raise ConfigError(f"gimbal {', '.join(missing)} has views, but no nominal station: {', '.join(nominal)} have")
    for key, station in nominal.items():
        if key != station.name:
            raise ConfigError(f"nominal station {key} calls itself {station.name}")
