"""The options of `trackerd calibrate lens`."""

import argparse
from pathlib import Path

from trackerd.cli.arguments import micrometres, millimetres, size
from trackerd.cli.statuses import DONE

KINDS = ("chessboard", "charuco", "circles", "asymmetric", "leds")


def add_lens(what: "argparse._SubParsersAction[argparse.ArgumentParser]") -> argparse.ArgumentParser:
    parser = what.add_parser(
        "lens",
        help="focal length, principal point and distortion of a camera, from pictures of a board",
        description="Intrinsics of a lens with their sigmas, from 10 to 20 pictures of a board that is turned and tilted, in"
        " every part of the sensor, near and far. Pictures without the board are named and left out, as are gross errors; what"
        " the pictures do not tell is a warning. Several folders are several zoom settings of one camera; the output is added"
        " to, if it is there. Exit status 3 where the pictures do not tell the lens, in words that say what would.",
    )
    parser.add_argument("images", nargs="+", metavar="IMAGES", help="pictures, folders of them, or patterns in quotes")
    parser.add_argument("--output", required=True, type=Path, metavar="FILE", help="the lens file (TOML)")
    parser.add_argument("--report", type=Path, metavar="FILE", help="the report with pictures (default: FILE.html beside it)")
    parser.add_argument("--zoom", metavar="NAME", help="name of the zoom setting (default: default, or each folder's name)")
    _add_board(parser)
    _add_model(parser)
    parser.set_defaults(run=_lens, needs_config=False)
    return parser


def _add_board(parser: argparse.ArgumentParser) -> None:
    board = parser.add_argument_group("the board")
    board.add_argument("--board-type", choices=KINDS, default="chessboard", help="default: chessboard")
    board.add_argument(
        "--board",
        type=size,
        metavar="CxR",
        help="columns and rows: inner corners of a chessboard (9x6), squares of a ChArUco board, dots of a grid",
    )
    board.add_argument(
        "--square-mm",
        type=millimetres,
        metavar="MM",
        help="side of a square; distance of the dots of a grid, half of that in a row where it is asymmetric",
    )
    board.add_argument("--marker-mm", type=millimetres, metavar="MM", help="side of a ChArUco marker")
    board.add_argument("--dictionary", default="4X4_50", metavar="NAME", help="of the markers, as in 5X5_100 (default: 4X4_50)")
    board.add_argument("--legacy", action="store_true", help="a ChArUco board as OpenCV before 4.6 drew it")
    board.add_argument("--points", type=Path, metavar="FILE", help="of leds: coordinates, CSV (id,x_mm,y_mm,z_mm) or TOML")


def _add_model(parser: argparse.ArgumentParser) -> None:
    model = parser.add_argument_group("the lens")
    model.add_argument("--fix-aspect", action="store_true", help="fx = fy, as square pixels have it")
    model.add_argument("--fix-centre", action="store_true", help="hold the principal point in the middle: narrow fields")
    model.add_argument("--coefficients", type=int, choices=(0, 1, 2, 4, 5), help="of distortion (default: by BIC)")
    model.add_argument("--pixel-um", type=micrometres, metavar="UM", help="pixel pitch: prints the focal length in mm")
    model.add_argument("--range-mm", type=millimetres, metavar="MM", help="prints the field of view at this distance")


def _lens(options: argparse.Namespace) -> int:
    from trackerd.calibrate.lens import LensOptions
    from trackerd.cli.calibrate_lens import BoardRequest, LensRequest, lens

    board = BoardRequest(
        options.board_type,
        options.board,
        options.square_mm,
        options.marker_mm,
        options.dictionary.upper().removeprefix("DICT_"),
        options.legacy,
        options.points,
    )
    model = LensOptions(options.fix_aspect, options.fix_centre, options.coefficients)
    lens(
        LensRequest(
            options.images,
            board,
            options.output,
            options.report,
            options.zoom,
            model,
            options.pixel_um,
            options.range_mm,
        )
    )
    return DONE
