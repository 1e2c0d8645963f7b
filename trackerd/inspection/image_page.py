"""The page of one image: what the detector saw, or where it looked in vain."""

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from trackerd.inspection import panels, style
from trackerd.inspection.examine import Examination, edges
from trackerd.inspection.numbers import examination_rows
from trackerd.inspection.style import SECTOR_TICKS

SIZE_IN = (16.0, 13.0)
MISSED_SIZE_IN = (16.0, 9.0)
MAGNIFIED_IN = 3.0  # 3 pixels of 100 dots each


def image_page(examination: Examination) -> Figure:
    if examination.found is None or examination.fit is None:
        return _missed(examination)
    return _found(examination)


def _found(examination: Examination) -> Figure:
    found, fit = examination.found, examination.fit
    assert found is not None
    assert fit is not None
    edge = edges(fit, examination.noise)
    with style.page(SIZE_IN, examination.name) as figure:
        panels.close_up(_at(figure, 0.02, 0.48, 0.46, 0.46), examination, found, edge)
        panels.radial_profile(_at(figure, 0.535, 0.765, 0.215, 0.175), examination)
        panels.whole(_at(figure, 0.78, 0.755, 0.20, 0.185), examination, found)
        width, height = MAGNIFIED_IN / SIZE_IN[0], MAGNIFIED_IN / SIZE_IN[1]
        panels.magnified(_at(figure, 0.535, 0.47, width, height), examination, found)
        style.table(_at(figure, 0.755, 0.44, 0.235, 0.28), examination_rows(examination), width=34, column=0.33)
        top = _at(figure, 0.06, 0.30, 0.92, 0.12)
        middle, bottom = _at(figure, 0.06, 0.175, 0.92, 0.085), _at(figure, 0.06, 0.05, 0.92, 0.085)
        panels.sector_offsets(top, edge, fit)
        panels.sector_chi2(middle, edge, fit)
        panels.sector_levels(bottom, edge, fit)
        _sector_axes(top, middle, bottom)
        return figure


def _missed(examination: Examination) -> Figure:
    with style.page(MISSED_SIZE_IN, f"{examination.name}: no ball found") as figure:
        panels.looked(_at(figure, 0.02, 0.04, 0.62, 0.86), examination)
        rows = [row for row in examination_rows(examination) if row[0] != "looked at"]
        rows += [(f"{number} looked at", _told(examination, number - 1)) for number in range(1, len(examination.looks) + 1)]
        style.table(_at(figure, 0.67, 0.04, 0.31, 0.86), rows, width=50, column=0.2)
        return figure


def _told(examination: Examination, index: int) -> str:
    (x, y, r), reason = examination.looks[index].circle, examination.looks[index].reason
    return f"({x:.0f}, {y:.0f}), r {r:.0f}: {reason}"


def _at(figure: Figure, left: float, bottom: float, width: float, height: float) -> Axes:
    return figure.add_axes((left, bottom, width, height))


def _sector_axes(*stacked: Axes) -> None:
    for axes in stacked:
        axes.set(xlim=(0, 360), xticks=SECTOR_TICKS, xticklabels=[f"{tick}°" for tick in SECTOR_TICKS])
    for axes in stacked[:-1]:
        axes.tick_params(labelbottom=False)
