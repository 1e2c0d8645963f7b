"""The daemon's life, from start to stop. What is heavy is imported while the twin starts and the Zenoh session opens."""

import asyncio
import logging
import signal
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import AsyncExitStack, asynccontextmanager, suppress
from dataclasses import replace
from importlib import import_module
from typing import Any

from trackerd.contract.clock import SystemClock
from trackerd.formats.config import CellConfig
from trackerd.service.notify import Notifier
from trackerd.service.twin_process import announcement, start_twin
from trackerd.service.zenoh_link import open_link
from trackerd.wiring import memory
from trackerd.wiring.cell import source_of

log = logging.getLogger("trackerd")


async def serve(cell: CellConfig, overrides: Sequence[str], duration_s: float | None) -> None:
    """Runs the cell until SIGTERM, SIGINT, the end of a recording, or for `duration_s` after READY."""
    memory.begin()
    stop = _stop_signals()
    told: dict[str, Any] | None = None
    async with AsyncExitStack() as stack:
        twin = None if cell.twin is None else await stack.enter_async_context(start_twin(cell.path, overrides))
        loading = asyncio.ensure_future(asyncio.to_thread(_load))
        source = source_of(cell)
        link = stack.enter_context(open_link(cell.zenoh, source))
        if twin is not None:
            told = await announcement(twin)
            cell = with_twin(cell, told)
        wiring, kernel = await loading
        log.info("vision kernel: %s", kernel)
        wiring.settle_threads()
        await _run(wiring.build(cell, source, link, SystemClock(), told), Notifier.from_environment(), stop, duration_s)


def _load() -> tuple[Any, str]:
    """The wiring, and the vision kernel's name: ready before a device is opened, so that nothing that runs waits for it."""
    return import_module("trackerd.wiring.build"), import_module("trackerd.vision.kernels").warm_up()


def with_twin(cell: CellConfig, told: dict[str, Any]) -> CellConfig:
    """The cell with the addresses that the twin picked."""
    gimbals = {
        name: gimbal.model_copy(update=told["gimbals"][name]) if name in told["gimbals"] else gimbal
        for name, gimbal in cell.gimbals.items()
    }
    cameras = {
        name: camera.model_copy(update=told["cameras"][name]) if name in told["cameras"] else camera
        for name, camera in cell.cameras.items()
    }
    return replace(cell, gimbals=gimbals, cameras=cameras)


def _stop_signals() -> asyncio.Event:
    """Set by SIGTERM and SIGINT; one that comes while the cell is still being opened ends it as soon as it is."""
    stop = asyncio.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        asyncio.get_running_loop().add_signal_handler(number, stop.set)
    return stop


async def _run(service: Any, notifier: Notifier, stop: asyncio.Event, duration_s: float | None) -> None:
    """Until it ends by itself, is told to stop, or its time is over; a stop is no error."""
    loop = asyncio.get_running_loop()

    def ready() -> None:
        memory.settle()
        notifier.ready("measuring")
        log.info("READY")
        if duration_s is not None:
            loop.call_later(duration_s, stop.set)

    async with _finished(service.run(ready)) as (running, stopping):
        await asyncio.wait((running, asyncio.ensure_future(stop.wait())), return_when=asyncio.FIRST_COMPLETED)
        notifier.stopping()
        stopping()
        with suppress(asyncio.CancelledError):
            await running
    memory.release()
    log.info("stopped")


@asynccontextmanager
async def _finished(work: Any) -> AsyncIterator[tuple["asyncio.Task[None]", Callable[[], object]]]:
    task = asyncio.ensure_future(work)
    try:
        yield task, task.cancel
    finally:
        task.cancel()
