"""One type of stamp per clock, and the host's clock as an argument.

HostNs is this machine's CLOCK_MONOTONIC, which never steps and is shared by all its processes; Unix time exists only at
the edges (Zenoh, recordings). A device's own stamps keep its own type until a clock fit has converted them.
"""

import time
from dataclasses import dataclass, field
from enum import StrEnum
from typing import NewType, Protocol

HostNs = NewType("HostNs", int)  # CLOCK_MONOTONIC
UnixNs = NewType("UnixNs", int)  # the system's wall clock
CameraNs = NewType("CameraNs", int)  # the camera's counter: unrelated zero, 50-100 ppm off
ControllerUs = NewType("ControllerUs", int)  # the gimbal controller's counter, unwrapped to 64 bits


class ClockKind(StrEnum):
    """What a device's stamps mean, and so who may convert them."""

    DEVICE = "device"  # its own counter: a clock fit converts
    HOST = "host"  # already CLOCK_MONOTONIC
    RECORDING = "recording"  # the recorded instant: one offset, common to all devices of the cell, maps it to now
    NONE = "none"  # it has no clock


class Clock(Protocol):
    """The host's clock; an argument wherever time is needed, so that tests own it."""

    def now(self) -> HostNs: ...

    def unix(self, instant: HostNs) -> UnixNs: ...


def _unix_minus_host_ns() -> int:
    """The least delayed of a few bracketed readings of both clocks."""
    readings = []
    for _ in range(9):
        before, unix, after = time.monotonic_ns(), time.time_ns(), time.monotonic_ns()
        readings.append((after - before, unix - (before + after) // 2))
    return min(readings)[1]


@dataclass(frozen=True, slots=True)
class SystemClock:
    """The real one. The offset to Unix time is taken once, so that a stepped wall clock moves no stamp."""

    unix_minus_host_ns: int = field(default_factory=_unix_minus_host_ns)

    def now(self) -> HostNs:
        return HostNs(time.monotonic_ns())

    def unix(self, instant: HostNs) -> UnixNs:
        return UnixNs(instant + self.unix_minus_host_ns)


@dataclass(slots=True)
class ManualClock:
    """A clock that moves when told to."""

    instant: HostNs = HostNs(0)
    unix_minus_host_ns: int = 1_700_000_000_000_000_000

    def now(self) -> HostNs:
        return self.instant

    def unix(self, instant: HostNs) -> UnixNs:
        return UnixNs(instant + self.unix_minus_host_ns)

    def advance(self, duration_s: float) -> HostNs:
        self.instant = HostNs(self.instant + round(duration_s * 1e9))
        return self.instant
