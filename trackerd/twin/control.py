"""The twin's control socket: JSON requests over a SOCK_SEQPACKET Unix socket, one answer each, for tests and experiments.

    {"do": "silence", "gimbal": "left", "for_s": 1.0}    takes requests and does not answer
    {"do": "restart", "gimbal": "left", "for_s": 0.2}    power off and on: no link meanwhile, then every count begins again
    {"do": "kill_link", "gimbal": "left", "for_s": 1.0}  no listener and no connection, then the same port again
    {"do": "refuse_fc23", "gimbal": "left", "on": true}
    {"do": "tear", "gimbal": "left", "records": 3}       so many status records with unequal guards
    {"do": "safety_fault", "gimbal": "left"}
    {"do": "latch_jump", "gimbal": "left", "exposures": 3}
    {"do": "stop_stream", "camera": "left"}              and "start_stream"
    {"do": "drop_frames", "camera": "left", "frames": 5}
    {"do": "hide_probe", "for_s": 1.0}                   from every camera, or from {"camera": "left"}
    {"do": "move_probe", "position_mm": [0, 0, 50]}      along an external path; tells when it will be there
    {"do": "status"}    per gimbal: true angles and rates, enabled, following, comm lost, trips of the watchdog ...
    {"do": "truth", "t_host_ns": 123}                    default: now
    {"do": "statistics"}                                 per camera: exposed, delivered, dropped, overruns ...

An error is answered by {"error": text}.
"""

import asyncio
import socket
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeAlias

from trackerd.formats.framelink import pack_message, unpack_message
from trackerd.twin.framelink import listen

LONGEST_REQUEST = 4096

Request: TypeAlias = dict[str, Any]
Answer: TypeAlias = dict[str, Any]


class ControlSocket:
    """Serves any number of clients; `serve` answers one request and raises ValueError or KeyError for a wrong one."""

    def __init__(self, path: Path, serve: Callable[[Request], Answer]) -> None:
        self._serve = serve
        self._clients: set[socket.socket] = set()
        self._loop = asyncio.get_running_loop()
        self._listener = listen(path)
        self._loop.add_reader(self._listener.fileno(), self._accept)

    def close(self) -> None:
        for client in tuple(self._clients):
            self._drop(client)
        self._loop.remove_reader(self._listener.fileno())
        self._listener.close()

    def _accept(self) -> None:
        with suppress(BlockingIOError):
            client, _ = self._listener.accept()
            client.setblocking(False)
            self._clients.add(client)
            self._loop.add_reader(client.fileno(), self._receive, client)

    def _receive(self, client: socket.socket) -> None:
        try:
            packet = client.recv(LONGEST_REQUEST)
            if packet:
                client.send(pack_message(**self._answer(packet)))
                return
        except BlockingIOError:
            return
        except OSError:
            pass
        self._drop(client)

    def _answer(self, packet: bytes) -> Answer:
        try:
            return self._serve(unpack_message(packet))
        except KeyError as error:
            return {"error": f"no {error}"}
        except (ValueError, TypeError) as error:
            return {"error": str(error)}

    def _drop(self, client: socket.socket) -> None:
        self._clients.discard(client)
        self._loop.remove_reader(client.fileno())
        client.close()
