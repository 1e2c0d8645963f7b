"""`trackerd`: what a person types."""

import argparse
import os
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from math import isfinite, nan
from pathlib import Path

from trackerd import __version__
from trackerd.contract.errors import ConfigError, TrackerdError

DONE, BUG, WRONG_INPUT, REFUSED, TO_MEND = 0, 1, 2, 3, 4

ABOUT = """\
Measures where a probe is, in real time, from cameras on two-axis gimbals, and publishes it on Zenoh.

  trackerd --config config/demo.toml          run a cell (this one is simulated: it needs no hardware)
  trackerd watch --config config/demo.toml    in another terminal: position, sigma, rate, age, error
  trackerd check --config cell.toml           what a configuration needs from this machine, and how to mend it

Starting the service moves nothing. On a real bus the axes follow only after `trackerd arm`; a simulated cell arms itself."""

STATUSES = """\
exit status: 0 done, or stopped by SIGTERM or SIGINT; 1 a defect of trackerd (with a traceback); 2 wrong usage or
configuration; 3 refused or unreachable (a port taken, another publisher on the key, no daemon there); 4 `check` found
something to mend."""


def main(arguments: Sequence[str] | None = None) -> int:
    options = _parser().parse_args(arguments)
    if options.config is None:
        _parser().error("--config FILE is needed")
    options.overrides += options.more_overrides
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before NumPy is loaded: small matrices, and cores are for the stations
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # as SIGINT; what runs on an event loop sets its own
    command: Callable[[argparse.Namespace], int] = options.run
    try:
        return command(options)
    except KeyboardInterrupt:
        return DONE
    except (TrackerdError, BaseExceptionGroup) as error:
        return _say(error)


def _say(error: BaseException) -> int:
    """One line for each thing that a person can mend; anything else is a defect, and keeps its traceback."""
    causes = list(_causes(error))
    if not all(isinstance(cause, TrackerdError) for cause in causes):
        raise error
    for cause in causes:
        print(f"trackerd: {cause}", file=sys.stderr)
    return WRONG_INPUT if any(isinstance(cause, ConfigError) for cause in causes) else REFUSED


def _causes(error: BaseException) -> Iterator[BaseException]:
    if isinstance(error, BaseExceptionGroup):
        for part in error.exceptions:
            yield from _causes(part)
    else:
        yield error


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="trackerd", description=ABOUT, epilog=STATUSES, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--version", action="version", version=f"trackerd {__version__}")
    _common(parser, None, "overrides")
    parser.add_argument("--duration", type=_seconds, metavar="S", help="stop S seconds after READY (default: run on)")
    parser.set_defaults(run=_serve, overrides=[], more_overrides=[])
    commands = parser.add_subparsers(title="commands", metavar="COMMAND")
    for add in (_add_check, _add_twin, _add_watch, _add_select, _add_arm):
        _common(add(commands), argparse.SUPPRESS, "more_overrides")
    return parser


def _common(parser: argparse.ArgumentParser, config: object, overrides: str) -> None:
    """Options that may stand before and after the command; `overrides` is the list that `--set` adds to there."""
    parser.add_argument(
        "--config", type=Path, metavar="FILE", default=config, help="the cell: a TOML file, see config/cell.toml"
    )
    parser.add_argument(
        "--set",
        dest=overrides,
        action="append",
        metavar="KEY=VALUE",
        default=argparse.SUPPRESS,
        help="lay one value over the file, as in --set gimbal.left.port=5021 (repeatable)",
    )


def _add_check(commands: "argparse._SubParsersAction[argparse.ArgumentParser]") -> argparse.ArgumentParser:
    parser = commands.add_parser(
        "check",
        help="validate a configuration and what it needs from this machine",
        description="Reads the configuration, then looks at devices, ports, limits and permissions; says how to mend each.",
    )
    parser.set_defaults(run=_check)
    return parser


def _add_twin(commands: "argparse._SubParsersAction[argparse.ArgumentParser]") -> argparse.ArgumentParser:
    parser = commands.add_parser(
        "twin",
        help="run the simulated cell, or record from it",
        description="Runs the simulated cell of the [twin] table on the wire: gimbal controllers, cameras, and the truth beside"
        " them; says on standard output, as one JSON line, where they are. With --record it writes a recording instead, as fast"
        " as it can: frames, encoder angles, truth, calibration.",
    )
    parser.add_argument("--record", type=Path, metavar="DIR", help="write a recording into DIR")
    parser.add_argument("--duration", type=_seconds, metavar="S", default=argparse.SUPPRESS, help="end after S seconds")
    parser.add_argument("--with-parent", action="store_true", help="end 5 s after standard input is closed")
    parser.set_defaults(run=_twin)
    return parser


def _add_watch(commands: "argparse._SubParsersAction[argparse.ArgumentParser]") -> argparse.ArgumentParser:
    parser = commands.add_parser(
        "watch",
        help="show the published position: an ordinary Zenoh subscriber",
        description="Shows position, sigma, rate, age and state as published, and the error where a twin tells the truth.",
    )
    parser.add_argument("--duration", type=_seconds, metavar="S", default=argparse.SUPPRESS, help="end after S seconds")
    parser.add_argument("--plain", action="store_true", help="one line a second instead of a live table")
    parser.set_defaults(run=_watch)
    return parser


def _add_select(commands: "argparse._SubParsersAction[argparse.ArgumentParser]") -> argparse.ArgumentParser:
    parser = commands.add_parser(
        "select",
        help="choose the target in one gimbal's image",
        description="The target becomes the ball nearest to a pixel of the sensor; --pixel auto lets it be found by itself.",
    )
    parser.add_argument("--gimbal", required=True, metavar="NAME")
    parser.add_argument("--pixel", required=True, type=_pixel, metavar="X,Y", help="sensor pixel, or auto")
    parser.set_defaults(run=_select)
    return parser


def _add_arm(commands: "argparse._SubParsersAction[argparse.ArgumentParser]") -> argparse.ArgumentParser:
    parser = commands.add_parser(
        "arm",
        help="let the axes follow: THEY MOVE",
        description="Arms the axes. Each then proves sign and scale of its axes by a small slow move, and follows the target."
        " --hold is the opposite: the axes stop where they are and stay there until they are armed again.",
    )
    parser.add_argument("--gimbal", metavar="NAME", help="one gimbal only (default: all)")
    parser.add_argument("--hold", action="store_true", help="hold the axes instead")
    parser.set_defaults(run=_arm)
    return parser


def _serve(options: argparse.Namespace) -> int:
    from trackerd.cli.run import serve

    return serve(options.config, options.overrides, options.duration)


def _check(options: argparse.Namespace) -> int:
    from trackerd.cli.run import check

    return TO_MEND if check(options.config, options.overrides) else DONE


def _twin(options: argparse.Namespace) -> int:
    from trackerd.cli.run import record, twin

    if options.record is not None:
        return record(options.config, options.overrides, options.record, options.duration)
    return twin(options.config, options.overrides, options.duration, options.with_parent)


def _watch(options: argparse.Namespace) -> int:
    from trackerd.cli.watch import watch

    try:
        return watch(options.config, options.overrides, options.duration, options.plain)
    except BrokenPipeError:  # who reads our output has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return DONE


def _select(options: argparse.Namespace) -> int:
    from trackerd.cli.ask import ask

    pixel = None if options.pixel == "auto" else options.pixel
    return ask(options.config, options.overrides, "select", {"gimbal": options.gimbal, "pixel": pixel})


def _arm(options: argparse.Namespace) -> int:
    from trackerd.cli.ask import ask

    request = {"gimbal": options.gimbal} if options.gimbal else {}
    return ask(options.config, options.overrides, "arm", request | ({"hold": True} if options.hold else {}))


def _seconds(text: str) -> float:
    value = _number(text)
    if not 0 < value < 1e9:
        raise argparse.ArgumentTypeError(f"{text!r}: needs a positive number of seconds")
    return value


def _pixel(text: str) -> object:
    if text == "auto":
        return text
    pixel = [_number(part) for part in text.split(",")]
    if len(pixel) != 2 or not all(map(isfinite, pixel)):
        raise argparse.ArgumentTypeError(f"{text!r}: needs X,Y, as in 1020,760, or auto")
    return pixel


def _number(text: str) -> float:
    """NaN for what is none."""
    try:
        return float(text)
    except ValueError:
        return nan
