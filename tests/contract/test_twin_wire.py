"""The twin through its own sockets: Modbus by pymodbus's client, cameras and control by raw ones."""

import asyncio
import json
import os
import signal
import socket
from pathlib import Path

import numpy as np
import pytest
import zenoh
from emulators.twin_process import Eye, Packets, connected, control, demo_cell, running_twin, until_listening
from pymodbus.exceptions import ModbusIOException

from trackerd.contract.model import AxisMode, GimbalFlag
from trackerd.formats import gimbal_map as gm
from trackerd.formats.framelink import unpack_doorbell
from trackerd.formats.gimbal_map import ByteOrder

LOST = GimbalFlag.COMM_LOST


def open_files() -> int:
    return len(list(Path("/proc/self/fd").iterdir()))


# ---- the process -----------------------------------------------------------------------------------------------------


async def test_it_announces_where_everything_is() -> None:
    async with running_twin() as twin:
        assert set(twin["gimbals"]) == set(twin["cameras"]) == {"left", "right"}
        assert twin["truth_key"] == "twin/truth"
        assert twin["pid"] == os.getpid()
        ports = {gimbal["port"] for gimbal in twin["gimbals"].values()}
        assert len(ports) == 2
        assert 0 not in ports


async def test_it_leaves_nothing_behind() -> None:
    before = open_files()
    async with running_twin() as twin:
        folder = Path(twin["control"]).parent
        assert folder.stat().st_mode & 0o777 == 0o700
        async with connected(twin) as left:
            await left.exchange()
    assert not folder.exists()
    assert open_files() <= before
    assert len(asyncio.all_tasks()) == 1


async def test_it_ends_after_its_parent() -> None:
    gone = asyncio.Event()
    async with running_twin(parent_gone=gone, linger_s=0.0) as twin:
        gone.set()
        await twin["task"]


async def test_it_ends_with_its_standard_input(monkeypatch: pytest.MonkeyPatch) -> None:
    ours, theirs = os.pipe()
    with os.fdopen(ours) as stdin:
        monkeypatch.setattr("sys.stdin", stdin)
        async with running_twin(watch_stdin=True, linger_s=0.0) as twin:
            os.write(theirs, b"still here\n")
            await control(twin, do="status")
            assert not twin["task"].done()
            os.close(theirs)
            await twin["task"]


async def test_it_ends_on_sigterm() -> None:
    async with running_twin() as twin:
        os.kill(os.getpid(), signal.SIGTERM)
        await twin["task"]


async def test_it_fails_as_a_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    async with running_twin() as twin:
        monkeypatch.setattr("trackerd.twin.server.truth_message", lambda *_: {}["broken"])
        with pytest.raises(KeyError, match="broken"):
            await twin["task"]


async def test_an_endpoint_that_is_none_ends_it() -> None:
    async with running_twin('zenoh.listen=["carrier-pigeon/7447"]') as twin:
        with pytest.raises(zenoh.ZError, match="carrier-pigeon"):
            await twin["task"]


async def test_a_taken_port_is_an_error_that_leaves_nothing_behind() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken, pytest.raises(OSError, match="in use"):
        async with running_twin(f"gimbal.right.port={taken.getsockname()[1]}"):
            pass


def test_a_real_controllers_address_is_not_taken() -> None:
    async def ports() -> set[int]:
        async with running_twin('gimbal.left.host="192.0.2.7"', "gimbal.left.port=502") as twin:
            return {gimbal["port"] for gimbal in twin["gimbals"].values()}

    assert 502 not in asyncio.run(ports())


# ---- gimbals ---------------------------------------------------------------------------------------------------------


async def test_the_static_block_and_the_history_read_over_the_wire() -> None:
    async with running_twin() as twin, connected(twin, "right") as right:
        static = await right.client.read_holding_registers(gm.STATIC_REGISTER, count=gm.STATIC_WORDS)
        assert gm.decode_static(gm.bytes_from_registers(static.registers), ByteOrder.MODBUS).serial == 1002
        history = await right.client.read_holding_registers(gm.HISTORY_REGISTER, count=gm.HISTORY_WORDS)
        assert gm.decode_history(gm.bytes_from_registers(history.registers), ByteOrder.MODBUS)
        mirrored = await right.client.read_input_registers(gm.STATUS_REGISTER, count=gm.STATUS_WORDS)
        assert gm.decode_status(gm.bytes_from_registers(mirrored.registers), ByteOrder.MODBUS).status_seq > 0


async def test_a_gimbal_enables_and_turns_over_the_wire() -> None:
    async with running_twin() as twin, connected(twin) as left:
        await left.exchange()
        first = await left.exchange(gm.ENABLE, watchdog_ms=1000)
        assert GimbalFlag(first.status) & GimbalFlag.ENABLED
        speed = gm.counts_per_ms(0.05)
        status = await left.exchange(gm.ENABLE | gm.FOLLOW, AxisMode.VELOCITY, az_vel=speed, watchdog_ms=1000)
        while gm.signed((status.az_live - first.az_live) & gm.LOW_WORD) < 1000 * speed // 20:
            status = await left.exchange(gm.ENABLE | gm.FOLLOW, AxisMode.VELOCITY, az_vel=speed, watchdog_ms=1000)
        assert status.fault == 0
        assert (await control(twin, do="status"))["gimbals"]["left"]["following"]


async def test_a_closed_connection_is_comm_lost() -> None:
    async with running_twin() as twin:
        async with connected(twin) as left:
            await left.exchange(watchdog_ms=1000)
        while not (await control(twin, do="status"))["gimbals"]["left"]["comm_lost"]:
            pass
        async with connected(twin) as left:
            assert GimbalFlag((await left.exchange(watchdog_ms=1000)).status) & LOST


async def test_a_silent_controller_takes_no_commands_and_its_watchdog_trips_in_time() -> None:
    async with running_twin() as twin, connected(twin, timeout_s=0.05) as left:
        await left.exchange(watchdog_ms=20)
        assert await control(twin, do="silence", gimbal="left", for_s=3600) == {"done": "silence"}
        before = (await control(twin, do="status"))["gimbals"]["left"]
        with pytest.raises(ModbusIOException):
            await left.exchange(watchdog_ms=20)
        after = (await control(twin, do="status"))["gimbals"]["left"]
        assert after["last_command_ns"] == before["last_command_ns"]
        assert after["trips_ns"] == [after["last_command_ns"] + 20_000_000]


async def test_a_refused_read_write_is_exception_1() -> None:
    async with running_twin() as twin, connected(twin) as left:
        await control(twin, do="refuse_fc23", gimbal="left")
        refused = await left.client.readwrite_registers(read_address=100, read_count=50, write_address=0, values=[0] * 16)
        assert refused.isError()
        assert refused.exception_code == 1
        assert not (await left.client.read_holding_registers(100, count=50)).isError()
        await control(twin, do="refuse_fc23", gimbal="left", on=False)
        await left.exchange()


async def test_a_killed_link_comes_back_on_the_same_port() -> None:
    async with running_twin() as twin:
        async with connected(twin) as left:
            await left.exchange(watchdog_ms=1000)
            await control(twin, do="kill_link", gimbal="left", for_s=0.0)
        await until_listening(twin, "left")
        async with connected(twin) as left:
            assert GimbalFlag((await left.exchange()).status) & LOST


async def test_a_restarted_controller_begins_again() -> None:
    async with running_twin() as twin:
        async with connected(twin) as left:
            await left.exchange()
            await left.exchange(gm.ENABLE, watchdog_ms=1000)
            await control(twin, do="restart", gimbal="left", for_s=0.0)
        await until_listening(twin, "left")
        async with connected(twin) as left:
            left.seq = 100
            status = await left.exchange(gm.ENABLE)
            assert GimbalFlag(status.status) == GimbalFlag.READY | GimbalFlag.HOMED
            assert status.cmd_seq_echo == 101
            assert 1000 * status.clock_us < (await control(twin, do="status"))["t_scene_ns"]
            assert status.status_seq < 10


async def test_faults_on_request() -> None:
    async with running_twin() as twin, connected(twin) as left:
        await left.exchange(watchdog_ms=1000)
        await control(twin, do="tear", gimbal="left", records=1)
        with pytest.raises(gm.TornRecord):
            await left.exchange(watchdog_ms=1000)
        await control(twin, do="safety_fault", gimbal="left")
        assert (await left.exchange(watchdog_ms=1000)).fault & gm.FAULT_CLASS == gm.FAULT_SAFETY
        assert (await control(twin, do="status"))["gimbals"]["right"]["fault"] == 0


async def test_wrong_requests_are_answered_in_words() -> None:
    async with running_twin() as twin:
        assert "there are: drop_frames" in (await control(twin, do="explode"))["error"]
        assert "middle" in (await control(twin, do="restart", gimbal="middle"))["error"]
        assert "for_s" in (await control(twin, do="silence", gimbal="left", for_s=-1))["error"]
        with Packets(twin["control"]) as client:
            client.socket.send(b"[1]")
            assert "not a message" in json.loads(await client.receive())["error"]


# ---- truth -----------------------------------------------------------------------------------------------------------


async def test_the_truth_is_told_for_any_instant() -> None:
    async with running_twin("twin.path.dwell_s=0") as twin:
        start = await control(twin, do="status")
        begun = start["t_host_ns"] - start["t_scene_ns"]
        truth = await control(twin, do="truth", t_host_ns=begun + 20_000_000_000)
        assert truth["schema"] == "trackerd/truth/1"
        assert truth["t_host_ns"] == begun + 20_000_000_000
        assert np.hypot(*truth["position_mm"][:2]) == pytest.approx(150.0)
        assert np.linalg.norm(truth["velocity_mm_s"]) == pytest.approx(250.0)


async def test_the_truth_is_published_to_a_daemon_that_comes_later() -> None:
    with socket.create_server(("127.0.0.1", 0)) as probe:
        endpoint = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
    async with running_twin(f'zenoh.listen=["{endpoint}"]'):
        config = zenoh.Config()
        config.insert_json5("listen/endpoints", json.dumps([endpoint]))
        config.insert_json5("scouting/multicast/enabled", "false")
        loop, arrived = asyncio.get_running_loop(), asyncio.Event()
        told: list[dict[str, object]] = []

        def take(sample: zenoh.Sample) -> None:
            told.append(json.loads(sample.payload.to_string()))
            if len(told) == 3:
                loop.call_soon_threadsafe(arrived.set)

        session = await asyncio.to_thread(zenoh.open, config)
        subscriber = session.declare_subscriber("twin/truth", take)
        await arrived.wait()
        subscriber.undeclare()
        await asyncio.to_thread(session.close)
    assert [set(message) for message in told[:1]] == [{"schema", "t_unix_ns", "t_host_ns", "position_mm", "velocity_mm_s"}]


# ---- cameras ---------------------------------------------------------------------------------------------------------


async def test_frames_arrive_in_order_with_the_probe_on_them() -> None:
    async with running_twin() as twin:
        with Eye(twin["cameras"]["left"]["socket"]) as eye:
            offer = await eye.open()
            assert (offer["width"], offer["height"], offer["camera"]) == (320, 240, "left")
            assert await eye.ask(do="start") == {"done": "start"}
            bells = [await eye.doorbell() for _ in range(5)]
            image = eye.frame(bells[-1])
        assert [bell.frame_id for bell in bells] == [0, 1, 2, 3, 4]
        assert {(bell.origin_x, bell.origin_y, bell.exposure_ns) for bell in bells} == {(864, 648, 2_000_000)}
        steps = np.diff([bell.mid_exposure_ns for bell in bells])
        assert set(steps) <= {18_181_818, 18_181_819}
        assert all(bell.rung_ns >= bell.due_ns for bell in bells)
        x, y = 159.5 + 60.0, 119.5 - 40.0  # start_offset_px
        assert image[round(y), round(x)] > 150
        assert image[round(y) + 100, round(x) - 200] < 100


async def test_latches_match_frames_by_index_and_instant() -> None:
    async with running_twin() as twin, connected(twin) as left:
        with Eye(twin["cameras"]["left"]["socket"]) as eye:
            await eye.open()
            await left.exchange(gm.LATCH_ENABLE | gm.LATCH_ZERO, watchdog_ms=1000)
            await eye.ask(do="start")
            bell = await eye.doorbell()
            while bell.frame_id < 3:
                bell = await eye.doorbell()
            latches = (await left.exchange(gm.LATCH_ENABLE, watchdog_ms=1000)).latches
            edges = {latch.index: latch.t_us for latch in latches}
            raw = bell.frame_id + 1
            mid_ns = 500 * (edges[raw] + edges[raw | gm.FALLING_EDGE])
            assert abs(mid_ns - bell.mid_exposure_ns) <= 1000  # both clocks are the scene's by default
            assert edges[raw | gm.FALLING_EDGE] - edges[raw] in (2000, 2001)


async def test_no_doorbell_and_no_exposure_after_the_answer_to_stop() -> None:
    async with running_twin() as twin, connected(twin) as left:
        with Eye(twin["cameras"]["left"]["socket"]) as eye:
            await eye.open()
            await left.exchange(gm.LATCH_ENABLE, watchdog_ms=1000)
            await eye.ask(do="start")
            await eye.doorbell()
            assert await eye.ask(do="stop") == {"done": "stop"}
            total = (await left.exchange(gm.LATCH_ENABLE, watchdog_ms=1000)).latch_total
            await eye.ask(do="start")
            assert (await eye.doorbell()).frame_id == 0
            assert (await left.exchange(gm.LATCH_ENABLE, watchdog_ms=1000)).latch_total >= total + 1


async def test_an_exposure_in_progress_at_a_stop_rings_no_doorbell_after_the_answer() -> None:
    exposing = ("camera.left.exposure_us=17500", "twin.camera.transfer_us=3000")  # nearly always
    async with running_twin(*exposing) as twin:
        with Eye(twin["cameras"]["left"]["socket"]) as eye:
            await eye.open()
            await eye.ask(do="start")
            await eye.doorbell()
            await eye.ask(do="stop")
            with pytest.raises(TimeoutError):
                async with asyncio.timeout(0.1):
                    await eye.doorbell()
        counts = (await control(twin, do="statistics"))["left"]
        assert counts["exposed"] == counts["delivered"] + counts["dropped"]


async def test_both_cameras_expose_at_the_same_instants() -> None:
    async with running_twin() as twin:
        with Eye(twin["cameras"]["left"]["socket"]) as left, Eye(twin["cameras"]["right"]["socket"]) as right:
            for eye in (left, right):
                await eye.open()
                await eye.ask(do="start")
            instants = [{(await eye.doorbell()).mid_exposure_ns for _ in range(6)} for eye in (left, right)]
        assert len(instants[0] & instants[1]) >= 3


async def test_dropped_frames_leave_a_gap_and_are_counted() -> None:
    async with running_twin() as twin:
        with Eye(twin["cameras"]["left"]["socket"]) as eye:
            await eye.open()
            await control(twin, do="drop_frames", camera="left", frames=2)
            await eye.ask(do="start")
            assert (await eye.doorbell()).frame_id == 2
        assert (await control(twin, do="statistics"))["left"]["dropped"] == 2


async def test_a_stream_stops_and_returns() -> None:
    async with running_twin() as twin:
        with Eye(twin["cameras"]["left"]["socket"]) as eye:
            await eye.open()
            await control(twin, do="stop_stream", camera="left")
            await eye.ask(do="start")
            exposed = (await control(twin, do="statistics"))["left"]["exposed"]
            await control(twin, do="start_stream", camera="left")
            assert (await eye.doorbell()).frame_id == 0
            assert exposed == 0


async def test_a_hidden_probe_is_not_on_the_image() -> None:
    async with running_twin() as twin:
        with Eye(twin["cameras"]["left"]["socket"]) as eye:
            await eye.open()
            await control(twin, do="hide_probe", for_s=3600)
            await eye.ask(do="start")
            assert eye.frame(await eye.doorbell()).max() < 100


async def test_an_external_probe_is_moved_and_tells_when_it_is_there() -> None:
    async with running_twin("twin.path.kind=external", "twin.path.speed_mm_s=2000") as twin:
        answer = await control(twin, do="move_probe", position_mm=[10.0, -20.0, 30.0])
        truth = await control(twin, do="truth", t_host_ns=answer["there_host_ns"])
        assert truth["position_mm"] == pytest.approx([10.0, -20.0, 30.0], abs=1e-9)
        assert "must be x, y, z" in (await control(twin, do="move_probe", position_mm=[1e9, 0, 0]))["error"]
    async with running_twin() as twin:
        assert "only an external path" in (await control(twin, do="move_probe", position_mm=[0, 0, 0]))["error"]


async def test_a_second_client_is_sent_away_and_a_dead_one_is_replaced() -> None:
    async with running_twin() as twin:
        path = twin["cameras"]["left"]["socket"]
        with Eye(path) as first:
            await first.open()
            with Packets(path) as second:
                assert "has a client already" in json.loads(await second.receive())["error"]
        with Eye(path) as third:
            await third.open()
            await third.ask(do="start")
            assert (await third.doorbell()).frame_id == 0


async def test_a_client_that_does_not_read_loses_doorbells_and_holds_nobody_up() -> None:
    async with running_twin("camera.left.frame_rate_hz=400", "camera.left.width_px=32", "camera.left.height_px=32") as twin:
        with Eye(twin["cameras"]["left"]["socket"]) as eye:
            await eye.open()
            await eye.ask(do="start")
            while not (await control(twin, do="statistics"))["left"]["missed_doorbells"]:
                pass
            while unpack_doorbell(await eye.receive()) is None:
                pass


async def test_unknown_requests_of_a_camera_client_are_answered() -> None:
    async with running_twin() as twin:
        with Eye(twin["cameras"]["left"]["socket"]) as eye:
            assert "unknown request" in (await eye.ask(do="dance"))["error"]


# ---- another event loop ----------------------------------------------------------------------------------------------


def test_it_runs_under_uvloop() -> None:
    uvloop = pytest.importorskip("uvloop")

    async def frames() -> list[int]:
        async with running_twin() as twin, connected(twin) as left:
            await left.exchange()
            with Eye(twin["cameras"]["left"]["socket"]) as eye:
                await eye.open()
                await eye.ask(do="start")
                return [(await eye.doorbell()).frame_id for _ in range(3)]

    assert uvloop.run(frames()) == [0, 1, 2]


def test_the_demo_is_a_cell_that_the_twin_can_be() -> None:
    assert demo_cell().twin is not None
