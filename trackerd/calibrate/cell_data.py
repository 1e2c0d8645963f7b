"""A dataset as the adjustment wants it: observations and targets, and what is kept outside for checking."""

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from math import hypot, sqrt

import numpy as np

from trackerd.calibrate.cell.observations import Observations, observations
from trackerd.calibrate.cell.targets import Body, Targets, board, join, known_points, mover, unknown_points, with_bars
from trackerd.contract.errors import ConfigError, Undetermined
from trackerd.contract.model import Array
from trackerd.formats.dataset import Dataset
from trackerd.formats.dataset_points import Point
from trackerd.formats.dataset_tables import GimbalTable
from trackerd.formats.dataset_views import ImagePoint
from trackerd.geometry.gimbal import AxisOrder, Station
from trackerd.geometry.lens import Lens
from trackerd.geometry.rigid import Rigid

MOVER = "mover"  # the body of a robot's points


@dataclass(frozen=True, slots=True)
class BoardPoint:
    """A point of a board in a picture."""

    feature: int
    q_px: Array  # (2,)
    sigma_px: float


FindBoard = Callable[[Dataset, ImagePoint], Sequence[BoardPoint] | str]  # why there is none, in words
BoardPoints = Callable[[Dataset, str], Array]  # (n, 3) of a board, by name


@dataclass(frozen=True, slots=True)
class Seen:
    """One image point of one target's point."""

    gimbal: str
    view: str
    az_rad: float
    el_rad: float
    q_px: Array
    sigma_px: float
    encoder_rad: float
    fixed_rad: float
    point: str  # of the targets


@dataclass(frozen=True, slots=True)
class CellData:
    """What is adjusted, and the check points, which are not. `nominal` has every gimbal of the dataset."""

    observations: Observations
    targets: Targets
    nominal: dict[str, Station]
    checks: tuple[Point, ...]
    check_observations: Observations | None  # their points are the checks, in their order
    left_out: tuple[str, ...]  # pictures without a board, and points that nobody saw

    @property
    def points_mm(self) -> Array:
        """Places that are known, also roughly, (n, 3): they tell the volume."""
        known = ~self.targets.free & (self.targets.body == 0)
        return np.asarray(self.targets.p_mm[known])


def cell_data(
    dataset: Dataset, find_board: FindBoard, board_points: BoardPoints, checks: Collection[str] | None = None
) -> CellData:
    """`checks` names the check points; None: those that the dataset calls so.

    Raises ConfigError for a check point that has no known place, Undetermined where nothing is left to adjust.
    """
    check_points = _checks(dataset, checks)
    left_out: list[str] = []
    order = list(dataset.gimbals)
    seen = sorted(_seen(dataset, find_board, left_out), key=lambda one: order.index(one.gimbal))
    names = {point.name for point in check_points}
    adjusted = [one for one in seen if one.point not in names]
    checked = [one for one in seen if one.point in names]
    if not adjusted:
        raise Undetermined(f"{dataset.folder}: there is no view to calibrate from" + "".join(f"\n{line}" for line in left_out))
    targets = _targets(dataset, {one.point for one in adjusted}, board_points)
    check_targets = (
        known_points(np.array([p.p_mm for p in check_points]), [p.name for p in check_points]) if check_points else None
    )
    return CellData(
        observations=_observations(adjusted, targets),
        targets=targets,
        nominal={name: dataset.stations.get(name) or _station(name, table) for name, table in dataset.gimbals.items()},
        checks=check_points,
        check_observations=_observations(checked, check_targets) if check_targets is not None and checked else None,
        left_out=tuple(left_out),
    )


def _checks(dataset: Dataset, names: Collection[str] | None) -> tuple[Point, ...]:
    if names is None:
        return tuple(point for point in dataset.points.values() if point.use == "check")
    for name in names:
        if name not in dataset.points or dataset.points[name].p_mm is None:
            raise ConfigError(f"--check-points {name}: the dataset has no point of this name with a known place")
    return tuple(point for point in dataset.points.values() if point.name in names)


def _seen(dataset: Dataset, find_board: FindBoard, left_out: list[str]) -> Iterator[Seen]:
    for line in dataset.image_points:
        table = dataset.gimbals[line.gimbal]
        common = (line.gimbal, line.view, line.az_rad, line.el_rad)
        encoder = table.encoder_sigma_rad / sqrt(line.frames)
        if line.q_px is not None:
            name = line.target if line.board is None else f"{line.target}:{line.feature}"
            sigma_px = sqrt(float(np.trace(line.cov_px2)) / 2.0)
            yield Seen(*common, line.q_px, sigma_px, encoder, table.encoder_fixed_rad, name)
            continue
        found = find_board(dataset, line)
        if isinstance(found, str):
            assert line.image is not None
            left_out.append(f"{line.image.name} (line {line.line}, {line.gimbal}): {found}")
            continue
        for one in found:
            sigma_px = hypot(one.sigma_px, table.pixel_sigma_px)
            yield Seen(*common, one.q_px, sigma_px, encoder, table.encoder_fixed_rad, f"{line.target}:{one.feature}")


def _targets(dataset: Dataset, seen: set[str], board_points: BoardPoints) -> Targets:
    parts = []
    points = [point for point in dataset.points.values() if point.name in seen]
    known = [point for point in points if point.p_mm is not None]
    unknown = [point.name for point in points if point.p_mm is None]
    boards = sorted({name.rpartition(":")[0] for name in seen if "/" in name})
    if known and dataset.mover.kind != "robot":
        places = np.array([point.p_mm for point in known])
        parts.append(known_points(places, [point.name for point in known], np.array([point.cov_mm2 for point in known])))
    if known and dataset.mover.kind == "robot":
        parts.append(
            _robot(dataset, [point.name for point in known], alone=not any(_is_fixed(dataset, name) for name in boards))
        )
    if unknown:
        parts.append(unknown_points(unknown))
    for name in boards:
        p_mm = board_points(dataset, name.partition("/")[0])
        names = [f"{name}:{i}" for i in range(len(p_mm))]
        placed = dataset.placements.get(name)
        if placed is not None and placed.fixed:
            parts.append(known_points(p_mm, names, body=Body(name, placed.rigid(), fixed=True)))
        else:
            parts.append(board(name, p_mm, None if placed is None else placed.rigid(), names))
    targets = join(*parts)
    bars = [bar for bar in dataset.bars if set(bar.between) <= seen]
    if not bars:
        return targets
    return with_bars(targets, [bar.between for bar in bars], [bar.length_mm for bar in bars], [bar.sigma_mm for bar in bars])


def _is_fixed(dataset: Dataset, placement: str) -> bool:
    return placement in dataset.placements and dataset.placements[placement].fixed


def _robot(dataset: Dataset, names: Sequence[str], alone: bool) -> Targets:
    """Its points. Its base is the world where nothing else is known of the world."""
    missing = sorted(set(names) - set(dataset.flange))
    if missing:
        raise ConfigError(f"flange.csv: has no pose for point {', '.join(missing[:5])}, which was seen")
    if alone and not dataset.bars:
        raise ConfigError(
            'dataset.toml [mover] kind = "robot": needs [[bar]], known distances: a robot is too coarse for the scale'
        )
    poses: list[Rigid] = [dataset.flange[name] for name in names]
    return mover(
        MOVER,
        np.array([pose.rotation for pose in poses]),
        np.array([pose.translation_mm for pose in poses]),
        dataset.mover.ball_mm,
        ball_sigma_mm=dataset.mover.ball_sigma_mm or np.inf,
        sigma_mm=dataset.mover.sigma_mm or 0.0,
        fixed=alone,
        names=names,
    )


def _observations(seen: Sequence[Seen], targets: Targets) -> Observations:
    return observations(
        [one.gimbal for one in seen],
        [one.view for one in seen],
        [one.az_rad for one in seen],
        [one.el_rad for one in seen],
        [float(one.q_px[0]) for one in seen],
        [float(one.q_px[1]) for one in seen],
        [one.point for one in seen],
        targets,
        sigma_px=[one.sigma_px for one in seen],
        encoder_sigma_rad=[one.encoder_rad for one in seen],
        encoder_fixed_rad=[one.fixed_rad for one in seen],
    )


def _station(name: str, table: GimbalTable) -> Station:
    """What the dataset believes of a gimbal; its place is not known."""
    if table.focal_px is None:
        raise ConfigError(f"dataset.toml [gimbal.{name}] focal_px: is missing, and no start calibration has this gimbal")
    width, height = table.sensor_px
    return Station(
        name=name,
        world_from_gimbal=Rigid.identity(),
        rg_from_camera=Rigid(np.eye(3), np.array(table.lever_mm)),
        lens=Lens(table.sensor_px, table.focal_px, table.focal_px, (width - 1) / 2.0, (height - 1) / 2.0),
        order=AxisOrder(table.order),
        az_sign=table.az_sign,
        el_sign=table.el_sign,
    )
