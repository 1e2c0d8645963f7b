"""Devices come and go: what is caught, what is told, and how long is waited."""

import asyncio
from collections.abc import Callable
from contextlib import suppress

import pytest

from trackerd.contract.errors import ConfigError, DeviceMissing, DeviceTimeout
from trackerd.service import supervisor
from trackerd.service.supervisor import Device, keep

PAUSES_S = (0.2, 1.0)


@pytest.fixture
def pauses(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """The pauses that were asked for; none is waited for."""
    asked: list[float] = []
    wait = asyncio.sleep

    async def sleep(duration_s: float) -> None:
        asked.append(duration_s)
        await wait(0)

    monkeypatch.setattr(supervisor.asyncio, "sleep", sleep)
    return asked


def failing(times: int, device: Device, error: Exception | None = None) -> Callable[[], asyncio.Future[None]]:
    """A device that comes up and breaks so many times, and then runs to its end."""
    left = times

    async def run() -> None:
        nonlocal left
        device.running()
        if left:
            left -= 1
            raise error or DeviceMissing("camera left", "open", "not there")

    return run


async def test_pauses_double_up_to_their_limit(pauses: list[float]) -> None:
    device = Device("camera left")
    await keep(device, failing(5, device), PAUSES_S)
    assert pauses == [0.2, 0.4, 0.8, 1.0, 1.0]
    assert (device.state, device.restarts) == ("running", 5)


async def test_pauses_start_anew_after_steady_running(pauses: list[float], monkeypatch: pytest.MonkeyPatch) -> None:
    device = Device("camera left")
    run = failing(4, device)

    async def steady_the_third_time() -> None:
        monkeypatch.setattr(supervisor, "STEADY_S", -1.0 if device.restarts == 2 else 10.0)
        await run()

    await keep(device, steady_the_third_time, PAUSES_S)
    assert pauses == [0.2, 0.4, 0.2, 0.4]


async def test_only_what_a_device_does_is_forgiven(pauses: list[float]) -> None:
    for error in (ConfigError("the table is empty"), RuntimeError("a defect")):
        device = Device("camera left")
        with pytest.raises(type(error)):
            await keep(device, failing(1, device, error), PAUSES_S)
        assert device.restarts == 0
    assert pauses == []


async def test_a_cancellation_ends_it_in_a_run_and_in_a_pause() -> None:
    async def wait() -> None:
        await asyncio.Event().wait()

    async def fail() -> None:
        raise DeviceMissing("camera left", "open", "not there")

    for run in (wait, fail):
        task = asyncio.create_task(keep(Device("camera left"), run, (1e6, 1e6)))
        await asyncio.sleep(0)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task


async def test_a_cancellation_that_came_out_as_a_device_error_ends_it() -> None:
    device = Device("gimbal left")

    async def swallows() -> None:
        with suppress(asyncio.CancelledError):
            await asyncio.Event().wait()
        raise DeviceTimeout("gimbal left", "exchange", "no reply")

    task = asyncio.create_task(keep(device, swallows, PAUSES_S))
    await asyncio.sleep(0)
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
    assert device.restarts == 0


async def test_one_device_waits_while_the_other_runs(pauses: list[float]) -> None:
    broken, whole = Device("camera left"), Device("camera right")
    async with asyncio.TaskGroup() as group:
        group.create_task(keep(broken, failing(3, broken), PAUSES_S))
        group.create_task(keep(whole, failing(0, whole), PAUSES_S))
    assert (broken.restarts, whole.restarts) == (3, 0)


def test_a_device_is_first_heard_of_when_it_runs_or_is_missing() -> None:
    for tell in (Device.running, lambda device: device.lost("not there")):
        device = Device("camera left")
        assert (device.state, device.first.is_set()) == ("opening", False)
        tell(device)
        assert device.first.is_set()


def test_changes_are_logged_and_repetitions_are_not(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO")
    device = Device("camera left")
    for tell in (device.running, device.running, *[lambda: device.lost("cable")] * 3, lambda: device.lost("power")):
        tell()
    assert caplog.messages == ["camera left is running", "camera left lost: cable", "camera left lost: power"]
    assert (device.state, device.reason, device.restarts) == ("lost", "power", 4)
    device.running()
    assert (device.state, device.reason) == ("running", "")
    device.ended("all 5 frames were played")
    assert (device.state, device.reason) == ("ended", "all 5 frames were played")
