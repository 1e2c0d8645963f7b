"""The newest frame, handed from a driver to the event loop; older ones are overwritten and counted.

One writer (a grab thread or the loop itself) fills `filling` and delivers it; one reader on the event loop iterates. The image
buffers are allocated once. At any time one is being filled, one waits, and the reader owns the last two it took; the rest is
reserve: a stalled loop or a slow reader costs frames, and never overwrites an image in use.
"""

import asyncio
from collections import deque
from contextlib import suppress
from dataclasses import replace
from threading import Lock, get_ident

import numpy as np

from trackerd.contract.errors import DeviceTimeout, TrackerdError
from trackerd.contract.model import CameraStatistics, Frame, Image

BUFFERS = 6
OWNED_BY_READER = 2  # a frame's image is valid until the frame after the next is taken


class Mailbox:
    """An endless `AsyncIterator[Frame]` that outlives stop and start; it ends when the camera is closed."""

    def __init__(self, device: str, image_px: tuple[int, int], dtype: type[np.uint8 | np.uint16], timeout_s: float) -> None:
        self._device = device
        self._timeout_s = timeout_s
        self._loop = asyncio.get_running_loop()
        self._thread = get_ident()
        self._ready = asyncio.Event()
        self._lock = Lock()  # guards what follows
        self._free = deque(np.zeros((image_px[1], image_px[0]), dtype) for _ in range(BUFFERS))
        self.filling: Image = self._free.popleft()  # the writer's own
        self.trouble = ""  # the writer's last trouble, told when the stream dries up
        self._owned: deque[Image] = deque()
        self._waiting: Frame | None = None
        self._next_id = 0
        self._end: TrackerdError | StopAsyncIteration | None = None
        self._totals = CameraStatistics()

    def restart(self) -> None:
        """A new stream begins with frame id 0; a frame that is left of the last one is skipped."""
        with self._lock:
            if self._waiting is not None:
                self._free.append(self._waiting.image)
                self._waiting = None
                self._totals = replace(self._totals, skipped=self._totals.skipped + 1)
            self._next_id = 0
            self._end = None
            self.trouble = ""
            self._ready.clear()

    def deliver(self, frame: Frame) -> None:
        """From any thread: `frame.image` is `filling`, which is swapped for another buffer. Counts what the ids leave out."""
        with self._lock:
            older, dropped = self._waiting, frame.frame_id - self._next_id
            skipped = 0
            if older is not None:
                self._free.append(older.image)
                skipped = older.skipped + 1
            total = self._totals
            self._totals = CameraStatistics(total.delivered, total.skipped + (older is not None), total.dropped + dropped)
            self._waiting = replace(frame, skipped=skipped, dropped=dropped + (older.dropped if older else 0))
            self._next_id = frame.frame_id + 1
            self.filling = self._free.popleft()
        self._wake()

    def finish(self, end: TrackerdError | StopAsyncIteration) -> None:
        """From any thread: the stream is over. A frame that waits is still handed out."""
        with self._lock:
            self._end = self._end or end
        self._wake()

    def close(self) -> None:
        self.finish(StopAsyncIteration())

    def statistics(self) -> CameraStatistics:
        with self._lock:
            return self._totals

    def __aiter__(self) -> "Mailbox":
        return self

    async def __anext__(self) -> Frame:
        frame = self._take()
        while frame is None:
            await self._wait()
            frame = self._take()
        return frame

    def _take(self) -> Frame | None:
        with self._lock:
            self._ready.clear()
            frame, self._waiting = self._waiting, None
            if frame is None:
                if self._end is not None:
                    raise self._end
                return None
            self._owned.append(frame.image)
            if len(self._owned) > OWNED_BY_READER:
                self._free.append(self._owned.popleft())
            self._totals = replace(self._totals, delivered=self._totals.delivered + 1)
            return frame

    async def _wait(self) -> None:
        try:
            async with asyncio.timeout(self._timeout_s):
                await self._ready.wait()
        except TimeoutError:
            told = f" (last trouble: {self.trouble})" if self.trouble else ""
            raise DeviceTimeout(self._device, "wait for a frame", f"none for {self._timeout_s:g} s{told}") from None

    def _wake(self) -> None:
        if get_ident() == self._thread:
            self._ready.set()
            return
        with suppress(RuntimeError):  # the loop may be closed under a grab thread that was abandoned
            self._loop.call_soon_threadsafe(self._ready.set)
