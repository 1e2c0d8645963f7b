"""A recorded gimbal: a table of the encoders' angles at each frame's mid-exposure."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

from drivers.table import read_rows
from trackerd.contract.clock import Clock, ClockKind, ControllerUs
from trackerd.contract.errors import ConfigError
from trackerd.contract.model import AxisCommand, GimbalFlag, GimbalInfo, GimbalReport, Latch, Source
from trackerd.formats.settings import GimbalSettings

COLUMNS = ("gimbal", "frame", "t_ns", "az_rad", "el_rad")


class Settings(GimbalSettings):
    csv: Path  # columns gimbal,frame,t_ns,az_rad,el_rad; the rows of other gimbals are left alone

    @property
    def source(self) -> Source:
        return Source.REPLAY


@asynccontextmanager
async def open_gimbal(name: str, settings: Settings, clock: Clock) -> AsyncIterator["ReplayGimbal"]:
    """Raises ConfigError where the table is not a recording of this gimbal."""
    yield ReplayGimbal(name, read_table(name, settings.csv), clock)


class ReplayGimbal:
    """Every report carries the whole recording: one latch a frame, at its mid-exposure. Commands are ignored."""

    def __init__(self, name: str, recorded: tuple[Latch, ...], clock: Clock) -> None:
        self.info = GimbalInfo(
            name=name,
            serial="",
            firmware="",
            steerable=False,
            clock=ClockKind.RECORDING,
            az_limits_rad=(min(row.az_rad for row in recorded), max(row.az_rad for row in recorded)),
            el_limits_rad=(min(row.el_rad for row in recorded), max(row.el_rad for row in recorded)),
            max_rad_s=0.0,
            max_rad_s2=0.0,
            edges=1,
        )
        self._newest_first = recorded[::-1]
        self._clock = clock
        self._sequence = 0

    async def exchange(self, command: AxisCommand) -> GimbalReport:
        self._sequence = (self._sequence + 1) & 0xFFFF
        last, now = self._newest_first[0], self._clock.now()
        return GimbalReport(
            sequence=self._sequence,
            flags=GimbalFlag.READY | GimbalFlag.HOMED,
            fault=0,
            echo=command.sequence,
            command_age_ms=0,
            az_rad=last.az_rad,
            el_rad=last.el_rad,
            instant=last.instant,
            latch_total=0 if command.latch_zero else last.index + 1,  # its frames are numbered from 0 as they stand
            latches=self._newest_first,
            sent=now,
            received=now,
        )


def read_table(name: str, file: Path) -> tuple[Latch, ...]:
    """The rows of one gimbal, oldest first; instants are rounded to µs, the unit of controllers. Raises ConfigError."""
    latches: list[Latch] = []
    others: set[str] = set()
    last_ns = -1
    for row in read_rows(file, COLUMNS):
        if row.text("gimbal") != name:
            others.add(row.text("gimbal"))
            continue
        frame, instant_ns = row.whole("frame"), row.whole("t_ns")
        if latches and frame <= latches[-1].index:
            raise row.error("frame", f"must increase from row to row of gimbal {name}")
        if instant_ns <= last_ns:
            raise row.error("t_ns", f"must increase from row to row of gimbal {name}")
        last_ns = instant_ns
        instant = ControllerUs((instant_ns + 500) // 1000)
        latches.append(Latch(frame, False, row.number("az_rad"), row.number("el_rad"), instant))
    if not latches:
        raise ConfigError(f"{file}: no row for gimbal {name!r} (there are: {', '.join(sorted(others)) or 'none'})")
    return tuple(latches)
