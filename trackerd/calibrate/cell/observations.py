"""What the cameras saw: image points of named targets, in views at known encoder angles."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import pi

import numpy as np
import numpy.typing as npt

from trackerd.calibrate.cell.targets import Targets
from trackerd.contract.errors import ConfigError
from trackerd.contract.model import Array

Indices = npt.NDArray[np.intp]
LARGEST_ANGLE_RAD = 2.0 * pi  # an encoder of a gimbal counts one turn; beyond it the angles are degrees
COARSEST_SIGMA_RAD = 0.02  # of an encoder: more than a degree is a wrong unit


@dataclass(frozen=True, slots=True)
class Observations:
    """n image points in v views of the gimbals. `observations` makes it from flat arrays and checks them."""

    gimbals: tuple[str, ...]
    views: tuple[str, ...]  # (v) names, for messages
    gimbal: Indices  # (v,) into `gimbals`
    angles_rad: Array  # (v, 2) of the encoders: az, el
    encoder_sigma_rad: Array  # (v,) 1 sigma of one axis, independent from view to view
    encoder_fixed_rad: Array  # (v,) 1 sigma of the part that is a function of the angle, but for 1 and 2 cycles a turn, which
    # pose, axes and mount absorb
    view: Indices  # (n,) into `views`
    point: Indices  # (n,) into the targets' points
    q_px: Array  # (n, 2) sensor coordinates
    sigma_px: Array  # (n,) 1 sigma of one coordinate

    def __len__(self) -> int:
        return len(self.view)

    def of_view(self, view: int) -> Indices:
        """The image points of one view, as indices."""
        return np.flatnonzero(self.view == view)


def observations(
    gimbal: Sequence[str] | npt.NDArray[np.str_],
    view: Sequence[object] | npt.NDArray[np.generic],
    az_rad: npt.ArrayLike,
    el_rad: npt.ArrayLike,
    u_px: npt.ArrayLike,
    v_px: npt.ArrayLike,
    point: Sequence[object] | npt.NDArray[np.generic],
    targets: Targets,
    *,
    sigma_px: npt.ArrayLike,
    encoder_sigma_rad: npt.ArrayLike,
    encoder_fixed_rad: npt.ArrayLike = 0.0,
) -> Observations:
    """From flat arrays, one entry for each image point (n,); the sigmas may be one number for all.

    `view` tells which image points were taken at once (any hashable name; a name may be used by several gimbals, and then
    means one view of each); their angles and encoder sigmas must be the same. `point` holds names of `targets`.
    Raises ConfigError, one line per error, for lengths that differ, what is not finite, sigmas that are not positive, angles
    beyond a turn (degrees?), unknown points, a view with two pairs of angles, and a point that a view shows twice.
    """
    names = [str(name) for name in gimbal]
    count = len(names)
    columns = {"az_rad": az_rad, "el_rad": el_rad, "u_px": u_px, "v_px": v_px}
    flat = {name: np.asarray(column, float) for name, column in columns.items()}
    sigmas = {"sigma_px": sigma_px, "encoder_sigma_rad": encoder_sigma_rad, "encoder_fixed_rad": encoder_fixed_rad}
    _check_lengths(count, {**flat, "view": view, "point": point}, sigmas)
    flat |= {name: np.broadcast_to(np.asarray(sigma, float), (count,)) for name, sigma in sigmas.items()}
    _check_values(flat)
    points = _point_indices([str(name) for name in point], targets)
    keys = list(zip(names, [str(key) for key in view], strict=True))
    first: dict[tuple[str, str], int] = {}
    for i, key in enumerate(keys):
        first.setdefault(key, i)
    of_key = {key: i for i, key in enumerate(first)}
    view_of = np.array([of_key[key] for key in keys], np.intp)
    rows = np.array(list(first.values()), np.intp)
    _check_views(keys, view_of, rows, points, flat, targets)
    gimbals = tuple(dict.fromkeys(names))
    order = np.argsort(view_of, kind="stable")
    return Observations(
        gimbals=gimbals,
        views=tuple(f"{g}/{v}" for g, v in first),
        gimbal=np.array([gimbals.index(g) for g, _ in first], np.intp),
        angles_rad=np.column_stack([flat["az_rad"][rows], flat["el_rad"][rows]]),
        encoder_sigma_rad=flat["encoder_sigma_rad"][rows],
        encoder_fixed_rad=flat["encoder_fixed_rad"][rows],
        view=view_of[order],
        point=points[order],
        q_px=np.column_stack([flat["u_px"], flat["v_px"]])[order],
        sigma_px=flat["sigma_px"][order].copy(),
    )


def _check_lengths(count: int, columns: dict[str, object], sigmas: dict[str, npt.ArrayLike]) -> None:
    if count == 0:
        raise ConfigError("observations: there is no image point")
    errors = [
        f"observations: {name} has {len(column)} entries, gimbal has {count}: one for each image point"  # type: ignore[arg-type]
        for name, column in columns.items()
        if len(column) != count  # type: ignore[arg-type]
    ]
    errors += [
        f"observations: {name} has {np.size(sigma)} entries: one, or one for each of {count} image points"
        for name, sigma in sigmas.items()
        if np.size(sigma) not in (1, count)
    ]
    if errors:
        raise ConfigError("\n".join(errors))


def _check_values(flat: dict[str, Array]) -> None:
    errors = []
    for name, column in flat.items():
        bad = np.flatnonzero(~np.isfinite(column))
        if len(bad):
            errors.append(f"observations: {name}[{bad[0]}] = {column[bad[0]]}: must be a finite number ({len(bad)} are not)")
            continue
        if name in ("sigma_px", "encoder_sigma_rad") and column.min() <= 0.0:
            errors.append(f"observations: {name}[{column.argmin()}] = {column.min()}: must be above 0")
        if name == "encoder_fixed_rad" and column.min() < 0.0:
            errors.append(f"observations: {name}[{column.argmin()}] = {column.min()}: must be 0 or more")
        largest = float(np.abs(column).max())
        if name in ("az_rad", "el_rad") and largest > LARGEST_ANGLE_RAD:
            where = int(np.abs(column).argmax())
            errors.append(f"observations: {name}[{where}] = {column[where]}: more than a turn: angles are radians, not degrees")
        if name.startswith("encoder") and largest > COARSEST_SIGMA_RAD:
            errors.append(f"observations: {name} = {largest}: must be at most {COARSEST_SIGMA_RAD} rad; 1 arcsec is 4.8e-6 rad")
    if errors:
        raise ConfigError("\n".join(errors))


def _point_indices(names: list[str], targets: Targets) -> Indices:
    index = {name: i for i, name in enumerate(targets.names)}
    unknown = sorted({name for name in names if name not in index})
    if unknown:
        shown = ", ".join(unknown[:5]) + (f" and {len(unknown) - 5} more" if len(unknown) > 5 else "")
        raise ConfigError(f"observations: point {shown}: no target has this name")
    return np.array([index[name] for name in names], np.intp)


def _check_views(
    keys: list[tuple[str, str]], view_of: Indices, rows: Indices, points: Indices, flat: dict[str, Array], targets: Targets
) -> None:
    for name in ("az_rad", "el_rad", "encoder_sigma_rad", "encoder_fixed_rad"):
        column = flat[name]
        other = np.flatnonzero(column != column[rows][view_of])
        if len(other):
            gimbal, view = keys[other[0]]
            there, here = column[rows][view_of][other[0]], column[other[0]]
            raise ConfigError(f"observations: view {view} of gimbal {gimbal}: {name} is {there} and {here}: one view has one")
    pairs, counts = np.unique(np.column_stack([view_of, points]), axis=0, return_counts=True)
    if counts.max() > 1:
        view_index, point = pairs[counts.argmax()]
        gimbal, view = keys[rows[view_index]]
        raise ConfigError(f"observations: view {view} of gimbal {gimbal} shows point {targets.names[point]} twice")
