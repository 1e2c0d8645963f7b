"""The twin as a process of its own: it holds our end of a pipe, and ends by itself soon after we are gone, however we went."""

import asyncio
import json
import logging
import sys
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

from trackerd.contract.errors import DeviceMissing

log = logging.getLogger("trackerd.twin")
START_S = 15.0
STOP_S = 3.0


@asynccontextmanager
async def start_twin(config: Path, overrides: Sequence[str]) -> AsyncIterator[asyncio.subprocess.Process]:
    """Starts it at once; `announcement` waits until it is up. -P: never the code of whatever folder we were started in."""
    options = [word for override in overrides for word in ("--set", override)]
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-P", "-m", "trackerd", "twin", "--config", str(config), "--with-parent", *options,
        stdin=asyncio.subprocess.PIPE, stdout=asyncio.subprocess.PIPE,
    )  # fmt: skip
    try:
        yield process
    finally:
        if process.returncode is None:
            process.terminate()
            try:
                await asyncio.wait_for(process.wait(), STOP_S)
            except TimeoutError:
                log.warning("the twin did not end within %g s: killed", STOP_S)
                process.kill()
                await process.wait()


async def announcement(process: asyncio.subprocess.Process) -> dict[str, Any]:
    """Where the twin's devices are. Raises DeviceMissing where it did not come up (its own words are on stderr)."""
    assert process.stdout is not None
    try:
        line = await asyncio.wait_for(process.stdout.readline(), START_S)
        told: dict[str, Any] = json.loads(line)
    except (TimeoutError, ValueError) as error:
        raise DeviceMissing("the twin", "start", "it did not say where its devices are") from error
    return told
