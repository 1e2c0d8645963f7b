"""Version 1 of a calibration's dataset: a folder that people can read, and mend with an editor.

    dataset.toml    format = "trackerd-dataset", version = 1; [gimbal.NAME] (sensor, start values, sigmas), [mover] (kind,
                    frame, sigma), [board.NAME], [placement.BOARD/NAME] of boards that are somewhere known, [[bar]],
                    [priors], start = "calibration.toml" (its stations are the start values); keys: dataset_tables.py
    views.csv       one line an image point: view,gimbal,az_rad,el_rad,target[,feature,u_px,v_px][,sigma_px | cuu_px2,cuv_px2,
                    cvv_px2][,face,frames,image]; or one a picture of a board, which has `image` and no u_px, v_px
    points.csv      point,x_mm,y_mm,z_mm[,sigma_mm | cxx_mm2 ... czz_mm2][,use]; without coordinates: seen, its place unknown;
                    use is `adjust` or `check`: a check point stays outside the adjustment, and tells what it is worth
    flange.csv      of a robot: point,x_mm,y_mm,z_mm,qw,qx,qy,qz, the flange in the robot's base where the point was taken

A view is one exposure: one gimbal at one pair of *encoder* angles, in radians. A target is a point, or BOARD/PLACEMENT; a
placement without a table is somewhere unknown. Pixels are the sensor's, an integer is a pixel's centre.
"""

import hashlib
from dataclasses import dataclass
from pathlib import Path

from trackerd.contract.errors import ConfigError
from trackerd.contract.model import Array
from trackerd.formats.calibration import load_calibration
from trackerd.formats.csv_table import Findings
from trackerd.formats.dataset_points import FLANGE, POINTS, Point, read_flange, read_listed, read_points
from trackerd.formats.dataset_tables import TABLES, BarTable, BoardTable, DatasetTables, GimbalTable, MoverTable, PlacementTable
from trackerd.formats.dataset_views import ImagePoint, Views
from trackerd.formats.tables import Problems, read_tables
from trackerd.geometry.gimbal import Station
from trackerd.geometry.rigid import Rigid


@dataclass(frozen=True, slots=True)
class Dataset:
    folder: Path
    identity: str  # SHA-256 over all its files
    gimbals: dict[str, GimbalTable]
    stations: dict[str, Station]  # start values, of the gimbals that have any
    mover: MoverTable
    points: dict[str, Point]
    flange: dict[str, Rigid]  # base_from_flange by point
    boards: dict[str, BoardTable]
    board_points_mm: dict[str, Array]  # (n, 3) of the boards whose points are listed in a file
    placements: dict[str, PlacementTable]
    bars: tuple[BarTable, ...]
    priors: dict[str, float]  # of the adjustment, by name, where they are not its defaults
    image_points: tuple[ImagePoint, ...]


def read_dataset(folder: Path) -> Dataset:
    """Raises ConfigError with what is wrong in the first file that has something wrong: file, line or table, field, rule."""
    if not (folder / TABLES).is_file():
        raise ConfigError(f"{folder}: is no dataset: there is no {TABLES} in it")
    tables = _tables(folder / TABLES)
    findings = Findings()
    points = dict(read_points(folder / POINTS, tables.mover, findings)) if (folder / POINTS).exists() else {}
    flange = dict(read_flange(folder / FLANGE, points, findings)) if (folder / FLANGE).exists() else {}
    listed = {
        name: read_listed(folder / board.file, findings) for name, board in tables.board.items() if board.file is not None
    }
    seen = tuple(Views(folder, tables, points, listed, findings).read())
    findings.raise_any()
    _check_names(tables, points, flange)
    stations = {} if tables.start is None else load_calibration(folder / tables.start).stations
    return Dataset(
        folder=folder,
        identity=identity_of(folder),
        gimbals=tables.gimbal,
        stations={name: station for name, station in stations.items() if name in tables.gimbal},
        mover=tables.mover,
        points=points,
        flange=flange,
        boards=tables.board,
        board_points_mm=listed,
        placements=tables.placement,
        bars=tables.bar,
        priors=tables.priors.given(),
        image_points=seen,
    )


def identity_of(folder: Path) -> str:
    """SHA-256 over the names and bytes of all files of the folder, in the names' order."""
    digest = hashlib.sha256()
    for path in sorted(path for path in folder.rglob("*") if path.is_file() and not path.name.startswith(".")):
        content = path.read_bytes()
        digest.update(f"{path.relative_to(folder).as_posix()}\0{len(content)}\0".encode())
        digest.update(content)
    return digest.hexdigest()


def _tables(path: Path) -> DatasetTables:
    raw = read_tables(path)
    problems = Problems(path.name)
    if raw.get("format") != "trackerd-dataset":
        problems.add((), "format", raw.get("format"), 'is no dataset: format must be "trackerd-dataset"')
        problems.raise_any()
    tables = problems.check(DatasetTables, raw)
    problems.raise_any()
    assert tables is not None
    for name in tables.placement:
        board = name.partition("/")[0]
        if board not in tables.board:
            problems.add(("placement", name), None, None, f"is named BOARD/PLACEMENT; there is no [board.{board}]")
    problems.raise_any()
    return tables


def _check_names(tables: DatasetTables, points: dict[str, Point], flange: dict[str, Rigid]) -> None:
    """Rules between the files."""
    problems = Problems(TABLES)
    for number, bar in enumerate(tables.bar):
        for name in bar.between:
            if name not in points:
                problems.add(("bar", str(number)), "between", list(bar.between), f"{POINTS} has no point {name}")
    if tables.mover.kind == "robot" and not flange:
        problems.add(("mover",), "kind", "robot", f"needs {FLANGE}, the flange's pose at every point")
    problems.raise_any()
