"""The small parts of the service: the timer's ticks, systemd's datagrams, workers, stages, health."""

import asyncio
import os
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import aclosing, suppress
from pathlib import Path

import pytest

from trackerd.service import vital_signs
from trackerd.service.cancellation import end_if_cancelled, is_cancelled
from trackerd.service.notify import Notifier, watchdog_period_s
from trackerd.service.pacer import ticks
from trackerd.service.stages import KEPT, Stage, Stages
from trackerd.service.vital_signs import VitalSigns
from trackerd.service.worker import Worker

PERIOD_S = 0.001


# ---- the pacer -------------------------------------------------------------------------------------------------------


async def test_ticks_come_no_faster_than_their_period() -> None:
    loop = asyncio.get_running_loop()
    began, periods = loop.time(), 0
    async with aclosing(ticks(PERIOD_S)) as due:
        async for passed in due:
            periods += passed
            if periods >= 10:
                break
    assert loop.time() - began >= 10 * PERIOD_S


async def test_a_late_loop_is_told_how_many_periods_have_passed() -> None:
    loop = asyncio.get_running_loop()
    async with aclosing(ticks(PERIOD_S)) as due:
        await anext(due)
        until = loop.time() + 5 * PERIOD_S
        while loop.time() < until:  # the loop is held up
            pass
        assert await anext(due) >= 4


def open_files() -> set[Path]:
    return set(Path("/proc/self/fd").iterdir())


async def test_a_closed_timer_leaves_no_file_behind() -> None:
    before = open_files()
    async with aclosing(ticks(PERIOD_S)) as due:
        await anext(due)
        assert len(open_files() - before) == 1
    assert open_files() <= before


# ---- systemd ---------------------------------------------------------------------------------------------------------


@pytest.fixture(params=["path", "abstract"])
def systemd(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[], str]]:
    """A real socket as systemd has one; reads the next datagram."""
    address = f"{tmp_path}/notify" if request.param == "path" else f"@trackerd-test-{os.getpid()}"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as ear:
        ear.bind(address.replace("@", "\0", 1))
        ear.setblocking(False)
        monkeypatch.setenv("NOTIFY_SOCKET", address)
        yield lambda: ear.recv(1000).decode()


def test_systemd_hears_that_we_are_ready_alive_and_stopping(systemd: Callable[[], str]) -> None:
    notifier = Notifier.from_environment()
    notifier.ready("measuring")
    notifier.watchdog()
    notifier.stopping()
    assert systemd() == "READY=1\nSTATUS=measuring"
    assert systemd() == "WATCHDOG=1"
    assert systemd() == "STOPPING=1\nSTATUS=holding the axes, closing"


def test_without_systemd_nothing_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NOTIFY_SOCKET", "")
    assert Notifier.from_environment() == Notifier(None)
    Notifier(None).ready("measuring")


def test_a_service_manager_that_is_gone_stops_nothing(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    Notifier(f"{tmp_path}/nobody").ready("measuring")
    assert "No such file or directory" in caplog.text


def test_a_service_manager_that_does_not_read_never_blocks_us(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as deaf:
        deaf.bind(f"{tmp_path}/notify")
        while not caplog.records:
            Notifier(f"{tmp_path}/notify").watchdog()
    assert "temporarily unavailable" in caplog.text


@pytest.mark.parametrize(
    ("usec", "pid", "period_s"),
    [("5000000", None, 5.0), ("5000000", str(os.getpid()), 5.0), ("5000000", "1", None), (None, None, None)],
    ids=["any process", "this process", "another process", "no watchdog"],
)
def test_the_watchdog_is_ours_only_where_systemd_says_so(
    monkeypatch: pytest.MonkeyPatch, usec: str | None, pid: str | None, period_s: float | None
) -> None:
    for name, value in (("WATCHDOG_USEC", usec), ("WATCHDOG_PID", pid)):
        if value is None:
            monkeypatch.delenv(name, raising=False)
        else:
            monkeypatch.setenv(name, value)
    assert watchdog_period_s() == period_s


# ---- health ----------------------------------------------------------------------------------------------------------


class Fed:
    """Takes the place of systemd's socket: which beats of the health task fed the watchdog?"""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, alive: Callable[[int], int], beats: int) -> None:
        self.ticks, self.lag_s, self.fed = 0, 0.0, [0] * (beats + 1)
        self.vitals = VitalSigns(Notifier(None), lambda: alive(self.ticks))
        self._beats, self._time = beats, 0.0
        monkeypatch.setenv("WATCHDOG_USEC", "400000")
        monkeypatch.delenv("WATCHDOG_PID", raising=False)
        monkeypatch.setattr(Notifier, "watchdog", lambda _: self._count())
        monkeypatch.setattr(vital_signs.asyncio, "get_running_loop", lambda: self)
        monkeypatch.setattr(vital_signs.asyncio, "sleep", self._sleep)

    def _count(self) -> None:
        self.fed[self.ticks] += 1

    def time(self) -> float:
        return self._time

    async def _sleep(self, duration_s: float) -> None:
        if self.ticks == self._beats:
            raise asyncio.CancelledError
        self.ticks += 1
        self._time += duration_s + self.lag_s + 0.001

    def run(self) -> list[int]:
        with suppress(asyncio.CancelledError):
            self.vitals.run().send(None)
        return self.fed[1:]


def test_the_watchdog_is_fed_while_the_fusion_counts_up(monkeypatch: pytest.MonkeyPatch) -> None:
    assert Fed(monkeypatch, lambda n: n, 4).run() == [1, 1, 1, 1]


def test_a_fusion_that_stands_still_starves_the_watchdog(monkeypatch: pytest.MonkeyPatch) -> None:
    assert Fed(monkeypatch, lambda n: min(n, 2), 5).run() == [1, 1, 0, 0, 0]


def test_a_loop_that_is_late_starves_the_watchdog(monkeypatch: pytest.MonkeyPatch) -> None:
    fed = Fed(monkeypatch, lambda n: n, 3)
    fed.lag_s = 0.6
    assert fed.run() == [0, 0, 0]
    assert fed.vitals._lag.percentiles().max_ms > 600.0


async def test_health_is_what_the_kernel_says_of_this_process() -> None:
    vitals = VitalSigns(Notifier(None), lambda: 0)
    assert vitals.look().cpu_share == 0.0
    found = vitals.look()
    assert found.resident_mb > 10.0
    assert found.threads >= threading.active_count()
    assert found.tasks == len(asyncio.all_tasks())
    assert found.open_files > 0
    assert found.loop_lag is None
    assert found.uptime_s >= 0.0


# ---- workers, stages, cancellation -----------------------------------------------------------------------------------


async def test_a_worker_keeps_the_order_of_asking_and_stays_off_the_loops_thread() -> None:
    done: list[tuple[int, int]] = []

    def work(number: int) -> int:
        done.append((number, threading.get_ident()))
        return 2 * number

    with Worker("track-left") as worker:
        answers = await asyncio.gather(*(worker.run(work, number) for number in range(20)))
    assert answers == [2 * n for n in range(20)]
    assert [number for number, _ in done] == list(range(20))
    assert len({thread for _, thread in done} - {threading.get_ident()}) == 1


async def test_a_worker_hands_over_the_error_and_goes_on() -> None:
    with Worker("track-left") as worker:
        with pytest.raises(ZeroDivisionError):
            await worker.run(divmod, 1, 0)
        assert await worker.run(divmod, 7, 2) == (3, 1)


async def test_a_closed_worker_leaves_no_thread() -> None:
    with Worker("track-left") as worker:
        await worker.run(int)
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("track-left")]


def test_a_stage_tells_percentiles_of_what_it_kept() -> None:
    stage = Stage()
    assert stage.percentiles() is None
    for ms in range(1, 101):
        stage.add(ms * 1_000_000)
    found = stage.percentiles()
    assert found is not None
    assert (found.n, found.p50_ms, found.max_ms) == (100, 50.5, 100.0)
    assert found.p99_ms == pytest.approx(99.01)


def test_a_stage_forgets_what_is_older_than_its_ring() -> None:
    stage = Stage()
    stage.add(10**12)
    for _ in range(KEPT):
        stage.add(1_000_000)
    found = stage.percentiles()
    assert found is not None
    assert (found.n, found.max_ms) == (KEPT + 1, 1.0)


def test_stages_are_told_by_their_names() -> None:
    stages = Stages()
    stages.work.add(2_000_000)
    found = stages.percentiles()
    assert list(found) == ["angles", "work", "tracked"]
    assert found["angles"] is None
    assert found["work"].p50_ms == 2.0


async def test_a_swallowed_cancellation_is_still_wanted() -> None:
    async def swallows() -> None:
        with suppress(asyncio.CancelledError):
            await asyncio.Event().wait()
        assert is_cancelled()
        end_if_cancelled()

    assert not is_cancelled()
    end_if_cancelled()
    task = asyncio.create_task(swallows())
    await asyncio.sleep(0)
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
