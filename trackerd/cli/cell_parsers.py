"""The options of `trackerd calibrate plan`, `capture` and `cell`."""

import argparse
from math import isfinite
from pathlib import Path

from trackerd.cli.arguments import count, number
from trackerd.cli.statuses import DONE


def volume(text: str) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """XxYxZ[@X,Y,Z], mm: size and centre of a box of W."""
    size_text, at, centre_text = text.partition("@")
    size = tuple(number(part) for part in size_text.split("x"))
    centre = tuple(number(part) for part in centre_text.split(",")) if at else (0.0, 0.0, 0.0)
    good = len(size) == len(centre) == 3 and all(map(isfinite, (*size, *centre))) and min(size) > 0.0
    if not good:
        raise argparse.ArgumentTypeError(
            f"{text!r}: needs a size in mm, and a centre if that is not W's origin: 400x400x300@0,0,50"
        )
    return size, centre


def positive(text: str) -> float:
    value = number(text)
    if not 0.0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"{text!r}: needs a positive number")
    return value


def whole(text: str) -> int:
    return 0 if text == "0" else count(text)


def add_plan(what: "argparse._SubParsersAction[argparse.ArgumentParser]") -> argparse.ArgumentParser:
    parser = what.add_parser(
        "plan",
        help="a mover's program that fills the work volume, and what a calibration by it will be worth",
        description="Writes a program that carries the probe through the work volume, in depth too, with a wait at each stop,"
        " in which every gimbal looks at the probe at five places of its image, and in its second face where the travel allows."
        " Every look is checked first: within the travel, in view, not behind. Beside it, PLAN.predicted.png: the error that"
        " targets will have over the volume. Nothing is armed, nothing moves.",
    )
    parser.add_argument("--points", type=count, metavar="N", default=40, help="stops for the adjustment (default: 40)")
    parser.add_argument("--check", type=whole, metavar="N", default=8, help="more stops, outside the adjustment (default: 8)")
    parser.add_argument("--format", choices=("gcode", "csv", "krl", "rapid"), default="gcode", help="default: gcode")
    parser.add_argument(
        "--volume", type=volume, metavar="XxYxZ[@X,Y,Z]", required=True, help="mm: size and centre, as in 400x400x300@0,0,50"
    )
    parser.add_argument("--output", type=Path, metavar="FILE", required=True, help="the program")
    parser.add_argument("--frames", type=count, metavar="N", default=20, help="averaged for each look (default: 20)")
    parser.add_argument("--mm-s", type=positive, metavar="V", default=50.0, help="speed of the mover (default: 50)")
    parser.add_argument(
        "--sigma-mm", type=positive, metavar="S", help="of the mover's places (default: 0.005, of a robot 0.65)"
    )
    parser.add_argument(
        "--tilt-deg", type=positive, metavar="A", default=20.0, help="krl, rapid: turns of the tool (default: 20)"
    )
    parser.add_argument("--seed", type=whole, metavar="N", default=1, help="of the places (default: 1)")
    parser.set_defaults(run=_plan)
    return parser


def add_capture(what: "argparse._SubParsersAction[argparse.ArgumentParser]") -> argparse.ArgumentParser:
    parser = what.add_parser(
        "capture",
        help="take a calibration's dataset: THE AXES MOVE",
        description="Follows a mover's program stop by stop: turns every gimbal so that the probe is at five places of its"
        " image, waits until it is still, averages, and stores the view. What is there already is not taken again, so the same"
        " command goes on after an interruption. No daemon may have the gimbals. A simulated cell's probe is moved by it"
        ' (twin.path.kind = "external"); a real machine runs the program, started by hand.',
    )
    parser.add_argument("--plan", type=Path, metavar="FILE", required=True, help="the mover's program")
    parser.add_argument("--output", type=Path, metavar="DIR", required=True, help="the dataset")
    parser.add_argument("--arm", action="store_true", help="let the axes move: nobody is near them")
    parser.add_argument("--frames", type=count, metavar="N", default=20, help="averaged for each look (default: 20)")
    parser.add_argument("--deg-s", type=positive, metavar="V", default=15.0, help="fastest turn of an axis (default: 15)")
    parser.add_argument("--mover", choices=("cnc", "robot"), default="cnc", help="what runs the program (default: cnc)")
    parser.add_argument("--sigma-mm", type=positive, metavar="S", help="of its places (default: 0.005, of a robot 0.65)")
    parser.set_defaults(run=_capture)
    return parser


def _plan(options: argparse.Namespace) -> int:
    from trackerd.cli.calibrate_plan import PlanRequest, plan

    wanted = ("config", "overrides", "points", "check", "format", "volume", "output", "frames", "mm_s", "sigma_mm", "seed")
    plan(PlanRequest(**{key: getattr(options, key) for key in wanted}, tilt_deg=options.tilt_deg))
    return DONE


def _capture(options: argparse.Namespace) -> int:
    from trackerd.cli.calibrate_capture import Request, capture

    wanted = ("config", "overrides", "plan", "output", "arm", "frames", "deg_s", "mover", "sigma_mm")
    capture(Request(**{key: getattr(options, key) for key in wanted}))
    return DONE


def add_cell(what: "argparse._SubParsersAction[argparse.ArgumentParser]") -> argparse.ArgumentParser:
    parser = what.add_parser(
        "cell",
        help="where every gimbal is, how it turns and what its camera sees, from a dataset",
        description="The joint adjustment of all gimbals of a dataset: poses, axes, camera mounts and lenses, with their"
        " covariance. It starts without a guess, rejects outliers, and is refused above 1.5 chi-square per degree of freedom."
        " Check points, outside the adjustment, verify it. A recording needs --config, the cell that was recorded, and"
        " truth.csv, the way of the probe. Writes the calibration file and a report. Exit status 3 where the data do not tell"
        " it, in words that say what would.",
    )
    parser.add_argument(
        "dataset", type=Path, metavar="DATASET", help="a folder with dataset.toml and views.csv, or a recording"
    )
    parser.add_argument("--output", type=Path, metavar="FILE", required=True, help="the calibration file")
    parser.add_argument("--report", type=Path, metavar="FILE", help="the report (default: the output's name with .html)")
    parser.add_argument("--order", choices=("auto", "az_outer", "el_outer"), help="of the axes; auto: found, with the signs")
    parser.add_argument("--signs", type=signs, metavar="AZEL", help="of the encoders, as +-; auto: found, with the order")
    parser.add_argument("--parent", type=Path, metavar="FILE", help="a calibration: start values, and what is held to it")
    parser.add_argument("--only", type=names, metavar="NAMES", default=(), help="adjust these gimbals, hold the others")
    parser.add_argument("--free", type=groups, metavar="GROUPS", default=(), help="pose,axes,hand-eye,lens: adjust only these")
    parser.add_argument("--force", metavar="WHY", default="", help="accept what chi-square refuses; every fix will say so")
    parser.add_argument("--check-points", type=names, metavar="NAMES", help="default: those that the dataset calls so")
    parser.add_argument("--method", choices=("bundle", "thesis"), default="bundle", help="thesis: the source's, to compare")
    parser.add_argument("--volume", type=volume, metavar="XxYxZ[@X,Y,Z]", help="to judge (default: what the data fill)")
    parser.set_defaults(run=_cell, needs_config=False)
    return parser


def names(text: str) -> tuple[str, ...]:
    return tuple(part.strip() for part in text.split(",") if part.strip())


def groups(text: str) -> tuple[str, ...]:
    known = ("pose", "axes", "hand-eye", "lens")
    for part in names(text):
        if part not in known:
            raise argparse.ArgumentTypeError(f"{part!r}: needs some of {', '.join(known)}")
    return names(text)


def signs(text: str) -> str:
    if text not in ("auto", "++", "+-", "-+", "--"):
        raise argparse.ArgumentTypeError(f"{text!r}: needs auto, or two signs for az and el, as in --signs=+-")
    return text


def _cell(options: argparse.Namespace) -> int:
    from trackerd.cli.calibrate_cell import CellRequest, cell

    wanted = (
        "dataset", "output", "report", "order", "signs", "only", "free", "parent", "force", "check_points", "method", "config",
        "overrides",
    )  # fmt: skip
    cell(CellRequest(**{key: getattr(options, key) for key in wanted}, volume=options.volume))
    return DONE
