"""`trackerd`: what a person types."""

import argparse
import os
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import chain
from pathlib import Path

from trackerd import __version__
from trackerd.cli.align_parser import add_align
from trackerd.cli.arguments import circle, count, names, pixel, positive, seconds, whole
from trackerd.cli.calibrate_parsers import add_calibrate
from trackerd.cli.calibration_parsers import add_calibration
from trackerd.cli.statuses import DONE, REFUSED, TO_MEND, WRONG_INPUT
from trackerd.contract.errors import ConfigError, TrackerdError

NO_BALL = TO_MEND

ABOUT = """\
Measures where a probe is, in real time, from cameras on two-axis gimbals, and publishes it on Zenoh.

  trackerd --config config/demo.toml          run a cell (this one is simulated: it needs no hardware)
  trackerd watch --config config/demo.toml    in another terminal: position, sigma, rate, age, error
  trackerd check --config cell.toml           what a configuration needs from this machine, and how to mend it

Starting the service moves nothing. On a real bus the axes follow only after `trackerd arm`; a simulated cell arms itself."""

STATUSES = """\
exit status: 0 done, or stopped by SIGTERM or SIGINT; 1 a defect of trackerd (with a traceback); 2 wrong usage or
configuration; 3 refused or unreachable (a port taken, another publisher on the key, no daemon there, pictures that do not
tell what was asked); 4 `check` found something to mend, or `inspect` no ball in any picture."""


def main(arguments: Sequence[str] | None = None) -> int:
    options = _parser().parse_args(arguments)
    if options.config is None and options.needs_config:
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
    parser.add_argument("--duration", type=seconds, metavar="S", help="stop S seconds after READY (default: run on)")
    parser.set_defaults(run=_serve, overrides=[], more_overrides=[], needs_config=True)
    commands = parser.add_subparsers(title="commands", metavar="COMMAND")
    for add in (_add_check, _add_twin, _add_watch, _add_select, _add_arm, _add_inspect, _add_budget):
        _common(add(commands), argparse.SUPPRESS, "more_overrides")
    _common(add_align(commands), argparse.SUPPRESS, "more_overrides")
    for each in chain(add_calibrate(commands), add_calibration(commands)):
        _common(each, argparse.SUPPRESS, "more_overrides")
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
    parser.add_argument("--duration", type=seconds, metavar="S", default=argparse.SUPPRESS, help="end after S seconds")
    parser.add_argument("--with-parent", action="store_true", help="end 5 s after standard input is closed")
    parser.set_defaults(run=_twin)
    return parser


def _add_watch(commands: "argparse._SubParsersAction[argparse.ArgumentParser]") -> argparse.ArgumentParser:
    parser = commands.add_parser(
        "watch",
        help="show the published position: an ordinary Zenoh subscriber",
        description="Shows position, sigma, rate, age and state as published, and the error where a twin tells the truth.",
    )
    parser.add_argument("--duration", type=seconds, metavar="S", default=argparse.SUPPRESS, help="end after S seconds")
    parser.add_argument("--plain", action="store_true", help="one line a second instead of a live table")
    parser.set_defaults(run=_watch)
    return parser


def _add_select(commands: "argparse._SubParsersAction[argparse.ArgumentParser]") -> argparse.ArgumentParser:
    parser = commands.add_parser(
        "select",
        help="choose the target in one gimbal's image",
        description="The target becomes the ball that a pixel of the sensor shows; --pixel auto lets it be found by itself.",
    )
    parser.add_argument("--gimbal", required=True, metavar="NAME")
    parser.add_argument("--pixel", required=True, type=pixel, metavar="X,Y", help="sensor pixel, or auto")
    parser.add_argument("--radius", type=float, metavar="PX", help="its radius there: the pixel is a guess, looked at first")
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


def _add_inspect(commands: "argparse._SubParsersAction[argparse.ArgumentParser]") -> argparse.ArgumentParser:
    parser = commands.add_parser(
        "inspect",
        help="draw what the detector sees in pictures, or help to focus a running camera",
        description="Draws, of one picture: edge points, outline, residuals, the centre with its 95 % ellipse; of a folder, or"
        " of each station of a recording (twin --record): repeatability and Allan deviation. The page goes to NAME.inspect.png"
        " in the working folder. With --live: edge width, contrast and exposure of a running camera, for the hand at the lens's"
        " ring (the edge width tells focus only while nothing moves). --config gives the camera's noise, lens and probe;"
        " without it a sensor of 10 ke- is assumed. Exit status 4, with the reasons, where no picture has a ball.",
    )
    parser.add_argument("path", nargs="?", type=Path, metavar="PATH", help="a picture, a folder of pictures, or a recording")
    parser.add_argument("--out", type=Path, metavar="FILE", help="the page: .png, .svg or .pdf")
    parser.add_argument("--csv", type=Path, metavar="FILE", help="write one row a picture")
    parser.add_argument("--guess", type=circle, metavar="X,Y,R", help="where the ball is, px of the picture (default: search)")
    parser.add_argument("--station", metavar="NAME", help="this station of a recording only")
    parser.add_argument("--live", action="store_true", help="look at a running camera of the cell instead")
    parser.add_argument("--camera", metavar="NAME", help="the camera of the cell (default: the station's, or the only one)")
    parser.add_argument("--frames", type=count, metavar="N", help="with --live: end after N frames")
    parser.add_argument("--duration", type=seconds, metavar="S", default=argparse.SUPPRESS, help="with --live: end after S s")
    parser.add_argument("--plain", action="store_true", help="with --live: one line a second instead of a live table")
    parser.set_defaults(run=_inspect, needs_config=False)
    return parser


def _add_budget(commands: "argparse._SubParsersAction[argparse.ArgumentParser]") -> argparse.ArgumentParser:
    parser = commands.add_parser(
        "budget",
        help="what limits a cell: a Monte-Carlo of layouts and noise, or the shares of a cell of your own",
        description="Simulates the cases and layouts of FILE (see config/budget.toml; without it, those of the source thesis)"
        " and prints Tables 4.1 to 4.7 with four columns a value: thesis, its method reproduced, bundle adjustment, Cramér-Rao"
        " bound. With --cell it tells instead what pixels, encoders and calibration add to the uncertainty of a target there.",
    )
    parser.add_argument("file", nargs="?", type=Path, metavar="FILE", help="cases, layouts, noise and volume: TOML")
    parser.add_argument("--cell", dest="config", type=Path, metavar="CELL", default=argparse.SUPPRESS, help="your cell's file")
    parser.add_argument("--out", type=Path, metavar="DIR", help="write tables (CSV, JSON, HTML) and pictures into DIR")
    parser.add_argument("--trials", type=count, metavar="N", help="of each case in each layout (default: FILE's)")
    parser.add_argument("--seed", type=whole, metavar="N", help="of the noise (default: FILE's)")
    parser.add_argument("--workers", type=count, metavar="N", help="processes (default: one a core); the result is the same")
    parser.add_argument("--cases", type=names, metavar="A,B", default=(), help="these cases only")
    parser.add_argument("--layouts", type=names, metavar="A,B", default=(), help="these layouts only")
    parser.add_argument("--pixel-sigma", type=positive, metavar="PX", help="with --cell: of the ball's centre in one picture")
    parser.set_defaults(run=_budget, needs_config=False)
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

    with _until_the_reader_leaves():
        return watch(options.config, options.overrides, options.duration, options.plain)
    return DONE


@contextmanager
def _until_the_reader_leaves() -> Iterator[None]:
    """Who reads our output has seen enough."""
    try:
        yield
        sys.stdout.flush()
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _select(options: argparse.Namespace) -> int:
    from trackerd.cli.ask import ask

    pixel = None if options.pixel == "auto" else options.pixel
    request = {"gimbal": options.gimbal, "pixel": pixel} | ({} if options.radius is None else {"radius_px": options.radius})
    return ask(options.config, options.overrides, "select", request)


def _arm(options: argparse.Namespace) -> int:
    from trackerd.cli.ask import ask

    request = {"gimbal": options.gimbal} if options.gimbal else {}
    return ask(options.config, options.overrides, "arm", request | ({"hold": True} if options.hold else {}))


def _inspect(options: argparse.Namespace) -> int:
    if options.live == (options.path is not None):
        raise ConfigError("inspect: needs either PATH, what to look at, or --live")
    if options.live:
        return DONE if _inspect_live(options) else NO_BALL
    from trackerd.cli.inspect import Request, inspect

    wanted = {key: getattr(options, key) for key in ("path", "out", "csv", "guess", "station", "config", "camera", "overrides")}
    return DONE if inspect(Request(**wanted)) else NO_BALL


def _inspect_live(options: argparse.Namespace) -> bool:
    from trackerd.cli.inspect_live import LiveRequest, live

    if options.config is None:
        raise ConfigError("inspect --live: needs --config FILE, the cell that has the camera")
    wanted = {key: getattr(options, key) for key in ("config", "camera", "overrides", "guess", "frames", "plain")}
    return live(LiveRequest(**wanted, duration_s=options.duration))


def _budget(options: argparse.Namespace) -> int:
    from trackerd.cli.budget import BudgetRequest, budget

    keys = ("file", "out", "trials", "seed", "workers", "cases", "layouts", "overrides")
    wanted = {key: getattr(options, key) for key in keys}
    with _until_the_reader_leaves():
        budget(BudgetRequest(**wanted, cell=options.config, pixel_sigma_px=options.pixel_sigma))
    return DONE
