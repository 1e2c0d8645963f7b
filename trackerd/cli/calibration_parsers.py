"""The options of `trackerd calibration WHAT`, one function for each WHAT."""

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

from trackerd.cli.arguments import box
from trackerd.cli.statuses import DONE

if TYPE_CHECKING:
    from trackerd.cli.calibration import Place

Commands: TypeAlias = "argparse._SubParsersAction[argparse.ArgumentParser]"
FORMATS = ("opencv", "camera_info")


def add_calibration(commands: Commands) -> Iterator[argparse.ArgumentParser]:
    """Adds `calibration`; yields the parser of each WHAT."""
    what = commands.add_parser(
        "calibration",
        help="the versions of a cell's calibration: list, show, activate, roll back; lenses of OpenCV and ROS",
        description="Keeps every version of the calibration of a cell (--config, or the file itself by --calibration) in the"
        " folder NAME.versions beside it. The active file is a whole copy of one of them. A daemon that runs is not touched by"
        " any of this: it has read its file, and reads it again when it is started again.",
    ).add_subparsers(title="what", metavar="WHAT", required=True)
    for add in (_add_list, _add_show, _add_add, _add_activate, _add_rollback, _add_export, _add_import):
        parser = add(what)
        parser.add_argument("--calibration", type=Path, metavar="FILE", help="the calibration file, instead of --config")
        parser.set_defaults(needs_config=False)
        yield parser


def _add_list(what: Commands) -> argparse.ArgumentParser:
    parser = what.add_parser("list", help="all versions, and who activated which, when and why")
    parser.set_defaults(run=_list)
    return parser


def _add_show(what: Commands) -> argparse.ArgumentParser:
    parser = what.add_parser(
        "show",
        help="stations, sigmas, verification, and the difference to the active one",
        description="Shows a version (default: the active one): what it was made from, how far it may be trusted, every"
        " station's parameters with their sigmas, and how far it shifts the work against the active one.",
    )
    parser.add_argument("id", nargs="?", metavar="ID", help="the version (default: the active one)")
    _add_volume(parser)
    parser.set_defaults(run=_show)
    return parser


def _add_add(what: Commands) -> argparse.ArgumentParser:
    parser = what.add_parser("add", help="keep a calibration file as a version, without activating it")
    parser.add_argument("file", type=Path, metavar="FILE")
    parser.set_defaults(run=_add)
    return parser


def _add_activate(what: Commands) -> argparse.ArgumentParser:
    parser = what.add_parser(
        "activate",
        help="make a version the active one",
        description="Prints how far the version shifts the work, asks, and replaces the active file in one step; the journal"
        " tells who, when and why.",
    )
    parser.add_argument("id", metavar="ID", help="the version")
    _add_change(parser)
    parser.set_defaults(run=_activate)
    return parser


def _add_rollback(what: Commands) -> argparse.ArgumentParser:
    parser = what.add_parser("rollback", help="go back to the version that was active before")
    _add_change(parser)
    parser.set_defaults(run=_rollback)
    return parser


def _add_change(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--why", required=True, metavar="TEXT", help="the reason, for the journal")
    parser.add_argument("--who", metavar="NAME", help="who does it, for the journal (default: the user's name)")
    parser.add_argument("--yes", action="store_true", help="do not ask: for scripts")
    _add_volume(parser)


def _add_volume(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--volume",
        type=box,
        metavar="X,Y,Z,X,Y,Z",
        help="where the shift is judged: two corners of a box, mm, written --volume=-200,... (default: the calibration's own)",
    )


def _add_export(what: Commands) -> argparse.ArgumentParser:
    parser = what.add_parser(
        "export",
        help="write a station's lens as OpenCV or ROS have it",
        description="Writes a lens as OpenCV's YAML (camera_matrix, distortion_coefficients) or as ROS' camera_info YAML"
        " (plumb_bob, not rectified). Numbers, frame (x right, y down, z forward) and pixels (an integer is a centre) are the"
        " same in all three.",
    )
    parser.add_argument("file", type=Path, metavar="FILE")
    parser.add_argument("--station", required=True, metavar="NAME")
    parser.add_argument("--format", choices=FORMATS, required=True)
    parser.add_argument("--id", metavar="ID", help="of this version (default: the active one)")
    parser.set_defaults(run=_export)
    return parser


def _add_import(what: Commands) -> argparse.ArgumentParser:
    parser = what.add_parser(
        "import",
        help="take a station's lens from a file of OpenCV or ROS, as a new version",
        description="Makes a new version: the active one with the lens of one station from FILE (OpenCV's YAML, XML or JSON, or"
        " ROS' camera_info YAML). The rest was not adjusted to that lens: the new version is unverified, and has no covariance."
        " Rational and fisheye models are refused by their name.",
    )
    parser.add_argument("file", type=Path, metavar="FILE")
    parser.add_argument("--station", required=True, metavar="NAME")
    parser.add_argument("--id", metavar="ID", help="of the new version (default: by the time)")
    parser.set_defaults(run=_import)
    return parser


def _list(options: argparse.Namespace) -> int:
    from trackerd.cli.calibration import list_versions

    return list_versions(_place(options))


def _show(options: argparse.Namespace) -> int:
    from trackerd.cli.calibration import show

    return show(_place(options), options.id, options.volume)


def _add(options: argparse.Namespace) -> int:
    from trackerd.cli.calibration import add

    return add(_place(options), options.file)


def _activate(options: argparse.Namespace) -> int:
    from trackerd.cli.calibration import Change, change

    return change(_place(options), Change(options.id, options.why, options.who, options.yes, options.volume))


def _rollback(options: argparse.Namespace) -> int:
    from trackerd.cli.calibration import Change, change

    return change(_place(options), Change(None, options.why, options.who, options.yes, options.volume))


def _export(options: argparse.Namespace) -> int:
    from trackerd.cli.calibration_lens import export_lens

    export_lens(_place(options), options.id, options.station, options.format, options.file)
    return DONE


def _import(options: argparse.Namespace) -> int:
    from trackerd.cli.calibration_lens import import_lens

    import_lens(_place(options), options.id, options.station, options.file)
    return DONE


def _place(options: argparse.Namespace) -> "Place":
    from trackerd.cli.calibration import Place

    return Place.of(options.config, options.calibration, options.overrides)
