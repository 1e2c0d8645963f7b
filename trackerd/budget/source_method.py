"""The source thesis's method, Algorithm 1: one view of known points by calibrateCamera and solvePnP, unweighted triangulation.

Its own choices are kept, because they are what is measured here: all intrinsics but distortion freed from one view, the found
camera matrix used for the pose and the nominal one for the lines of sight, the lever arm believed, the encoders not averaged.
Its misprints are not: the camera's pose is inverted (solvePnP gives camera_from_world), the projection centre is the lens's,
rays begin at the camera and not at the gimbal, and the axes are in the order that its tables have (Rx(az) Ry(el)).
"""

from collections.abc import Mapping
from dataclasses import replace

import cv2
import numpy as np

from trackerd.budget.outcome import Outcome, outcome
from trackerd.budget.simulate import Readings
from trackerd.budget.stage import Sight, Stage
from trackerd.contract.errors import Degenerate
from trackerd.contract.model import Array
from trackerd.geometry.gimbal import Station
from trackerd.geometry.rigid import Rigid

FLAGS = (
    cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K1 | cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3
)  # ten parameters are left; with as many, 12 points leave the residual that Table 4.2 prints
FREE_PARAMETERS = 10


def by_source_method(stage: Stage, readings: Readings) -> tuple[Outcome, dict[str, Station]]:
    """Its errors, and the stations that it finds.

    Raises Degenerate where the view or the lines of sight do not determine what is asked.
    """
    found, rms_px = {}, []
    for name, nominal in stage.stations.items():
        found[name], rms = _calibrated(nominal, stage.points_mm, readings[name])
        rms_px.append(rms)
    measured_mm = nearest_points(*lines_of_sight(found, readings))
    return outcome(stage, rms_px, found, measured_mm), found


def _calibrated(nominal: Station, points_mm: Array, seen: Sight) -> tuple[Station, float]:
    """The station with the base pose of Eqs 3.5-3.10, and the reprojection RMS, px."""
    lens = nominal.lens
    guess = np.array(((lens.fx_px, 0.0, lens.cx_px), (0.0, lens.fy_px, lens.cy_px), (0.0, 0.0, 1.0)))
    points, pixels = points_mm.astype(np.float32), seen.view_px.astype(np.float32)
    try:
        fit = cv2.calibrateCamera([points], [pixels], lens.sensor_px, guess, np.zeros(5), flags=FLAGS)
        rms_px, matrix, distortion = fit[:3]
        solved, turn, shift = cv2.solvePnP(points_mm, seen.view_px, matrix, distortion)
    except cv2.error as error:
        raise Degenerate(f"station {nominal.name}: the one view determines no camera: {error.err}") from error
    if not solved:
        raise Degenerate(f"station {nominal.name}: solvePnP finds no pose")
    world_from_camera = Rigid(np.array(cv2.Rodrigues(turn)[0], float), np.array(shift[:, 0], float)).inverse()
    gimbal_from_camera = replace(nominal, world_from_gimbal=Rigid.identity()).world_from_camera(*seen.view_rad.tolist())
    return replace(nominal, world_from_gimbal=world_from_camera @ gimbal_from_camera.inverse()), float(rms_px)


def lines_of_sight(found: Mapping[str, Station], readings: Readings) -> tuple[Array, Array]:
    """Origins and unit directions of every station's line to every target, (K, P, 3) each; by each one's lens."""
    poses = {
        name: [station.world_from_camera(az, el) for az, el in readings[name].targets_rad.tolist()]
        for name, station in found.items()
    }
    origins = np.array([[pose.translation_mm for pose in row] for row in poses.values()])
    directions = [
        [pose.rotate(found[name].lens.unproject(q_px)) for pose, q_px in zip(row, readings[name].targets_px, strict=True)]
        for name, row in poses.items()
    ]
    return origins, np.array(directions)


def nearest_points(origins_mm: Array, directions: Array) -> Array:
    """Eqs 3.14-3.17 for all targets at once, (P, 3): every line counts alike."""
    across = np.eye(3) - directions[..., :, None] * directions[..., None, :]
    normal = across.sum(axis=0)
    if np.linalg.cond(normal).max() > 1e8:
        raise Degenerate("the lines of sight are parallel: the layout has no baseline")
    return np.linalg.solve(normal, (across @ origins_mm[..., None]).sum(axis=0))[..., 0]
