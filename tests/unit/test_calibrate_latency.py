"""`trackerd calibrate latency`, end to end: a recorded sweep with late latches, calibrated, and taken back by the daemon."""

import tomllib
from pathlib import Path

import numpy as np
import pytest

from drivers.gimbal.replay import Settings as ReplaySettings
from drivers.gimbal.replay import open_gimbal
from trackerd.cli import main
from trackerd.contract.clock import CameraNs, HostNs, ManualClock
from trackerd.contract.errors import ConfigError
from trackerd.contract.model import Array, AxisAngles, AxisCommand, Frame
from trackerd.engine.latched import LatchedAngles, RecordingTime
from trackerd.formats.calibration import load_calibration
from trackerd.formats.recorded import recorded_angles
from trackerd.sim.record import TICK_NS
from trackerd.twin.cell import scene_of
from trackerd.wiring.cell import load

DEMO = Path(__file__).parents[2] / "config" / "demo.toml"
DONE, WRONG, REFUSED = 0, 2, 3
HEAD = "gimbal,frame,t_ns,az_rad,el_rad\n"
LATE_US = 250.0
CELL = [f"camera.{name}.{key}" for name in ("left", "right") for key in ("exposure_us=400", "width_px=448", "height_px=352")]
CELL += [f"camera.{name}.{key}" for name in ("left", "right") for key in ("offset_x_px=800", "offset_y_px=592")]
STILL = ["twin.path.kind=still", "twin.path.dwell_s=0", f"twin.encoder.latch_skew_us={LATE_US}"]
SWEEP = ["twin.sweep.az_deg=0.22", "twin.sweep.el_deg=0.18", "twin.sweep.az_hz=6.7", "twin.sweep.el_hz=7.9"]


def overrides(*values: str) -> list[str]:
    return [word for value in values for word in ("--set", value)]


def record(folder: Path, seconds: float, *values: str) -> None:
    twin = ["twin", "--record", str(folder), "--duration", str(seconds)]
    assert main(["--config", str(DEMO), *overrides(*CELL, *STILL, *values), *twin]) == DONE


@pytest.fixture(scope="module")
def sweep(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("sweep")
    record(folder, 2.5, *SWEEP)
    return folder


def calibrate(*arguments: str, cell: bool = True) -> int:
    config = ["--config", str(DEMO), *overrides(*CELL)] if cell else []
    return main([*config, "calibrate", "latency", *arguments])


def drive(table: Path, *values: str) -> tuple[list[int], Array]:
    """A run of the same late gimbal without images: writes its angles, returns the instants and the true angles (n, 2)."""
    cell = load(DEMO, [*CELL, *STILL, *values])
    scene = scene_of(cell, load_calibration(cell.calibration).stations)
    scene.place()
    trigger, tick_ns = scene.trigger("left"), 0
    instants, rows, angles = [], [HEAD], []
    for frame_id in range(110):
        begin_ns = trigger.begin_ns(frame_id)
        mid_ns, end_ns = begin_ns + trigger.exposure_ns // 2, begin_ns + trigger.exposure_ns
        while tick_ns <= end_ns:
            scene.follow(tick_ns, tick_ns + TICK_NS)
            tick_ns += TICK_NS
        az, el = scene.latched("left", begin_ns, end_ns)
        rows.append(f"left,{frame_id},{mid_ns},{az:.12f},{el:.12f}\n")
        instants.append(mid_ns)
        angles.append(scene.gimbals["left"].angles(mid_ns))
    table.write_text("".join(rows))
    return instants, np.array(angles)


async def as_the_daemon_has_them(table: Path, lines: dict[str, list[float]], instants_ns: list[int]) -> Array:
    """Recorded angles of the left gimbal through the replay driver and the engine, with a configuration's lines."""
    settings = ReplaySettings(driver="replay", camera="left", csv=table, **lines)
    clock, found = ManualClock(HostNs(10**12)), []
    async with open_gimbal("left", settings, clock) as gimbal:
        latched = LatchedAngles(gimbal.info, settings, RecordingTime(), 10**9)
        for frame_id, mid_ns in enumerate(instants_ns):
            latched.reported(await gimbal.exchange(AxisCommand(0)))
            frame = Frame(np.zeros((2, 2), np.uint8), frame_id, CameraNs(mid_ns), clock.now(), 400_000)
            angles = latched.match(frame, clock.now())
            assert isinstance(angles, AxisAngles)
            found.append((angles.az_rad, angles.el_rad))
            clock.advance(0.018)
    return np.array(found)


async def test_a_recorded_sweep_tells_the_latency_and_the_daemon_takes_it_back(
    sweep: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    capsys.readouterr()
    assert calibrate(str(sweep), "--station", "left", "--out", str(tmp_path / "late.svg")) == DONE
    told = capsys.readouterr().out
    lines = tomllib.loads(told[told.index("[gimbal.left]") :])["gimbal"]["left"]
    for late_us, sigma_us in zip(lines["latch_offset_us"], lines["latch_offset_sigma_us"], strict=True):
        assert sigma_us < 10.0
        assert late_us == pytest.approx(LATE_US, abs=3.0 * sigma_us + 3.0)
    for words in ("latency AZ: +", "latency EL: +", "together: +", "degrees of freedom", "smeared by up to"):
        assert words in told
    assert "speed, deg/s" in (tmp_path / "late.svg").read_text()
    following = ["twin.sweep.az_deg=4", "twin.sweep.el_deg=3", "twin.sweep.az_hz=0.8", "twin.sweep.el_hz=1.1"]
    instants_ns, true = drive(tmp_path / "angles.csv", *following)
    speeds = np.gradient(true, np.array(instants_ns) * 1e-9, axis=0)
    for corrected, expected_us in ((lines, 0.0), ({}, LATE_US)):
        off = await as_the_daemon_has_them(tmp_path / "angles.csv", corrected, instants_ns) - true
        late_us = (off * speeds)[3:].sum(axis=0) / (speeds**2)[3:].sum(axis=0) * 1e6
        assert late_us == pytest.approx((expected_us, expected_us), abs=25.0)


def test_a_stations_folder_and_no_configuration_will_do(
    sweep: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    capsys.readouterr()
    assert calibrate(str(sweep / "right"), "--out", str(tmp_path / "late.png"), cell=False) == DONE
    told = capsys.readouterr().out
    assert "[gimbal.right]" in told
    assert "smeared" not in told
    lines = tomllib.loads(told[told.index("[gimbal.right]") :])["gimbal"]["right"]
    assert lines["latch_offset_us"][0] == pytest.approx(LATE_US, abs=3.0 * lines["latch_offset_sigma_us"][0] + 3.0)
    assert (tmp_path / "late.png").stat().st_size > 10_000


def test_what_a_recording_does_not_tell_is_refused_station_by_station(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    record(tmp_path / "still", 0.9)
    capsys.readouterr()
    assert calibrate(str(tmp_path / "still"), "--out", str(tmp_path / "late.svg")) == REFUSED
    told = capsys.readouterr().err.splitlines()
    assert [line.partition(" axis")[0] for line in told] == ["trackerd: left: the AZ", "trackerd: right: the AZ"]
    assert all("does not sweep" in line and "move both axes to and fro" in line for line in told)
    assert not list(tmp_path.glob("late*"))


def test_a_ball_that_is_seldom_seen_is_told_with_the_reason(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    record(tmp_path / "far", 0.5, "twin.sweep.az_deg=3", "twin.sweep.el_deg=3", "twin.sweep.az_hz=1", "twin.sweep.el_hz=1.3")
    assert calibrate(str(tmp_path / "far"), "--station", "left", "--out", str(tmp_path / "late.svg")) == REFUSED
    assert "frames, most often because of this: the guess" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("SWEEP", "--out", "late.txt"), "--out late.txt: must end in .svg, .png, .pdf"),
        (("SWEEP", "--station", "top"), "--station top: there is no such station (there are: left, right)"),
        (("missing",), "missing: there is no such file or folder"),
        (("SWEEP/left/000000.bmp",), "no recording: needs angles.csv, and a folder of frames with its NAME.csv"),
    ],
)
def test_wrong_usage_is_told(sweep: Path, arguments: tuple[str, ...], words: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert calibrate(*(word.replace("SWEEP", str(sweep)) for word in arguments)) == WRONG
    assert words in capsys.readouterr().err


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (HEAD + "right,0,5,0.1,0.2\n", "no row for gimbal 'left' (there are: right)"),
        (HEAD + "left,0,5,nan,0.2\n", "line 2: its angles are no finite numbers: az_rad, el_rad = (nan, 0.2)"),
        (HEAD + "left,0,5,much,0.2\n", "needs the columns gimbal,frame,t_ns,az_rad,el_rad, with numbers in every row"),
        ("gimbal,frame\nleft,0\n", "needs the columns gimbal,frame,t_ns,az_rad,el_rad"),
        (None, "cannot be read"),
    ],
)
def test_a_table_of_angles_that_is_none_is_told(tmp_path: Path, text: str | None, words: str) -> None:
    if text is not None:
        (tmp_path / "angles.csv").write_text(text)
    with pytest.raises(ConfigError) as error:
        recorded_angles(tmp_path / "angles.csv", "left")
    assert words in str(error.value)
    assert "angles.csv" in str(error.value)
