"""`trackerd calibration export` and `import`: lenses of other programs."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from trackerd import __version__
from trackerd.cli.calibration import Place, now
from trackerd.contract.errors import ConfigError, TrackerdError
from trackerd.formats.calibration import Calibration
from trackerd.formats.camera_files import CameraFormat, read_lens, write_lens
from trackerd.geometry.gimbal import Station


def export_lens(place: Place, version: str | None, station: str, form: str, file: Path) -> None:
    """Raises ConfigError for a version or a station that is not there, TrackerdError where the file cannot be written."""
    calibration = place.chosen(version).sound()
    lens = _station(calibration, station).lens
    try:
        write_lens(lens, file, CameraFormat(form), station)
    except OSError as error:
        raise TrackerdError(f"{file}: cannot be written: {error.strerror}") from error
    print(f"written: {file}, the lens of {station} in calibration {calibration.id}")


def import_lens(place: Place, id_: str | None, station: str, file: Path) -> None:
    """A new version: the active one with another lens, without the covariance, chi-square and verification of the old one.

    Raises ConfigError for a file or a station that does not fit.
    """
    old = place.chosen(None).sound()
    there = _station(old, station)
    lens = read_lens(file)
    if lens.sensor_px != there.lens.sensor_px:
        raise ConfigError(
            f"{file.name} image_width, image_height = {lens.sensor_px[0]}, {lens.sensor_px[1]}: the sensor of station"
            f" {station} has {there.lens.sensor_px[0]} x {there.lens.sensor_px[1]} px: calibrate on the whole sensor"
        )
    at = now()
    new = replace(
        old,
        id=id_ or f"{old.id}+{station}-lens-{at[:19].replace(':', '').replace('-', '')}",
        created=at,
        software=f"trackerd {__version__}",
        method=f"lens of {station} from {file.name}",
        parent=old.id,
        stations={**old.stations, station: replace(there, lens=lens)},
        parameters=(),
        covariance=np.zeros((0, 0)),
        chi2_per_dof=None,
        dof=None,
        forced=False,
        forced_because="",
        verification=None,
    )
    added = place.store.add(new)
    print(f"kept as version {added.name}: {added.path}")
    print("the rest of the cell was not adjusted to this lens: it is unverified, and its covariance is not known")


def _station(calibration: Calibration, name: str) -> Station:
    if name not in calibration.stations:
        raise ConfigError(f"calibration {calibration.id} has no station {name} (it has: {', '.join(calibration.stations)})")
    return calibration.stations[name]
