"""What a status record says against moving axes, in words for an operator."""

from trackerd.contract.model import GimbalFlag, GimbalReport

SAFETY_FAULT = 0x0500
FAULT_CLASS = 0xFF00


def is_safety_input(report: GimbalReport) -> bool:
    return report.fault & FAULT_CLASS == SAFETY_FAULT


def trouble_of(report: GimbalReport) -> str:
    """Why axes that move are to stop, in words; empty: nothing."""
    if report.fault:
        return f"controller fault 0x{report.fault:04x}"
    if report.flags & GimbalFlag.COMM_LOST:
        return "the controller's watchdog took over (comm lost)"
    return "" if report.flags & GimbalFlag.ENABLED else "the controller disabled the axes"


def news_of(before: GimbalReport, report: GimbalReport) -> str:
    """A fault or a lost link that an operator did not know of when arming."""
    came = report.fault not in (0, before.fault) or GimbalFlag.COMM_LOST in report.flags & ~before.flags
    return trouble_of(report) if came else ""
