"""A recording of a probe whose way is known, as a calibration's dataset: every frame is a view, every instant a place."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from trackerd.cli.telling import progress
from trackerd.contract.errors import ConfigError
from trackerd.contract.model import Array, Found
from trackerd.formats.calibration import load_calibration
from trackerd.formats.config import CellConfig
from trackerd.formats.csv_table import Findings, read_rows
from trackerd.formats.dataset import Dataset, identity_of
from trackerd.formats.dataset_points import Point
from trackerd.formats.dataset_tables import TABLES, GimbalTable, MoverTable
from trackerd.formats.dataset_views import ImagePoint
from trackerd.formats.recorded import recorded_angles
from trackerd.formats.stills import Stills, read_still, stills
from trackerd.geometry.gimbal import Station
from trackerd.geometry.sphere import centre_and_range
from trackerd.inspection.camera import camera_of
from trackerd.inspection.detector import detector_for, place
from trackerd.vision.rays import Circle
from trackerd.wiring.cell import load

ANGLES, TRUTH = "angles.csv", "truth.csv"
MOST_FRAMES = 200  # of each gimbal, spread over the recording: more tell hardly more
LEAST_ARCSEC = 0.01  # no reading is without an error
CHECKED = 10  # every so many places are check points
MOVER = MoverTable(kind="cnc", frame="recording", sigma_mm=0.005)  # of a place whose table has no sigma


def is_recording(folder: Path) -> bool:
    return (folder / ANGLES).is_file() and not (folder / TABLES).is_file()


def recorded_dataset(folder: Path, config: Path | None, overrides: Sequence[str]) -> Dataset:
    """`truth.csv` (t_ns,x_mm,y_mm,z_mm) tells where the probe was at the exposures; what has no place is left alone.

    Start values are the recording's own calibration, or the cell's. Raises ConfigError.
    """
    cell = None if config is None else load(config, overrides)
    series = [one for one in stills(folder) if one.station is not None]
    if cell is None or not series:
        what = "--config FILE, the cell that was recorded" if series else "frames of gimbals beside angles.csv"
        raise ConfigError(f"{folder}: a recording needs {what}")
    places = _places(folder / TRUTH)
    stations = load_calibration(series[0].calibration or cell.calibration).stations
    missing = [one.name for one in series if one.name not in stations or one.name not in cell.gimbals]
    if missing:
        raise ConfigError(f"{folder}: its gimbal {missing[0]} is not in the calibration, or not in the cell's file")
    seen = tuple(point for one in series for point in _views(one, stations[one.name], cell, places))
    used = list(dict.fromkeys(point.target for point in seen))
    points = {
        name: Point(name, *places[name], "check" if n % CHECKED == CHECKED - 1 else "adjust") for n, name in enumerate(used)
    }
    return Dataset(
        folder=folder,
        identity=identity_of(folder),
        gimbals={one.name: _gimbal(stations[one.name], cell) for one in series},
        stations={one.name: stations[one.name] for one in series},
        mover=MOVER,
        points=points,
        flange={},
        boards={},
        board_points_mm={},
        placements={},
        bars=(),
        priors={},
        image_points=seen,
    )


def _places(path: Path) -> dict[str, tuple[Array, Array]]:
    """By instant: place in W and covariance."""
    if not path.is_file():
        raise ConfigError(f"{path}: is missing: t_ns,x_mm,y_mm,z_mm tell where the probe was at each exposure")
    findings = Findings()
    assert MOVER.sigma_mm is not None
    cov_mm2 = np.eye(3) * MOVER.sigma_mm**2
    found = {
        row.text("t_ns"): (np.array([row.number(key) for key in ("x_mm", "y_mm", "z_mm")]), cov_mm2)
        for row in read_rows(path, ("t_ns", "x_mm", "y_mm", "z_mm"), (), findings)
    }
    findings.raise_any()
    return found


def _gimbal(station: Station, cell: CellConfig) -> GimbalTable:
    settings = cell.gimbals[station.name]
    x, y, z = station.rg_from_camera.translation_mm.tolist()
    return GimbalTable(
        sensor_px=station.lens.sensor_px,
        focal_px=station.lens.fx_px,
        lever_mm=(x, y, z),
        order=station.order.value,
        az_sign=1 if station.az_sign > 0 else -1,
        el_sign=1 if station.el_sign > 0 else -1,
        encoder_sigma_arcsec=max(settings.encoder_sigma_arcsec, LEAST_ARCSEC),
        encoder_fixed_arcsec=settings.encoder_fixed_arcsec,
    )


def _views(
    pictures: Stills, station: Station, cell: CellConfig, places: dict[str, tuple[Array, Array]]
) -> Iterator[ImagePoint]:
    """The frames that show the ball at an instant that has a place."""
    if pictures.instants_ns is None:
        raise ConfigError(f"{pictures.files[0].parent}.csv: is missing: it tells when each frame was exposed")
    angles = recorded_angles(pictures.files[0].parent.parent / ANGLES, pictures.name)
    known = [n for n, t_ns in enumerate(pictures.instants_ns) if n in angles and str(t_ns) in places]
    chosen = known[:: max(-(-len(known) // MOST_FRAMES), 1)]
    if not chosen:
        raise ConfigError(f"{pictures.files[0].parent}: {TRUTH} has no place for any of its instants")
    first = read_still(pictures.files[0])
    camera = camera_of(cell, None, pictures.name)
    detector, origin_px = detector_for(first, camera), camera.origin_of(first)
    last: Circle | None = None
    with progress(f"looking at {pictures.name}", len(chosen)) as advance:
        for n in chosen:
            advance()
            image = read_still(pictures.files[n])
            outline = detector.locate(image, last)
            if last is not None and not isinstance(outline, Found):  # the probe is kept in the image's middle, more or less
                outline = detector.locate(image, None)
            if not isinstance(outline, Found):
                continue
            last = place(outline)
            q_px = np.array((outline.x_px + origin_px[0], outline.y_px + origin_px[1]))
            centre, _ = centre_and_range(q_px, outline.r_px, cell.probe.radius_mm, station.lens)
            t_ns = str(pictures.instants_ns[n])
            yield ImagePoint(
                line=n + 2,
                view=t_ns,
                gimbal=pictures.name,
                face=1,
                az_rad=angles[n][0],
                el_rad=angles[n][1],
                target=t_ns,
                feature=0,
                q_px=station.lens.project(centre),
                cov_px2=outline.cov_px2[:2, :2],
                frames=1,
                image=None,
            )
