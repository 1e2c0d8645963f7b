"""The commands that run something: the service, the check, the twin, a recording."""

import asyncio
import json
from collections.abc import Coroutine, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from trackerd.cli.log import set_up_log
from trackerd.contract.errors import ConfigError
from trackerd.formats.config import CellConfig
from trackerd.wiring.cell import load


def serve(config: Path, overrides: Sequence[str], duration_s: float | None) -> int:
    cell = load(config, overrides)
    set_up_log(cell.service.log_level, cell.service.log_format)

    async def run() -> None:
        from trackerd.wiring.daemon import serve as serve_cell

        await serve_cell(cell, overrides, duration_s)

    _run(run())
    return 0


def check(config: Path, overrides: Sequence[str]) -> bool:
    """True: there is something to mend."""
    from trackerd.wiring.check import examine

    cell = load(config, overrides)
    print(f"{config.name}: the configuration is sound")
    to_mend = False
    for finding in examine(cell):
        to_mend |= not finding.good
        print(f"  {'ok  ' if finding.good else 'MEND'} {finding.what}")
        if not finding.good:
            print(f"       {finding.mend}")
    return to_mend


def twin(config: Path, overrides: Sequence[str], duration_s: float | None, with_parent: bool) -> int:
    from trackerd.twin.server import run_twin

    cell = _with_twin(load(config, overrides))
    set_up_log(cell.service.log_level, cell.service.log_format)

    def announce(told: dict[str, Any]) -> None:
        print(json.dumps(told), flush=True)

    async def run() -> None:
        with suppress(TimeoutError):
            async with asyncio.timeout(duration_s):
                await run_twin(cell, announce, watch_stdin=with_parent)

    _run(run())
    return 0


def record(config: Path, overrides: Sequence[str], folder: Path, duration_s: float | None) -> int:
    from trackerd.wiring.recording import record_cell

    cell = _with_twin(load(config, overrides))
    if duration_s is None:
        raise ConfigError("--record needs --duration S: how long a recording to make")
    record_cell(cell, folder, duration_s)
    return 0


def _with_twin(cell: CellConfig) -> CellConfig:
    if cell.twin is None:
        raise ConfigError(f"{cell.path.name}: there is no [twin] table: nothing to simulate")
    return cell


def _run(work: Coroutine[Any, Any, None]) -> None:
    """On uvloop where it is installed (extra `fast`), else on asyncio's own loop."""
    factory = None
    with suppress(ImportError):
        import uvloop

        factory = uvloop.new_event_loop
    with asyncio.Runner(loop_factory=factory) as runner:
        runner.run(work)
