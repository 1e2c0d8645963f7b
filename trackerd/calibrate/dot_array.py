"""Arrays of LEDs or dots in pictures: each dot is told by its place among the others."""

import numpy as np

from trackerd.calibrate.blobs import find_spots
from trackerd.calibrate.board_kinds import Detected, Detection, DotArray, Missed
from trackerd.calibrate.dot_match import fewest_dots, match_dots
from trackerd.contract.model import Image

SHARE = 0.6  # of the array's points that must be seen: fewer could be matched otherwise, too
MOST_DOTS = 3  # times as many as the array has: that picture shows something else


def detect_dot_array(board: DotArray, image: Image) -> Detection:
    """`image` (height, width) uint8. A part of the array will do. What looks alike from several sides is refused."""
    spots = find_spots(image, board.dark)
    count = len(board.points_mm)
    fewest = fewest_dots(board.points_mm, SHARE)
    if len(spots) < fewest:
        return Missed(f"{len(spots)} dots, at least {fewest} of the array's {count} are needed")
    if len(spots) > MOST_DOTS * count:
        return Missed(f"{len(spots)} dots, the array has {count}: something else is in the picture")
    matches = match_dots(board.points_mm, np.array(board.facing), spots.q_px, fewest)
    front = [one for one in matches if one.front]
    if not matches:
        return Missed(f"{len(spots)} dots, but fewer than {fewest} of them lie as the array's do")
    if not front:
        return Missed(
            "the dots match only mirrored, as if seen from behind: a coordinate has the wrong sign, axes are exchanged, or"
            f" `facing` {list(board.facing)} points the wrong way"
        )
    if len({tuple(zip(one.points, one.dots, strict=True)) for one in front}) > 1:
        return Missed(f"the array looks alike in {len(front)} ways: leave out or move some dots so that it is not symmetric")
    found = front[0]
    order = np.argsort(found.points)
    points, dots = found.points[order], found.dots[order]
    return Detected(points, spots.q_px[dots], spots.sigma_px[dots])
