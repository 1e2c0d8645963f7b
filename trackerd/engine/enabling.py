"""How a controller is brought to 'enabled' by the rules of its map, asked for once each bus cycle.

Out of 'comm lost' only by enable 0 and then 1, and 0 only once the controller itself has disabled and braked: an EL axis that
carries an eccentric camera falls when it is disabled. A fault is reset on the way, with the drives as they are.
"""

from dataclasses import dataclass

from trackerd.contract.model import GimbalFlag, GimbalReport

DISABLED_CYCLES = 2  # 'enable 0' and the fault reset are sent this often before 'enable 1'
ROUND_CYCLES = 20  # what has not worked after so many is tried from the start
FAULT_ROUNDS = 5  # a fault that outlives so many resets is not ours to clear


@dataclass(frozen=True, slots=True)
class Wish:
    enable: bool
    reset_fault: bool = False


def is_enabled(report: GimbalReport) -> bool:
    """And free to follow."""
    return bool(report.flags & GimbalFlag.ENABLED) and not report.flags & GimbalFlag.COMM_LOST and not report.fault


@dataclass(slots=True)
class Enabling:
    """One attempt."""

    _cycles: int = 0

    def wish(self, report: GimbalReport) -> Wish:
        """What the next record should say."""
        enabled = bool(report.flags & GimbalFlag.ENABLED)
        if enabled and report.flags & GimbalFlag.COMM_LOST:
            return Wish(enable=True)  # it is about to disable by itself
        first = self._cycles % ROUND_CYCLES < DISABLED_CYCLES
        self._cycles += 1
        return Wish(enable=enabled or not first, reset_fault=first and report.fault != 0)

    def hopeless(self, report: GimbalReport) -> bool:
        """A fault stays whatever is done."""
        return report.fault != 0 and self._cycles >= FAULT_ROUNDS * ROUND_CYCLES
