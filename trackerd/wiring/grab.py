"""Frames of one camera of a cell, without its gimbal: nothing is armed and nothing moves."""

from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import AsyncExitStack, asynccontextmanager

from trackerd.contract.clock import SystemClock
from trackerd.contract.errors import ConfigError, RecordingEnded
from trackerd.contract.model import Frame, Image
from trackerd.contract.ports import Camera
from trackerd.formats.config import CellConfig
from trackerd.formats.settings import CameraSettings
from trackerd.service.twin_process import announcement, start_twin
from trackerd.wiring.cell import driver
from trackerd.wiring.daemon import with_twin

TWINS_OWN = "synthetic"  # the driver whose frames come from the twin


def camera_of(cell: CellConfig, name: str) -> CameraSettings:
    """Raises ConfigError for a name that the cell does not have."""
    if name not in cell.cameras:
        raise ConfigError(f"{cell.path.name}: --camera {name}: no such camera (there are: {', '.join(cell.cameras)})")
    return cell.cameras[name]


@asynccontextmanager
async def grabbing(cell: CellConfig, name: str, overrides: Sequence[str] = ()) -> AsyncIterator[AsyncIterator[Frame]]:
    """The running camera's newest frames, until a recording ends or the context is left; a twin is started where it needs one.

    An image is valid until the frame after the next is taken. Raises ConfigError and DeviceError.
    """
    camera_of(cell, name)
    async with AsyncExitStack() as stack:
        if cell.twin is not None and cell.cameras[name].driver == TWINS_OWN:
            cell = with_twin(cell, await announcement(await stack.enter_async_context(start_twin(cell.path, overrides))))
        settings = cell.cameras[name]
        opened = driver("camera", settings.driver).open_camera(name, settings, SystemClock())
        camera: Camera = await stack.enter_async_context(opened)
        await camera.start()
        stack.push_async_callback(camera.stop)
        yield _until_the_end(camera)


async def grab(
    cell: CellConfig, name: str, count: int, overrides: Sequence[str] = (), progress: Callable[[int], None] | None = None
) -> list[Image]:
    """Copies of `count` frames, of fewer where a recording ends; `progress` is told how many there are."""
    images: list[Image] = []
    async with grabbing(cell, name, overrides) as frames:
        async for frame in frames:
            images.append(frame.image.copy())
            if progress is not None:
                progress(len(images))
            if len(images) == count:
                break
    return images


async def _until_the_end(camera: Camera) -> AsyncIterator[Frame]:
    try:
        async for frame in camera.frames():
            yield frame
    except RecordingEnded:
        return
