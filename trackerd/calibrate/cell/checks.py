"""What must hold before and after the adjustment, and words for a person where it does not."""

from collections.abc import Mapping

import numpy as np

from trackerd.calibrate.cell.adjust import Adjusted
from trackerd.calibrate.cell.covariance import column_name
from trackerd.calibrate.cell.known import Flags
from trackerd.calibrate.cell.observations import LARGEST_ANGLE_RAD, Observations
from trackerd.calibrate.cell.options import Options
from trackerd.calibrate.cell.problem import Problem
from trackerd.calibrate.cell.state import difference
from trackerd.calibrate.cell.targets import Targets
from trackerd.contract.errors import ConfigError, Undetermined
from trackerd.geometry.gimbal import Station

FEWEST_VIEWS = 6  # of a gimbal
LEAST_TURN_RAD = 0.005  # of each axis, over the views of a gimbal: 0.3 deg
LEAST_DOF = 20  # below it chi-square tells nothing
MOST_REJECTED = 0.35
FLAT = 0.02  # third spread of the points over the first
PULLED, FAR_PULLED = 4.0, 8.0  # sigmas of a prior: warned of; refused. Weak directions show what the model does not know first
CAUSES = (
    "a wrong order of the axes or a wrong sign (find_axes tries all), angles in degrees or of other views, a wrong square or"
    " point list, image points of another camera or region, a lens or mount far off the nominal one, something that moved"
    " meanwhile, or sigmas that are too small"
)


def check_options(options: Options, nominal: Mapping[str, Station]) -> None:
    """Raises ConfigError, one line per error."""
    errors = []
    priors = {name: getattr(options.priors, name) for name in options.priors.__slots__}
    errors += [f"options: priors.{name} = {value}: must be above 0" for name, value in priors.items() if not value > 0.0]
    if not 0 <= options.distortion <= 5:
        errors.append(f"options: distortion = {options.distortion}: 0 to 5 coefficients can be free")
    if not options.reject_sigma > 1.0:
        errors.append(f"options: reject_sigma = {options.reject_sigma}: must be above 1")
    if not options.stand_tilt_rad >= 0.0:
        errors.append(f"options: stand_tilt_rad = {options.stand_tilt_rad}: must be 0 or more")
    errors += [
        f"options: free names gimbal {name}, which has no nominal station" for name in options.free or () if name not in nominal
    ]
    errors += _held_errors(options)
    if errors:
        raise ConfigError("\n".join(errors))


def _held_errors(options: Options) -> list[str]:
    held = options.held
    if held is None:
        return []
    if held.covariance.shape != (len(held.parameters),) * 2:
        return [f"options: held has {len(held.parameters)} parameters and a covariance {held.covariance.shape}"]
    if not np.isfinite(held.covariance).all():
        return ["options: held has a covariance that is not finite"]
    return []


def check_data(observations: Observations, targets: Targets, options: Options) -> list[str]:
    """Warnings; raises ConfigError and Undetermined."""
    for name, values in (
        ("angles_rad", observations.angles_rad),
        ("q_px", observations.q_px),
        ("sigma_px", observations.sigma_px),
    ):
        if not np.isfinite(values).all():
            raise ConfigError(f"observations: {name} holds a value that is not finite")
    if np.abs(observations.angles_rad).max() > LARGEST_ANGLE_RAD:
        raise ConfigError("observations: angles_rad goes beyond a turn: angles are radians, not degrees")
    counts = np.bincount(observations.gimbal, minlength=len(observations.gimbals))
    seen = np.unique(observations.gimbal[observations.view])
    if options.free is None and len(seen) < 2:
        raise Undetermined(
            f"only gimbal {observations.gimbals[int(seen[0])]} has views: a cell needs two or more;"
            " to calibrate one beside stations that are known, say which groups of it are free"
        )
    for k, name in enumerate(observations.gimbals):
        if counts[k] < FEWEST_VIEWS:
            raise Undetermined(
                f"gimbal {name} has {counts[k]} views, {FEWEST_VIEWS} are the least: a probe at 20 or more points, each at five"
                " image positions, is what works well"
            )
        angles = observations.angles_rad[observations.gimbal == k]
        for axis, values in zip(("az", "el"), angles.T, strict=True):
            if np.ptp(values) < LEAST_TURN_RAD:
                raise Undetermined(
                    f"gimbal {name}: {axis} turns by {np.ptp(values):.2g} rad over all its views: while it stands still,"
                    " nothing tells its axis; move the target, or give radians if these are other units"
                )
    return _flat(observations, targets)


def _flat(observations: Observations, targets: Targets) -> list[str]:
    points = np.unique(observations.point)
    known = points[~targets.free[points] & np.array([b.fixed for b in targets.bodies])[targets.body[points]]]
    if len(known) < 4 or len(np.unique(targets.body[points])) > 1:
        return []
    spread = np.linalg.svd(targets.p_mm[known] - targets.p_mm[known].mean(axis=0), compute_uv=False)
    if spread[2] >= FLAT * spread[0]:
        return []
    return ["all points lie in a plane: away from it the calibration is weak; points in depth make it several times better"]


def check_result(problem: Problem, adjusted: Adjusted, dof: int, allowed: Flags, options: Options) -> list[str]:
    """Warnings; raises Undetermined where the result is none, or chi-square refuses it and it is not forced."""
    cost, weights = adjusted.normal.cost, adjusted.weights.point
    if not np.isfinite(cost):
        raise Undetermined(f"no start was found that puts the points in front of the cameras: {CAUSES}")
    doubts = _doubts(problem, adjusted, dof, allowed, options)
    if dof < LEAST_DOF and not weights.all():
        raise Undetermined(f"refused: {'; '.join(doubts) or 'too much was rejected'}. Likely causes: {CAUSES}")
    if dof < LEAST_DOF:
        raise Undetermined(
            f"{len(weights)} image points for {len(adjusted.columns.free)} unknowns leave {dof} degrees of freedom;"
            f" {LEAST_DOF} are the least: nothing would tell a mistake"
        )
    if doubts and not options.force:
        raise Undetermined(f"refused: {'; '.join(doubts)}. Likely causes: {CAUSES}")
    warnings = [f"forced: {doubt}" for doubt in doubts]
    warnings += [text for text, sigmas in _pulled(problem, adjusted, allowed) if sigmas <= FAR_PULLED]
    if cost / dof < 0.5:
        warnings.append(f"chi-square per degree of freedom is {cost / dof:.2g}: the sigmas are larger than the residuals say")
    return warnings


def _doubts(problem: Problem, adjusted: Adjusted, dof: int, allowed: Flags, options: Options) -> list[str]:
    doubts = []
    weights = adjusted.weights.point
    if dof > 0 and adjusted.normal.cost / dof > options.worst_chi2_per_dof:
        doubts.append(
            f"chi-square per degree of freedom is {adjusted.normal.cost / dof:.2f}, more than {options.worst_chi2_per_dof:g}"
        )
    of_gimbal = problem.observations.gimbal[problem.observations.view]
    for k, name in enumerate(problem.observations.gimbals):
        share = 1.0 - float(weights[of_gimbal == k].mean())
        if share > MOST_REJECTED:
            doubts.append(f"{share:.0%} of gimbal {name}'s image points do not fit the rest")
    doubts += [text for text, sigmas in _pulled(problem, adjusted, allowed) if sigmas > FAR_PULLED]
    return doubts


def _pulled(problem: Problem, adjusted: Adjusted, allowed: Flags) -> list[tuple[str, float]]:
    """Parameters that are far from what was said to be known, and by how many of its sigmas."""
    from_centre = difference(adjusted.state, problem.known.centre).ravel()
    information = np.diag(problem.known.station)
    usual = allowed & (information > 0.0) & (np.count_nonzero(problem.known.station, axis=1) == 1)
    sigmas = np.where(usual, np.abs(from_centre) * np.sqrt(information), 0.0)
    return [
        (
            f"{column_name(problem, column)} would be {from_centre[column]:.4g} off its nominal value, {sigmas[column]:.0f}"
            " sigmas of what was said to be known",
            float(sigmas[column]),
        )
        for column in np.flatnonzero(sigmas > PULLED).tolist()
    ]
