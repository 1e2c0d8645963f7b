"""Every wrong configuration is told by file, table, key, value and rule."""

from collections.abc import Sequence
from pathlib import Path

import pytest

import drivers
from trackerd.contract.errors import ConfigError
from trackerd.formats.config import CellConfig, load_cell
from trackerd.formats.settings import Settings

CONFIG = Path(__file__).parents[2] / "config"
CELL = """\
name = "cell"
calibration = "calibration.toml"

[probe]
radius_mm = 4.0

[camera.left]
driver = "synthetic"
width_px = 640
height_px = 480
offset_x_px = 704
offset_y_px = 528

[camera.right]
driver = "synthetic"

[gimbal.left]
driver = "modbus"
camera = "left"
host = "10.0.0.1"

[gimbal.left.steering]
gain = 0.7

[gimbal.right]
driver = "modbus"
camera = "right"
host = "10.0.0.2"

[twin]
seed = 1
"""


def settings_of(role: str, driver: str) -> type[Settings]:
    model: type[Settings] = drivers.load(role, driver).Settings
    return model


def load(folder: Path, text: str, overrides: Sequence[str] = ()) -> CellConfig:
    (folder / "calibration.toml").write_bytes((CONFIG / "demo-calibration.toml").read_bytes())
    (folder / "cell.toml").write_text(text)
    return load_cell(folder / "cell.toml", overrides, settings_of=settings_of)


def errors(folder: Path, text: str, overrides: Sequence[str] = ()) -> list[str]:
    with pytest.raises(ConfigError) as caught:
        load(folder, text, overrides)
    return str(caught.value).splitlines()


# what is replaced in the cell above, by what, and the line that this must give after the file's name
WRONG = [
    ("gain = 0.7", "gain = 1.4", "[gimbal.left.steering] gain = 1.4: must be above 0 and at most 1"),
    ("gain = 0.7", 'gain = "0.7"', '[gimbal.left.steering] gain = "0.7": must be a number'),
    ("gain = 0.7", "gain = true", "[gimbal.left.steering] gain = true: must be a number"),
    ("gain = 0.7", "gain = nan", "[gimbal.left.steering] gain = nan: must be a finite number"),
    ("gain = 0.7", "gian = 0.7", "[gimbal.left.steering] gian = 0.7: unknown key (did you mean gain?)"),
    ("gain = 0.7", "feed_forward = 1", "[gimbal.left.steering] feed_forward = 1: must be true or false"),
    (
        "gain = 0.7",
        'rearm = "auto"',
        '[gimbal.left.steering] rearm = "auto": must be one of "automatic" or "operator"',
    ),
    (
        "gain = 0.7",
        "az_limits_deg = [30, -30]",
        "[gimbal.left.steering] az_limits_deg = [30, -30]: the lower limit must be below the upper one",
    ),
    ("gain = 0.7", "el_limits_deg = [30]", "[gimbal.left.steering] el_limits_deg = [30]: needs 2 values"),
    (
        "gain = 0.7",
        "el_limits_deg = [-400, 30]",
        "[gimbal.left.steering] el_limits_deg = [-400, 30]: must lie within -360 and 360 degrees",
    ),
    (
        "gain = 0.7",
        "az_limits_deg = [0, 0.3]",
        "[gimbal.left.steering] az_limits_deg = [0, 0.3]: leaves no room for the test of the axes"
        " by test_deg = 0.2 to both sides",
    ),
    (
        "gain = 0.7",
        "aim_px = [1023, 1200]",
        "[gimbal.left.steering] aim_px = [1023.0, 1200.0]: outside what camera left sees, x 704..1343, y 528..1007"
        " (pixels of the sensor)",
    ),
    (
        "[gimbal.right]",
        "[gimbal.right.tracking]\ntarget_px = [2048, 0]\n[gimbal.right]",
        "[gimbal.right.tracking] target_px = [2048.0, 0.0]: outside what camera right sees, x 0..2047, y 0..1535"
        " (pixels of the sensor)",
    ),
    (
        "[gimbal.right]",
        "[gimbal.right.tracking]\nradius_px = [50, 20]\n[gimbal.right]",
        "[gimbal.right.tracking] radius_px = [50, 20]: needs 3 <= smallest < largest",
    ),
    (
        "[gimbal.right]",
        "[gimbal.right.tracking]\ntarget_radius_px = 60.0\n[gimbal.right]",
        "[gimbal.right.tracking] target_radius_px = 60.0: needs target_px: the two are one guess of where the target is",
    ),
    (
        "[gimbal.right]",
        "[gimbal.right.tracking]\ntarget_px = [1020, 760]\ntarget_radius_px = 600\n[gimbal.right]",
        "[gimbal.right.tracking] target_radius_px = 600: must lie within radius_px = [12, 250]",
    ),
    ('host = "10.0.0.1"', "", "[gimbal.left] host: is missing and has no default"),
    ('host = "10.0.0.1"', "host = 10", "[gimbal.left] host = 10: must be text in quotes"),
    (
        'host = "10.0.0.1"',
        'host = "10.0.0.1"\nport = 70000',
        "[gimbal.left] port = 70000: must be at least 0 and at most 65535",
    ),
    (
        'host = "10.0.0.1"',
        'host = "10.0.0.1"\nport = 502.5',
        "[gimbal.left] port = 502.5: must be a whole number",
    ),
    (
        'host = "10.0.0.1"',
        'host = "10.0.0.1"\ncycle_ms = 30',
        "[gimbal.left] cycle_ms = 30: must be at most half of steering.watchdog_ms = 50",
    ),
    (
        'host = "10.0.0.1"',
        'host = "10.0.0.1"\nstale_ms = 8',
        "[gimbal.left] stale_ms = 8: must be at least two cycles of cycle_ms = 5",
    ),
    (
        'host = "10.0.0.1"',
        'host = "10.0.0.1"\nlatch_offset_us = 250.0',
        "[gimbal.left] latch_offset_us = 250.0: must be a list in [ ]",
    ),
    (
        'host = "10.0.0.1"',
        'host = "10.0.0.1"\nlatch_offset_us = [250.0, 18182.0]',
        "[gimbal.left] latch_offset_us = [250.0, 18182.0]: must be at most 5000",
    ),
    (
        'host = "10.0.0.1"',
        'host = "10.0.0.1"\nlatch_offset_sigma_us = [-1.0, 1.0]',
        "[gimbal.left] latch_offset_sigma_us = [-1.0, 1.0]: must be at least 0",
    ),
    ('host = "10.0.0.2"', 'host = "10.0.0.1"', "[gimbal.right] port = 502: gimbal left is at 10.0.0.1:502, unit 1 already"),
    (
        'camera = "right"',
        'camera = "rihgt"',
        '[gimbal.right] camera = "rihgt": there is no [camera.rihgt] (did you mean right?)',
    ),
    ('camera = "right"', 'camera = "left"', '[gimbal.right] camera = "left": gimbal left carries this camera already'),
    (
        "[gimbal.right]",
        '[camera.spare]\ndriver = "synthetic"\n[gimbal.right]',
        '[camera.spare]: no gimbal carries this camera: set camera = "spare" in one, or delete the table',
    ),
    (
        '[gimbal.right]\ndriver = "modbus"\ncamera = "right"\nhost = "10.0.0.2"',
        "",
        "[gimbal]: a position needs at least 2 gimbals [gimbal.NAME] (there is: left)",
    ),
    (
        "[gimbal.right]",
        "[gimbal.rear]",
        '[gimbal.rear]: calibration "demo-1" has no station rear (it has: left, right)',
    ),
    (
        "[gimbal.right]",
        "[gimbal.Right]",
        "[gimbal.Right]: a name has small letters, digits, - and _ only, and begins with a letter",
    ),
    (
        '[camera.right]\ndriver = "synthetic"',
        '[camera.right]\ndriver = "synthetik"',
        '[camera.right] driver = "synthetik": no such camera driver (there are: basler, replay, synthetic)',
    ),
    ('[camera.right]\ndriver = "synthetic"', "[camera.right]", "[camera.right] driver: is missing and has no default"),
    (
        "width_px = 640",
        "exposure_us = 20000",
        "[camera.left] exposure_us = 20000: must not be longer than the frame period, 18182 us at frame_rate_hz = 55",
    ),
    ("width_px = 640", 'exposure_us = "2 ms"', '[camera.left] exposure_us = "2 ms": must be a number'),
    ("width_px = 640", "exposure_us = 0", "[camera.left] exposure_us = 0: must be above 0 and at most 1e+06"),
    (
        "width_px = 640",
        "width_px = 2048",
        "[camera.left] width_px = 2048: the region ends at 704 + 2048 = 2752 px, but the calibrated sensor has 2048 px",
    ),
    ("offset_y_px = 528", "offset_y_px = -1", "[camera.left] offset_y_px = -1: must be at least 0"),
    (
        "[twin]\nseed = 1",
        "",
        '[camera.left] driver = "synthetic": a synthetic camera is fed by the twin: add a [twin] table',
    ),
    (
        "[twin]\nseed = 1",
        "[zenoh]\nlease_ms = 10",
        "[zenoh] lease_ms = 10: must be at least 500 and at most 60000",
    ),
    ("seed = 1", "seed = -1", "[twin] seed = -1: must be at least 0 and below 9.22337e+18"),
    (
        "seed = 1",
        'path.kind = "a"',
        '[twin.path] kind = "a": must be one of "still", "circle", "raster", "random" or "external"',
    ),
    ("seed = 1", "error.lefft.d_mm = 1", "[twin.error.lefft]: the cell has no lefft (did you mean left?)"),
    ("seed = 1", "error.left.dd_mm = 1", "[twin.error.left] dd_mm = 1: unknown key (did you mean d_mm?)"),
    ("radius_mm = 4.0", "", "[probe] radius_mm: is missing and has no default"),
    ("radius_mm = 4.0", "radius_mm = -4.0", "[probe] radius_mm = -4.0: must be above 0 and at most 500"),
    (
        "radius_mm = 4.0",
        "radius_mm = 4.0\ndiameter_in = 0.3",
        "[probe] diameter_in = 0.3: unknown key (known: radius_mm, radius_tolerance)",
    ),
    ("[probe]", "[prob]", "prob = { ... }: unknown key or table (did you mean probe?)"),
    ("[probe]\nradius_mm = 4.0", "", "[probe] radius_mm: is missing and has no default"),
    (
        'name = "cell"',
        'name = "Cell 1"',
        'name = "Cell 1": a name has small letters, digits, - and _ only, and begins with a letter',
    ),
    ('name = "cell"', 'name = "cell"\nzenoh = 3', "zenoh = 3: must be a table: [zenoh]"),
    ('name = "cell"', 'name = "cell"\nfusion = [1]', "fusion = [1]: must be a table: [fusion]"),
    ("[twin]", "[camera]\nrear = 3\n[twin]", "[camera] rear = 3: must be a table: [camera.NAME]"),
    (
        "[twin]",
        "[gimbal.right.steering]\nwatchdog_ms = [1]\n[twin]",
        "[gimbal.right.steering] watchdog_ms = [1]: must be a whole number",
    ),
    ("[gimbal.left.steering]\ngain = 0.7", "steering = 3", "[gimbal.left] steering = 3: must be a table"),
    (
        "[twin]",
        '[zenoh]\nkey = "probe//position"\n[twin]',
        "[zenoh] key = \"probe//position\": not a Zenoh key: chunks parted by single '/', without * $ ? # or blanks",
    ),
    (
        "[twin]",
        '[zenoh]\nlisten = "tcp/127.0.0.1:7447"\n[twin]',
        '[zenoh] listen = "tcp/127.0.0.1:7447": must be a list in [ ]',
    ),
    ("[twin]", "[service]\nrestart_s = [5, 1]\n[twin]", "[service] restart_s = [5, 1]: needs 0 < first pause <= longest pause"),
]


@pytest.mark.parametrize(("old", "new", "line"), WRONG, ids=[line.partition(": ")[0] for _, _, line in WRONG])
def test_a_wrong_configuration_is_told_in_one_line(tmp_path: Path, old: str, new: str, line: str) -> None:
    assert CELL.count(old) == 1
    assert f"cell.toml {line}" in errors(tmp_path, CELL.replace(old, new))


def test_the_cell_of_these_tests_is_right_before_it_is_spoilt(tmp_path: Path) -> None:
    assert load(tmp_path, CELL).name == "cell"


SYNTAX = [
    ("seed = 1", "seed = ", "cell.toml line 31, column 8: invalid value"),
    ("gain = 0.7", "gain = 0.7\ngain = 0.8", "cell.toml line 24, column 11: the key in this line is set twice"),
    ("[twin]", "[gimbal.left]\n[twin]", "cell.toml line 30, column 13: the table [gimbal.left] is there twice"),
    ("[twin]", "[twin", "cell.toml line 30, column 6: expected ']' at the end of a table declaration"),
]


@pytest.mark.parametrize(("old", "new", "line"), SYNTAX)
def test_broken_toml_is_told_with_line_and_column(tmp_path: Path, old: str, new: str, line: str) -> None:
    assert errors(tmp_path, CELL.replace(old, new)) == [line]


def test_all_errors_are_told_at_once(tmp_path: Path) -> None:
    text = CELL.replace("gain = 0.7", "gain = 7").replace("radius_mm = 4.0", "radius_mm = 0").replace('"right"', '"rihgt"')
    found = errors(tmp_path, text, ["camera.left.exposure_us=30000", "nonsense"])
    parts = ("gain = 7", "radius_mm = 0", '"rihgt"', "exposure_us = 30000", "--set nonsense")
    assert len(found) == len(parts)
    for part in parts:
        assert any(part in line for line in found)


def test_a_missing_file_is_told_with_its_whole_path(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=f"^cell.toml: no such file: {tmp_path}/cell.toml$"):
        load_cell(tmp_path / "cell.toml", settings_of=settings_of)


def test_a_folder_is_no_configuration(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="cannot be read: Is a directory"):
        load_cell(tmp_path, settings_of=settings_of)


def test_a_file_that_is_not_utf8_is_told_with_the_byte(tmp_path: Path) -> None:
    (tmp_path / "cell.toml").write_bytes('name = "Zürich"'.encode("latin-1"))
    with pytest.raises(ConfigError, match=r"^cell\.toml: byte 9 is not UTF-8"):
        load_cell(tmp_path / "cell.toml", settings_of=settings_of)


@pytest.mark.parametrize("text", ["name = " + "[" * 100_000, "name = " + "1" * 10_000])
def test_what_breaks_the_parser_is_a_configuration_error(tmp_path: Path, text: str) -> None:
    assert errors(tmp_path, text) == ["cell.toml: is no configuration: nested too deeply, or a number too long"]


def test_a_name_with_a_line_end_does_not_break_the_line(tmp_path: Path) -> None:
    found = errors(tmp_path, CELL.replace('camera = "right"', 'camera = "a\\nb"'))
    assert all(line.startswith("cell.toml [") for line in found)


def test_a_missing_calibration_is_told_with_its_whole_path(tmp_path: Path) -> None:
    text = CELL.replace('"calibration.toml"', '"gone.toml"')
    assert errors(tmp_path, text) == [f'cell.toml calibration = "gone.toml": no such file: {tmp_path}/gone.toml']


def test_no_calibration_at_all_is_an_error(tmp_path: Path) -> None:
    found = errors(tmp_path, CELL.replace('calibration = "calibration.toml"', ""))
    assert found == ["cell.toml calibration: must be the calibration file's path in quotes"]


def test_the_calibrations_own_errors_are_told_beside_the_cells(tmp_path: Path) -> None:
    (tmp_path / "other.toml").write_text('format = "something"')
    found = errors(tmp_path, CELL.replace('"calibration.toml"', '"other.toml"').replace("gain = 0.7", "gain = 7"))
    assert [line.split()[0] for line in found] == ["other.toml", "cell.toml"]


def test_a_missing_folder_of_a_driver_is_told(tmp_path: Path) -> None:
    text = CELL.replace('driver = "synthetic"\nwidth_px', 'driver = "replay"\nfolder = "frames"\nwidth_px')
    assert f'cell.toml [camera.left] folder = "frames": no such file or folder: {tmp_path}/frames' in errors(tmp_path, text)


def test_two_cameras_with_one_serial_are_an_error(tmp_path: Path) -> None:
    text = CELL.replace('driver = "synthetic"', 'driver = "basler"\nserial = "123"')
    assert errors(tmp_path, text) == ['cell.toml [camera.right] serial = "123": camera left has the same: each needs its own']


def test_two_cameras_without_a_serial_are_an_error(tmp_path: Path) -> None:
    text = CELL.replace('driver = "synthetic"', 'driver = "basler"')
    assert errors(tmp_path, text) == ['cell.toml [camera.right] serial = "": camera left has the same: each needs its own']


def test_two_cameras_that_play_one_folder_are_an_error(tmp_path: Path) -> None:
    text = CELL.replace('driver = "synthetic"', 'driver = "replay"\nfolder = "."')
    [found] = errors(tmp_path, text)
    assert found.startswith(f'cell.toml [camera.right] folder = "{str(tmp_path)[:20]}')
    assert found.endswith(": camera left has the same: each needs its own")


def test_a_port_that_the_twin_picks_needs_a_twin(tmp_path: Path) -> None:
    text = CELL.replace('host = "10.0.0.1"', 'host = "10.0.0.1"\nport = 0').replace("[twin]\nseed = 1", "")
    expected = (
        "cell.toml [gimbal.left] port = 0: 0 lets the twin pick a free port: add a [twin] table, or set the controller's port"
    )
    assert expected in errors(tmp_path, text)


OVERRIDES = [
    ("gain", "--set gain: must have the form table.key=value"),
    ("gimbal..gain=1", "--set gimbal..gain=1: must have the form table.key=value"),
    ("name.first=1", "--set name.first=1: name is no table"),
    ("gimbal.left.steering.gain=2", "cell.toml [gimbal.left.steering] gain = 2: must be above 0 and at most 1"),
    ("gimbal.left.steering.gian=1", "cell.toml [gimbal.left.steering] gian = 1: unknown key (did you mean gain?)"),
    ("gimbal.left.port=abc", 'cell.toml [gimbal.left] port = "abc": must be a whole number'),
]


@pytest.mark.parametrize(("text", "line"), OVERRIDES)
def test_a_wrong_override_is_told_like_a_wrong_file(tmp_path: Path, text: str, line: str) -> None:
    assert errors(tmp_path, CELL, [text]) == [line]


def test_an_override_that_is_right_mends_the_file(tmp_path: Path) -> None:
    cell = load(tmp_path, CELL.replace("gain = 0.7", "gain = 7"), ["gimbal.left.steering.gain=0.5", "gimbal.right.port=5021"])
    assert cell.gimbals["left"].steering.gain == 0.5
    assert cell.gimbals["right"].model_dump()["port"] == 5021


def test_an_override_that_reads_as_a_number_is_text_where_text_belongs(tmp_path: Path) -> None:
    text = CELL.replace('[camera.right]\ndriver = "synthetic"', '[camera.right]\ndriver = "basler"')
    cell = load(tmp_path, text, ["camera.right.serial=024587345", "camera.left.socket=/run/twin.sock", "gimbal.left.host=1"])
    assert cell.cameras["right"].model_dump()["serial"] == "024587345"
    assert cell.cameras["left"].model_dump()["socket"] == "/run/twin.sock"
    assert cell.gimbals["left"].model_dump()["host"] == "1"
