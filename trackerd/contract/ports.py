"""One Protocol per hardware role: few methods, errors promised.

A driver module has a frozen `Settings` (a `formats.settings.CameraSettings` or `GimbalSettings`) and one async context manager,
`open_camera(name, settings, clock)` or `open_gimbal(name, settings, clock)`; constructors touch no hardware, and leaving the
context releases everything, also after an error.
"""

from collections.abc import AsyncIterator
from contextlib import AbstractAsyncContextManager
from typing import Any, Protocol

from trackerd.contract.clock import Clock
from trackerd.contract.model import (
    AxisCommand,
    CameraInfo,
    CameraStatistics,
    Frame,
    GimbalInfo,
    GimbalReport,
)


class Camera(Protocol):
    """A camera. Every method raises DeviceError and nothing else, but `frames` may end with RecordingEnded."""

    @property
    def info(self) -> CameraInfo: ...

    async def start(self) -> None:
        """Begin a stream: the next exposure has frame id 0."""
        ...

    async def stop(self) -> None:
        """End the stream: no exposure, and so no latch, happens after it returns. Harmless when stopped."""
        ...

    def frames(self) -> AsyncIterator[Frame]:
        """The newest frame each time; older ones are counted in `skipped`. DeviceTimeout where the stream dries up."""
        ...

    def statistics(self) -> CameraStatistics: ...


class Gimbal(Protocol):
    """One two-axis gimbal controller. Every method raises DeviceError and nothing else."""

    @property
    def info(self) -> GimbalInfo: ...

    async def exchange(self, command: AxisCommand) -> GimbalReport:
        """Hand over one command record and take one status record back."""
        ...


class CameraDriver(Protocol):
    """What a camera driver's module offers."""

    Settings: type[Any]

    def open_camera(self, name: str, settings: Any, clock: Clock) -> AbstractAsyncContextManager[Camera]: ...


class GimbalDriver(Protocol):
    """What a gimbal driver's module offers."""

    Settings: type[Any]

    def open_gimbal(self, name: str, settings: Any, clock: Clock) -> AbstractAsyncContextManager[Gimbal]: ...
