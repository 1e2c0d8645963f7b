"""One suite, every gimbal driver, both event loops."""

import asyncio
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest
import uvloop
from emulators.controllers import BENCHES

from trackerd.testing.gimbal import GIMBAL_CHECKS, GimbalMaker


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One for all, so that the C helper is compiled once."""
    return tmp_path_factory.mktemp("gimbals")


@pytest.mark.parametrize("run", [asyncio.run, uvloop.run], ids=["asyncio", "uvloop"])
@pytest.mark.parametrize("driver", BENCHES)
@pytest.mark.parametrize("check", GIMBAL_CHECKS, ids=lambda check: check.__name__.removeprefix("check_"))
def test_gimbal(check: Callable[[GimbalMaker], Awaitable[None]], driver: str, run: Callable[[Any], None], folder: Path) -> None:
    run(check(lambda: BENCHES[driver](folder)))
