"""The report of one lens at one zoom setting: figures, pictures with corners and reprojections, parameters, warnings."""

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from trackerd.calibrate.board_kinds import Board
from trackerd.calibrate.lens_figures import coverage_figure, distortion_figure, draw_picture, field_figure, residual_figure
from trackerd.calibrate.lens_model import INTRINSICS
from trackerd.calibrate.lens_result import LensResult
from trackerd.calibrate.report_page import (
    Html,
    dense_figure,
    figure,
    gallery,
    heading,
    page,
    paragraph,
    photograph,
    table,
    tiles,
    warnings,
)
from trackerd.contract.model import Image

MOST_PICTURES = 24  # that are drawn: the worst ones, in their order
MANY_POINTS = 3000  # beyond it a figure with each of them is smaller as PNG


def lens_report(
    result: LensResult,
    board: Board,
    title: str,
    lead: str,
    optics: Sequence[tuple[str, str]],
    picture: Callable[[str], Image],
) -> str:
    """HTML. `optics`: focal length in mm and the like; `picture`: the pixels (height, width) uint8 of a picture by its name."""
    dense = len(result.views.q_px) > MANY_POINTS
    embed = dense_figure if dense else figure
    blocks = [
        tiles(list(_tiles(result))),
        warnings(result.warnings, "No warning: every parameter is observable, and the points cover the sensor."),
        heading("Parameters"),
        table(("", "value", "1 sigma", "correlation with a pose"), list(_parameters(result))),
        paragraph(_how(result)),
        *([table(("lens", ""), list(optics))] if optics else []),
        heading("Residuals"),
        embed(residual_figure(result), "Left: every residual, coloured by picture. Right: root mean square of the distances."),
        embed(
            field_figure(result),
            "Residuals where they are on the sensor. Where orange arrows of neighbouring cells point the same way, the model"
            " does not fit: a board that is not flat, or a lens that needs more coefficients.",
        ),
        heading("Coverage and distortion"),
        embed(coverage_figure(result), "Points in each cell of the sensor; dashed, the outermost point's distance."),
        figure(distortion_figure(result), "The radial part; beyond the outermost point it is extrapolated."),
        heading("Pictures"),
        table(("picture", "points", "rms", "rejected"), list(_pictures(result))),
        *_left_out(result),
        paragraph(
            "Rings: measured. Crosses: where lens and pose put them. Black lines: the residuals, 50 times as long. Arrows: the"
            " board's x (orange) and y (green)."
        ),
        gallery(list(_drawn(result, board, picture))),
    ]
    return page(title, lead, blocks)


def parameter_rows(result: LensResult) -> Iterator[tuple[str, str, str]]:
    """Name, value and sigma in words."""
    for name, value in zip(INTRINSICS, result.estimate.intrinsics.tolist(), strict=True):
        sigma = result.sigmas[name]
        digits = 2 if name.endswith("_px") else 5
        yield name, f"{value:.{digits}f}", f"{sigma:.{digits}f}" if sigma else "held"


def _tiles(result: LensResult) -> Iterator[tuple[str, str]]:
    yield "rms of the distances", f"{result.rms_px:.3f} px"
    yield "sigma of a coordinate", f"{result.sigma_px:.3f} px"
    yield "fx", f"{result.lens.fx_px:.1f} ± {result.sigmas['fx_px']:.1f} px"
    yield "pictures used", f"{len(result.pictures)} of {len(result.pictures) + len(result.left_out)}"
    yield "points used", f"{len(result.views.q_px)}"
    yield "points rejected", f"{result.rejected}"
    yield "sensor covered", f"{result.coverage.share:.0%}"


def _parameters(result: LensResult) -> Iterator[tuple[str, str, str, str]]:
    for (name, value, sigma), correlation in zip(parameter_rows(result), result.correlation.tolist(), strict=True):
        yield name, value, sigma, f"{correlation:.4f}" if correlation else ""


def _how(result: LensResult) -> str:
    tried = ", ".join(f"{one.coefficients}: rms {one.rms_px:.4f} px, BIC {one.bic:.0f}" for one in result.tried)
    wide = f" Sigmas are widened {result.inflation:.2f} times, as the pictures disagree." if result.inflation > 1.0 else ""
    return (
        f"{result.coefficients} distortion coefficients ({tried}). Sigmas are those of the scatter of {result.freedom} degrees"
        f" of freedom, all poses unknown.{wide} OpenCV's model and order; an integer pixel is a pixel's centre."
    )


def _pictures(result: LensResult) -> Iterator[tuple[str, str, str, str]]:
    for one in result.pictures:
        yield one.name, str(one.points), f"{one.rms_px:.3f} px", ", ".join(map(str, one.rejected)) or "none"


def _left_out(result: LensResult) -> list[Html]:
    if not result.left_out:
        return [paragraph("No picture is left out.")]
    return [paragraph("Left out:"), table(("picture", "why"), [(one.name, one.reason) for one in result.left_out])]


def _drawn(result: LensResult, board: Board, picture: Callable[[str], Image]) -> Iterator[Html]:
    worst = np.argsort([-one.rms_px for one in result.pictures], kind="stable")[:MOST_PICTURES]
    for n in sorted(int(n) for n in worst):
        one = result.pictures[n]
        drawn = draw_picture(picture(one.name), result, n, board.points_mm)
        yield photograph(drawn, f"{one.name}: rms {one.rms_px:.3f} px")
