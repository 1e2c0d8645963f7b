"""The options of `trackerd calibrate WHAT`, one function for each WHAT."""

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import TypeAlias

from trackerd.cli.arguments import count
from trackerd.cli.statuses import DONE

Commands: TypeAlias = "argparse._SubParsersAction[argparse.ArgumentParser]"


def add_calibrate(commands: Commands) -> Iterator[argparse.ArgumentParser]:
    """Adds `calibrate`; yields the parser of each WHAT."""
    what = commands.add_parser(
        "calibrate",
        help="measure what the cell's file says of its devices",
        description="Measures what the cell's file says of its devices, and prints the lines for it.",
    ).add_subparsers(title="what", metavar="WHAT", required=True)
    for add in (_add_noise,):
        yield add(what)


def _add_noise(what: Commands) -> argparse.ArgumentParser:
    parser = what.add_parser(
        "noise",
        help="gain and read noise of a camera, from pictures of a still scene",
        description="Gain and read noise of a camera by photon transfer, with their sigmas and a plot. The pictures, 8 or more,"
        " show one still scene of many grey levels, such as a wall that is lit from one side, out of focus. The light may"
        " flicker and drift. With --config and --camera it takes them from a camera of the cell; nothing is armed, nothing"
        " moves. Exit status 3 where the pictures do not tell it, in words that say what would.",
    )
    parser.add_argument("path", nargs="?", type=Path, metavar="PATH", help="a folder of pictures, or a recording")
    parser.add_argument("--out", type=Path, metavar="FILE", default=Path("noise.svg"), help="the plot (default: noise.svg)")
    parser.add_argument("--camera", metavar="NAME", help="the camera of the cell")
    parser.add_argument("--frames", type=count, metavar="N", default=100, help="of the camera (default: 100)")
    parser.set_defaults(run=_noise, needs_config=False)
    return parser


def _noise(options: argparse.Namespace) -> int:
    from trackerd.cli.calibrate_noise import NoiseRequest, noise

    noise(NoiseRequest(options.path, options.out, options.config, options.camera, options.frames, options.overrides))
    return DONE
