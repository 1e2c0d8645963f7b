"""What the control socket may ask of the simulated cell; the requests are listed in control.py."""

from collections.abc import Callable
from typing import Any

import numpy as np

from trackerd.contract.clock import Clock
from trackerd.twin.camera import TwinCamera
from trackerd.twin.cell import TwinCell, TwinGimbal
from trackerd.twin.control import Answer, Request
from trackerd.twin.modbus import READ_WRITE
from trackerd.twin.truth import truth_message

FARTHEST_MM = 10_000.0
REBOOT_S = 0.2  # a restarted controller is off the wire for this long


class ControlDesk:
    """Answers one request. Raises KeyError or ValueError for one that is wrong."""

    def __init__(self, cell: TwinCell, clock: Clock) -> None:
        self._cell = cell
        self._clock = clock
        self._of_gimbal: dict[str, Callable[[TwinGimbal, Request], None]] = {
            "silence": lambda gimbal, request: gimbal.server.silence(_duration_s(request)),
            "restart": self._restart,
            "kill_link": lambda gimbal, request: gimbal.server.kill_link(_duration_s(request)),
            "refuse_fc23": _refuse_fc23,
            "tear": _tear,
            "safety_fault": lambda gimbal, _: gimbal.controller.emergency_stop(cell.times.now()),
            "latch_jump": lambda gimbal, request: gimbal.controller.latch.jump(_count(request, "exposures", 3)),
        }
        self._of_camera: dict[str, Callable[[TwinCamera, Request], None]] = {
            "stop_stream": lambda camera, _: camera.hold_up(True),
            "start_stream": lambda camera, _: camera.hold_up(False),
            "drop_frames": lambda camera, request: camera.drop_frames(_count(request, "frames", 1)),
        }
        self._questions: dict[str, Callable[[Request], Answer]] = {
            "hide_probe": self._hide_probe,
            "move_probe": self._move_probe,
            "status": self._status,
            "truth": self._truth,
            "statistics": lambda _: {name: camera.statistics() for name, camera in cell.cameras.items()},
        }

    def __call__(self, request: Request) -> Answer:
        wish = request.get("do")
        if wish in self._of_gimbal:
            self._of_gimbal[wish](self._cell.gimbals[request["gimbal"]], request)
        elif wish in self._of_camera:
            self._of_camera[wish](self._cell.cameras[request["camera"]], request)
        elif wish in self._questions:
            return self._questions[wish](request)
        else:
            known = ", ".join(sorted(self._of_gimbal | self._of_camera | self._questions))
            raise ValueError(f"unknown request {wish!r} (there are: {known})")
        return {"done": wish}

    def _restart(self, gimbal: TwinGimbal, request: Request) -> None:
        """Its clients go first: what they lose is the old life's."""
        gimbal.server.kill_link(_duration_s(request, REBOOT_S))
        gimbal.controller.restart(self._cell.times.now())

    def _hide_probe(self, request: Request) -> Answer:
        cameras = self._cell.cameras
        for camera in [cameras[request["camera"]]] if "camera" in request else cameras.values():
            camera.hide_probe(_duration_s(request))
        return {"done": "hide_probe"}

    def _move_probe(self, request: Request) -> Answer:
        p_mm = np.array(request["position_mm"], float)
        if p_mm.shape != (3,) or not np.abs(p_mm).max() < FARTHEST_MM:
            raise ValueError(f"position_mm = {request['position_mm']}: must be x, y, z within {FARTHEST_MM:g} mm")
        times = self._cell.times
        return {"done": "move_probe", "there_host_ns": times.host(self._cell.scene.path.go(times.now(), p_mm))}

    def _status(self, _: Request) -> Answer:
        now = self._cell.times.now()
        gimbals = {name: _gimbal_status(gimbal, now) for name, gimbal in self._cell.gimbals.items()}
        return {"t_scene_ns": now, "t_host_ns": self._cell.times.host(now), "gimbals": gimbals}

    def _truth(self, request: Request) -> Answer:
        times = self._cell.times
        t_ns = times.scene(int(request["t_host_ns"])) if "t_host_ns" in request else times.now()
        return truth_message(self._cell.scene, times, self._clock, max(0, t_ns))


def _gimbal_status(gimbal: TwinGimbal, now: int) -> dict[str, Any]:
    """Angles and rates are the channels' true ones; instants are scene ns."""
    controller = gimbal.controller
    controller.advance(now)
    angles_rad, rates_rad_s = controller.axes.motion(now)
    return {
        "t_scene_ns": now,
        "az_rad": angles_rad[0],
        "el_rad": angles_rad[1],
        "az_rad_s": rates_rad_s[0],
        "el_rad_s": rates_rad_s[1],
        "enabled": controller.enabled,
        "following": controller.following,
        "comm_lost": controller.comm_lost,
        "comm_lost_ns": controller.lost_ns,
        "fault": controller.fault,
        "trips_ns": list(controller.trips),
        "last_command_ns": controller.heard_ns,
        "watchdog_ns": controller.watchdog_ns,
        "connections": len(gimbal.server.connections),
    }


def _refuse_fc23(gimbal: TwinGimbal, request: Request) -> None:
    gimbal.server.refused_functions = frozenset((READ_WRITE,)) if request.get("on", True) else frozenset()


def _tear(gimbal: TwinGimbal, request: Request) -> None:
    gimbal.controller.tear = _count(request, "records", 1)


def _duration_s(request: Request, default_s: float = 1.0) -> float:
    duration_s = float(request.get("for_s", default_s))
    if not 0.0 <= duration_s <= 3600.0:
        raise ValueError(f"for_s = {duration_s}: must be 0 to 3600")
    return duration_s


def _count(request: Request, name: str, default: int) -> int:
    count = int(request.get(name, default))
    if not 0 <= count <= 1_000_000:
        raise ValueError(f"{name} = {count}: must be 0 to 1000000")
    return count
