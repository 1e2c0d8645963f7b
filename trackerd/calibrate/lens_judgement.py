"""What a person should know before believing a lens: what the pictures do not tell, and where they tell nothing."""

from collections.abc import Iterator
from math import degrees, sqrt

import numpy as np

from trackerd.calibrate.lens_result import Coverage, LensResult
from trackerd.calibrate.lens_solve import UNTURNED
from trackerd.contract.errors import Undetermined
from trackerd.contract.model import Array

COLUMNS, ROWS = 8, 6  # cells of the sensor
GOOD_PICTURES = 10
LEAST_COVER, LEAST_RADIUS = 0.7, 0.75  # of the cells; of the way to the corner
FOCAL_LIMIT, CENTRE_LIMIT = 0.005, 0.01  # sigma: of the focal length; of the sensor's side
FOCAL_HOPELESS = 0.2  # a focal length that is less certain is none
CORRELATED = 0.99  # with a pose: told here, because a principal point reaches 0.998 in good pictures, too
LEAST_TILT = 10.0  # degrees between two boards
SQUARE_SIGMAS, SQUARE_SHARE = 5.0, 0.002  # of fy / fx from 1: pixels of cameras are square to better than this
MOST_LEFT_OUT = 0.3


def cover(q_px: Array, sensor_px: tuple[int, int]) -> Coverage:
    width, height = sensor_px
    cells, _, _ = np.histogram2d(q_px[:, 1], q_px[:, 0], (ROWS, COLUMNS), ((-0.5, height - 0.5), (-0.5, width - 0.5)))
    centre = np.array(((width - 1) / 2.0, (height - 1) / 2.0))
    radius = float(np.linalg.norm(q_px - centre, axis=1).max())
    return Coverage(cells.astype(np.intp), radius, 0.5 * sqrt(width**2 + height**2))


def judge(result: LensResult) -> Iterator[str]:
    """Warnings, the gravest first. Raises Undetermined where there is no focal length."""
    yield from _centre_warnings(result)
    yield from _focal_warnings(result)
    yield from _pixel_warnings(result)
    yield from _picture_warnings(result)
    yield from _coverage_warnings(result)


def tilt_deg(result: LensResult) -> float:
    """The largest angle between the planes of two boards."""
    normals = result.estimate.rotation[:, :, 2]
    return degrees(float(np.arccos(np.clip((normals @ normals.T).min(), -1.0, 1.0))))


def _focal_warnings(result: LensResult) -> Iterator[str]:
    lens = result.lens
    shares = {"fx": result.sigmas["fx_px"] / lens.fx_px, "fy": result.sigmas["fy_px"] / lens.fy_px}
    tilt = tilt_deg(result)
    if max(shares.values()) > FOCAL_HOPELESS:
        raise Undetermined(
            f"the pictures do not tell the focal length: {lens.fx_px:.0f} +- {result.sigmas['fx_px']:.0f} px;"
            f" no two boards are tilted by more than {tilt:.1f} degrees to each other: {UNTURNED}"
        )
    for (name, share), correlation in zip(shares.items(), result.correlation[:2], strict=True):
        if share > FOCAL_LIMIT:
            yield (
                f"{name} is hardly observable: its sigma is {share:.1%} of it, its correlation with a board's pose"
                f" {correlation:.4f}: {UNTURNED}, or let the encoders of a gimbal tell it (calibrate cell)"
            )
    if tilt < LEAST_TILT:
        yield f"all boards are nearly parallel, within {tilt:.1f} degrees: {UNTURNED}"


def _centre_warnings(result: LensResult) -> Iterator[str]:
    lens = result.lens
    for name, value, side, correlation in (
        ("cx", lens.cx_px, lens.sensor_px[0], result.correlation[2]),
        ("cy", lens.cy_px, lens.sensor_px[1], result.correlation[3]),
    ):
        sigma = result.sigmas[f"{name}_px"]
        if not -0.5 <= value <= side - 0.5:
            yield (
                f"the principal point leaves the sensor: {name} = {value:.0f} +- {sigma:.0f} px of 0 to {side - 1};"
                " no lens does that"
            )
        if sigma > CENTRE_LIMIT * side:
            pose = f", its correlation with a board's pose {correlation:.4f}" if correlation > CORRELATED else ""
            yield (
                f"{name} is not observable: its sigma is {sigma:.0f} px{pose}: hold it (--fix-centre), or let the encoders"
                " of a gimbal tell it (calibrate cell)"
            )


def _pixel_warnings(result: LensResult) -> Iterator[str]:
    ratio = result.lens.fy_px / result.lens.fx_px
    slope = np.zeros(9)
    slope[:2] = -ratio / result.lens.fx_px, 1.0 / result.lens.fx_px
    sigma = sqrt(max(0.0, float(slope @ result.covariance @ slope)))  # 0, to rounding, where it is held
    if abs(ratio - 1.0) > SQUARE_SHARE and (abs(ratio - 1.0) > SQUARE_SIGMAS * sigma or abs(ratio - 1.0) > 10 * SQUARE_SHARE):
        yield f"fy / fx = {ratio:.4f} +- {sigma:.4f}: pixels are square, so either is wrong; hold it (--fix-aspect)"


def _picture_warnings(result: LensResult) -> Iterator[str]:
    used, lost = len(result.pictures), len(result.left_out)
    if used < GOOD_PICTURES:
        yield f"only {used} pictures are used: {GOOD_PICTURES} to 20 make the sigmas trustworthy"
    if lost > MOST_LEFT_OUT * (used + lost):
        yield f"{lost} of {used + lost} pictures are left out"
    if result.inflation > 1.0:
        yield (
            f"pictures agree {result.inflation:.1f} times less with each other than the corners of one picture do (board not"
            " flat, print not true, lens more complicated): all sigmas are widened by that"
        )


def _coverage_warnings(result: LensResult) -> Iterator[str]:
    coverage = result.coverage
    if coverage.share < LEAST_COVER:
        yield f"points cover {coverage.share:.0%} of the sensor's cells: show the board in every part of the picture"
    if coverage.radius_share < LEAST_RADIUS:
        yield f"no point is farther out than {coverage.radius_share:.0%} of the way to the corner: distortion beyond is a guess"
    if _folds(result):
        yield "the distortion folds the picture over before its corner: fewer coefficients, or points farther out"


def _folds(result: LensResult) -> bool:
    """The radius in the picture does not grow with the angle all the way to the corner."""
    lens = result.lens
    k1, k2, _, _, k3 = lens.distortion
    reach = result.coverage.corner_px / min(lens.fx_px, lens.fy_px)
    r2 = np.linspace(0.0, reach, 200) ** 2
    slope = 1.0 + r2 * (3 * k1 + r2 * (5 * k2 + 7 * r2 * k3))
    return bool((slope <= 0.0).any())
