"""Before the first follow: does each axis do in the image what the calibration says?

Both axes are moved by a small angle to either side, slowly, one after the other, while the target stands still. What the pixel
does between the two ends must be what the geometry predicts from the *encoder* between them, and the encoder must have gone
where it was told: a flipped sign, swapped axes, a wrong scale or a foreign calibration cannot pass.
"""

from dataclasses import dataclass, field
from enum import Enum, auto
from math import hypot, radians

import numpy as np

from trackerd.contract.clock import HostNs
from trackerd.contract.model import Array, AxisAngles
from trackerd.formats.settings import SteeringSettings

FRAMES_PER_END = 2  # averaged at each end
ARRIVED_SHARE = 0.05  # of the test angle: closer than this, and no longer moving, is 'there'
NOISE_SIGMAS = 5.0  # of one reading: nothing closer than this can be told
SCALE_TOLERANCE = 0.2  # of the predicted pixel path; a flipped sign is off by 2, swapped axes by 1.4
STILL_SHARE = 0.1  # of the predicted pixel path: more than this between two looks at the base, and the target moved
SMALLEST_PATH_PX = 10.0  # below this the test proves nothing
PATIENCE_S = 3.0  # at each end
GAP_NS = 500_000_000  # without a look: the waiting begins anew
AXES = ("az", "el")


class Verdict(Enum):
    RUNNING = auto()
    PASSED = auto()
    UNCLEAR = auto()  # the target moved: try again
    FAILED = auto()


@dataclass(frozen=True, slots=True)
class Look:
    """The mean of the frames at one end."""

    q_px: Array  # (2,)
    angles_rad: Array  # (2,)


@dataclass(slots=True)
class AxisTest:
    """One run, from the angles at its start. Feed it every frame on which the target is seen; read `target` every bus cycle."""

    base_rad: Array
    steering: SteeringSettings
    reason: str = ""
    _place: int = 0
    _since: HostNs | None = None
    _seen: HostNs | None = None
    _frames: list[tuple[Array, Array]] = field(default_factory=list)
    _looks: list[Look] = field(default_factory=list)
    _last_rad: Array | None = None

    @property
    def target(self) -> tuple[float, float]:
        """Where the axes should be now, encoder angles."""
        az, el = self.base_rad + self._steps()[min(self._place, 6)]
        return float(az), float(el)

    def seen(self, q_px: Array, angles: AxisAngles, jacobian: Array, instant: HostNs) -> Verdict:
        """`jacobian` (2, 2) is d pixel / d (az, el) of a point that stands still in W."""
        here = np.array((angles.az_rad, angles.el_rad))
        if self._since is None or self._seen is None or instant - self._seen > GAP_NS:
            self._since, self._last_rad, self._frames = instant, None, []
        self._seen = instant
        if not self._settled(here, angles.sigma_rad):
            return self._wait(here, instant)
        self._frames.append((q_px, here))
        if len(self._frames) < FRAMES_PER_END:
            return Verdict.RUNNING
        self._looks.append(Look(*(np.mean(part, axis=0) for part in zip(*self._frames, strict=True))))
        self._frames, self._since, self._place = [], instant, self._place + 1
        return Verdict.RUNNING if self._place < 7 else self._judge(jacobian)

    def _steps(self) -> tuple[Array, ...]:
        a = radians(self.steering.test_deg)
        return tuple(np.array(p) for p in ((0.0, 0.0), (a, 0.0), (-a, 0.0), (0.0, 0.0), (0.0, a), (0.0, -a), (0.0, 0.0)))

    def _settled(self, here: Array, sigma_rad: float) -> bool:
        """There, and at rest, as far as the encoders' noise tells."""
        tolerance = ARRIVED_SHARE * radians(self.steering.test_deg)
        last, self._last_rad = self._last_rad, here
        at_rest = last is not None and float(np.abs(here - last).max()) < max(0.2 * tolerance, NOISE_SIGMAS * sigma_rad)
        return at_rest and float(np.abs(here - self.target).max()) < max(tolerance, NOISE_SIGMAS * sigma_rad)

    def _wait(self, here: Array, instant: HostNs) -> Verdict:
        self._frames = []
        if self._since is not None and instant - self._since > PATIENCE_S * 1e9:
            off = np.degrees(here - self.target)
            self.reason = f"the axes did not go where they were told (az {off[0]:+.3f}, el {off[1]:+.3f} deg away)"
            return Verdict.FAILED
        return Verdict.RUNNING

    def _judge(self, jacobian: Array) -> Verdict:
        base, az_up, az_down, middle, el_up, el_down, end = self._looks
        paths = [(az_up, az_down), (el_up, el_down)]
        predicted = [jacobian @ (up.angles_rad - down.angles_rad) for up, down in paths]
        shortest = min(hypot(*p) for p in predicted)
        if shortest < SMALLEST_PATH_PX:
            self.reason = f"the test angle moves the image by {shortest:.1f} px only"
            return Verdict.FAILED
        moved = max(hypot(*(look.q_px - base.q_px - jacobian @ (look.angles_rad - base.angles_rad))) for look in (middle, end))
        if moved > STILL_SHARE * shortest:
            self.reason = f"the target moved by {moved:.1f} px during the test"
            return Verdict.UNCLEAR
        for axis, (up, down), path in zip(AXES, paths, predicted, strict=True):
            seen = up.q_px - down.q_px
            if hypot(*(seen - path)) > SCALE_TOLERANCE * hypot(*path):
                self.reason = (
                    f"{axis} moved the image by ({seen[0]:+.1f}, {seen[1]:+.1f}) px,"
                    f" the calibration says ({path[0]:+.1f}, {path[1]:+.1f}) px: sign, order or scale of the axes is wrong"
                )
                return Verdict.FAILED
        return Verdict.PASSED
