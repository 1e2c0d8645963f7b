"""The fusion task: steps of all stations in, fixes out. It also ticks when nothing comes, so that a loss is told."""

import asyncio
from collections import deque
from collections.abc import Callable
from contextlib import aclosing

from trackerd.contract.clock import Clock
from trackerd.contract.model import Fix
from trackerd.engine.fuse import Fuser
from trackerd.engine.track import Step
from trackerd.service.pacer import ticks

INBOX = 256  # steps; older ones are dropped and counted: a queue never grows


class FusionTask:
    def __init__(self, fuser: Fuser, clock: Clock, publish: Callable[[Fix], None], period_s: float) -> None:
        self.dropped = 0
        self.ticks = 0
        self._fuser = fuser
        self._clock = clock
        self._publish = publish
        self._period_s = period_s
        self._inbox: deque[tuple[str, Step]] = deque(maxlen=INBOX)
        self._wake = asyncio.Event()

    def offer(self, station: str, step: Step) -> None:
        self.dropped += len(self._inbox) == INBOX
        self._inbox.append((station, step))
        self._wake.set()

    def lost(self, station: str, reason: str) -> None:
        for fix in self._fuser.lost(station, reason, self._clock.now()):
            self._publish(fix)

    async def run(self) -> None:
        async with asyncio.TaskGroup() as group:
            group.create_task(self._fuse(), name="fuse")
            group.create_task(self._tick(), name="fuse-tick")

    async def _fuse(self) -> None:
        while True:
            await self._wake.wait()
            self._wake.clear()
            while self._inbox:
                station, step = self._inbox.popleft()
                if step.sightline is None:
                    self.lost(station, step.why)
                    continue
                for fix in self._fuser.add(step.sightline, self._clock.now()):
                    self._publish(fix)

    async def _tick(self) -> None:
        async with aclosing(ticks(self._period_s)) as due:
            async for _ in due:
                self.ticks += 1
                fix = self._fuser.tick(self._clock.now())
                if fix is not None:
                    self._publish(fix)
