"""How a cell begins, how it refuses to, and how it ends: asked to, or killed."""

import signal
import socket
from contextlib import closing
from pathlib import Path

import psutil
from system.cell import (
    DEADLINE_S,
    DEMO,
    LONG_DWELL,
    PATIENT,
    Cell,
    ask_twin,
    children,
    free_port,
    listen,
    running_cell,
    trackerd,
    twin_says,
)

STILL = 'twin.path.kind="still"'
OPERATOR = tuple(f'gimbal.{name}.steering.rearm="operator"' for name in ("left", "right"))


def angles(cell: Cell) -> list[float]:
    gimbals = cell.control(do="status")["gimbals"].values()
    return [gimbal[key] for gimbal in gimbals for key in ("az_rad", "el_rad")]


def shared_memory(processes: list[psutil.Process]) -> set[Path]:
    """Files in /dev/shm that they map."""
    paths = {m.path for process in processes for m in process.memory_maps() if m.path.startswith("/dev/shm/")}
    return {Path(path) for path in paths}


def test_it_tells_systemd_how_it_is_and_leaves_nothing_behind_when_it_is_stopped() -> None:
    with running_cell(STILL) as cell:
        cell.ready()
        cell.wait("notify", lambda m: "WATCHDOG=1" in m["lines"])
        cell.valid_fix()
        family = [psutil.Process(cell.process.pid), *children(cell.process.pid)]
        shared = shared_memory(family)
        assert len(family) > 1
        assert cell.stop() == 0, cell.words()
        assert cell.post.all("notify")[-1]["lines"][0] == "STOPPING=1"
        assert any(line.startswith("STATUS=") for line in cell.ready()["lines"])
        assert not psutil.wait_procs(family, timeout=DEADLINE_S)[1]
        assert list((cell.folder / "tmp").iterdir()) == []
        assert not [path for path in shared if path.exists()]
        assert "Traceback" not in cell.words()


def test_a_stop_while_the_cell_is_still_being_opened_is_a_stop_too() -> None:
    with running_cell(STILL) as cell:  # it listens, and the twin is on its way up
        family = children(cell.process.pid)
        assert cell.stop() == 0, cell.words()
        assert not psutil.wait_procs(family, timeout=DEADLINE_S)[1]
        assert list((cell.folder / "tmp").iterdir()) == []
        assert "Traceback" not in cell.words()


def test_nothing_moves_before_the_operator_arms() -> None:
    with running_cell(STILL, *OPERATOR, *PATIENT) as cell:
        first = cell.wait("status")
        before = angles(cell)
        cell.valid_fix()
        later = first["t_published_unix_ns"] + 2_000_000_000
        held = cell.status(lambda s: s["t_published_unix_ns"] > later)
        for station in held["stations"].values():
            assert (station["axes"]["state"], station["axes"]["reason"]) == ("held", "not armed")
        assert max(abs(a - b) for a, b in zip(angles(cell), before, strict=True)) < 1e-6

        done = cell.trackerd("arm")
        assert (done.returncode, done.stdout) == (0, "left: armed\nright: armed\n"), done.stderr
        cell.axes("following")
        cell.status(lambda s: all(part["axes"]["offset_px"] < 2.0 for part in s["stations"].values()))
        assert max(abs(a - b) for a, b in zip(angles(cell), before, strict=True)) > 1e-4
        cell.nothing_false(0)


def test_a_killed_daemon_leaves_the_axes_held_and_a_twin_that_ends() -> None:
    with running_cell("twin.path.speed_mm_s=100", LONG_DWELL, *PATIENT) as cell:
        cell.axes("following")
        cell.wait("truth", lambda m: max(map(abs, m["velocity_mm_s"])) > 70.0)
        where = cell.twin()
        cell.process.kill()
        assert cell.process.wait(DEADLINE_S) == -signal.SIGKILL
        told = twin_says(where["control"], lambda s: all(g["comm_lost"] for g in s["gimbals"].values()))
        for gimbal in told["gimbals"].values():
            assert gimbal["comm_lost_ns"] - gimbal["last_command_ns"] <= gimbal["watchdog_ns"]
            assert not gimbal["following"]
        rest = twin_says(where["control"], lambda s: all(g["az_rad_s"] == g["el_rad_s"] == 0.0 for g in s["gimbals"].values()))
        later = ask_twin(where["control"], do="status")
        for name, gimbal in later["gimbals"].items():
            assert all(gimbal[key] == rest["gimbals"][name][key] for key in ("az_rad", "el_rad"))
        psutil.Process(where["pid"]).wait(DEADLINE_S)
        assert list((cell.folder / "tmp").iterdir()) == []


def test_a_port_that_is_taken_is_told_in_words() -> None:
    with closing(socket.create_server(("127.0.0.1", 0))) as taken:
        port = taken.getsockname()[1]
        refused = trackerd("--config", str(DEMO), "--set", listen(port))
        assert refused.returncode == 3
        assert f"[zenoh] listen = tcp/127.0.0.1:{port}: the port is taken by another process" in refused.stderr
        assert "Traceback" not in refused.stderr

        found = trackerd("check", "--config", str(DEMO), "--set", listen(port))
        assert found.returncode == 4
        assert f"MEND [zenoh] listen tcp/127.0.0.1:{port}" in found.stdout


def test_check_finds_nothing_to_mend_in_the_demo() -> None:
    sound = trackerd("check", "--config", str(DEMO), "--set", listen(free_port()))
    assert sound.returncode == 0, sound.stdout + sound.stderr
    assert "the configuration is sound" in sound.stdout


def test_a_wrong_configuration_ends_every_command_with_status_2_and_the_rule() -> None:
    for words in (("check",), (), ("watch",), ("arm",)):
        wrong = trackerd(*words, "--config", str(DEMO), "--set", "gimbal.left.steering.gain=1.4")
        assert wrong.returncode == 2
        assert "[gimbal.left.steering] gain = 1.4" in wrong.stderr
        assert "Traceback" not in wrong.stderr


def test_a_command_without_a_daemon_is_told_that_nobody_answers() -> None:
    alone = trackerd("arm", "--config", str(DEMO), "--set", listen(free_port()))
    assert alone.returncode == 3
    assert "Traceback" not in alone.stderr
