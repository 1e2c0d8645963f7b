"""What one trial of one method ended in: errors against the truth."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from trackerd.budget.stage import Stage
from trackerd.contract.model import Array
from trackerd.geometry.gimbal import Station


@dataclass(frozen=True, slots=True)
class Outcome:
    """K gimbals, P targets. A stack of T trials has one more axis in front."""

    rms_px: Array  # (K,) reprojection of the one view: root of the mean squared distance of a point
    centre_mm: Array  # (K, 3) error of a gimbal's centre, in W
    turn_rad: Array  # (K, 3) error of its orientation: rotation vector in W, R_found = exp([turn]x) R_true
    target_mm: Array  # (P, 3) errors of the measured points


def outcome(stage: Stage, rms_px: Sequence[float], found: Mapping[str, Station], measured_mm: Array) -> Outcome:
    poses = [(found[name].world_from_gimbal, true.world_from_gimbal) for name, true in stage.stations.items()]
    return Outcome(
        rms_px=np.array(rms_px),
        centre_mm=np.array([there.translation_mm - true.translation_mm for there, true in poses]),
        turn_rad=np.array([Rotation.from_matrix(there.rotation @ true.rotation.T).as_rotvec() for there, true in poses]),
        target_mm=measured_mm - stage.points_mm,
    )


def stacked(outcomes: Sequence[Outcome]) -> Outcome:
    """Of T trials, along a new first axis."""
    fields = ("rms_px", "centre_mm", "turn_rad", "target_mm")
    return Outcome(**{name: np.array([getattr(each, name) for each in outcomes]) for name in fields})
