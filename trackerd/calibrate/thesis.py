"""The source thesis's own calibration, for comparison on the same data: calibrateCamera, then solvePnP view by view.

Each gimbal's lens from all its board views, its base pose from each view of a board in a known place, by Eqs 3.5-3.10 with the
lever arm believed; mean and standard deviation over the views in 321 Euler angles, as its Table 4.12 prints them. Its misprints
are not repeated: solvePnP's pose is inverted, and the projection centre is the lens's.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import cv2
import numpy as np

from trackerd.calibrate.cell.observations import Observations
from trackerd.calibrate.cell.targets import Targets
from trackerd.calibrate.cell_data import CellData
from trackerd.contract.errors import Undetermined
from trackerd.contract.model import Array
from trackerd.geometry.gimbal import Station
from trackerd.geometry.lens import Lens
from trackerd.geometry.rigid import Rigid, euler_321_from_matrix, matrix_from_euler_321

FEWEST_POINTS = 6  # in a view, for its pose
FEWEST_VIEWS = 3  # of a gimbal, for its lens


@dataclass(frozen=True, slots=True)
class ThesisGimbal:
    """Of one gimbal, over its views of boards in known places."""

    station: Station  # with the mean pose and the lens that was found
    rms_px: float  # reprojection, of calibrateCamera
    views: int
    place_mm: Array  # (3,) mean of the gimbal's place in W
    place_sd_mm: Array  # (3,)
    euler_rad: Array  # (3,) mean of psi, theta, phi: R = Rz(psi) Ry(theta) Rx(phi)
    euler_sd_rad: Array  # (3,)


@dataclass(frozen=True, slots=True)
class _View:
    p_board_mm: Array  # (n, 3)
    q_px: Array  # (n, 2)
    angles_rad: Array  # (2,)
    world_from_board: Rigid | None


def by_thesis(data: CellData) -> dict[str, ThesisGimbal]:
    """Raises Undetermined for data that its method cannot use: it needs many points in a view, and boards in known places."""
    return {name: _gimbal(name, data, index) for index, name in enumerate(data.observations.gimbals)}


def _gimbal(name: str, data: CellData, index: int) -> ThesisGimbal:
    views = [view for view in _views(data.observations, data.targets, index) if len(view.p_board_mm) >= FEWEST_POINTS]
    placed = [view for view in views if view.world_from_board is not None]
    if len(views) < FEWEST_VIEWS or not placed:
        raise Undetermined(
            f"gimbal {name}: the thesis's method needs {FEWEST_VIEWS} views of {FEWEST_POINTS} points or more (here"
            f" {len(views)}), at least one of a board in a known place (here {len(placed)})"
        )
    nominal = data.nominal[name]
    lens, rms_px = _lens(nominal.lens, views)
    poses = [_pose(nominal, lens, view) for view in placed]
    places = np.array([pose.translation_mm for pose in poses])
    angles = np.unwrap(np.array([euler_321_from_matrix(pose.rotation) for pose in poses]), axis=0)
    freedom = 1 if len(poses) > 1 else 0
    place, turn = places.mean(axis=0), angles.mean(axis=0)
    station = replace(nominal, world_from_gimbal=Rigid(matrix_from_euler_321(*turn.tolist()), place), lens=lens)
    place_sd, turn_sd = places.std(axis=0, ddof=freedom), angles.std(axis=0, ddof=freedom)
    return ThesisGimbal(station, rms_px, len(poses), place, place_sd, turn, turn_sd)


def _views(o: Observations, targets: Targets, gimbal: int) -> Iterator[_View]:
    for view in np.flatnonzero(o.gimbal == gimbal):
        rows = np.flatnonzero(o.view == view)
        for body_index in np.unique(targets.body[o.point[rows]]):
            points = rows[targets.body[o.point[rows]] == body_index]
            body = targets.bodies[body_index]
            place = body.world_from_body if body.fixed else None
            yield _View(targets.p_mm[o.point[points]], o.q_px[points], o.angles_rad[view], place)


def _lens(nominal: Lens, views: list[_View]) -> tuple[Lens, float]:
    """All intrinsics freed, as its Table 4.8 has them; boards must be flat for a start without a guess, so there is one."""
    guess = np.array(((nominal.fx_px, 0.0, nominal.cx_px), (0.0, nominal.fy_px, nominal.cy_px), (0.0, 0.0, 1.0)))
    points = [np.asarray(view.p_board_mm, np.float32) for view in views]
    pixels = [np.asarray(view.q_px, np.float32) for view in views]
    flags = cv2.CALIB_USE_INTRINSIC_GUESS
    try:
        rms_px, matrix, found, _, _ = cv2.calibrateCamera(points, pixels, nominal.sensor_px, guess, np.zeros(5), flags=flags)
    except cv2.error as error:
        raise Undetermined(f"calibrateCamera finds no lens: {error.err}") from error
    k1, k2, p1, p2, k3 = found.ravel()[:5].tolist()
    fx, fy, cx, cy = (float(matrix[i]) for i in ((0, 0), (1, 1), (0, 2), (1, 2)))
    return Lens(nominal.sensor_px, fx, fy, cx, cy, (k1, k2, p1, p2, k3)), float(rms_px)


def _pose(nominal: Station, lens: Lens, view: _View) -> Rigid:
    """world_from_gimbal from one view: the camera's pose by solvePnP, the encoders and the lever arm believed."""
    matrix = np.array(((lens.fx_px, 0.0, lens.cx_px), (0.0, lens.fy_px, lens.cy_px), (0.0, 0.0, 1.0)))
    _, turn, place = cv2.solvePnP(view.p_board_mm, view.q_px, matrix, np.array(lens.distortion))
    camera_from_board = Rigid(np.asarray(cv2.Rodrigues(turn)[0], float), np.asarray(place, float).ravel())
    assert view.world_from_board is not None
    world_from_camera = view.world_from_board @ camera_from_board.inverse()
    az, el = view.angles_rad.tolist()
    gimbal_from_camera = replace(nominal, world_from_gimbal=Rigid.identity()).world_from_camera(az, el)
    return world_from_camera @ gimbal_from_camera.inverse()
