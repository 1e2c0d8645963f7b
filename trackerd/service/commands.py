"""What people may ask of the running cell over Zenoh: arm the axes, select the target, the last position, the status."""

from dataclasses import dataclass
from typing import Any

from trackerd.service.cell_service import StationParts
from trackerd.service.outlet import Outlet
from trackerd.service.zenoh_link import ZenohLink

BEYOND_ANY_SENSOR_PX = 1e6


@dataclass(frozen=True, slots=True)
class Commands:
    stations: dict[str, StationParts]
    outlet: Outlet

    def serve(self, link: ZenohLink) -> None:
        link.answer(link.keys.position, self.outlet.answer_position)
        link.answer(link.keys.status, self.outlet.answer_status)
        link.answer(link.keys.arm, self.arm)
        link.answer(link.keys.select, self.select)

    def arm(self, request: dict[str, Any]) -> dict[str, Any]:
        """{"gimbal": name} or {} for all; {"hold": true} disarms. The answer tells what each gimbal still waits for."""
        _known_keys(request, {"gimbal", "hold"})
        if not isinstance(request.get("hold", False), bool):
            raise ValueError(f"hold {request['hold']!r}: needs true or false")
        answers = {}
        for name, part in self._chosen(request).items():
            if request.get("hold", False):
                part.link.hold("held by the operator")
                answers[name] = "held"
            else:
                answers[name] = part.link.arm()
        return {"gimbals": answers}

    def select(self, request: dict[str, Any]) -> dict[str, Any]:
        """{"gimbal": name, "pixel": [x, y]}: the target nearest to that sensor pixel; null lets it be found by itself.

        With "radius_px" as well, pixel and radius are a guess: the target is looked for right there first.
        """
        _known_keys(request, {"gimbal", "pixel", "radius_px"})
        if "gimbal" not in request or "pixel" not in request:
            raise ValueError('needs "gimbal" and "pixel"')
        pixel = None if request["pixel"] is None else _pixel(request["pixel"])
        radius_px = None if request.get("radius_px") is None else _radius(request["radius_px"], pixel)
        chosen = self._chosen(request)
        for part in chosen.values():
            part.task.select(pixel, radius_px)
        return {"gimbals": dict.fromkeys(chosen, "selected" if pixel is not None else "finds its target by itself")}

    def _chosen(self, request: dict[str, Any]) -> dict[str, StationParts]:
        name = request.get("gimbal")
        if name is None:
            return self.stations
        if not isinstance(name, str) or name not in self.stations:
            raise ValueError(f"no gimbal {name!r} (there are: {', '.join(self.stations)})")
        return {name: self.stations[name]}


def _known_keys(request: dict[str, Any], known: set[str]) -> None:
    unknown = sorted(set(request) - known)
    if unknown:
        raise ValueError(f"unknown keys {', '.join(unknown)} (known: {', '.join(sorted(known))})")


def _pixel(value: Any) -> tuple[float, float]:
    if not isinstance(value, list) or len(value) != 2 or not all(map(_is_number, value)):
        raise ValueError(f"pixel {value!r}: needs two numbers [x, y]")
    return float(value[0]), float(value[1])


def _radius(value: Any, pixel: tuple[float, float] | None) -> float:
    if pixel is None or not _is_number(value) or value <= 0.0:
        raise ValueError(f"radius_px {value!r}: needs a number above 0, and a pixel")
    return float(value)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < BEYOND_ANY_SENSOR_PX
