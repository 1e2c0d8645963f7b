"""The tables in words: the same for terminal, HTML and CSV."""

import csv
import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict, astuple, dataclass, fields
from io import StringIO
from math import isfinite

from trackerd import __version__
from trackerd.budget.contributions import Contributions
from trackerd.budget.layout_shares import Share
from trackerd.budget.settings import BudgetSettings
from trackerd.budget.summary import Efficiency, Row

COLUMNS = ("thesis", "its method", "adjustment", "bound")
TITLES = {
    "reprojection": "reprojection RMS of the one view",
    "pose": "pose of the gimbals: mean |error|, d the norm of the three means",
    "position": "measured targets: mean |error|, d the norm of the three means",
}
BOUND_WORDS = "bound: the mean |error| of normal errors with the Cramér-Rao covariance"
NOTES = {
    "reprojection": "bound: what noise leaves of the view when ten parameters are fitted to it alone",
    "pose": f"{BOUND_WORDS}; pixels without noise are weighed with 1e-4 px or more all the same",
    "position": BOUND_WORDS,
}
KINDS = {"4.2": "reprojection", "4.3": "pose", "4.4": "position", "4.5": "reprojection", "4.6": "pose", "4.7": "position"}
CONTRIBUTIONS = ("part", "sigma x", "sigma y", "sigma z", "3D rms", "U across", "U depth", "share")
UNKNOWN = "-"


@dataclass(frozen=True, slots=True)
class Printed:
    """A table as text; `groups` tell where a rule is drawn: the first cell changes."""

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    note: str = ""


def case_table(settings: BudgetSettings) -> Printed:
    """Table 4.1: the noise of each case."""
    rows = tuple(
        (
            name,
            f"{case.pixel_3sigma_px:g}",
            f"{case.pixel_sigma_px:.4g}",
            f"{case.encoder_arcsec:g}",
            f"{case.encoder_arcsec / 3600.0:.3g}",
            f"{case.encoder_fixed_arcsec:g}",
        )
        for name, case in settings.case.items()
    )
    header = ("case", "pixels 3 sigma, px", "1 sigma, px", 'encoders white, "', "white, deg", 'fixed, "')
    note = "The thesis's pixel levels are 3 sigma, its encoder levels 1 sigma."
    return Printed("Table 4.1: cases", header, rows, note)


def value_tables(rows: Sequence[Row]) -> Iterator[Printed]:
    """One for each table and layout, in the order of the rows."""
    keys = dict.fromkeys((row.table, row.layout) for row in rows)
    for table, layout in keys:
        own = [row for row in rows if (row.table, row.layout) == (table, layout)]
        kind = KINDS.get(table, table)
        title = f"Table {table}: {layout}, {TITLES[kind]}" if table in KINDS else f"{layout}: {TITLES[kind]}"
        body = tuple((row.case, row.value, row.unit, *map(_number, _columns(row))) for row in own)
        yield Printed(title, ("case", "value", "unit", *COLUMNS), body, NOTES[kind])


def efficiency_table(efficiencies: Sequence[Efficiency]) -> Printed:
    """What the adjustment reaches of what is possible."""
    rows = tuple(
        (
            each.layout,
            each.case,
            f"{each.encoder_arcsec:g}",
            f"{each.encoder_fixed_arcsec:g}",
            *map(_number, (each.rms_mm, each.p95_mm, each.max_mm, each.u_across_mm, each.u_depth_mm)),
            *map(_number, (each.bound_rms_mm, each.calibration_rms_mm)),
            UNKNOWN if each.ratio is None else f"{each.ratio:.3f} ± {each.ratio_sigma:.3f}",
            f"{each.refused_source}, {each.refused_adjusted}",
        )
        for each in efficiencies
    )
    lengths = ("rms", "95 %", "max", "U across", "U depth", "bound", "calibration")
    header = ("layout", "case", 'white, "', 'fixed, "', *lengths, "rms / bound", "refused")
    note = (
        "3D errors of single looks in mm; U is k = 2, across in its worst direction. 'white' and 'fixed' are the parts of the"
        " encoders; the bound takes both for independent from view to view, so that it has no ratio where one is fixed."
        " 'calibration' is the part of the bound that more looks at a target do not reduce. 'refused' counts trials that the"
        " thesis's method, and the adjustment, could not solve."
    )
    return Printed("Measured targets by bundle adjustment, against the Cramér-Rao bound", header, rows, note)


def contribution_table(title: str, found: Contributions) -> Printed:
    """Root mean squares over the volume, k = 1 by axis and k = 2 across and in depth."""
    rows = tuple(
        (part.name, *map(_number, (*part.sigma_mm, part.rms_mm, part.u_across_mm, part.u_depth_mm)), f"{part.share:.0%}")
        for part in found.parts
    )
    note = "mm, root mean squares of single looks over the volume; U is k = 2, across in its worst direction; share of variance"
    return Printed(title, CONTRIBUTIONS, rows, note)


def share_table(shares: Sequence[Share]) -> Printed:
    """The same for the cases and layouts of the Monte-Carlo."""
    rows = tuple((each.layout, each.case, each.part, *map(_number, astuple(each)[3:9]), f"{each.share:.0%}") for each in shares)
    note = "mm, first order; root mean squares of single looks over the points' box; U is k = 2, across in its worst direction"
    return Printed("Where it comes from, by layout and case", ("layout", "case", *CONTRIBUTIONS), rows, note)


def as_csv(rows: Sequence[object]) -> str:
    """Of frozen values of one type: a column for each field, empty where not known."""
    out = StringIO()
    writer = csv.writer(out, lineterminator="\n")
    names = [field.name for field in fields(rows[0])]  # type: ignore[arg-type]
    writer.writerow(names)
    writer.writerows([["" if value is None else value for value in asdict(row).values()] for row in rows])  # type: ignore[call-overload]
    return out.getvalue()


def as_json(settings: BudgetSettings, rows: Sequence[Row], efficiencies: Sequence[Efficiency], shares: Sequence[Share]) -> str:
    """Everything, with the settings that made it."""
    found = {
        "simulated": True,
        "software": f"trackerd {__version__}",
        "settings": settings.model_dump(mode="json"),
        "tables": [_told(row) for row in rows],
        "efficiency": [_told(each) for each in efficiencies],
        "shares": [_told(each) for each in shares],
    }
    return json.dumps(found, indent=1, allow_nan=False) + "\n"


def _told(value: Row | Efficiency | Share) -> dict[str, object]:
    """Its fields; what is no number is null, because JSON has no NaN."""
    return {name: None if isinstance(each, float) and not isfinite(each) else each for name, each in asdict(value).items()}


def plain(printed: Printed) -> str:
    """Aligned with blanks, numbers to the right."""
    lines = [printed.header, *printed.rows]
    widths = [max(len(line[n]) for line in lines) for n in range(len(printed.header))]
    rows = ("  ".join(_aligned(cell, width) for cell, width in zip(line, widths, strict=True)).rstrip() for line in lines)
    body = "\n".join(rows)
    return f"{printed.title}\n{body}" + (f"\n{printed.note}" if printed.note else "") + "\n"


def is_number(cell: str) -> bool:
    return cell[:1].isdigit() or cell in (UNKNOWN, "nan")


def _aligned(cell: str, width: int) -> str:
    return cell.rjust(width) if is_number(cell) else cell.ljust(width)


def _columns(row: Row) -> tuple[float | None, ...]:
    return row.source, row.method, row.adjusted, row.bound


def _number(value: float | None) -> str:
    """Four digits; what is not known is '-'."""
    if value is None:
        return UNKNOWN
    if not isfinite(value):
        return str(value)
    return "0" if value == 0.0 else f"{value:.4g}" if 1e-3 <= abs(value) < 1e5 else f"{value:.2e}"
