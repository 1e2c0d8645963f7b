"""What a configuration needs from this machine, looked at one by one; each finding says how to mend it."""

import asyncio
import importlib.util
import os
import resource
import socket
import time
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

from trackerd.contract.clock import SystemClock
from trackerd.contract.errors import ConfigError, DeviceError
from trackerd.contract.model import Source
from trackerd.formats.calibration import FEWEST_CHECK_POINTS, Calibration, load_calibration
from trackerd.formats.config import CellConfig
from trackerd.formats.settings import CameraSettings, GimbalSettings
from trackerd.wiring.cell import driver, source_of

OPEN_S = 5.0
FILES_WANTED = 4096  # buffers, sockets and USB descriptors; pylon alone asks for some hundred
RTPRIO_WANTED = 50
VERIFY = f"measure {FEWEST_CHECK_POINTS} points or more outside the adjustment, and compare them with their reference values"
BUFFERS = 10  # that the camera library queues


@dataclass(frozen=True, slots=True)
class Finding:
    good: bool
    what: str
    mend: str = ""


def examine(cell: CellConfig) -> Iterator[Finding]:
    """The calibration, the ports, the machine's limits, then each device in turn: it is opened and closed, nothing moves."""
    yield from _calibration(load_calibration(cell.calibration), source_of(cell) is Source.TWIN)
    yield from (_endpoint(endpoint) for endpoint in cell.zenoh.listen)
    yield from _limits()
    yield from _usb(cell)
    for name, camera in cell.cameras.items():
        yield _device("camera", name, camera)
    for name, gimbal in cell.gimbals.items():
        yield _device("gimbal", name, gimbal)


def _calibration(calibration: Calibration, twin: bool) -> Iterator[Finding]:
    """A twin knows its truth: nothing is there to be verified."""
    yield Finding(
        not calibration.forced,
        f"calibration {calibration.id} of {calibration.created} ({calibration.method})",
        f"it was forced past its own chi-square ({calibration.forced_because}): calibrate again",
    )
    v = calibration.verification
    if v is None:
        yield Finding(
            twin, f"check points: none{', and none needed: a twin is true' if twin else ''}", f"it is unverified: {VERIFY}"
        )
        return
    figures = f"rms {v.rms_mm:.3g} mm, maximum {v.max_mm:.3g} mm, En {v.en_max:.3g}"
    until = "" if v.expires is None else f", good until {v.expires}"
    yield Finding(
        calibration.standing(time.time_ns()).verified,
        f"check points: {v.points} on {v.date}, {figures}{until}",
        f"{'; '.join(('it is unverified', *v.shortcomings())) if v.shortcomings() else 'it has expired'}: {VERIFY}",
    )


def _endpoint(endpoint: str) -> Finding:
    """Can the daemon listen there?"""
    protocol, _, address = endpoint.partition("/")
    host, _, port = address.rpartition(":")
    what = f"[zenoh] listen {endpoint}"
    if protocol != "tcp" or not port.isdigit():
        return Finding(True, f"{what}: not tried")
    try:
        with closing(socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET)) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind((host.strip("[]"), int(port)))
    except (OSError, OverflowError) as error:
        return Finding(
            False,
            f"{what}: {getattr(error, 'strerror', error)}",
            "stop who uses the port (ss -ltnp shows it), or choose another in [zenoh]",
        )
    return Finding(True, f"{what}: free")


def _limits() -> Iterator[Finding]:
    files = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    yield Finding(
        files >= 1024,
        f"open files: {files} (the unit asks for {FILES_WANTED})",
        f"ulimit -n {FILES_WANTED}, or LimitNOFILE={FILES_WANTED} in the unit",
    )
    priority = resource.getrlimit(resource.RLIMIT_RTPRIO)[0]
    note = "" if priority >= RTPRIO_WANTED else ": fine on an idle machine; LimitRTPRIO in the unit allows more"
    yield Finding(True, f"real-time priority allowed: {priority}{note}")
    cores = len(os.sched_getaffinity(0))
    yield Finding(cores >= 2, f"cores: {cores}", "one for the images, one for the loop: give the machine a second core")


def _usb(cell: CellConfig) -> Iterator[Finding]:
    """The bus of real USB cameras: speed, permission, and the kernel's memory for transfers against what they queue."""
    live = [camera for camera in cell.cameras.values() if camera.driver == "basler" and camera.source is Source.LIVE]
    if not live:
        return
    vision = import_module("drivers.usb.vision")
    try:
        connected = vision.cameras()
    except vision.NoUsb as error:
        yield Finding(False, f"USB: {error}", "apt install libusb-1.0-0")
        return
    yield Finding(
        len(connected) >= len(live),
        f"USB3 Vision cameras connected: {len(connected)} of {len(live)}",
        "plug them in, each to a USB 3 port of its own controller",
    )
    for camera in connected:
        what = f"USB camera {camera.vendor_id:04x}:{camera.product_id:04x} at {camera.port}"
        yield Finding(not camera.fell_back, f"{what}: USB 3 speed", "it fell back to USB 2: another cable, port or hub")
        yield Finding(
            camera.serial is not None,
            f"{what}: may be opened",
            "copy systemd/70-trackerd.rules to /etc/udev/rules.d, plug it in anew",
        )
    yield from _usb_memory(live)


def _usb_memory(live: list[CameraSettings]) -> Iterator[Finding]:
    setting = Path("/sys/module/usbcore/parameters/usbfs_memory_mb")
    if not setting.exists():
        yield Finding(False, "USB: the kernel has no usbcore", "this machine has no USB: run on one that has")
        return
    need_mb, have_mb = round(sum(BUFFERS * c.width_px * c.height_px for c in live) / 2**20), int(setting.read_text())
    yield Finding(
        have_mb == 0 or have_mb >= need_mb,
        f"USB transfer memory: {have_mb} MB for {need_mb} MB of buffers",
        f"echo 1000 > {setting}, and usbcore.usbfs_memory_mb=1000 on the kernel's command line",
    )


def _device(role: str, name: str, settings: CameraSettings | GimbalSettings) -> Finding:
    what = f"{role} {name} ({settings.driver})"
    if getattr(settings, "port", None) == 0 or settings.driver == "synthetic":
        return Finding(True, f"{what}: the twin's, started with the cell")
    try:
        return Finding(True, f"{what}: {asyncio.run(_opened(role, name, settings))}")
    except (ConfigError, DeviceError) as error:
        return Finding(False, f"{what}: {error}", _mend(role, settings))
    except TimeoutError:
        return Finding(False, f"{what}: not open after {OPEN_S:g} s", _mend(role, settings))


async def _opened(role: str, name: str, settings: CameraSettings | GimbalSettings) -> str:
    module = driver(role, settings.driver)
    opener = module.open_camera if role == "camera" else module.open_gimbal
    async with asyncio.timeout(OPEN_S), opener(name, settings, SystemClock()) as device:
        info = device.info
        return f"{getattr(info, 'model', '') or 'controller'} {info.serial}".strip()


def _mend(role: str, settings: CameraSettings | GimbalSettings) -> str:
    if settings.driver == "basler" and importlib.util.find_spec("pypylon") is None:
        return "pip install 'trackerd[basler]'"
    if role == "camera":
        return "plug it in (a USB 3 port, a short cable), and copy the udev rule of systemd/ to /etc/udev/rules.d"
    return "switch it on, and try: ping its address; is its Modbus server enabled, and nobody else connected?"
