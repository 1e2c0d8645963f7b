"""`trackerd align`: where the cell lies in the world of a machine or a workpiece."""

import hashlib
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from trackerd import __version__
from trackerd.calibrate.align import Alignment, ThreeTwoOne, best_fit, in_common, three_two_one
from trackerd.contract.errors import ConfigError, TrackerdError
from trackerd.formats.calibration import DataIdentity, load_calibration
from trackerd.formats.config import calibration_path
from trackerd.formats.datum import Datum, save_datum
from trackerd.formats.points import Points, read_points
from trackerd.geometry.rigid import euler_321_from_matrix

SCALE_SIGMAS = 4.0  # of a scale: beyond, it is no chance


@dataclass(frozen=True, slots=True)
class AlignRequest:
    """What is asked for. `roles`: 3-2-1; None: the best fit."""

    measured: Path
    nominal: Path
    name: str
    output: Path
    roles: ThreeTwoOne | None = None
    left_out: Sequence[str] = ()
    config: Path | None = None
    overrides: Sequence[str] = ()


def align(request: AlignRequest) -> None:
    """Prints every point's error, and writes the datum. Raises ConfigError, and Undetermined where the points tell none."""
    id_ = None if request.config is None else load_calibration(calibration_path(request.config, request.overrides)).id
    both = read_points(request.measured), read_points(request.nominal)
    for name in request.left_out:
        if not any(name in points.ids for points in both):
            raise ConfigError(
                f"--leave-out {name}: there is no such point in {request.measured.name} or {request.nominal.name}"
            )
    measured, nominal, notes = in_common(*(_without(points, request.left_out) for points in both))
    found = _aligned(measured, nominal, request.roles)
    for note in (*notes, *_warnings(found, measured, nominal, request.roles)):
        print(f"note: {note}", file=sys.stderr)
    try:
        save_datum(_datum(request, found, id_), request.output)
    except OSError as error:
        raise TrackerdError(f"{request.output}: cannot be written: {error.strerror}") from error
    _print(request, found)


def _without(points: Points, left_out: Sequence[str]) -> Points:
    return points.only([name for name in points.ids if name not in left_out])


def _aligned(measured: Points, nominal: Points, roles: ThreeTwoOne | None) -> Alignment:
    return best_fit(measured, nominal) if roles is None else three_two_one(measured, nominal, roles)


def _warnings(found: Alignment, measured: Points, nominal: Points, roles: ThreeTwoOne | None) -> Iterator[str]:
    if found.chi2 is not None and found.beyond_chance:
        yield (
            f"chi-square {found.chi2 / found.dof:.3g} per degree of freedom: the points are off by more than their sigmas say:"
            " a wrong name, a moved point, or sigmas that are too small; the covariance was multiplied by it"
        )
    scaled = found
    if found.suspect is not None:
        rest = [name for name in found.ids if name != found.suspect.id]
        scaled = best_fit(measured.only(rest), nominal.only(rest))  # a point that is off looks like a scale, too
        words = f"point {found.suspect.id} does not fit: off by {found.suspect.error_mm:.3g} mm"
        if roles is None:
            words += f"; without it the rms is {scaled.rms_mm:.3g} mm instead of {found.rms_mm:.3g}"
        yield f"{words} (--leave-out {found.suspect.id})"
    if abs(scaled.scale - 1.0) > SCALE_SIGMAS * scaled.scale_sigma:
        yield (
            f"the nominal points are {(scaled.scale - 1.0) * 1e6:+.0f} ± {scaled.scale_sigma * 1e6:.0f} ppm further apart than"
            " the measured ones (not applied): temperature, or the scale of the calibration"
        )


def _datum(request: AlignRequest, found: Alignment, calibration_id: str | None) -> Datum:
    return Datum(
        name=request.name,
        created=datetime.now(UTC).isoformat(timespec="seconds"),
        software=f"trackerd {__version__}",
        method=_method(request),
        world_from_cell=found.world_from_cell,
        covariance=found.cov,
        errors_mm={name: (x, y, z) for name, (x, y, z) in zip(found.ids, found.errors_mm.tolist(), strict=True)},
        rms_mm=found.rms_mm,
        max_mm=found.max_mm,
        dof=found.dof,
        scale=found.scale,
        scale_sigma=found.scale_sigma,
        measured=_identity(request.measured),
        nominal=_identity(request.nominal),
        chi2_per_dof=None if found.chi2 is None else found.chi2 / found.dof,
        calibration_id=calibration_id,
    )


def _method(request: AlignRequest) -> str:
    return "best fit" if request.roles is None else "3-2-1"


def _identity(path: Path) -> DataIdentity:
    return DataIdentity(path.name, hashlib.sha256(path.read_bytes()).hexdigest())


def _print(request: AlignRequest, found: Alignment) -> None:
    rows = [
        (name, *(f"{value:+.4f}" for value in error), f"{float(np.linalg.norm(error)):.4f}")
        for name, error in zip(found.ids, found.errors_mm, strict=True)
    ]
    console = Console()
    if console.is_terminal:
        table = Table(title="measured - nominal, mm", title_justify="left")
        for column in ("point", "x", "y", "z", "3D"):
            table.add_column(column, justify="left" if column == "point" else "right")
        for row in rows:
            table.add_row(*row)
        console.print(table)
    else:
        print("point x y z 3D, measured - nominal, mm")
        for row in rows:
            print(" ".join(row))
    for title, words in _rows(request, found):
        print(f"{title}: {words}")
    print(f"written: {request.output}")


def _rows(request: AlignRequest, found: Alignment) -> Iterator[tuple[str, str]]:
    sigmas = np.sqrt(np.diag(found.cov))
    angles = np.degrees(euler_321_from_matrix(found.world_from_cell.rotation))
    yield "datum", f"{request.name}, {_method(request)} of {len(found.ids)} points"
    yield "errors", f"rms {found.rms_mm:.4g} mm, maximum {found.max_mm:.4g} mm"
    if found.chi2 is not None:
        yield "chi-square", f"{found.chi2:.3g} of {found.dof} degrees of freedom"
    else:
        yield "scatter", f"{found.sigma_mm:.3g} mm a coordinate, of {found.dof} degrees of freedom (the files tell no sigma)"
    yield "scale", f"{(found.scale - 1.0) * 1e6:+.1f} ± {found.scale_sigma * 1e6:.1f} ppm (1 sigma), not applied"
    yield (
        "translation",
        ", ".join(
            f"{axis} {value:.4f} ± {sigma:.2g}"
            for axis, value, sigma in zip(
                "xyz", found.world_from_cell.translation_mm.tolist(), sigmas[3:].tolist(), strict=True
            )
        )
        + " mm",
    )
    yield "rotation", f"z {angles[0]:.5f}, y {angles[1]:.5f}, x {angles[2]:.5f} deg (321), ± {_arcsec(sigmas[:3])}"


def _arcsec(sigmas_rad: "np.ndarray[tuple[int, ...], np.dtype[np.float64]]") -> str:
    return ", ".join(f"{value:.2g}" for value in np.degrees(sigmas_rad) * 3600.0) + " arcsec about x, y, z"
