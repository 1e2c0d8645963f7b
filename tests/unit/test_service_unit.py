"""The files that a machine gets: the systemd unit, the udev rules, the kernel's settings."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from trackerd.wiring.check import RTPRIO_WANTED

SYSTEMD = Path(__file__).parents[2] / "systemd"
UNIT = SYSTEMD / "trackerd.service"
ANALYZE = shutil.which("systemd-analyze")
MOST_EXPOSED = 3.0  # of 10: a service that needs the network and USB devices has about 2

needs_systemd = pytest.mark.skipif(ANALYZE is None, reason="needs the Debian package systemd")


def analyze(*arguments: str) -> str:
    assert ANALYZE is not None
    done = subprocess.run([ANALYZE, "--no-pager", *arguments], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout + done.stderr


@needs_systemd
def test_systemd_understands_every_line_of_the_unit(tmp_path: Path) -> None:
    """With a program that is there: ours is installed by the user."""
    unit = tmp_path / UNIT.name
    unit.write_text(re.sub(r"^ExecStart=\S+", "ExecStart=/bin/true", UNIT.read_text(), flags=re.MULTILINE))
    assert str(unit) not in analyze("verify", "--man=no", str(unit))


@needs_systemd
def test_the_service_is_shut_in() -> None:
    found = re.search(
        r"Overall exposure level for trackerd.service: ([\d.]+)", analyze("security", "--offline=true", str(UNIT))
    )
    assert found is not None
    assert float(found[1]) <= MOST_EXPOSED


def test_the_unit_says_what_the_daemon_does() -> None:
    values = dict(re.findall(r"^(\w+)=(.*)$", UNIT.read_text(), re.MULTILINE))
    assert (values["Type"], values["NotifyAccess"]) == ("notify", "main")
    assert float(values["WatchdogSec"]) > 0
    assert values["RestartPreventExitStatus"] == "2"
    assert int(values["LimitRTPRIO"]) >= RTPRIO_WANTED
    assert "AF_UNIX" in values["RestrictAddressFamilies"]


RULE = re.compile(r'^(?:[A-Z]+(?:\{\w+\})?\s*(?:==|!=|=|\+=)\s*"[^"]*"(?:,\s*|$))+$')


def test_every_udev_rule_parses_and_gives_cameras_to_plugdev() -> None:
    lines = (SYSTEMD / "70-trackerd.rules").read_text().splitlines()
    rules = [line for line in lines if line and not line.startswith("#")]
    assert rules
    for rule in rules:
        assert RULE.match(rule), rule
        assert 'GROUP="plugdev"' in rule
        assert 'ENV{DEVTYPE}=="usb_device"' in rule
    assert any("*:ef0500:*" in rule for rule in rules), "USB3 Vision, whoever made it"


@pytest.mark.skipif(shutil.which("udevadm") is None, reason="needs the Debian package udev")
def test_udev_accepts_the_rules() -> None:
    told = subprocess.run(["udevadm", "--help"], capture_output=True, text=True, check=True).stdout
    if " verify " not in told:
        pytest.skip("this udevadm cannot verify rules: it came with version 254")
    subprocess.run(["udevadm", "verify", SYSTEMD / "70-trackerd.rules"], check=True)


def test_every_kernel_setting_is_a_key_and_a_number() -> None:
    lines = (SYSTEMD / "70-trackerd-sysctl.conf").read_text().splitlines()
    assert all(line.startswith("#") or re.fullmatch(r"[a-z_.]+ = \d+", line) for line in lines if line)
