"""Every file of config/ runs: what is hardware's is overridden to pylon's emulated cameras and the twin's controllers."""

import json
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from system.cell import DEADLINE_S, DEMO, Cell, Message, ask_twin, free_port, listen, running_cell

CONFIG = DEMO.parent
RUN_ELSEWHERE = {"emulated.toml": "test_emulated.py"}
RUN_AS_UNITS = {"budget.toml": "../unit/test_budget_command.py"}
GIMBALS = ("left", "right")
SERIALS = ("0815-0002", "0815-0003")


@contextmanager
def controllers() -> Iterator[Message]:
    """The twin alone, as a controller on the network: where its devices are."""
    command = [sys.executable, "-m", "trackerd", "twin", "--config", str(DEMO), "--set", listen(free_port()), "--with-parent"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as twin:
        try:
            assert twin.stdout is not None
            told: Message = json.loads(twin.stdout.readline())
            yield told
        finally:
            twin.terminate()
            assert twin.wait(DEADLINE_S) == 0


def emulated_hardware(told: Message) -> Iterator[str]:
    """For config/cell.toml: serials and addresses. Cameras show pylon's test pattern, in which there is no probe."""
    for gimbal, serial in zip(GIMBALS, SERIALS, strict=True):
        yield f"camera.{gimbal}.serial={serial}"
        yield f"gimbal.{gimbal}.host={told['gimbals'][gimbal]['host']}"
        yield f"gimbal.{gimbal}.port={told['gimbals'][gimbal]['port']}"
    yield "zenoh.key=cell/probe/position"


def ends_cleanly(cell: Cell) -> None:
    assert cell.stop() == 0, cell.words()
    assert "Traceback" not in cell.words()


def test_every_file_is_run_by_a_test_or_is_a_part_of_one_that_is() -> None:
    cells = {"cell.toml", "demo.toml", *RUN_ELSEWHERE}
    parts = {tomllib.loads((CONFIG / name).read_text())["calibration"] for name in cells}
    assert {file.name for file in CONFIG.iterdir()} == cells | parts | {*RUN_AS_UNITS}
    for name, test in (RUN_ELSEWHERE | RUN_AS_UNITS).items():
        assert name in (Path(__file__).parent / test).read_text()


def test_the_demo_runs_until_it_is_stopped() -> None:
    with running_cell() as cell:
        cell.ready()
        assert cell.status()["cell"] == "demo"
        ends_cleanly(cell)


def test_the_file_of_a_real_cell_runs_on_real_drivers_and_moves_nothing() -> None:
    pytest.importorskip("pypylon", reason="needs trackerd[basler]")
    with controllers() as told:
        at_rest = ask_twin(told["control"], do="status")["gimbals"]
        with running_cell(*emulated_hardware(told), prefix="cell", config=CONFIG / "cell.toml") as cell:
            cell.ready()
            status = cell.status(lambda s: all(s["stations"][name]["frames"]["processed"] > 5 for name in GIMBALS))
            assert (status["source"], status["cell"]) == ("live", "cell")
            for station in status["stations"].values():
                assert station["camera"]["state"] == station["gimbal"]["state"] == "running"
                assert (station["axes"]["state"], station["axes"]["armed"]) == ("held", False)
                assert station["track"]["state"] == "searching"
            assert not any(m["valid"] for m in cell.post.all("position"))
            ends_cleanly(cell)
        after = ask_twin(told["control"], do="status")["gimbals"]
        for name in GIMBALS:
            assert all(after[name][axis] == at_rest[name][axis] for axis in ("az_rad", "el_rad"))
