"""Set-points that the axes can follow: limited in travel, velocity, acceleration and jerk, without lag behind a moving target.

Each step plans the fastest way to the target in the frame that moves along with it (Ruckig; Berscheid and Kröger 2021), so that
a target of constant velocity is met and not trailed, and takes the first part of it. Ruckig knows no travel limits: a step is
taken only if the axis could still stop inside the travel after it, else the axis brakes, which the step before has proved to
be possible.
"""

from dataclasses import dataclass
from math import degrees, isfinite, radians

from ruckig import ControlInterface, InputParameter, Result, Ruckig, Synchronization, Trajectory

from trackerd.contract.model import GimbalInfo
from trackerd.formats.settings import SteeringSettings

AXES = 2
LONGEST_STEP_S = 0.01  # a longer cycle is cut up, so that the travel is checked in between
LONGEST_CYCLE_S = 0.1  # after a longer pause the set-point does not jump to catch up
FASTEST_TARGET = 0.95  # of the axes' speed: the rest is for catching up
TRAVEL_TOLERANCE_RAD = 1e-10

Point = tuple[float, float, float, float]  # az, el, rad; their rates, rad/s


@dataclass(frozen=True, slots=True)
class _State:
    """Of both axes."""

    position: list[float]
    velocity: list[float]
    acceleration: list[float]


@dataclass(frozen=True, slots=True)
class _Brake:
    """The fastest way to stop, and how far it goes at least and at most."""

    way: Trajectory
    lowest: list[float]
    highest: list[float]


class SetPointLimiter:
    """Keeps the last set-point; `reset` before the first step."""

    def __init__(self, settings: SteeringSettings) -> None:
        self._low, self._high = zip(settings.az_limits_rad, settings.el_limits_rad, strict=True)
        self._fastest = radians(settings.max_deg_s)
        self._planner = Ruckig(AXES)
        self._input = InputParameter(AXES)
        self._input.synchronization = Synchronization.No
        self._input.max_acceleration = [radians(settings.max_deg_s2)] * AXES
        self._input.max_jerk = [radians(settings.max_deg_s3)] * AXES
        self.reset(0.0, 0.0, 0.0, 0.0)

    def reset(self, az_rad: float, el_rad: float, az_rad_s: float, el_rad_s: float) -> None:
        """Start from where the axes are."""
        rates = [min(max(rate, -self._fastest), self._fastest) for rate in (az_rad_s, el_rad_s)]
        self._state = _State([az_rad, el_rad], rates, [0.0] * AXES)
        self._brake = self._plan_brake(self._state)

    def step(self, az_rad: float, el_rad: float, az_rad_s: float, el_rad_s: float, dt_s: float) -> Point:
        """The set-point `dt_s` after the one before; the target's angles and rates are those at this new instant."""
        target, rates = [az_rad, el_rad], [az_rad_s, el_rad_s]
        if not all(isfinite(value) for value in (*target, *rates)):
            return self.stop_step(dt_s)
        for axis in range(AXES):
            target[axis], rates[axis] = self._admitted(axis, target[axis], rates[axis])
        left_s = min(max(dt_s, 0.0), LONGEST_CYCLE_S)
        while left_s > 0.0:
            taken_s = left_s if left_s <= LONGEST_STEP_S else LONGEST_STEP_S
            left_s -= taken_s
            there = [p - v * left_s for p, v in zip(target, rates, strict=True)]
            self._take(self._towards(there, rates, taken_s), taken_s)
        return self._point()

    def stop_step(self, dt_s: float) -> Point:
        """Brake as fast as the limits allow, then hold."""
        self._take(None, min(max(dt_s, 0.0), LONGEST_CYCLE_S))
        return self._point()

    def _point(self) -> Point:
        (az, el), (az_rate, el_rate) = self._state.position, self._state.velocity
        return az, el, az_rate, el_rate

    def _admitted(self, axis: int, target: float, rate: float) -> tuple[float, float]:
        """A target beyond the travel stands still at its end."""
        low, high = self._low[axis], self._high[axis]
        if not low < target < high:
            return min(max(target, low), high), 0.0
        fastest = FASTEST_TARGET * self._fastest
        return target, min(max(rate, -fastest), fastest)

    def _towards(self, target: list[float], rates: list[float], dt_s: float) -> _State | None:
        """State after `dt_s` on the fastest way to a target that moves. None: there is no way."""
        plan, now = self._input, self._state
        plan.control_interface = ControlInterface.Position
        plan.current_position = [p - (q - v * dt_s) for p, q, v in zip(now.position, target, rates, strict=True)]
        plan.current_velocity = [u - v for u, v in zip(now.velocity, rates, strict=True)]
        plan.current_acceleration = now.acceleration
        plan.target_position = plan.target_velocity = plan.target_acceleration = [0.0] * AXES
        plan.max_velocity = [self._fastest - v for v in rates]
        plan.min_velocity = [-self._fastest - v for v in rates]
        way = Trajectory(AXES)
        if self._planner.calculate(plan, way) not in (Result.Working, Result.Finished):
            return None
        position, velocity, acceleration = way.at_time(dt_s)
        return _State(
            [p + q for p, q in zip(position, target, strict=True)],
            [u + v for u, v in zip(velocity, rates, strict=True)],
            acceleration,
        )

    def _take(self, wanted: _State | None, dt_s: float) -> None:
        """Go to the wanted state with each axis that can still stop in time afterwards; brake with the other."""
        braked = _State(*self._brake.way.at_time(dt_s))
        if wanted is None:
            self._state, self._brake = braked, self._plan_brake(braked)
            return
        brake = self._plan_brake(wanted)
        safe = [self._stops_in_time(axis, brake) for axis in range(AXES)]
        if all(safe):
            self._state, self._brake = wanted, brake
            return
        self._state = _State(*(_chosen(safe, a, b) for a, b in (
            (wanted.position, braked.position),
            (wanted.velocity, braked.velocity),
            (wanted.acceleration, braked.acceleration),
        )))  # fmt: skip
        self._brake = self._plan_brake(self._state)

    def _stops_in_time(self, axis: int, brake: _Brake) -> bool:
        """Inside the travel, or where braking now would end up anyway (a start outside of it)."""
        low = min(self._low[axis], self._brake.lowest[axis]) - TRAVEL_TOLERANCE_RAD
        high = max(self._high[axis], self._brake.highest[axis]) + TRAVEL_TOLERANCE_RAD
        return bool(low <= brake.lowest[axis] and brake.highest[axis] <= high)

    def _plan_brake(self, state: _State) -> _Brake:
        plan = self._input
        plan.control_interface = ControlInterface.Velocity
        plan.current_position, plan.current_velocity = state.position, state.velocity
        plan.current_acceleration = state.acceleration
        plan.target_velocity = plan.target_acceleration = [0.0] * AXES
        plan.max_velocity, plan.min_velocity = [self._fastest] * AXES, [-self._fastest] * AXES
        way = Trajectory(AXES)
        answer = self._planner.calculate(plan, way)
        if answer not in (Result.Working, Result.Finished):  # braking exists from every state
            raise ArithmeticError(f"no way to brake from {state}: {answer}")
        extrema = way.position_extrema
        return _Brake(way, [e.min for e in extrema], [e.max for e in extrema])


def _chosen(first: list[bool], a: list[float], b: list[float]) -> list[float]:
    return [x if take else y for take, x, y in zip(first, a, b, strict=True)]


def within(steering: SteeringSettings, info: GimbalInfo) -> SteeringSettings:
    """The settings with the controller's own limits, where those are narrower."""
    travel = {
        name: (max(wanted[0], degrees(own[0])), min(wanted[1], degrees(own[1])))
        for name, wanted, own in (
            ("az_limits_deg", steering.az_limits_deg, info.az_limits_rad),
            ("el_limits_deg", steering.el_limits_deg, info.el_limits_rad),
        )
    }
    speed = {
        "max_deg_s": min(steering.max_deg_s, degrees(info.max_rad_s)),
        "max_deg_s2": min(steering.max_deg_s2, degrees(info.max_rad_s2)),
    }
    return steering.model_copy(update=travel | speed)
