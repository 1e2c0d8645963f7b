"""A gimbal and a camera in memory, behind the ports; their time is a manual clock that each exchange moves on."""

import asyncio
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass, field
from math import radians

import numpy as np

from trackerd.contract.clock import CameraNs, ClockKind, ControllerUs, ManualClock
from trackerd.contract.errors import TrackerdError
from trackerd.contract.model import (
    AxisCommand,
    CameraInfo,
    CameraStatistics,
    Frame,
    GimbalFlag,
    GimbalInfo,
    GimbalReport,
    Latch,
)

BOOT_US = 5_000_000
CYCLE_S = 1e-3
PATIENCE_S = 10.0  # with a link that should be there
EXPOSURE_NS = 2_000_000
TRAVEL = (radians(-60.0), radians(60.0))
UP = GimbalFlag.READY | GimbalFlag.HOMED

GIMBAL = GimbalInfo(
    name="left",
    serial="1",
    firmware="1.0",
    steerable=True,
    clock=ClockKind.DEVICE,
    az_limits_rad=TRAVEL,
    el_limits_rad=TRAVEL,
    max_rad_s=1.0,
    max_rad_s2=10.0,
)
CAMERA = CameraInfo(
    name="left",
    model="memory",
    serial="1",
    sensor_px=(2048, 1536),
    image_px=(64, 48),
    frame_rate_hz=55.0,
    exposure_ns=EXPOSURE_NS,
    clock=ClockKind.HOST,
)


@dataclass
class MemoryGimbal:
    """A controller whose drives and latches are as the test sets them. `error` is raised by every exchange."""

    clock: ManualClock
    info: GimbalInfo = GIMBAL
    commands: list[AxisCommand] = field(default_factory=list)
    latches: tuple[Latch, ...] = ()
    latch_total: int = 0
    zeroes: bool = True  # follows latch_zero
    enabled: bool = False
    fault: int = 0
    error: Exception | None = None
    swallow: bool = False  # a cancellation during the exchange is lost
    booted: int = 0
    _sequence: int = 0
    _news: asyncio.Event = field(default_factory=asyncio.Event)

    async def exchange(self, command: AxisCommand) -> GimbalReport:
        sent = self.clock.now()
        received = self.clock.advance(CYCLE_S)
        await self._answer()
        if command.latch_zero and self.zeroes:
            self.latch_total, self.latches = 0, ()
        self._sequence = (self._sequence + 1) & 0xFFFF
        self.commands.append(command)
        self._news.set()
        self._news = asyncio.Event()
        return GimbalReport(
            sequence=self._sequence,
            flags=UP | (GimbalFlag.ENABLED if self.enabled else GimbalFlag(0)),
            fault=self.fault,
            echo=command.sequence,
            command_age_ms=0,
            az_rad=0.1,
            el_rad=0.2,
            instant=self.time((sent + received) // 2),
            latch_total=self.latch_total,
            latches=self.latches,
            sent=sent,
            received=received,
        )

    async def _answer(self) -> None:
        try:
            await asyncio.sleep(0)
        except asyncio.CancelledError:
            if not self.swallow:
                raise
        if self.error is not None:
            raise self.error

    def time(self, host_ns: int) -> ControllerUs:
        return ControllerUs(BOOT_US + (host_ns - self.booted) // 1000)

    def expose(self, index: int, mid_ns: int) -> None:
        """Both edges of one exposure are latched."""
        start, end = (self.time(mid_ns + side * EXPOSURE_NS // 2) for side in (-1, 1))
        self.latches = (Latch(index, True, 0.1, 0.2, end), Latch(index, False, 0.1, 0.2, start), *self.latches)[:8]
        self.latch_total = index + 1

    def restart(self) -> None:
        """Its clock and its count begin anew."""
        self.booted, self.latches, self.latch_total = self.clock.now(), (), 0

    async def exchanged(self, count: int) -> None:
        """Waits for so many more exchanges."""
        async with asyncio.timeout(PATIENCE_S):
            for _ in range(count):
                await self._news.wait()


@dataclass
class MemoryCamera:
    """Delivers what is put into it, from the frames themselves to the error that ends the stream."""

    clock: ManualClock
    info: CameraInfo = CAMERA
    on_start: Callable[[], None] = lambda: None
    calls: list[str] = field(default_factory=list)
    counts: CameraStatistics = field(default_factory=CameraStatistics)
    out: asyncio.Queue[Frame | TrackerdError] = field(default_factory=asyncio.Queue)

    async def start(self) -> None:
        self.calls.append("start")
        self.on_start()

    async def stop(self) -> None:
        self.calls.append("stop")

    async def frames(self) -> AsyncIterator[Frame]:
        while True:
            item = await self.out.get()
            if isinstance(item, TrackerdError):
                raise item
            yield item

    def statistics(self) -> CameraStatistics:
        return self.counts

    def expose(self, frame_id: int, image: np.ndarray | None = None, **fields: int) -> Frame:
        """One frame is complete now."""
        now = self.clock.now()
        grey = np.full((48, 64), 60, np.uint8) if image is None else image
        made = Frame(grey, frame_id, CameraNs(now - EXPOSURE_NS), now, EXPOSURE_NS, **fields)
        self.out.put_nowait(made)
        return made
