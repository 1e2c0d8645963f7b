"""The truth beside the measurement: where the probe really is, on a Zenoh key of the twin's own.

The session is a peer that only connects: to the daemon's listening endpoint, again and again until it is there. Opening it and
losing it never hold the twin up.
"""

import asyncio
import json
from contextlib import suppress
from typing import Any

import zenoh

from trackerd.contract.clock import Clock, HostNs
from trackerd.formats.settings import ZenohSettings
from trackerd.sim.scene import Scene
from trackerd.twin.clock import SceneTime

SCHEMA = "trackerd/truth/1"
PERIOD_NS = 5_000_000  # 200 Hz
RETRY = {"period_init_ms": 100, "period_max_ms": 1000, "period_increase_factor": 2}  # between attempts to connect


def truth_message(scene: Scene, times: SceneTime, clock: Clock, t_ns: int) -> dict[str, Any]:
    """The probe's centre in W at an instant of the scene."""
    position_mm, velocity_mm_s, _ = scene.truth(t_ns)
    host_ns = HostNs(times.host(t_ns))
    return {
        "schema": SCHEMA,
        "t_unix_ns": clock.unix(host_ns),
        "t_host_ns": host_ns,
        "position_mm": [float(x) for x in position_mm],
        "velocity_mm_s": [float(x) for x in velocity_mm_s],
    }


def session_config(settings: ZenohSettings) -> zenoh.Config:
    """Connects to where the cell's daemon listens (or else connects to itself); listens to nobody."""
    endpoints = list(settings.listen[:1] or settings.connect)
    config = zenoh.Config()
    for key, value in {
        "mode": "peer",
        "listen/endpoints": [],
        "connect/endpoints": [endpoint.replace("0.0.0.0", "127.0.0.1").replace("[::]", "[::1]") for endpoint in endpoints],
        "connect/timeout_ms": -1,
        "connect/exit_on_failure": False,
        "connect/retry": RETRY,
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "transport/shared_memory/enabled": False,  # messages are small; every process would leave a file in /dev/shm
        "scouting/delay": 0,  # there is nobody to wait for
    }.items():
        config.insert_json5(key, json.dumps(value))
    return config


class TruthPublisher:
    """Opens its session in the background; until then nothing is published."""

    def __init__(self, settings: ZenohSettings) -> None:
        self.key = truth_key(settings)
        self._session: zenoh.Session | None = None
        self._publisher: zenoh.Publisher | None = None
        self._opening = asyncio.get_running_loop().create_task(self._open(settings))
        self._opening.add_done_callback(_tell_failure)

    def publish(self, message: dict[str, Any]) -> None:
        if self._publisher is not None:
            self._publisher.put(json.dumps(message))

    async def close(self) -> None:
        with suppress(zenoh.ZError):
            await self._opening
        session, self._session, self._publisher = self._session, None, None
        if session is not None:
            await asyncio.to_thread(session.close)

    async def _open(self, settings: ZenohSettings) -> None:
        self._session = await asyncio.to_thread(zenoh.open, session_config(settings))
        self._publisher = self._session.declare_publisher(
            self.key, encoding=zenoh.Encoding.APPLICATION_JSON, congestion_control=zenoh.CongestionControl.DROP, express=True
        )


def truth_key(settings: ZenohSettings) -> str:
    return f"{settings.twin_prefix}/truth"


def _tell_failure(opening: "asyncio.Task[None]") -> None:
    """An endpoint that Zenoh cannot use at all; one where nobody is yet is no failure."""
    if not opening.cancelled() and (error := opening.exception()) is not None:
        opening.get_loop().call_exception_handler({"message": "the truth's session", "exception": error})
