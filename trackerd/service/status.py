"""The status: what every device, station and task tells of itself, gathered into plain values."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from trackerd.engine.fuse import Fuser
from trackerd.formats.calibration import Calibration
from trackerd.service.cell_service import StationParts
from trackerd.service.fusion_task import FusionTask
from trackerd.service.outlet import Outlet
from trackerd.service.vital_signs import Vitals, VitalSigns

LOOK_NS = 1_000_000_000  # the daemon's health is looked at once a second


@dataclass(frozen=True, slots=True)
class Watched:
    stations: dict[str, StationParts]
    fusion: FusionTask
    fuser: Fuser
    outlet: Outlet
    vitals: VitalSigns


class CellStatus:
    def __init__(self, cell: str, version: str, calibration: Calibration, twin: Mapping[str, Any] | None) -> None:
        """`twin`: where a simulated cell is on the wire, as it announced itself."""
        self._head = {"cell": cell, "version": version, "calibration_id": calibration.id, "twin": twin}
        self._watched: Watched | None = None
        self._vitals: Vitals | None = None
        self._looked = 0

    def watch(
        self, stations: dict[str, StationParts], fusion: FusionTask, fuser: Fuser, outlet: Outlet, vitals: VitalSigns
    ) -> None:
        self._watched = Watched(stations, fusion, fuser, outlet, vitals)

    def gather(self) -> dict[str, Any]:
        w = self._watched
        if w is None:
            return dict(self._head)
        now = w.outlet.clock.now()
        if now - self._looked > LOOK_NS or self._vitals is None:
            self._vitals, self._looked = w.vitals.look(), now
        return {
            **self._head,
            "stations": {name: _station(part) for name, part in w.stations.items()},
            "fusion": {"dropped": w.fusion.dropped, **asdict(w.fuser.statistics())},
            "published": {"fixes": w.outlet.fixes, "valid": w.outlet.valid_fixes, "latency": w.outlet.published.percentiles()},
            "other_publishers": sorted(w.outlet.link.others),
            "daemon": self._vitals,
        }


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
        "stages": part.task.stages.percentiles(),
    }
