"""The twin's process: opens the simulated cell on the wire, says where it is, and leaves nothing behind."""

import asyncio
import gc
import os
import signal
import sys
import tempfile
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress
from ipaddress import ip_address
from pathlib import Path
from typing import Any

import cv2

from trackerd.contract.clock import Clock, SystemClock
from trackerd.formats.calibration import load_calibration
from trackerd.formats.cell import CellConfig
from trackerd.formats.settings import GimbalSettings
from trackerd.sim.scene import Scene
from trackerd.twin.cell import TwinCell, scene_of
from trackerd.twin.control import ControlSocket
from trackerd.twin.requests import ControlDesk
from trackerd.twin.truth import PERIOD_NS, TruthPublisher, truth_message

LOOPBACK = "127.0.0.1"
SWITCH_S = 2e-4  # a renderer keeps the interpreter no longer than this from a request that waits for its answer


async def run_twin(
    cell: CellConfig,
    announce: Callable[[dict[str, Any]], None],
    *,
    parent_gone: asyncio.Event | None = None,
    watch_stdin: bool = False,
    linger_s: float = 5.0,
) -> None:
    """Run until cancelled, until SIGTERM or SIGINT, or until `linger_s` after the parent is gone.

    `announce` is given {"gimbals": {name: {"host", "port"}}, "cameras": {name: {"socket"}}, "control": path, "truth_key": key,
    "pid": pid} once everything listens. The parent is gone when it sets `parent_gone` or, with `watch_stdin`, when standard
    input ends. Raises ConfigError for a calibration that cannot be read, OSError where a port is taken.
    """
    gone = parent_gone or asyncio.Event()
    async with _failures() as failed, _stop_signals() as stopped, _stdin_watched(watch_stdin, gone), _opened(cell) as where:
        announce(where)
        tasks: list[asyncio.Future[Any]] = [asyncio.create_task(stopped.wait()), asyncio.create_task(_lingered(gone, linger_s))]
        try:
            await asyncio.wait([*tasks, failed], return_when=asyncio.FIRST_COMPLETED)
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
    if not failed.cancelled():
        failed.result()


@asynccontextmanager
async def _opened(cell: CellConfig) -> AsyncIterator[dict[str, Any]]:
    """Everything on the wire; yields what is announced."""
    scene = scene_of(cell, load_calibration(cell.calibration).stations)
    with tempfile.TemporaryDirectory(prefix="twin-") as name:  # mode 0700, and short enough for a socket's path
        folder = Path(name)
        clock = SystemClock()
        async with _twin_cell(cell, scene, folder) as twin, _truth(cell, twin, clock) as key:
            control = ControlSocket(folder / "control", ControlDesk(twin, clock))
            undo = _tune()
            try:
                yield {
                    "gimbals": {n: {"host": g.server.host, "port": g.server.port} for n, g in twin.gimbals.items()},
                    "cameras": {n: {"socket": str(camera.socket)} for n, camera in twin.cameras.items()},
                    "control": str(folder / "control"),
                    "truth_key": key,
                    "pid": os.getpid(),
                }
            finally:
                undo()
                control.close()


def _tune() -> Callable[[], None]:
    """Fit the process to its work; returns how to undo it."""
    threads, switch_s = cv2.getNumThreads(), sys.getswitchinterval()
    cv2.setNumThreads(1)  # each camera has a worker of its own
    sys.setswitchinterval(SWITCH_S)
    gc.freeze()  # what is there now stays: a full collection would hold a frame up for 20 ms

    def undo() -> None:
        cv2.setNumThreads(threads)
        sys.setswitchinterval(switch_s)
        gc.unfreeze()

    return undo


@asynccontextmanager
async def _twin_cell(cell: CellConfig, scene: Scene, folder: Path) -> AsyncIterator[TwinCell]:
    twin = TwinCell(scene, folder)
    try:
        for name, gimbal in twin.gimbals.items():
            await gimbal.server.open(LOOPBACK, _port(cell.gimbals[name]))
        yield twin
    finally:
        await twin.close()


@asynccontextmanager
async def _truth(cell: CellConfig, twin: TwinCell, clock: Clock) -> AsyncIterator[str]:
    """Publish the truth; the same beat works off what is due in controllers that nobody asks. Yields the key."""
    publisher, ticking = TruthPublisher(cell.zenoh), True

    def tick(t_ns: int) -> None:
        if not ticking:
            return
        twin.advance()
        publisher.publish(truth_message(twin.scene, twin.times, clock, t_ns))
        following = max(t_ns + PERIOD_NS, twin.times.now() // PERIOD_NS * PERIOD_NS)  # after a stall: no burst
        twin.alarm.at(twin.times.host(following), lambda: tick(following))

    tick(twin.times.now() // PERIOD_NS * PERIOD_NS)
    try:
        yield publisher.key
    finally:
        ticking = False
        await publisher.close()


@asynccontextmanager
async def _failures() -> AsyncIterator["asyncio.Future[None]"]:
    """Ends with the first exception of a callback: nothing in the twin is expected to fail, so it fails as a whole."""
    loop = asyncio.get_running_loop()
    failed: asyncio.Future[None] = loop.create_future()
    before = loop.get_exception_handler()

    def fail(_: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        if not failed.done():
            failed.set_exception(context.get("exception") or RuntimeError(context["message"]))

    loop.set_exception_handler(fail)
    try:
        yield failed
    finally:
        loop.set_exception_handler(before)
        if not failed.cancel():
            failed.exception()  # taken notice of, also where another error is on its way out


@asynccontextmanager
async def _stop_signals() -> AsyncIterator[asyncio.Event]:
    """Set by SIGTERM and SIGINT."""
    loop, stopped = asyncio.get_running_loop(), asyncio.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, stopped.set)
    try:
        yield stopped
    finally:
        for number in (signal.SIGTERM, signal.SIGINT):
            loop.remove_signal_handler(number)


@asynccontextmanager
async def _stdin_watched(watched: bool, gone: asyncio.Event) -> AsyncIterator[None]:
    """The end of standard input: whoever held its other end is gone."""
    if not watched:
        yield
        return
    loop, fd = asyncio.get_running_loop(), sys.stdin.fileno()

    def readable() -> None:
        if not os.read(fd, 4096):
            loop.remove_reader(fd)
            gone.set()

    loop.add_reader(fd, readable)
    try:
        yield
    finally:
        loop.remove_reader(fd)


async def _lingered(gone: asyncio.Event, linger_s: float) -> None:
    await gone.wait()
    await asyncio.sleep(linger_s)


def _port(gimbal: GimbalSettings) -> int:
    """The configured port where the configuration means this machine; a real controller's address is not ours to take."""
    with suppress(ValueError):
        if ip_address(getattr(gimbal, "host", "")).is_loopback:
            return int(getattr(gimbal, "port", 0))
    return 0
