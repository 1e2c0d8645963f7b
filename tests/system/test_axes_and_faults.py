"""The axes over the wire: what an operator commands, and controllers that fail. The probe stands still."""

from signal import SIGCONT, SIGSTOP

from system.cell import Cell, Message, twin_says

AZ_EL = ("az_rad", "el_rad")
MEASURED_RAD = 1e-6


def gimbal(status: Message, name: str = "left") -> Message:
    part: Message = status["stations"][name]
    return part


def angles(cell: Cell, name: str) -> list[float]:
    state = cell.gimbal(name)
    return [state[key] for key in AZ_EL]


def moved_rad(before: list[float], after: list[float]) -> float:
    return max(abs(a - b) for a, b in zip(after, before, strict=True))


def test_a_controller_whose_link_is_cut_is_followed_again_by_itself(following: Cell) -> None:
    cell, since = following, following.mark("position")
    cell.control(do="kill_link", gimbal="left", for_s=1.0)
    lost = cell.status(lambda s: gimbal(s)["gimbal"]["state"] == "lost")
    assert gimbal(lost)["gimbal"]["reason"]
    assert gimbal(lost)["axes"]["state"] == "offline"
    told = cell.wait("position", lambda m: m["state"] == "searching", since)
    assert any(reason.startswith("left: ") or reason == "only one station: right" for reason in told["reasons"])
    back = cell.axes("following")
    assert gimbal(back)["gimbal"]["restarts"] > 0
    assert gimbal(back, "right")["gimbal"]["state"] == "running"
    cell.valid_fix()
    cell.nothing_false(since)


def test_a_controller_that_restarts_is_proved_and_followed_again(following: Cell) -> None:
    cell, since, statuses = following, following.mark("position"), following.mark("status")
    cell.control(do="restart", gimbal="left")
    cell.wait("status", lambda s: gimbal(s)["gimbal"]["state"] == "lost", statuses)
    cell.wait("status", lambda s: gimbal(s)["axes"]["state"] == "testing", statuses)
    cell.axes("following")
    cell.valid_fix()
    cell.nothing_false(since)


def test_a_silent_controller_gives_no_angles_and_no_fix_until_it_speaks_again(following: Cell) -> None:
    cell, since, statuses = following, following.mark("position"), following.mark("status")
    cell.control(do="silence", gimbal="right", for_s=1.5)  # longer than a request waits
    lost = cell.wait("status", lambda s: gimbal(s, "right")["gimbal"]["state"] == "lost", statuses)
    assert "no reply" in gimbal(lost, "right")["gimbal"]["reason"]
    told = cell.wait("position", lambda m: m["state"] == "searching", since)
    assert not told["valid"]
    cell.axes("following")
    cell.valid_fix()
    cell.nothing_false(since)


def test_a_hung_daemon_is_noticed_by_the_watchdog_and_follows_again(following: Cell) -> None:
    cell, since, where = following, following.mark("position"), following.twin()["control"]
    trips = {name: len(gimbal["trips_ns"]) for name, gimbal in cell.control(do="status")["gimbals"].items()}
    cell.process.send_signal(SIGSTOP)  # the connections stay: only the watchdogs can notice
    told = twin_says(where, lambda s: all(len(g["trips_ns"]) > trips[name] for name, g in s["gimbals"].items()))
    cell.process.send_signal(SIGCONT)
    for state in told["gimbals"].values():
        assert state["trips_ns"][-1] - state["last_command_ns"] == state["watchdog_ns"]
        assert state["comm_lost_ns"] == state["trips_ns"][-1]
        assert not state["following"]
    cell.status(lambda s: any(part["axes"]["state"] != "following" for part in s["stations"].values()))
    cell.axes("following")
    cell.valid_fix()
    cell.nothing_false(since)


def test_after_a_safety_fault_only_the_operator_arms(following: Cell) -> None:
    cell, since = following, following.mark("position")
    cell.control(do="safety_fault", gimbal="left")
    held = cell.status(lambda s: gimbal(s)["axes"]["state"] == "held")
    assert gimbal(held)["axes"]["fault"] == 0x0501
    assert not gimbal(held)["axes"]["armed"]
    assert "safety input" in gimbal(held)["axes"]["reason"]
    before = angles(cell, "left")
    later = held["t_published_unix_ns"] + 2_000_000_000
    still = cell.status(lambda s: s["t_published_unix_ns"] > later)
    assert gimbal(still)["axes"]["state"] == "held"
    assert not cell.gimbal("left")["enabled"]
    assert moved_rad(before, angles(cell, "left")) < MEASURED_RAD
    cell.valid_fix()  # measuring goes on

    done = cell.trackerd("arm", "--gimbal", "left")
    assert done.returncode == 0, done.stderr
    cell.axes("following")
    cell.nothing_false(since)


def test_hold_stops_the_axes_and_arm_lets_them_follow_again(following: Cell) -> None:
    cell = following
    done = cell.trackerd("arm", "--hold")
    assert (done.returncode, done.stdout) == (0, "left: held\nright: held\n"), done.stderr
    held = cell.axes("held")
    assert gimbal(held)["axes"]["reason"] == "held by the operator"
    assert not cell.gimbal("left")["following"]
    cell.valid_fix()
    done = cell.trackerd("arm")
    assert done.returncode == 0, done.stderr
    cell.axes("following")


def test_select_chooses_the_target_by_pixel_and_by_itself(following: Cell) -> None:
    cell = following
    done = cell.trackerd("select", "--gimbal", "left", "--pixel", "1024,768")
    assert (done.returncode, done.stdout) == (0, "left: selected\n"), done.stderr
    cell.valid_fix()
    done = cell.trackerd("select", "--gimbal", "left", "--pixel", "auto")
    assert (done.returncode, done.stdout) == (0, "left: finds its target by itself\n"), done.stderr
    cell.valid_fix()


def test_a_command_for_a_gimbal_that_is_not_there_is_refused_in_words(following: Cell) -> None:
    done = following.trackerd("arm", "--gimbal", "middle")
    assert done.returncode == 3
    assert "no gimbal 'middle' (there are: left, right)" in done.stderr


def test_a_subscriber_can_watch(following: Cell) -> None:
    done = following.trackerd("watch", "--plain", "--duration", "3")
    assert done.returncode == 0, done.stderr
    last = done.stdout.splitlines()[-1]
    assert "state: tracking" in last
    assert "against the twin" in last


def test_the_daemon_was_never_restarted(following: Cell) -> None:
    assert following.process.poll() is None
    assert sum("READY=1" in m["lines"] for m in following.post.all("notify")) == 1
