"""What a person types: help, exit statuses, and words instead of tracebacks. In this process, but for signals and pipes."""

import json
import logging
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from trackerd import __version__
from trackerd.cli import main
from trackerd.cli.log import JsonFormatter
from trackerd.contract.errors import ConfigError, DeviceMissing

CONFIG = Path(__file__).parents[2] / "config"
DEMO = str(CONFIG / "demo.toml")
DONE, WRONG, REFUSED = 0, 2, 3

COMMANDS = ("check", "twin", "watch", "select", "arm", "calibrate", "calibration", "inspect", "align")
OPTIONS = {
    "": ("--config", "--set", "--duration", "--version", "exit status", *COMMANDS),
    "check": ("--config", "--set"),
    "twin": ("--config", "--set", "--record", "--duration", "--with-parent"),
    "watch": ("--config", "--set", "--duration", "--plain"),
    "select": ("--config", "--set", "--gimbal", "--pixel", "--radius", "auto"),
    "arm": ("--config", "--set", "--gimbal", "--hold", "small slow move"),
    "calibrate": ("noise", "lens"),
    "calibrate lens": ("IMAGES", "--output", "--report", "--zoom", "--board", "--square-mm", "--points", "Exit status 3"),
    "calibrate noise": ("PATH", "--config", "--set", "--out", "--camera", "--frames", "Exit status 3"),
    "calibration": ("list", "show", "add", "activate", "rollback", "export", "import"),
    "calibration list": ("--config", "--set", "--calibration"),
    "calibration show": ("ID", "--config", "--calibration", "--volume"),
    "calibration add": ("FILE", "--config"),
    "calibration activate": ("ID", "--config", "--why", "--who", "--yes", "--volume"),
    "calibration rollback": ("--config", "--why", "--who", "--yes"),
    "calibration export": ("FILE", "--station", "--format", "opencv", "camera_info", "--id"),
    "calibration import": ("FILE", "--station", "--id"),
    "align": ("MEASURED", "NOMINAL", "--name", "--output", "--plane", "--line", "--origin", "--leave-out", "Exit status 3"),
    "inspect": ("PATH", "--config", "--set", "--out", "--csv", "--guess", "--station", "--live", "--camera", "--frames"),
}


@pytest.fixture(autouse=True)
def process_as_it_was(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Commands set what belongs to a process of their own."""
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "1")
    monkeypatch.setenv("COLUMNS", "200")
    handler = signal.getsignal(signal.SIGTERM)
    yield
    signal.signal(signal.SIGTERM, handler)


@pytest.fixture
def port() -> int:
    with closing(socket.create_server(("127.0.0.1", 0))) as server:
        return int(server.getsockname()[1])


def listening(port: int) -> list[str]:
    return ["--set", f'zenoh.listen=["tcp/127.0.0.1:{port}"]']


def usage(*arguments: str) -> int:
    """The status of a command line that is wrong, or only asks."""
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    assert isinstance(ended.value.code, int)
    return ended.value.code


# ---- help and usage --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("command", OPTIONS)
def test_help_tells_every_option(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert usage(*command.split(), "--help") == DONE
    told = capsys.readouterr().out
    for option in OPTIONS[command]:
        assert option in told


def test_the_version_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    assert usage("--version") == DONE
    assert capsys.readouterr().out == f"trackerd {__version__}\n"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], "--config FILE is needed"),
        (["check"], "--config FILE is needed"),
        (["chekc", "--config", DEMO], "invalid choice"),
        (["--config", DEMO, "--duration", "soon"], "'soon': needs a positive number of seconds"),
        (["--config", DEMO, "--duration", "-1"], "'-1': needs a positive number of seconds"),
        (["--config", DEMO, "--duration", "nan"], "'nan': needs a positive number of seconds"),
        (["select", "--config", DEMO, "--pixel", "1,2"], "--gimbal"),
        (["select", "--config", DEMO, "--gimbal", "left", "--pixel", "1"], "'1': needs X,Y"),
        (["select", "--config", DEMO, "--gimbal", "left", "--pixel", "1,nan"], "'1,nan': needs X,Y"),
        (["calibrate"], "WHAT"),
        (["calibrate", "noise", "--frames", "inf"], "'inf': needs a whole number, 1 or above"),
        (["inspect", "one.png", "--guess", "1,2"], "'1,2': needs X,Y,R"),
    ],
)
def test_wrong_usage_is_status_2_and_says_what_is_wrong(
    arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert usage(*arguments) == WRONG
    assert words in capsys.readouterr().err


# ---- configuration ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "command", [[], ["check"], ["twin"], ["watch"], ["arm"], ["select", "--gimbal", "left", "--pixel", "auto"]]
)
def test_a_configuration_that_is_not_there_is_status_2(command: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*command, "--config", "nowhere.toml"]) == WRONG
    told = capsys.readouterr().err
    assert "nowhere.toml" in told
    assert len(told.splitlines()) == 1


def test_every_error_of_a_configuration_is_told_and_no_traceback(capsys: pytest.CaptureFixture[str]) -> None:
    wrong = ["probe.radius_mm=-1", "gimbal.left.steering.gain=1.4", "fusion.colour=3", "no_equals_sign"]
    assert main(["--config", DEMO, *(word for text in wrong for word in ("--set", text))]) == WRONG
    told = capsys.readouterr().err
    for words in ("[probe] radius_mm = -1", "[gimbal.left.steering] gain = 1.4", "[fusion] colour = 3", "no_equals_sign"):
        assert words in told
    assert "Traceback" not in told


def test_values_are_laid_over_the_file_before_and_after_the_command(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--set", "probe.radius_mm=-1", "check", "--config", DEMO, "--set", "fusion.colour=3"]) == WRONG
    told = capsys.readouterr().err
    assert "radius_mm" in told
    assert "colour" in told


# ---- refusals --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("command", [["watch"], ["arm"], ["select", "--gimbal", "left", "--pixel", "1,2"]])
def test_without_a_daemon_it_is_status_3(command: list[str], port: int, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*command, "--config", DEMO, *listening(port)]) == REFUSED
    told = capsys.readouterr().err
    assert f"nobody answers at tcp/127.0.0.1:{port}: is the daemon (or the router) running?" in told
    assert len(told.splitlines()) == 1


def test_a_taken_port_is_status_3(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with closing(socket.create_server(("127.0.0.1", 0))) as server:
        port = server.getsockname()[1]
        assert main(["--config", str(live_cell(tmp_path)), *listening(port)]) == REFUSED
    told = capsys.readouterr().err
    assert f"trackerd: [zenoh] listen = tcp/127.0.0.1:{port}: the port is taken by another process" in told


def live_cell(folder: Path) -> Path:
    """Two mounts that do not move, their cameras on pylon: nothing of it is opened here."""
    tables = [f'calibration = "{CONFIG}/demo-calibration.toml"', "[probe]", "radius_mm = 4.0"]
    for n, name in enumerate(("left", "right")):
        tables += [f"[camera.{name}]", 'driver = "basler"', f'serial = "0815-000{n}"']
        tables += [f"[gimbal.{name}]", 'driver = "fixed"', f'camera = "{name}"']
    file = folder / "cell.toml"
    file.write_text("\n".join(tables))
    return file


# ---- recordings ------------------------------------------------------------------------------------------------------


def test_a_recording_needs_to_know_how_long(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["twin", "--config", DEMO, "--record", str(tmp_path)]) == WRONG
    assert capsys.readouterr().err == "trackerd: --record needs --duration S: how long a recording to make\n"


def test_only_a_simulated_cell_can_be_recorded(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cell = live_cell(tmp_path)
    assert main(["twin", "--config", str(cell), "--record", str(tmp_path), "--duration", "1"]) == WRONG
    assert "cell.toml: there is no [twin] table" in capsys.readouterr().err


def test_a_recording_into_a_file_is_status_3(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "taken").touch()
    assert main(["twin", "--config", DEMO, "--record", str(tmp_path / "taken"), "--duration", "0.02"]) == REFUSED
    assert f"trackerd: {tmp_path}/taken" in capsys.readouterr().err


# ---- errors from inside ----------------------------------------------------------------------------------------------


def raising(monkeypatch: pytest.MonkeyPatch, error: BaseException) -> int:
    """The status where the service ends with an error."""

    def serve(*_: Any) -> int:
        raise error

    monkeypatch.setattr("trackerd.cli.run.serve", serve)
    return main(["--config", DEMO])


def test_every_cause_in_a_group_is_told(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    missing = DeviceMissing("camera left", "open", "not there")
    assert raising(monkeypatch, ExceptionGroup("", [missing, ExceptionGroup("", [ConfigError("a row is missing")])])) == WRONG
    assert capsys.readouterr().err.splitlines() == ["trackerd: camera left: open: not there", "trackerd: a row is missing"]
    assert raising(monkeypatch, ExceptionGroup("", [missing])) == REFUSED


def test_a_defect_keeps_its_traceback(monkeypatch: pytest.MonkeyPatch) -> None:
    group = ExceptionGroup("", [ConfigError("a row is missing"), ZeroDivisionError()])
    for defect in (ZeroDivisionError(), group):
        with pytest.raises(type(defect)):
            raising(monkeypatch, defect)


def test_an_interruption_is_an_end_like_any_other(monkeypatch: pytest.MonkeyPatch) -> None:
    assert raising(monkeypatch, KeyboardInterrupt()) == DONE


# ---- processes -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_watcher_ends_well_when_it_is_told_to(number: signal.Signals) -> None:
    from trackerd.formats.settings import ZenohSettings
    from trackerd.service.zenoh_session import open_listening

    with closing(socket.create_server(("127.0.0.1", 0))) as server:
        port = server.getsockname()[1]
    session = open_listening(ZenohSettings(listen=(f"tcp/127.0.0.1:{port}",)))
    try:
        command = [sys.executable, "-m", "trackerd", "watch", "--plain", "--config", DEMO, *listening(port)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
            assert process.stdout is not None
            assert process.stdout.readline() == "state: nothing heard yet\n"
            process.send_signal(number)
            assert process.wait(20) == DONE
    finally:
        session.close()


def test_the_log_can_be_one_json_object_a_line() -> None:
    try:
        raise ValueError("why")
    except ValueError:
        record = logging.LogRecord("trackerd.axes", logging.WARNING, "", 1, "%s lost", ("left",), sys.exc_info())
    line = JsonFormatter().format(record)
    told = json.loads(line)
    assert (told["level"], told["logger"], told["message"]) == ("warning", "trackerd.axes", "left lost")
    assert "ValueError: why" in told["exception"]
    assert "\n" not in line
