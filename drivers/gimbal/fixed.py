"""No gimbal at all: two constant angles, so that a static stereo pair is a cell too."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from math import radians

from trackerd.contract.clock import Clock, ClockKind, ControllerUs
from trackerd.contract.model import AxisCommand, GimbalFlag, GimbalInfo, GimbalReport
from trackerd.formats.settings import GimbalSettings


class Settings(GimbalSettings):
    az_deg: float = 0.0  # encoder angles
    el_deg: float = 0.0


@asynccontextmanager
async def open_gimbal(name: str, settings: Settings, clock: Clock) -> AsyncIterator["FixedGimbal"]:
    yield FixedGimbal(name, radians(settings.az_deg), radians(settings.el_deg), clock)


class FixedGimbal:
    """A mount. Commands are ignored, and the live angles hold for every frame."""

    def __init__(self, name: str, az_rad: float, el_rad: float, clock: Clock) -> None:
        self.info = GimbalInfo(
            name=name,
            serial="",
            firmware="",
            steerable=False,
            clock=ClockKind.NONE,
            az_limits_rad=(az_rad, az_rad),
            el_limits_rad=(el_rad, el_rad),
            max_rad_s=0.0,
            max_rad_s2=0.0,
            edges=0,
        )
        self._az_rad, self._el_rad, self._clock = az_rad, el_rad, clock
        self._sequence = 0

    async def exchange(self, command: AxisCommand) -> GimbalReport:
        self._sequence = (self._sequence + 1) & 0xFFFF
        now = self._clock.now()
        return GimbalReport(
            sequence=self._sequence,
            flags=GimbalFlag.READY | GimbalFlag.HOMED,
            fault=0,
            echo=command.sequence,
            command_age_ms=0,
            az_rad=self._az_rad,
            el_rad=self._el_rad,
            instant=ControllerUs(now // 1000),
            latch_total=0,
            latches=(),
            sent=now,
            received=now,
        )
