"""What is particular to the modbus driver: the map, the fall-back, and every way in which a controller can answer wrongly."""

import asyncio
import socket
from collections.abc import AsyncIterator
from dataclasses import replace
from math import pi
from typing import Any

import pytest
from emulators.controllers import BIG, STATIC, STATUS, SimController, edges, open_modbus
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError
from pymodbus.constants import ExcCodes

from drivers.gimbal import modbus
from drivers.gimbal.records import encode_command
from trackerd.contract.clock import ControllerUs, ManualClock
from trackerd.contract.errors import DeviceError, DeviceFault, DeviceMissing, DeviceTimeout
from trackerd.contract.model import AxisCommand, AxisMode, GimbalFlag
from trackerd.formats import gimbal_map as m


def decoded(command: AxisCommand) -> m.CommandRecord:
    return m.decode_command(encode_command(command, BIG), BIG)


@given(az=st.floats(-50, 50), el=st.floats(-50, 50))
def test_commanded_angles_arrive_modulo_a_turn(az: float, el: float) -> None:
    record = decoded(AxisCommand(1, az_rad=az, el_rad=el))
    assert m.nearest_angle(record.az_cmd, az) == pytest.approx(az, abs=m.RAD_PER_COUNT)
    assert m.nearest_angle(record.el_cmd, el) == pytest.approx(el, abs=m.RAD_PER_COUNT)


@pytest.mark.parametrize(
    ("key", "bit"),
    [
        ("enable", m.ENABLE),
        ("follow", m.FOLLOW),
        ("halt", m.HALT),
        ("reset_fault", m.FAULT_RESET),
        ("latch", m.LATCH_ENABLE),
        ("latch_zero", m.LATCH_ZERO),
        ("velocity_valid", m.VELOCITY_VALID),
    ],
)
def test_each_wish_is_its_own_control_bit(key: str, bit: int) -> None:
    silent: dict[str, Any] = {"latch": False}
    assert decoded(AxisCommand(1, **silent)).control == 0
    assert decoded(AxisCommand(1, **(silent | {key: True}))).control == bit


def test_the_instant_of_a_set_point_is_the_low_word_and_marked_valid() -> None:
    record = decoded(AxisCommand(1, at=ControllerUs((7 << 32) + 5)))
    assert record.cmd_time_us == 5
    assert record.control & m.TIME_VALID
    assert not decoded(AxisCommand(1)).control & m.TIME_VALID


def test_mode_speed_and_watchdog_travel_along() -> None:
    record = decoded(AxisCommand(9, AxisMode.POSITION, az_rad_s=0.5, el_rad_s=-99999.0, watchdog_ms=80))
    assert (record.cmd_seq, record.mode, record.watchdog_ms) == (9, 1, 80)
    assert m.rad_per_s(record.az_vel) == pytest.approx(0.5, abs=m.rad_per_s(1))
    assert record.el_vel == -(1 << 31)


async def test_without_a_command_the_status_alone_is_asked_for(controller: SimController) -> None:
    async with open_modbus(controller.port) as gimbal:
        await gimbal.exchange(AxisCommand(5))
        written = controller.command
        report = await gimbal.exchange(AxisCommand(0, enable=True))
    assert controller.command == written
    assert report.echo == 5


@pytest.fixture
async def controller() -> AsyncIterator[SimController]:
    async with SimController() as controller:
        yield controller


async def test_the_static_block_becomes_the_info(controller: SimController) -> None:
    async with open_modbus(controller.port) as gimbal:
        info = gimbal.info
    assert (info.serial, info.firmware, info.steerable, info.edges) == ("4711", "2.7", True, 2)
    assert info.az_limits_rad == pytest.approx((-1.0, 1.0))
    assert info.el_limits_rad == pytest.approx((-0.5, 0.75))
    assert info.max_rad_s == pytest.approx(2.0, rel=1e-5)
    assert info.max_rad_s2 == pytest.approx(1000 * 1e6 * m.RAD_PER_COUNT)
    assert (info.latch_delay_ns, info.encoder_delay_ns) == (150, 250)


async def test_latches_are_unwrapped_near_the_live_sample(controller: SimController) -> None:
    clock_us = (3 << 32) + 1000  # the low word has just wrapped
    ring = (*edges(5, clock_us - 3000), *edges(1, clock_us - 40_000))
    live = {"az_live": 100, "az_turns": 2, "el_live": (1 << 31) + 50, "el_turns": 0}
    controller.status = replace(STATUS, clock_us=clock_us, latches=ring, **live)
    async with open_modbus(controller.port) as gimbal:
        report = await gimbal.exchange(AxisCommand(1))
    assert report.instant == clock_us
    assert [latch.instant for latch in report.latches] == [clock_us - d for d in (1000, 3000, 38_000, 40_000)]
    assert [(latch.index, latch.falling) for latch in report.latches] == [(4, True), (4, False), (0, True), (0, False)]
    assert report.az_rad == pytest.approx(4 * pi, abs=1e-6)
    assert all(abs(latch.az_rad - report.az_rad) < 1e-5 for latch in report.latches)
    assert all(abs(latch.el_rad - report.el_rad) <= pi for latch in report.latches)


async def test_the_latch_count_wraps_at_31_bits(controller: SimController) -> None:
    controller.status = replace(STATUS, latches=(m.LatchRecord(0, 0, 0, 7), *STATUS.latches[:2]))
    async with open_modbus(controller.port) as gimbal:
        report = await gimbal.exchange(AxisCommand(1))
    assert report.latches[0].index == m.INDEX_MASK


async def test_status_bits_and_faults_are_handed_on(controller: SimController) -> None:
    controller.status = replace(STATUS, status=0xF800 | 0b1010001, fault=0x0501)
    async with open_modbus(controller.port) as gimbal:
        report = await gimbal.exchange(AxisCommand(1))
    assert report.flags == GimbalFlag.READY | GimbalFlag.FAULT | GimbalFlag.COMM_LOST
    assert report.fault == 0x0501


async def test_an_exchange_is_one_request_where_fc23_is_understood(controller: SimController) -> None:
    async with open_modbus(controller.port) as gimbal:
        await gimbal.exchange(AxisCommand(1))
        await gimbal.exchange(AxisCommand(2))
    assert controller.functions == [3, 23, 23, 23, 23]  # the write part and the read part of each


async def test_refusing_fc23_is_remembered(controller: SimController) -> None:
    controller.refuse_23 = True
    async with open_modbus(controller.port) as gimbal:
        for sequence in (1, 2, 3):
            assert (await gimbal.exchange(AxisCommand(sequence))).echo == sequence
    assert controller.functions == [3, 23, 16, 3, 16, 3, 16, 3]


async def test_a_torn_status_is_read_again_once(controller: SimController) -> None:
    async with open_modbus(controller.port) as gimbal:
        controller.tear = 1
        assert (await gimbal.exchange(AxisCommand(1))).echo == 1
        controller.tear = 2
        with pytest.raises(
            DeviceFault, match=r"gimbal left: exchange: torn twice in a row: status record: status_seq \d+, copy"
        ):
            await gimbal.exchange(AxisCommand(2))
        assert (await gimbal.exchange(AxisCommand(3))).echo == 3


async def test_another_word_order_is_named_when_it_is_opened() -> None:
    swapped = m.encode_static(STATIC, BIG)
    swapped = swapped[2:4] + swapped[:2] + swapped[4:]
    async with SimController(static=swapped) as controller:
        with pytest.raises(DeviceFault, match=r"gimbal left: read the static block: another map: .*0x03040102"):
            async with open_modbus(controller.port):
                pytest.fail("it must not open")


async def test_another_map_in_the_status_is_named(controller: SimController) -> None:
    controller.map_id = 0x0207
    async with open_modbus(controller.port) as gimbal:
        with pytest.raises(DeviceFault, match="map id 0x0207, expected 0x0101"):
            await gimbal.exchange(AxisCommand(1))


@pytest.mark.parametrize(
    ("answer", "error", "text"),
    [
        (ExcCodes.ILLEGAL_ADDRESS, DeviceFault, "Modbus exception 2 to function 23"),
        (ExcCodes.DEVICE_FAILURE, DeviceFault, "Modbus exception 4 to function 23"),
        (ExcCodes.DEVICE_BUSY, DeviceTimeout, "busy"),
        (ExcCodes.GATEWAY_NO_RESPONSE, DeviceMissing, "the gateway does not reach it"),
    ],
)
async def test_exceptions_are_sorted_by_what_can_be_done(
    controller: SimController, answer: ExcCodes, error: type[DeviceError], text: str
) -> None:
    async with open_modbus(controller.port) as gimbal:
        controller.refuse_with = answer
        with pytest.raises(error, match=text):
            await gimbal.exchange(AxisCommand(1))


async def test_a_silent_controller_is_a_timeout_and_recovers(controller: SimController) -> None:
    async with open_modbus(controller.port, timeout_ms=100) as gimbal:
        controller.gate = asyncio.Event()
        with pytest.raises(DeviceTimeout, match=r"gimbal left: exchange: no reply in 0\.1 s"):
            await gimbal.exchange(AxisCommand(1))
        controller.gate.set()
        assert (await gimbal.exchange(AxisCommand(2))).echo == 2


async def test_a_cancelled_exchange_does_not_answer_the_next(controller: SimController) -> None:
    async with open_modbus(controller.port) as gimbal:
        controller.gate = asyncio.Event()
        cancelled = asyncio.create_task(gimbal.exchange(AxisCommand(1)))
        await asyncio.wait([cancelled], timeout=0.01)
        cancelled.cancel()
        await asyncio.wait([cancelled])
        controller.gate.set()
        assert (await gimbal.exchange(AxisCommand(2))).echo == 2


async def test_a_closed_port_is_a_missing_device() -> None:
    async with SimController() as controller:
        port = controller.port
    with pytest.raises(DeviceMissing, match=f"gimbal left: connect to 127.0.0.1:{port}"):
        async with open_modbus(port):
            pytest.fail("it must not open")


async def test_a_port_that_the_twin_has_not_told_is_a_missing_device() -> None:
    with pytest.raises(DeviceMissing, match="the twin has not told its port"):
        async with open_modbus(0):
            pytest.fail("it must not open")


async def test_a_controller_that_hangs_up_is_missing_and_a_new_context_reaches_the_next() -> None:
    async with SimController() as first, open_modbus(first.port) as gimbal:
        await first.__aexit__()
        with pytest.raises(DeviceMissing, match="the connection is lost"):
            await gimbal.exchange(AxisCommand(1))
    async with SimController() as second, open_modbus(second.port) as gimbal:
        assert (await gimbal.exchange(AxisCommand(1))).echo == 1


async def test_stamps_come_from_the_clock_that_was_given(controller: SimController) -> None:
    clock = ManualClock()
    async with open_modbus(controller.port, clock) as gimbal:
        clock.advance(2.5)
        report = await gimbal.exchange(AxisCommand(1))
    assert (report.sent, report.received) == (2_500_000_000, 2_500_000_000)


@pytest.mark.parametrize(
    ("changes", "key"),
    [({"port": 65536}, "port"), ({"timeout_ms": 19}, "timeout_ms"), ({"unit": 248}, "unit"), ({"host": ""}, "host")],
)
def test_settings_out_of_range_are_refused(changes: dict[str, Any], key: str) -> None:
    keys: dict[str, Any] = {"driver": "modbus", "camera": "left", "host": "127.0.0.1"} | changes
    with pytest.raises(ValidationError, match=key):
        modbus.Settings(**keys)


async def test_something_else_on_the_port_is_a_timeout_that_says_what_was_asked() -> None:
    silence = pytest.raises(DeviceTimeout, match="gimbal left: read the static block: no reply")
    with socket.create_server(("127.0.0.1", 0)) as mute, silence:  # the kernel takes the connection, and nobody says a word
        async with open_modbus(mute.getsockname()[1], timeout_ms=50):
            pytest.fail("it must not open")
