"""Callbacks at exact instants: a timerfd in the event loop.

The loop's own timers count in whole milliseconds; a frame rung a millisecond late would be charged to the render.
"""

import asyncio
import ctypes
import heapq
import os
import struct
import time
from collections.abc import Callable
from itertools import count

CLOCK_MONOTONIC = 1
TFD_CLOEXEC, TFD_NONBLOCK, TFD_TIMER_ABSTIME = 0o2000000, 0o4000, 1
_ITIMERSPEC = struct.Struct("@qqqq")  # interval s, ns; value s, ns
_libc = ctypes.PyDLL(None, use_errno=True)  # keeps the interpreter lock: both calls take microseconds


class Alarm:
    """One timerfd and a heap of what is due on it; instants are CLOCK_MONOTONIC ns. Works under asyncio and uvloop."""

    def __init__(self) -> None:
        self._due: list[tuple[int, int, Callable[[], None]]] = []
        self._numbers = count()
        self._fd = _libc.timerfd_create(CLOCK_MONOTONIC, TFD_CLOEXEC | TFD_NONBLOCK)
        if self._fd < 0:
            raise OSError(ctypes.get_errno(), "timerfd_create")
        self._loop = asyncio.get_running_loop()
        self._loop.add_reader(self._fd, self._ring)

    def at(self, host_ns: int, call: Callable[[], None]) -> None:
        """An instant that is over is due at once."""
        heapq.heappush(self._due, (host_ns, next(self._numbers), call))
        if self._due[0][0] == host_ns:
            self._set(host_ns)

    def close(self) -> None:
        self._loop.remove_reader(self._fd)
        os.close(self._fd)
        self._due.clear()

    def _ring(self) -> None:
        os.read(self._fd, 8)
        now = time.monotonic_ns()
        try:
            while self._due and self._due[0][0] <= now:
                heapq.heappop(self._due)[2]()
        finally:  # one that fails does not silence the others
            if self._due:
                self._set(self._due[0][0])

    def _set(self, host_ns: int) -> None:
        seconds, ns = divmod(max(1, host_ns), 1_000_000_000)  # 0 would disarm it
        value = _ITIMERSPEC.pack(0, 0, seconds, ns)
        if _libc.timerfd_settime(self._fd, TFD_TIMER_ABSTIME, value, None) < 0:
            raise OSError(ctypes.get_errno(), "timerfd_settime")
