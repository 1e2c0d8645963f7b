"""Datasets that are made, not measured: known probe points, seen by a true cell with seeded noise."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import tomli_w
from unit.sim_cell import station

from trackerd.contract.model import Array
from trackerd.formats.calibration import Calibration, save_calibration
from trackerd.formats.dataset_file import COLUMNS
from trackerd.geometry.gimbal import Station
from trackerd.geometry.rigid import Rigid, quaternion_from_matrix, rotation_about

ARCSEC = np.pi / 648_000.0
TRUE = {"left": station("left", -550.0), "right": station("right", 550.0)}
CROSS = ((0.0, 0.0), (500.0, 100.0), (-500.0, 250.0), (250.0, -400.0), (-200.0, -300.0))  # px from the middle, on several radii


def spread(count: int, seed: int = 1, half_mm: Sequence[float] = (200.0, 200.0, 150.0)) -> Array:
    """Points in the volume about W's origin, (count, 3)."""
    return np.random.default_rng(seed).uniform(-1.0, 1.0, (count, 3)) * np.array(half_mm)


def write_dataset(
    folder: Path,
    p_mm: Array,
    stations: Mapping[str, Station] = TRUE,
    *,
    check: int = 0,
    sigma_px: float = 0.1,
    sigma_arcsec: float = 2.0,
    point_mm: float = 0.005,
    seed: int = 1,
    start: Mapping[str, Station] | None = None,
    offsets_px: Sequence[tuple[float, float]] = CROSS,
) -> Path:
    """The last `check` points are check points."""
    rng = np.random.default_rng(seed)
    folder.mkdir(parents=True, exist_ok=True)
    tables = {
        "format": "trackerd-dataset",
        "version": 1,
        "mover": {"kind": "cnc", "sigma_mm": point_mm},
        "gimbal": {name: gimbal_table(one, sigma_px, sigma_arcsec) for name, one in stations.items()},
    }
    if start is not None:
        tables["start"] = "start.toml"
        nominal = Calibration("start", "2025-01-01T00:00:00+00:00", "trackerd", "nominal", dict(start))
        save_calibration(nominal, folder / "start.toml")
    (folder / "dataset.toml").write_text(tomli_w.dumps(tables))
    names = [f"{'C' if i >= len(p_mm) - check else 'P'}{i:02d}" for i in range(len(p_mm))]
    uses = ["check" if name[0] == "C" else "adjust" for name in names]
    rows = (f"{name},{x!r},{y!r},{z!r},{use}" for name, (x, y, z), use in zip(names, p_mm.tolist(), uses, strict=True))
    (folder / "points.csv").write_text("\n".join(("point,x_mm,y_mm,z_mm,use", *rows)) + "\n")
    true_mm = p_mm + rng.normal(0.0, point_mm, p_mm.shape)
    lines = [",".join(COLUMNS)]
    for name, true in zip(names, true_mm, strict=True):
        for gimbal, one in stations.items():
            lines += list(_views(name, true, gimbal, one, offsets_px, sigma_px, sigma_arcsec * ARCSEC, rng))
    (folder / "views.csv").write_text("\n".join(lines) + "\n")
    return folder


def gimbal_table(one: Station, sigma_px: float, sigma_arcsec: float) -> dict[str, object]:
    return {
        "sensor_px": list(one.lens.sensor_px),
        "focal_px": 30500.0,
        "lever_mm": [0.0, -124.5, 0.0],
        "encoder_sigma_arcsec": sigma_arcsec,
        "pixel_sigma_px": sigma_px,
    }


def _views(
    name: str,
    p_mm: Array,
    gimbal: str,
    one: Station,
    offsets_px: Sequence[tuple[float, float]],
    sigma_px: float,
    sigma_rad: float,
    rng: np.random.Generator,
) -> list[str]:
    width, height = one.lens.sensor_px
    lines = []
    for number, offset in enumerate(offsets_px):
        az, el = one.aim(p_mm, np.array((0.5 * (width - 1), 0.5 * (height - 1))) + offset)
        u, v = (one.pixel(p_mm, az, el) + rng.normal(0.0, sigma_px, 2)).tolist()
        az, el = (angle + rng.normal(0.0, sigma_rad) for angle in (az, el))
        cov = f"{sigma_px**2:.9g},0,{sigma_px**2:.9g}"
        lines.append(f"{name}.{number},{gimbal},{az!r},{el!r},{name},0,{u!r},{v!r},{cov},1,1,")
    return lines


BALL_MM = np.array((12.0, -7.0, 105.0))  # in the robot's flange, true
BARS_MM = 300.0


def write_robot_dataset(folder: Path, count: int = 30, bars: int = 6, seed: int = 1, robot_mm: float = 0.65) -> Path:
    """A robot that is off by `robot_mm` a coordinate, and bars whose ends are at unknown places."""
    rng = np.random.default_rng(seed)
    middle = rng.uniform(-1.0, 1.0, (bars, 3)) * (80.0, 80.0, 60.0)
    way = rng.normal(size=(bars, 3))
    way *= 0.5 * BARS_MM / np.linalg.norm(way, axis=1)[:, None]
    ends = np.concatenate((middle - way, middle + way))
    ball = spread(count, seed)
    write_dataset(folder, np.concatenate((ball, ends)), point_mm=1e-9, seed=seed)
    names = [f"P{i:02d}" for i in range(count + 2 * bars)]
    turns = [rotation_about(axis / np.linalg.norm(axis), float(rng.uniform(0.1, 0.5))) for axis in rng.normal(size=(count, 3))]
    flange = [p - turn @ BALL_MM + rng.normal(0.0, robot_mm, 3) for p, turn in zip(ball, turns, strict=True)]
    rows = [
        ",".join((name, *(repr(float(x)) for x in (*place, *quaternion_from_matrix(turn)))))
        for name, place, turn in zip(names, flange, turns, strict=False)
    ]
    (folder / "flange.csv").write_text("\n".join(("point,x_mm,y_mm,z_mm,qw,qx,qy,qz", *rows)) + "\n")
    known = [f"{name},0,0,0" for name in names[:count]]  # by the flange's pose; the numbers here do not count
    (folder / "points.csv").write_text(
        "\n".join(("point,x_mm,y_mm,z_mm", *known, *(f"{name},,," for name in names[count:]))) + "\n"
    )
    text = (
        (folder / "dataset.toml")
        .read_text()
        .replace('kind = "cnc"\nsigma_mm = 1e-09', f'kind = "robot"\nsigma_mm = {robot_mm}')
    )
    assert "robot" in text
    for i in range(bars):
        ends_of = f'"{names[count + i]}", "{names[count + bars + i]}"'
        text += f"\n[[bar]]\nbetween = [{ends_of}]\nlength_mm = {BARS_MM}\nsigma_mm = 0.005\n"
    (folder / "dataset.toml").write_text(text)
    return folder


def write_board_dataset(folder: Path, views: int = 12, loose: int = 6, seed: int = 1, sigma_px: float = 0.3) -> Path:
    """A chessboard in a known place and loose ones, each seen by both gimbals from several angles; corners, no pictures."""
    rng = np.random.default_rng(seed)
    write_dataset(folder, spread(2), seed=seed)
    text = (folder / "dataset.toml").read_text()
    text += '\n[board.grid]\nkind = "chessboard"\ncolumns = 9\nrows = 6\nsquare_mm = 8.0\n'
    text += '\n[placement."grid/fixed"]\nquaternion_wxyz = [1.0, 0.0, 0.0, 0.0]\ntranslation_mm = [-32.0, -20.0, 0.0]\n'
    (folder / "dataset.toml").write_text(text)
    (folder / "points.csv").unlink()
    row, column = np.divmod(np.arange(54), 9)
    corners = np.column_stack((column, row, np.zeros(54))) * 8.0
    lines = [",".join(COLUMNS)]
    for number in range(loose + 1):
        turn = rotation_about(np.array((0.6, 0.8, 0.0)), float(rng.uniform(-0.6, 0.6)))
        place = Rigid(turn, np.array((*rng.uniform(-120.0, 120.0, 2), rng.uniform(-90.0, 90.0))))
        name = "fixed" if number == 0 else f"loose{number}"
        p_mm = corners + np.array((-32.0, -20.0, 0.0)) if number == 0 else place.move(corners)
        for gimbal, one in TRUE.items():
            for view in range(views):
                lines += _board_views(f"{name}.{view}", f"grid/{name}", gimbal, one, p_mm, sigma_px, rng)
    (folder / "views.csv").write_text("\n".join(lines) + "\n")
    return folder


def _board_views(
    view: str, target: str, gimbal: str, one: Station, p_mm: Array, sigma_px: float, rng: np.random.Generator
) -> list[str]:
    width, height = one.lens.sensor_px
    aim_px = np.array((0.5 * (width - 1), 0.5 * (height - 1))) + rng.uniform(-0.3, 0.3, 2) * (width, height)
    az, el = one.aim(p_mm[26], aim_px)
    q = np.array([one.pixel(p, az, el) for p in p_mm]) + rng.normal(0.0, sigma_px, (len(p_mm), 2))
    az, el = (angle + rng.normal(0.0, 2.0 * ARCSEC) for angle in (az, el))
    seen = ((q > 0.0) & (q < (width - 1, height - 1))).all(axis=1)
    cov = f"{sigma_px**2:.9g},0,{sigma_px**2:.9g}"
    return [
        f"{view},{gimbal},{az!r},{el!r},{target},{i},{u!r},{v!r},{cov},1,1,"
        for i, ((u, v), inside) in enumerate(zip(q.tolist(), seen, strict=True))
        if inside
    ]
