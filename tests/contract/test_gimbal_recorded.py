"""What is particular to the gimbals that only tell angles: replay and fixed."""

from math import pi
from pathlib import Path

import pytest

from drivers.gimbal import fixed, replay
from trackerd.contract.clock import ClockKind, HostNs, ManualClock
from trackerd.contract.errors import ConfigError
from trackerd.contract.model import AxisCommand, GimbalInfo, GimbalReport, Latch

HEADER = "gimbal,frame,t_ns,az_rad,el_rad\n"


async def played(csv: Path, name: str = "left") -> tuple[GimbalInfo, GimbalReport]:
    settings = replay.Settings(driver="replay", camera=name, csv=csv)
    async with replay.open_gimbal(name, settings, ManualClock(HostNs(9))) as gimbal:
        return gimbal.info, await gimbal.exchange(AxisCommand(7, az_rad=3.0))


async def test_every_report_carries_the_gimbals_own_rows_newest_first(tmp_path: Path) -> None:
    csv = tmp_path / "angles.csv"
    csv.write_text(HEADER + "left,0,1499,0.1,0.2\nright,0,1400,9,9\nleft,2,40001500,0.3,-0.4\n\n")
    info, report = await played(csv)
    assert (info.steerable, info.clock, info.edges) == (False, ClockKind.RECORDING, 1)
    assert report.latches == (Latch(2, False, 0.3, -0.4, 40_002), Latch(0, False, 0.1, 0.2, 1))
    assert (report.az_rad, report.el_rad, report.instant, report.echo) == (0.3, -0.4, 40_002, 7)
    assert (report.sent, report.received) == (9, 9)


async def test_columns_may_stand_in_any_order_beside_others(tmp_path: Path) -> None:
    csv = tmp_path / "angles.csv"
    csv.write_text("note,el_rad,az_rad,t_ns,frame,gimbal\nx,0.2,0.1,1000,0,left\n")
    _, report = await played(csv)
    assert report.latches == (Latch(0, False, 0.1, 0.2, 1),)


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("gimbal,frame,t_ns,az_rad\nleft,0,1,2\n", r"line 1: no column el_rad: needs gimbal,frame,t_ns,az_rad,el_rad"),
        (HEADER + "right,0,1,2,3\n", r"no row for gimbal 'left' \(there are: right\)"),
        (HEADER, r"no row for gimbal 'left' \(there are: none\)"),
        (HEADER + "left,0,1,0,0\nleft,0,2,0,0\n", r"line 3: frame = '0': must increase from row to row of gimbal left"),
        (HEADER + "left,0,5,0,0\nleft,1,5,0,0\n", r"line 3: t_ns = '5': must increase"),
        (HEADER + "left,0,1.5,0,0\n", r"line 2: t_ns = '1.5': must be a whole number"),
        (HEADER + "left,-1,1,0,0\n", r"line 2: frame = '-1': must be a whole number"),
        (HEADER + "left,0,1,nan,0\n", r"line 2: az_rad = 'nan': must be a finite number"),
        (HEADER + "left,0,1,0,abc\n", r"line 2: el_rad = 'abc': must be a finite number"),
        (HEADER + "left,0,1,0\n", r"line 2: el_rad = '': must be a finite number"),
    ],
)
async def test_a_bad_table_names_file_line_column_and_value(tmp_path: Path, text: str, error: str) -> None:
    csv = tmp_path / "angles.csv"
    csv.write_text(text)
    with pytest.raises(ConfigError, match=rf"angles\.csv.*{error}"):
        await played(csv)


async def test_a_missing_or_binary_table_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"none\.csv: cannot be read"):
        await played(tmp_path / "none.csv")
    (tmp_path / "image.csv").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ConfigError, match=r"image\.csv: cannot be read"):
        await played(tmp_path / "image.csv")


async def test_a_fixed_gimbal_tells_its_two_angles_for_ever() -> None:
    settings = fixed.Settings(driver="fixed", camera="left", az_deg=90.0, el_deg=-45.0)
    async with fixed.open_gimbal("left", settings, ManualClock()) as gimbal:
        reports = [await gimbal.exchange(AxisCommand(n, az_rad=1.0)) for n in (1, 2)]
        assert (gimbal.info.steerable, gimbal.info.clock, gimbal.info.edges) == (False, ClockKind.NONE, 0)
    assert [(report.az_rad, report.el_rad, report.latches) for report in reports] == [(pi / 2, -pi / 4, ())] * 2
