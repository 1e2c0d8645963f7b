"""The proof that the axes do in the image what the calibration says: the axis test, as often as it takes to be clear."""

import numpy as np

from trackerd.contract.model import Array, Found, GimbalReport, TrackState
from trackerd.engine.axis_test import AxisTest, Verdict
from trackerd.engine.track import Step
from trackerd.formats.settings import SteeringSettings
from trackerd.steering.limits import Point, SetPointLimiter

UNCLEAR_TESTS = 20  # attempts that the target spoils by moving or hiding, before a person is asked
SPEED_SHARE = 0.9  # of the speed that is allowed: a servo that catches up is faster than its set-point
RAMP_S = 0.1  # to that speed


class Proof:
    """All attempts turn about the same angles, so that an attempt that is broken off at one end does not move on the next."""

    def __init__(self, steering: SteeringSettings) -> None:
        self.passed = False
        self.reason = ""  # of the last attempt that was not clear
        self._anchor_rad: Array | None = None
        self._unclear = 0
        self.limit(steering)

    def limit(self, steering: SteeringSettings) -> None:
        """Other limits, for the attempts to come."""
        speed = SPEED_SHARE * steering.test_deg_s
        gentle = {"max_deg_s": speed, "max_deg_s2": min(steering.max_deg_s2, speed / RAMP_S)}
        self._steering = steering
        self._limiter = SetPointLimiter(steering.model_copy(update=gentle))
        self._test: AxisTest | None = None

    def forget(self) -> None:
        """Other axes, or another wiring, or a person who wants to see it again."""
        self.passed = False
        self.renew()

    def renew(self) -> None:
        """A person has looked: the attempts are counted anew, from where the axes are."""
        self.reason, self._anchor_rad, self._unclear = "", None, 0

    def begin(self, report: GimbalReport) -> None:
        here = np.array((report.az_rad, report.el_rad))
        if self._anchor_rad is None:
            self._anchor_rad = here
        self._test = AxisTest(self._anchor_rad, self._steering)
        self._limiter.reset(report.az_rad, report.el_rad, 0.0, 0.0)

    def set_point(self, dt_s: float) -> Point:
        """Of the attempt, `dt_s` after the one before."""
        if self._test is None:
            return self._limiter.stop_step(dt_s)
        return self._limiter.step(*self._test.target, 0.0, 0.0, dt_s)

    def seen(self, step: Step) -> Verdict:
        """FAILED also where too many attempts were unclear; why is in `reason`."""
        test = self._test
        if test is None:
            return Verdict.RUNNING
        if step.state is TrackState.SEARCHING:
            return self.spoilt("the target was lost")
        if not isinstance(step.outline, Found) or step.angles is None or step.jacobian is None:
            return Verdict.RUNNING
        q_px = np.array((step.outline.x_px, step.outline.y_px))
        verdict = test.seen(q_px, step.angles, step.jacobian, step.instant)
        if verdict is Verdict.UNCLEAR:
            return self.spoilt(test.reason)
        if verdict is Verdict.FAILED:
            self.reason = f"axis test: {test.reason}"
        if verdict is Verdict.PASSED:
            self.renew()
            self.passed = True
        return verdict

    def spoilt(self, reason: str) -> Verdict:
        """The attempt says nothing: UNCLEAR, or FAILED where that happened too often."""
        self._unclear += 1
        self.reason = f"axis test: {reason}"
        if self._unclear < UNCLEAR_TESTS:
            return Verdict.UNCLEAR
        self.reason += f", after {UNCLEAR_TESTS} attempts: let it stand still, then arm"
        return Verdict.FAILED
