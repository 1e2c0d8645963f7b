"""The options of `trackerd align`."""

import argparse
from pathlib import Path

from trackerd.cli.statuses import DONE
from trackerd.contract.errors import ConfigError

ROLES = (("plane", 3, "A,B,C"), ("line", 2, "A,B"), ("origin", 1, "A"))


def add_align(commands: "argparse._SubParsersAction[argparse.ArgumentParser]") -> argparse.ArgumentParser:
    parser = commands.add_parser(
        "align",
        help="where the cell lies in the world of a machine: datum transfer from measured to nominal points",
        description="Finds world_from_cell from points that the cell measured and their nominal coordinates, both CSV with the"
        " columns id, x_mm, y_mm, z_mm and, where known, sigma_mm or cxx_mm2, cxy_mm2, cxz_mm2, cyy_mm2, cyz_mm2, czz_mm2. Best"
        " fit, or 3-2-1: a plane from three points (--plane), a direction in it from two (--line), a place along that from one"
        " (--origin). Prints every point's error, rms, maximum and chi-square; a scale is reported, never applied. Writes a"
        " named datum with its covariance into a file of its own. Exit status 3 where the points determine none.",
    )
    parser.add_argument("measured", type=Path, metavar="MEASURED", help="points as the cell measured them, CSV")
    parser.add_argument("nominal", type=Path, metavar="NOMINAL", help="the same points in the world's coordinates, CSV")
    parser.add_argument("--name", required=True, metavar="WORLD", help="the world's name, such as mill-3")
    parser.add_argument("--output", required=True, type=Path, metavar="FILE", help="the datum, TOML")
    parser.add_argument("--plane", metavar="A,B,C", help="3-2-1: three points that make the plane")
    parser.add_argument("--line", metavar="A,B", help="3-2-1: two points in its direction")
    parser.add_argument("--origin", metavar="A", help="3-2-1: the point along that")
    parser.add_argument("--leave-out", action="append", default=[], metavar="ID", help="a point that is not used (repeatable)")
    parser.set_defaults(run=_align, needs_config=False)
    return parser


def _align(options: argparse.Namespace) -> int:
    from trackerd.calibrate.align import ThreeTwoOne
    from trackerd.cli.align import AlignRequest, align

    roles = None
    if any(getattr(options, role) is not None for role, _, _ in ROLES):
        plane, line, origin = (_names(options, *role) for role in ROLES)
        roles = ThreeTwoOne((plane[0], plane[1], plane[2]), (line[0], line[1]), origin[0])
    wanted = {key: getattr(options, key) for key in ("measured", "nominal", "name", "output", "config", "overrides")}
    align(AlignRequest(**wanted, roles=roles, left_out=options.leave_out))
    return DONE


def _names(options: argparse.Namespace, role: str, count: int, form: str) -> list[str]:
    text = getattr(options, role)
    if text is None:
        raise ConfigError(f"align: 3-2-1 needs --plane, --line and --origin: --{role} {form} is missing")
    names = [name.strip() for name in text.split(",")]
    if len(names) != count or not all(names):
        raise ConfigError(f"--{role} {text}: needs the names of {count} points: {form}")
    return names
