"""A cell as its configuration describes it, and the rules that no table can hold alone."""

from collections.abc import Callable, Hashable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

from trackerd.formats.calibration import Calibration
from trackerd.formats.rules import NO_VALUE, nearest
from trackerd.formats.settings import (
    CameraSettings,
    FusionSettings,
    GimbalSettings,
    Pixel,
    ProbeSettings,
    ServiceSettings,
    ZenohSettings,
)
from trackerd.formats.twin import TwinSettings

FEWEST_GIMBALS = 2  # one line of sight has no depth

Finding: TypeAlias = tuple[tuple[str, ...], str | None, Any, str]  # table, key, value, rule


@dataclass(frozen=True, slots=True)
class CellConfig:
    """Everything that one daemon needs to know. Paths are absolute."""

    path: Path
    name: str
    probe: ProbeSettings
    calibration: Path
    cameras: dict[str, CameraSettings]
    gimbals: dict[str, GimbalSettings]
    fusion: FusionSettings
    zenoh: ZenohSettings
    service: ServiceSettings
    twin: TwinSettings | None


@dataclass(frozen=True, slots=True)
class Devices:
    """The devices whose own tables are right, and the names of all that were configured."""

    cameras: Mapping[str, CameraSettings]
    gimbals: Mapping[str, GimbalSettings]
    camera_names: tuple[str, ...]
    gimbal_names: tuple[str, ...]
    calibration: Calibration | None
    with_twin: bool  # there is a [twin] table
    twin: TwinSettings | None


def findings(devices: Devices) -> Iterator[Finding]:
    """What is wrong between the tables."""
    for rule in (_enough, _carried, _used, _calibrated, _regions, _pixels, _addresses, _sources, _twin, _twin_names):
        yield from rule(devices)


def _enough(d: Devices) -> Iterator[Finding]:
    if len(d.gimbal_names) < FEWEST_GIMBALS:
        there = ", ".join(d.gimbal_names) or "none"
        yield ("gimbal",), None, None, f"a position needs at least {FEWEST_GIMBALS} gimbals [gimbal.NAME] (there is: {there})"


def _carried(d: Devices) -> Iterator[Finding]:
    """Each gimbal carries a camera of its own."""
    carrier: dict[str, str] = {}
    for name, gimbal in d.gimbals.items():
        table = ("gimbal", name)
        if gimbal.camera not in d.camera_names:
            yield (
                table,
                "camera",
                gimbal.camera,
                f"there is no [camera.{gimbal.camera}]{nearest(gimbal.camera, d.camera_names)}",
            )
        elif gimbal.camera in carrier:
            yield table, "camera", gimbal.camera, f"gimbal {carrier[gimbal.camera]} carries this camera already"
        carrier.setdefault(gimbal.camera, name)


def _used(d: Devices) -> Iterator[Finding]:
    if len(d.gimbals) < len(d.gimbal_names):
        return  # a gimbal that is wrong itself may be the one
    used = {gimbal.camera for gimbal in d.gimbals.values()}
    for name in d.camera_names:
        if name not in used:
            yield (
                ("camera", name),
                None,
                None,
                f'no gimbal carries this camera: set camera = "{name}" in one, or delete the table',
            )


def _calibrated(d: Devices) -> Iterator[Finding]:
    if d.calibration is None:
        return
    stations = d.calibration.stations
    for name in d.gimbal_names:
        if name not in stations:
            rule = f'calibration "{d.calibration.id}" has no station {name} (it has: {", ".join(stations)})'
            yield ("gimbal", name), None, None, rule


def _regions(d: Devices) -> Iterator[Finding]:
    """A camera's region lies on the sensor that its lens was calibrated with."""
    if d.calibration is None:
        return
    for name, gimbal in d.gimbals.items():
        camera, station = d.cameras.get(gimbal.camera), d.calibration.stations.get(name)
        if camera is None or station is None:
            continue
        spans = ((camera.offset_x_px, camera.width_px), (camera.offset_y_px, camera.height_px))
        for (offset, size), sensor, key in zip(spans, station.lens.sensor_px, ("width_px", "height_px"), strict=True):
            if offset + size > sensor:
                rule = f"the region ends at {offset} + {size} = {offset + size} px, but the calibrated sensor has {sensor} px"
                yield ("camera", gimbal.camera), key, size, rule


def _pixels(d: Devices) -> Iterator[Finding]:
    """The pixels of a gimbal lie inside its camera's region; they count on the whole sensor."""
    for name, gimbal in d.gimbals.items():
        camera = d.cameras.get(gimbal.camera)
        if camera is None:
            continue
        for table, key, pixel in (
            ("steering", "aim_px", gimbal.steering.aim_px),
            ("tracking", "target_px", gimbal.tracking.target_px),
        ):
            if pixel is not None and not _inside(pixel, camera):
                yield ("gimbal", name, table), key, pixel, f"outside what camera {gimbal.camera} sees, {_region(camera)}"


def _inside(pixel: Pixel, camera: CameraSettings) -> bool:
    x, y = pixel[0] - camera.offset_x_px, pixel[1] - camera.offset_y_px
    return 0 <= x <= camera.width_px - 1 and 0 <= y <= camera.height_px - 1


def _region(camera: CameraSettings) -> str:
    right, bottom = camera.offset_x_px + camera.width_px - 1, camera.offset_y_px + camera.height_px - 1
    return f"x {camera.offset_x_px}..{right}, y {camera.offset_y_px}..{bottom} (pixels of the sensor)"


def _addresses(d: Devices) -> Iterator[Finding]:
    """No two gimbals talk to one controller."""

    def address(gimbal: GimbalSettings) -> Hashable:
        host, port, unit = (getattr(gimbal, key, None) for key in ("host", "port", "unit"))
        return (host, port, unit) if host and port else None

    for name, other, gimbal in _twice(d.gimbals, address):
        unit = getattr(gimbal, "unit", None)
        at = f"{getattr(gimbal, 'host', '')}:{getattr(gimbal, 'port', '')}" + ("" if unit is None else f", unit {unit}")
        yield ("gimbal", name), "port", getattr(gimbal, "port", NO_VALUE), f"gimbal {other} is at {at} already"


def _sources(d: Devices) -> Iterator[Finding]:
    """No two cameras are one device, or one folder."""
    for key in ("serial", "folder", "socket"):

        def source(camera: CameraSettings, key: str = key) -> Hashable:
            value = getattr(camera, key, None)
            return (camera.driver, str(value)) if value or (key == "serial" and value is not None) else None

        for name, other, camera in _twice(d.cameras, source):
            yield ("camera", name), key, str(getattr(camera, key)), f"camera {other} has the same: each needs its own"


def _twice(devices: Mapping[str, Any], identity: Callable[[Any], Hashable]) -> Iterator[tuple[str, str, Any]]:
    """(name, name of the first one, settings) of each device whose identity is taken; an identity of None is nobody's."""
    first: dict[Hashable, str] = {}
    for name, settings in devices.items():
        mark = identity(settings)
        if mark is not None and first.setdefault(mark, name) != name:
            yield name, first[mark], settings


def _twin(d: Devices) -> Iterator[Finding]:
    """What only the twin can provide needs its table."""
    if d.with_twin:
        return
    for name, camera in d.cameras.items():
        if camera.driver == "synthetic" and not getattr(camera, "socket", ""):
            yield ("camera", name), "driver", camera.driver, "a synthetic camera is fed by the twin: add a [twin] table"
    for name, gimbal in d.gimbals.items():
        if getattr(gimbal, "port", None) == 0:
            yield (
                ("gimbal", name),
                "port",
                0,
                "0 lets the twin pick a free port: add a [twin] table, or set the controller's port",
            )


def _twin_names(d: Devices) -> Iterator[Finding]:
    """The twin's imperfections belong to devices of the cell."""
    if d.twin is None:
        return
    for table, configured, known in (
        (("twin", "error"), d.twin.error, d.gimbal_names),
        (("twin", "clock", "gimbal"), d.twin.clock.gimbal, d.gimbal_names),
        (("twin", "clock", "camera"), d.twin.clock.camera, d.camera_names),
    ):
        for name in configured:
            if name not in known:
                yield (*table, name), None, NO_VALUE, f"the cell has no {name}{nearest(name, known)}"
