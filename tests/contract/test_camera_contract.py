"""One suite, every camera driver, both event loops."""

import asyncio
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest
import uvloop
from emulators.cameras import BENCHES

from trackerd.testing.camera import CAMERA_CHECKS, CameraMaker


@pytest.mark.parametrize("run", [asyncio.run, uvloop.run], ids=["asyncio", "uvloop"])
@pytest.mark.parametrize("driver", BENCHES)
@pytest.mark.parametrize("check", CAMERA_CHECKS, ids=lambda check: check.__name__.removeprefix("check_"))
def test_camera(
    check: Callable[[CameraMaker], Awaitable[None]], driver: str, run: Callable[[Any], None], tmp_path: Path
) -> None:
    run(check(lambda: BENCHES[driver](tmp_path)))
