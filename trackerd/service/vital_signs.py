"""The daemon's own health: loop lag, CPU, memory, threads, and the watchdog that systemd listens to."""

import asyncio
import os
import resource
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from trackerd.service.notify import Notifier, watchdog_period_s
from trackerd.service.stages import Percentiles, Stage

BEAT_S = 0.1
LAG_LIMIT_S = 0.5  # a loop that is later than this is not well: systemd is not told otherwise
PAGE = os.sysconf("SC_PAGE_SIZE")


@dataclass(frozen=True, slots=True)
class Vitals:
    uptime_s: float
    cpu_share: float  # of one core, since the last look
    resident_mb: float
    threads: int
    tasks: int
    open_files: int
    loop_lag: Percentiles | None


@dataclass(slots=True)
class VitalSigns:
    notifier: Notifier
    alive: Callable[[], int]  # counts up while the fusion works
    _lag: Stage = field(default_factory=Stage)
    _began: float = field(default_factory=time.monotonic)
    _last_look: tuple[float, float] = (0.0, 0.0)

    async def run(self) -> None:
        """Beats; feeds systemd's watchdog while the loop is in time and the fusion's count goes up."""
        loop = asyncio.get_running_loop()
        watchdog_s = watchdog_period_s()
        fed, count = loop.time(), self.alive()
        while True:
            due = loop.time() + BEAT_S
            await asyncio.sleep(BEAT_S)
            lag = loop.time() - due
            self._lag.add(max(0, round(lag * 1e9)))
            well = lag < LAG_LIMIT_S and self.alive() != count
            if watchdog_s is not None and well and loop.time() - fed > watchdog_s / 4:
                self.notifier.watchdog()
                fed = loop.time()
            count = self.alive()

    def look(self) -> Vitals:
        usage = resource.getrusage(resource.RUSAGE_SELF)
        now, cpu = time.monotonic(), usage.ru_utime + usage.ru_stime
        then, used = self._last_look
        self._last_look = (now, cpu)
        return Vitals(
            uptime_s=now - self._began,
            cpu_share=(cpu - used) / (now - then) if then else 0.0,
            resident_mb=int(Path("/proc/self/statm").read_text().split()[1]) * PAGE / 2**20,
            threads=len(list(Path("/proc/self/task").iterdir())),
            tasks=len(asyncio.all_tasks()),
            open_files=len(list(Path("/proc/self/fd").iterdir())),
            loop_lag=self._lag.percentiles(),
        )
