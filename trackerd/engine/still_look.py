"""Many frames of a target that stands still before axes that stand still, as one measurement with its covariance."""

from dataclasses import dataclass, field

import numpy as np

from trackerd.contract.clock import HostNs
from trackerd.contract.model import Array, AxisAngles, Found, TrackState
from trackerd.engine.track import Step

MOST_SCATTER_PX = 1.0  # of one frame's place: more is no noise but motion
DRIFT_SIGMAS = 4.0  # between the means of both halves: more, and something still moves
FLOOR_PX = 0.01  # of the place in the raster of pixels, the same in every frame: averaging does not reduce it


@dataclass(frozen=True, slots=True)
class StillView:
    """Means over `frames` frames."""

    q_px: Array  # (2,) of the outline's centre, on the sensor
    r_px: float
    cov_px2: Array  # (2, 2) of the mean
    az_rad: float
    el_rad: float
    jacobian: Array  # (2, 2) d px / d encoder rad
    frames: int
    last_frame: int  # its id


@dataclass(slots=True)
class StillLook:
    """Feed it every step; it answers once the last `frames` of them are still. Frames exposed before `since` do not count."""

    frames: int
    since: HostNs
    reason: str = "no frames"
    _steps: list[tuple[Found, AxisAngles, Step]] = field(default_factory=list)

    def add(self, step: Step) -> StillView | None:
        if step.instant < self.since:
            return None
        found, angles = step.outline, step.angles
        if step.state is not TrackState.LOCKED or not isinstance(found, Found) or angles is None or step.jacobian is None:
            self._steps, self.reason = [], step.why or "the target is not locked yet"
            return None
        self._steps = [*self._steps, (found, angles, step)][-self.frames :]
        if len(self._steps) < self.frames:
            self.reason = f"{len(self._steps)} of {self.frames} frames so far"
            return None
        return self._mean(step)

    def _mean(self, last: Step) -> StillView | None:
        q = np.array([(found.x_px, found.y_px) for found, _, _ in self._steps])
        scatter = np.cov(q.T) if len(q) > 2 else np.zeros((2, 2))
        half = len(q) // 2
        drift = np.abs(q[:half].mean(axis=0) - q[-half:].mean(axis=0)) if half else np.zeros(2)
        sigma = np.sqrt(np.mean(np.diff(q, axis=0) ** 2, axis=0) / 2.0) if len(q) > 1 else np.zeros(2)  # blind to drift
        if sigma.max() > MOST_SCATTER_PX or (drift > DRIFT_SIGMAS * sigma * np.sqrt(2.0 / max(half, 1)) + FLOOR_PX).any():
            self.reason = f"it is not still: scatter {sigma.max():.2f} px, drift {drift.max():.2f} px"
            return None
        stated = np.mean([found.cov_px2[:2, :2] for found, _, _ in self._steps], axis=0)
        larger = scatter if np.trace(scatter) > np.trace(stated) else stated
        assert last.jacobian is not None
        return StillView(
            q_px=q.mean(axis=0),
            r_px=float(np.mean([found.r_px for found, _, _ in self._steps])),
            cov_px2=larger / len(q) + FLOOR_PX**2 * np.eye(2),
            az_rad=float(np.mean([angles.az_rad for _, angles, _ in self._steps])),
            el_rad=float(np.mean([angles.el_rad for _, angles, _ in self._steps])),
            jacobian=last.jacobian,
            frames=len(q),
            last_frame=last.frame_id,
        )
