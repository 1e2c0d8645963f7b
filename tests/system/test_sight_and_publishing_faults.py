"""What the cameras see fails, and who listens fails. The probe moves slowly: whatever stands still is wrong soon."""

import sys
from pathlib import Path
from signal import SIGCONT, SIGSTOP
from subprocess import PIPE, Popen

from system.cell import DEADLINE_S, DEMO, Cell, Message, free_port, listen, trackerd

from trackerd.formats.wire import token_key

POSITION = "twin/probe/position"
SUBSCRIBER = """
import sys, time
sys.path.insert(0, sys.argv[2])
from system.cell import zenoh_client
with zenoh_client(int(sys.argv[1])) as session:
    held = session.declare_subscriber("twin/**", lambda sample: print(sample.key_expr, flush=True))
    sys.stdin.read()
"""


def camera(status: Message, name: str = "left") -> Message:
    part: Message = status["stations"][name]["camera"]
    return part


def accounted(status: Message, name: str) -> int:
    frames = status["stations"][name]["frames"]
    return int(frames["processed"] + frames["skipped"] + frames["dropped"])


def hold_up(cell: Cell, name: str) -> tuple[int, int]:
    """Stops a stream, and waits until that is noticed: exposures there were, frames that the daemon accounts for."""
    since = cell.mark("status")
    cell.control(do="stop_stream", camera=name)
    lost = cell.wait("status", lambda s: camera(s, name)["state"] == "lost", since)
    return cell.control(do="statistics")[name]["exposed"], accounted(lost, name)


def test_a_stream_that_stops_and_returns_is_told_and_every_frame_is_accounted_for(moving: Cell) -> None:
    cell, since = moving, moving.mark("position")
    exposed, known = hold_up(cell, "left")
    told = cell.wait("position", lambda m: m["state"] == "searching", since)
    assert "only one station: right" in told["reasons"]
    cell.control(do="start_stream", camera="left")
    back = cell.status(lambda s: camera(s)["state"] == "running")
    assert camera(back)["restarts"] > 0
    cell.valid_fix()
    later = cell.mark("position") + 100
    cell.wait("position", lambda m: cell.mark("position") > later)

    exposed_then, known_then = hold_up(cell, "left")
    assert known_then - known == exposed_then - exposed
    cell.control(do="start_stream", camera="left")
    cell.valid_fix()
    cell.axes("following")
    cell.nothing_false(since)


def test_frames_that_are_lost_on_their_way_are_counted_and_nothing_is_mispaired(moving: Cell) -> None:
    cell, since = moving, moving.mark("position")
    before = cell.status()["stations"]["right"]["frames"]["dropped"]
    cell.control(do="drop_frames", camera="right", frames=3)
    cell.status(lambda s: s["stations"]["right"]["frames"]["dropped"] >= before + 3)
    cell.valid_fix()
    cell.nothing_false(since)


def test_a_probe_that_is_hidden_is_said_to_be_lost_and_found_again(moving: Cell) -> None:
    cell, since, statuses = moving, moving.mark("position"), moving.mark("status")
    cell.control(do="hide_probe", for_s=0.5)
    cell.wait("position", lambda m: m["state"] == "coasting" and not m["valid"], since)
    lost = cell.wait("position", lambda m: m["state"] == "searching", since)
    assert lost["position_mm"] is None
    assert any(reason.startswith("lost: no agreeing pair") for reason in lost["reasons"])
    assert any(reason.startswith(("left: ", "right: ")) for reason in lost["reasons"])
    cell.wait("status", lambda s: s["stations"]["left"]["track"]["state"] != "locked", statuses)
    found = cell.mark("position")
    cell.wait("position", lambda m: m["state"] == "unconfirmed" and not m["valid"], found)
    cell.valid_fix()
    cell.axes("following")
    cell.nothing_false(since)


def test_latches_that_jump_are_noticed_and_found_again_by_time(moving: Cell) -> None:
    cell, since = moving, moving.mark("position")
    before = cell.status()["stations"]["left"]["frames"]
    cell.control(do="latch_jump", gimbal="left", exposures=7)
    told = cell.status(lambda s: s["stations"]["left"]["frames"]["no_angle"] > before["no_angle"])
    assert "fits by time" in told["stations"]["left"]["frames"]["last_no_angle"]
    cell.valid_fix()
    assert cell.status()["stations"]["left"]["camera"]["state"] == "running"
    cell.nothing_false(since)


def test_a_frozen_subscriber_delays_nobody(moving: Cell) -> None:
    cell = moving
    command = [sys.executable, "-c", SUBSCRIBER, str(cell.port), str(Path(__file__).parents[1])]
    with Popen(command, stdin=PIPE, stdout=PIPE) as frozen:
        assert frozen.stdout is not None
        assert frozen.stdin is not None
        assert frozen.stdout.readline()
        frozen.send_signal(SIGSTOP)
        since, statuses = cell.mark("position"), cell.mark("status")
        first = cell.valid_fix()
        last = cell.wait("position", lambda m: m["valid"] and m["t_unix_ns"] > first["t_unix_ns"] + 5_000_000_000, since)
        frozen.send_signal(SIGCONT)
        frozen.stdin.close()
        frozen.stdout.read()
        assert frozen.wait(DEADLINE_S) == 0
    valid = [m for m in cell.post.all("position", since) if m["valid"] and m["t_unix_ns"] <= last["t_unix_ns"]]
    assert len(valid) > 0.8 * 5 * 55
    assert len(cell.post.all("status", statuses)) > 0.8 * 5 * 10
    cell.nothing_false(since)


def test_no_fix_is_valid_while_a_foreign_publisher_is_alive_on_the_key(moving: Cell) -> None:
    cell, since = moving, moving.mark("position")
    token = cell.session.liveliness().declare_token(token_key(POSITION, "foreign"))
    told = cell.status(lambda s: s["other_publishers"])
    assert told["other_publishers"] == [token_key(POSITION, "foreign")]
    during = cell.mark("position")
    refused = cell.wait("position", lambda m: m["state"] == "tracking", during)
    assert refused["reasons"] == [f"another publisher is alive on {POSITION}"]
    assert not any(m["valid"] for m in cell.post.all("position", during))
    token.undeclare()
    cell.status(lambda s: not s["other_publishers"])
    cell.valid_fix()
    cell.nothing_false(since)


def test_a_second_daemon_on_the_key_refuses_to_start(moving: Cell) -> None:
    connect = f'zenoh.connect=["tcp/127.0.0.1:{moving.port}"]'
    second = trackerd("--config", str(DEMO), "--set", listen(free_port()), "--set", connect)
    assert second.returncode == 3
    assert f"[zenoh] key = {POSITION}: another publisher is alive on it" in second.stderr
    moving.valid_fix()


def test_the_daemon_was_never_restarted(moving: Cell) -> None:
    assert moving.process.poll() is None
    assert sum("READY=1" in m["lines"] for m in moving.post.all("notify")) == 1
