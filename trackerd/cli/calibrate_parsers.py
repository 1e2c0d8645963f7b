"""The options of `trackerd calibrate WHAT`, one function for each WHAT."""

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import TypeAlias

from trackerd.cli.arguments import count
from trackerd.cli.cell_parsers import add_capture, add_cell, add_plan
from trackerd.cli.lens_parser import add_lens
from trackerd.cli.statuses import DONE

Commands: TypeAlias = "argparse._SubParsersAction[argparse.ArgumentParser]"


def add_calibrate(commands: Commands) -> Iterator[argparse.ArgumentParser]:
    """Adds `calibrate`; yields the parser of each WHAT."""
    what = commands.add_parser(
        "calibrate",
        help="measure what the cell's file says of its devices",
        description="Measures what the cell's file says of its devices, and prints the lines for it.",
    ).add_subparsers(title="what", metavar="WHAT", required=True)
    for add in (_add_noise, _add_latency, add_lens, add_plan, add_capture, add_cell):
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


def _add_latency(what: Commands) -> argparse.ArgumentParser:
    parser = what.add_parser(
        "latency",
        help="how late the encoders' angles are, from a recording of a sweep over a still target",
        description="The constant time from a frame's mid-exposure to the instant at which its angles were taken, of each axis,"
        " with its sigma and a plot, from a recording in which the gimbal sweeps to and fro over a still ball: both axes, fast,"
        " exposed shortly. --config tells the camera's noise and region, the ball's radius and the encoders' noise. Exit"
        " status 3 where the sweep does not tell it, in words that say what would.",
    )
    parser.add_argument(
        "path", type=Path, metavar="RECORDING", help="a recording (twin --record), or one station's folder in it"
    )
    parser.add_argument("--out", type=Path, metavar="FILE", default=Path("latency.svg"), help="the plot (default: latency.svg)")
    parser.add_argument("--station", metavar="NAME", help="this station of the recording only")
    parser.set_defaults(run=_latency, needs_config=False)
    return parser


def _latency(options: argparse.Namespace) -> int:
    from trackerd.cli.calibrate_latency import LatencyRequest, latency

    latency(LatencyRequest(options.path, options.out, options.station, options.config, options.overrides))
    return DONE
