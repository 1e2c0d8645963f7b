"""Devices come and go; the rest goes on. Only this file catches DeviceError; anything else ends the daemon."""

import asyncio
import logging
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field

from trackerd.contract.errors import DeviceError
from trackerd.service.cancellation import end_if_cancelled

log = logging.getLogger("trackerd.supervisor")
STEADY_S = 10.0  # a device that ran this long is trusted again: the pauses start from the shortest


@dataclass(slots=True)
class Device:
    """What is told of one device."""

    name: str
    state: str = "opening"  # opening | running | lost | ended
    reason: str = ""
    restarts: int = 0
    first: asyncio.Event = field(default_factory=asyncio.Event)  # it ran, or was found missing, for the first time

    def running(self) -> None:
        if self.state != "running":
            log.info("%s is running", self.name)
        self.state, self.reason = "running", ""
        self.first.set()

    def ended(self, reason: str) -> None:
        self.state, self.reason = "ended", reason

    def lost(self, reason: str) -> None:
        if (self.state, self.reason) != ("lost", reason):
            log.warning("%s lost: %s", self.name, reason)
        self.state, self.reason = "lost", reason
        self.restarts += 1
        self.first.set()


async def keep(device: Device, run: Callable[[], Awaitable[None]], pauses_s: tuple[float, float]) -> None:
    """Runs a device until it is cancelled: on DeviceError it is opened again after a pause that doubles up to a limit."""
    loop = asyncio.get_running_loop()
    pause_s = pauses_s[0]
    while True:
        began = loop.time()
        try:
            await run()
            return
        except DeviceError as error:
            end_if_cancelled()
            device.lost(str(error))
        if loop.time() - began > STEADY_S:
            pause_s = pauses_s[0]
        await asyncio.sleep(pause_s)
        pause_s = min(2 * pause_s, pauses_s[1])
