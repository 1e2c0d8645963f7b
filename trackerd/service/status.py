"""The status: what every device, station and task tells of itself, gathered into plain values."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from trackerd.contract.clock import HostNs
from trackerd.engine.fuse import Fuser
from trackerd.engine.latched import RecordingTime
from trackerd.formats.calibration import Calibration
from trackerd.formats.wire import plain
from trackerd.service.cell_service import StationParts
from trackerd.service.fusion_task import FusionTask
from trackerd.service.outlet import Outlet
from trackerd.service.vital_signs import VitalSigns

LOOK_NS = 1_000_000_000  # percentiles and the daemon's health are looked at once a second


@dataclass(frozen=True, slots=True)
class Watched:
    stations: dict[str, StationParts]
    fusion: FusionTask
    fuser: Fuser
    outlet: Outlet
    vitals: VitalSigns
    recording: RecordingTime

    @property
    def recording_offset_ns(self) -> int | None:
        """Unix time minus recorded time of everything that is played; None where nothing is."""
        offset = self.recording.offset_ns
        return None if offset is None else self.outlet.clock.unix(HostNs(offset))


@dataclass(frozen=True, slots=True)
class Slow:
    """What costs too much to be looked at ten times a second; plain values already."""

    looked: HostNs
    vitals: Any
    stages: dict[str, Any]
    latency: Any


class CellStatus:
    def __init__(self, cell: str, version: str, calibration: Calibration, twin: Mapping[str, Any] | None) -> None:
        """`twin`: where a simulated cell is on the wire, as it announced itself."""
        self._head = {"cell": cell, "version": version, "calibration_id": calibration.id, "twin": twin}
        self._watched: Watched | None = None
        self._slow: Slow | None = None

    def watch(self, watched: Watched) -> None:
        self._watched = watched

    def gather(self) -> dict[str, Any]:
        w = self._watched
        if w is None:
            return dict(self._head)
        slow = self._slow
        if slow is None or w.outlet.clock.now() - slow.looked > LOOK_NS:
            self._slow = slow = _look(w)
        return {
            **self._head,
            "stations": {name: _station(part) | {"stages": slow.stages[name]} for name, part in w.stations.items()},
            "fusion": {"dropped": w.fusion.dropped, **asdict(w.fuser.statistics())},
            "published": {"fixes": w.outlet.fixes, "valid": w.outlet.valid_fixes, "latency": slow.latency},
            "recording_offset_ns": w.recording_offset_ns,
            "other_publishers": sorted(w.outlet.link.others),
            "daemon": slow.vitals,
        }


def _look(w: Watched) -> Slow:
    stages = {name: plain(part.task.stages.percentiles()) for name, part in w.stations.items()}
    return Slow(w.outlet.clock.now(), plain(w.vitals.look()), stages, plain(w.outlet.published.percentiles()))


def _station(part: StationParts) -> dict[str, Any]:
    exchanges, late = part.link.exchanges
    last = part.task.last
    return {
        "camera": {"state": part.camera.state, "reason": part.camera.reason, "restarts": part.camera.restarts},
        "gimbal": {
            "state": part.gimbal.state,
            "reason": part.gimbal.reason,
            "restarts": part.gimbal.restarts,
            "stale": part.link.stale(),
            "exchanges": exchanges,
            "missed_cycles": late,
            "clock": part.link.clock_fit,
        },
        "axes": part.link.snapshot(),
        "track": {"state": part.task.state.value, "why": "" if last is None else last.why},
        "frames": part.task.counts,
    }
