"""The two command records that a cycle sends: stay as you are, or be there."""

from trackerd.contract.clock import ControllerUs
from trackerd.contract.model import AxisCommand, AxisMode
from trackerd.steering.limits import Point


def still(sequence: int, watchdog_ms: int, enable: bool, reset_fault: bool = False) -> AxisCommand:
    """Heartbeat and hold. Where nothing is to begin the drive stays as it is: enabling and disabling are moves."""
    return AxisCommand(sequence, enable=enable, reset_fault=reset_fault, watchdog_ms=watchdog_ms)


def position(sequence: int, watchdog_ms: int, point: Point, controller_now: ControllerUs | None) -> AxisCommand:
    az, el, az_rate, el_rate = point
    return AxisCommand(
        sequence=sequence,
        mode=AxisMode.POSITION,
        az_rad=az,
        el_rad=el,
        az_rad_s=az_rate,
        el_rad_s=el_rate,
        at=controller_now,
        enable=True,
        follow=True,
        velocity_valid=True,
        watchdog_ms=watchdog_ms,
    )
