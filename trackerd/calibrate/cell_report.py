"""The report of a cell's calibration: one file that needs no other, for any browser."""

from collections.abc import Iterator, Sequence
from html import escape

from trackerd.calibrate.cell import CellResult
from trackerd.calibrate.cell_data import CellData
from trackerd.calibrate.cell_figures import cell_picture, check_picture, correlation_picture, error_map, residual_picture
from trackerd.calibrate.cell_words import Rows, parameter_rows
from trackerd.calibrate.cell_worth import STEPS, Worth
from trackerd.calibrate.figures import DOTS_AN_INCH, look
from trackerd.calibrate.report_page import Html, dense_figure, heading, page, paragraph, table, tiles, warnings
from trackerd.formats.calibration import Calibration


def report(
    data: CellData,
    result: CellResult,
    worth: Worth,
    calibration: Calibration,
    summary: Rows,
    more: Sequence[tuple[str, Rows]] = (),
) -> str:
    """The page's HTML. `more` are further tables with their titles."""
    with look():
        blocks = list(_blocks(data, result, worth, calibration, summary, more))
    source = "" if calibration.data is None else f"from {calibration.data.name} (sha256 {calibration.data.sha256[:16]}…), "
    return page(f"Calibration {calibration.id}", f"{source}{calibration.created}, {calibration.software}", blocks)


def _blocks(
    data: CellData,
    result: CellResult,
    worth: Worth,
    calibration: Calibration,
    summary: Rows,
    more: Sequence[tuple[str, Rows]],
) -> Iterator[Html]:
    yield tiles(_tiles(result, worth))
    yield warnings([*_standing(calibration), *result.warnings], "verified by its check points; the adjustment has no warning")
    yield _words(summary)
    for title, rows in more:
        yield heading(title)
        yield _words(rows)
    yield heading("The cell")
    yield dense_figure(cell_picture(result, worth), "Stations, work volume and points. Ellipsoids hold 1 sigma.", DOTS_AN_INCH)
    yield heading("Predicted error of a target over the volume")
    words = "Three slices through the depth. Pixels and encoders of one frame, and the calibration; below, its part alone."
    yield dense_figure(error_map(worth, STEPS), words, DOTS_AN_INCH)
    yield from _checks(worth)
    yield heading("Residuals")
    for name in data.observations.gimbals:
        yield dense_figure(residual_picture(data, result, name), f"{name}: after the encoders' corrections.", DOTS_AN_INCH)
    yield from _left_out(data, result)
    yield heading("Parameters")
    words = "Dark pairs are told apart badly by the data; the priors keep them finite, and targets feel little of it."
    yield dense_figure(correlation_picture(result), words, DOTS_AN_INCH)
    yield table(("parameter", "value", "± 1 sigma"), list(parameter_rows(result)))


def _words(rows: Rows) -> Html:
    """Names and words, from the left."""
    left = ' style="text-align:left"'
    cells = "\n".join(f"<tr><td>{escape(name)}</td><td{left}>{escape(words)}</td></tr>" for name, words in rows)
    return Html(f"<table><tbody>\n{cells}\n</tbody></table>")


def _tiles(result: CellResult, worth: Worth) -> list[tuple[str, str]]:
    across, depth = worth.total.worst()
    shown = [
        ("chi-square per degree of freedom", f"{result.chi2_per_dof:.2f}"),
        ("U (k = 2) across, mm", f"{across:.3f}"),
        ("U (k = 2) in depth, mm", f"{depth:.3f}"),
        ("of it the calibration, in depth, mm", f"{worth.calibration.worst()[1]:.3f}"),
    ]
    if worth.checked is not None:
        shown.append((f"rms of {len(worth.checked.names)} check points, mm", f"{worth.checked.verification.rms_mm:.3f}"))
    return shown


def _standing(calibration: Calibration) -> list[str]:
    found = [f"forced: {calibration.forced_because}"] if calibration.forced else []
    if calibration.verification is None:
        return [*found, "unverified: there are no check points outside the adjustment"]
    return [*found, *(f"unverified: {words}" for words in calibration.verification.shortcomings())]


def _checks(worth: Worth) -> Iterator[Html]:
    picture = check_picture(worth)
    if picture is not None:
        yield heading("Check points, outside the adjustment")
        yield dense_figure(picture, "En is the error over its expanded uncertainty (k = 2): at most 1.", DOTS_AN_INCH)


def _left_out(data: CellData, result: CellResult) -> Iterator[Html]:
    if result.rejected:
        yield paragraph(f"{len(result.rejected)} were rejected:")
        rows = [(r.view, r.point or "the whole view", f"{r.sigmas:.1f}", r.reason) for r in result.rejected]
        yield table(("view", "point", "sigmas", "why"), rows)
    if data.left_out:
        yield paragraph("Pictures that were left out: " + "; ".join(data.left_out))
