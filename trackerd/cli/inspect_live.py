"""`trackerd inspect --live`: focus, exposure and light at a running camera, for the hand at the lens's ring."""

import asyncio
import time
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from math import inf
from pathlib import Path

from rich.console import Console
from rich.live import Live
from rich.table import Table

from trackerd.contract.model import Frame
from trackerd.formats.config import CellConfig
from trackerd.inspection.camera import Camera, camera_of
from trackerd.inspection.detector import detector_for
from trackerd.inspection.live import Glance, LiveView
from trackerd.inspection.series import Locator
from trackerd.vision.kernels import warm_up
from trackerd.vision.rays import Circle
from trackerd.wiring.cell import load
from trackerd.wiring.grab import grabbing

PLAIN_S, TABLE_S = 1.0, 0.1  # between two lines, between two pictures of the table

Show = Callable[[LiveView], None]


@dataclass(frozen=True, slots=True)
class LiveRequest:
    """What is asked for."""

    config: Path
    camera: str | None = None
    overrides: Sequence[str] = ()
    guess: Circle | None = None
    frames: int | None = None
    duration_s: float | None = None
    plain: bool = False


def live(request: LiveRequest) -> bool:
    """Until so many frames or seconds, the end of a recording, or Ctrl-C; False: no frame had a ball.

    Raises ConfigError and DeviceError.
    """
    cell = load(request.config, request.overrides)
    camera = camera_of(cell, request.camera)
    warm_up()
    view = LiveView()
    console = Console()
    if request.plain or not console.is_terminal:
        asyncio.run(_look(cell, camera, request, view, PLAIN_S, _print))
        _print(view)
    else:
        with Live(console=console, auto_refresh=False) as table:
            asyncio.run(
                _look(cell, camera, request, view, TABLE_S, lambda view: table.update(_table(camera.name, view), refresh=True))
            )
    return view.seen > 0


async def _look(cell: CellConfig, camera: Camera, request: LiveRequest, view: LiveView, every_s: float, show: Show) -> None:
    """Each frame is looked at where it arrives: nothing else waits for this loop."""
    with suppress(TimeoutError):
        async with grabbing(cell, camera.name, request.overrides) as frames, asyncio.timeout(request.duration_s):
            await _follow(frames, camera, request, view, every_s, show)


async def _follow(
    frames: AsyncIterator[Frame], camera: Camera, request: LiveRequest, view: LiveView, every_s: float, show: Show
) -> None:
    locator: Locator | None = None
    due_s = time.monotonic() + every_s
    async for frame in frames:
        if locator is None:
            detector = detector_for(frame.image, camera)
            locator = Locator(detector, request.guess)
        outline = locator.locate(frame.image)
        view.add(Glance(frame.arrived * 1e-9, frame.exposure_ns * 1e-9, outline), frame.image, detector.noise)
        if time.monotonic() >= due_s:
            due_s = time.monotonic() + every_s
            show(view)
        if view.frames >= (request.frames or inf):
            break


def _print(view: LiveView) -> None:
    print("  ".join(f"{name}: {words}" for name, words in view.rows()), flush=True)


def _table(name: str, view: LiveView) -> Table:
    table = Table(title=f"camera {name}", show_header=False, title_justify="left", min_width=78)
    table.add_column(style="dim", width=12)
    table.add_column()
    for title, words in view.rows():
        style = ("green" if words == "seen" else "red") if title == "ball" else ""
        table.add_row(title, words, style=style)
    return table
