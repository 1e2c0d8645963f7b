"""`trackerd check`: what it finds on this machine, and that every finding says how to mend it."""

import asyncio
import importlib.util
import socket
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, closing
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from drivers.usb.vision import NoUsb, UsbCamera
from trackerd.cli import main
from trackerd.contract.errors import DeviceMissing
from trackerd.formats.calibration import Verification, load_calibration, save_calibration
from trackerd.wiring import check
from trackerd.wiring.cell import load
from trackerd.wiring.check import Finding, examine

CONFIG = Path(__file__).parents[2] / "config"
TO_MEND = 4
IPV6 = Path("/proc/net/if_inet6")


def free_port() -> int:
    with closing(socket.create_server(("127.0.0.1", 0))) as server:
        return int(server.getsockname()[1])


def nobody_listens() -> list[str]:
    """The user's cell, its controllers where nobody is."""
    overrides = [f'zenoh.listen=["tcp/127.0.0.1:{free_port()}"]']
    return overrides + [
        f"gimbal.{name}.{key}" for name in ("left", "right") for key in ("host=127.0.0.1", f"port={free_port()}")
    ]


def findings(file: str = "cell.toml", *overrides: str) -> list[Finding]:
    return list(examine(load(CONFIG / file, [*nobody_listens(), *overrides])))


def about(found: list[Finding], words: str) -> Finding:
    [one] = [finding for finding in found if words in finding.what]
    return one


@pytest.fixture
def no_cameras(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pylon takes seconds to find out that nothing is connected."""

    @asynccontextmanager
    async def open_camera(name: str, *_: Any) -> AsyncIterator[None]:
        raise DeviceMissing(f"camera {name}", "find serial 24587345", "no such camera is connected")
        yield

    real = check.driver
    absent = SimpleNamespace(open_camera=open_camera)
    monkeypatch.setattr(check, "driver", lambda role, name: absent if role == "camera" else real(role, name))


@pytest.fixture
def usb(monkeypatch: pytest.MonkeyPatch) -> list[UsbCamera]:
    """The cameras on the bus."""
    connected: list[UsbCamera] = []
    monkeypatch.setattr("drivers.usb.vision.cameras", lambda: connected)
    return connected


def test_the_demo_needs_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    listen = f'zenoh.listen=["tcp/127.0.0.1:{free_port()}"]'
    assert main(["check", "--config", str(CONFIG / "demo.toml"), "--set", listen]) == 0
    told = capsys.readouterr().out
    assert "demo.toml: the configuration is sound" in told
    assert "gimbal left (modbus): the twin's, started with the cell" in told
    assert "MEND" not in told


@pytest.mark.usefixtures("no_cameras", "usb")
def test_devices_that_are_not_there_are_named_with_what_to_do(capsys: pytest.CaptureFixture[str]) -> None:
    overrides = [word for text in nobody_listens() for word in ("--set", text)]
    assert main(["check", "--config", str(CONFIG / "cell.toml"), *overrides]) == TO_MEND
    told = capsys.readouterr().out
    assert "MEND camera left (basler): camera left: find serial 24587345: no such camera is connected" in told
    assert "plug it in (a USB 3 port, a short cable)" in told
    assert "MEND gimbal right (modbus): gimbal right: connect to 127.0.0.1:" in told
    assert "switch it on, and try: ping its address" in told


@pytest.mark.usefixtures("no_cameras", "usb")
def test_every_finding_that_is_not_good_says_how_to_mend_it() -> None:
    found = findings()
    assert [finding for finding in found if not finding.good]
    assert all(finding.mend for finding in found if not finding.good)


@pytest.mark.usefixtures("no_cameras", "usb")
def test_a_device_that_never_opens_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    @asynccontextmanager
    async def open_gimbal(*_: Any) -> AsyncIterator[None]:
        await asyncio.Event().wait()
        yield

    monkeypatch.setattr(check, "OPEN_S", 0.0)
    monkeypatch.setattr(check, "driver", lambda *_: SimpleNamespace(open_camera=open_gimbal, open_gimbal=open_gimbal))
    assert about(findings(), "gimbal left (modbus): not open after 0 s").mend


def test_a_mount_that_does_not_move_is_opened_and_closed(tmp_path: Path) -> None:
    (tmp_path / "left").mkdir()
    file = tmp_path / "cell.toml"
    tables = [f'calibration = "{CONFIG}/demo-calibration.toml"', "[probe]", "radius_mm = 4.0", "[zenoh]", "listen = []"]
    for name in ("left", "right"):
        (tmp_path / name).mkdir(exist_ok=True)
        tables += [f"[camera.{name}]", 'driver = "replay"', f'folder = "{name}"']
        tables += [f"[gimbal.{name}]", 'driver = "fixed"', f'camera = "{name}"']
    file.write_text("\n".join(tables))
    found = list(examine(load(file)))
    assert about(found, "gimbal left (fixed): controller").good
    empty = about(found, "camera left (replay)")
    assert not empty.good
    assert str(tmp_path / "left") in empty.what


# ---- the calibration, the ports, the machine -------------------------------------------------------------------------


def test_a_calibration_that_was_forced_is_told(tmp_path: Path) -> None:
    [calibration, *_] = judged(tmp_path, forced=True, forced_because="the fair opens at nine")
    assert not calibration.good
    assert "forced past its own chi-square (the fair opens at nine)" in calibration.mend


CHECKED = Verification("2025-03-01", points=12, rms_mm=0.04, max_mm=0.09, en_max=0.8, expires="2999-01-01")


@pytest.mark.parametrize(
    ("verification", "what", "mend"),
    [
        (CHECKED, "check points: 12 on 2025-03-01, rms 0.04 mm, maximum 0.09 mm, En 0.8, good until 2999-01-01", None),
        (None, "check points: none", "it is unverified: measure 8 points or more outside the adjustment"),
        (replace(CHECKED, en_max=1.2), "En 1.2", "it is unverified; En 1.2 above 1: measure 8 points"),
        (replace(CHECKED, expires="2025-06-01"), "good until 2025-06-01", "it has expired: measure 8 points"),
    ],
)
@pytest.mark.usefixtures("no_cameras", "usb")
def test_a_calibration_that_no_check_points_verify_any_more_is_told(
    tmp_path: Path, verification: Verification | None, what: str, mend: str | None
) -> None:
    found = about(judged(tmp_path, "cell.toml", verification=verification), "check points:")
    assert what in found.what
    assert found.good is (mend is None)
    assert mend is None or found.mend.startswith(mend)


def test_a_twin_needs_no_check_points(tmp_path: Path) -> None:
    assert about(judged(tmp_path), "check points: none").good


def judged(tmp_path: Path, cell: str = "demo.toml", **changes: Any) -> list[Finding]:
    """What is found where the calibration is the demo's with these changes."""
    save_calibration(replace(load_calibration(CONFIG / "demo-calibration.toml"), **changes), tmp_path / "c.toml")
    overrides = [f"calibration={tmp_path / 'c.toml'}", *(nobody_listens() if cell == "cell.toml" else [])]
    return list(examine(load(CONFIG / cell, overrides)))


@pytest.mark.parametrize(
    ("endpoint", "good", "words"),
    [
        ("tcp/127.0.0.1:0", True, "free"),
        ("tcp/[::1]:0", True, "free"),
        ("udp/127.0.0.1:7447", True, "not tried"),
        ("tcp/127.0.0.1:7447#iface=lo", True, "not tried"),
        ("tcp/192.0.2.1:7447", False, "Cannot assign requested address"),
        ("tcp/127.0.0.1:99999", False, "0-65535"),
    ],
)
def test_an_endpoint_is_tried(endpoint: str, good: bool, words: str) -> None:
    if "::1" in endpoint and not (IPV6.exists() and "lo" in IPV6.read_text().split()):
        pytest.skip("this machine has no IPv6")
    found = check._endpoint(endpoint)
    assert found.good is good
    assert words in found.what


def test_a_port_that_is_taken_says_how_to_find_who_has_it() -> None:
    with closing(socket.create_server(("127.0.0.1", 0))) as server:
        found = check._endpoint(f"tcp/127.0.0.1:{server.getsockname()[1]}")
    assert (found.good, "Address already in use" in found.what, "ss -ltnp" in found.mend) == (False, True, True)


def test_few_files_and_one_core_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(check.resource, "getrlimit", lambda _: (256, 4096))
    monkeypatch.setattr(check.os, "sched_getaffinity", lambda _: {0})
    found = list(check._limits())
    assert not about(found, "open files: 256").good
    assert not about(found, "cores: 1").good


# ---- USB -------------------------------------------------------------------------------------------------------------


def camera(speed: int = 4, serial: str | None = "24587345") -> UsbCamera:
    return UsbCamera(0x2676, 0xBA02, "2-1", speed, serial)


@pytest.mark.usefixtures("no_cameras")
def test_cameras_on_usb_2_or_without_permission_are_told(usb: list[UsbCamera]) -> None:
    usb += [camera(), camera(speed=3, serial=None)]
    found = findings()
    assert about(found, "USB3 Vision cameras connected: 2 of 2").good
    assert [finding.good for finding in found if "USB 3 speed" in finding.what] == [True, False]
    locked = [finding for finding in found if "may be opened" in finding.what]
    assert [finding.good for finding in locked] == [True, False]
    assert "70-trackerd.rules" in locked[1].mend


@pytest.mark.usefixtures("no_cameras")
def test_a_camera_that_is_not_plugged_in_is_missed(usb: list[UsbCamera]) -> None:
    usb.append(camera())
    assert not about(findings(), "USB3 Vision cameras connected: 1 of 2").good


@pytest.mark.usefixtures("no_cameras")
def test_without_libusb_the_package_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    def cameras() -> None:
        raise NoUsb("libusb-1.0 is not installed")

    monkeypatch.setattr("drivers.usb.vision.cameras", cameras)
    assert about(findings(), "USB: libusb-1.0 is not installed").mend == "apt install libusb-1.0-0"


@pytest.mark.parametrize(("have", "good"), [(16, False), (60, True), (0, True), (None, False)])
def test_the_kernels_usb_memory_is_set_against_what_the_cameras_queue(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, have: int | None, good: bool
) -> None:
    setting = tmp_path / "usbfs_memory_mb"
    if have is not None:
        setting.write_text(f"{have}\n")
    monkeypatch.setattr(check, "Path", lambda _: setting)
    [found] = check._usb_memory(list(load(CONFIG / "cell.toml").cameras.values()))
    assert found.good is good
    if have:
        assert f"{have} MB for 60 MB" in found.what


def test_a_missing_sdk_is_told_with_its_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: None)
    assert check._mend("camera", load(CONFIG / "cell.toml").cameras["left"]) == "pip install 'trackerd[basler]'"
