"""One page of a report in one file: figures and pictures are inside, nothing is loaded from elsewhere."""

from base64 import b64encode
from collections.abc import Sequence
from html import escape
from io import BytesIO, StringIO
from typing import NewType

import cv2
from matplotlib.figure import Figure

from trackerd.contract.model import Image

Html = NewType("Html", str)

JPEG_QUALITY = 88
STYLE = """
:root { --ink: #1d2733; --faint: #64748b; --line: #dbe1e8; --ground: #f6f8fa; --accent: #1f5f99; --warn: #9a5b00; }
* { box-sizing: border-box; }
body { font: 15px/1.5 system-ui, "Segoe UI", "Liberation Sans", sans-serif; margin: 0; }
body { color: var(--ink); background: var(--ground); }
main { max-width: 1180px; margin: 0 auto; padding: 28px 24px 60px; }
h1 { font-size: 26px; font-weight: 650; margin: 0 0 2px; }
h2 { font-size: 18px; font-weight: 650; margin: 36px 0 10px; padding-top: 14px; border-top: 1px solid var(--line); }
p { margin: 6px 0 10px; max-width: 82ch; }
.lead { color: var(--faint); margin-bottom: 18px; }
.tiles { display: flex; flex-wrap: wrap; gap: 10px; margin: 18px 0; }
.tile { background: #fff; border: 1px solid var(--line); border-radius: 8px; padding: 9px 14px; min-width: 112px; }
.tile b { display: block; font-size: 19px; font-weight: 650; font-variant-numeric: tabular-nums; }
.tile span { color: var(--faint); font-size: 13px; }
.warn { background: #fff7e6; border-left: 4px solid #e09a1a; padding: 8px 14px; margin: 8px 0; color: var(--warn); }
.good { background: #edf7ef; border-left: 4px solid #3c9a5f; padding: 8px 14px; margin: 8px 0; color: #22633c; }
table { border-collapse: collapse; background: #fff; border: 1px solid var(--line); font-variant-numeric: tabular-nums; }
th, td { padding: 5px 14px; text-align: right; border-bottom: 1px solid var(--line); }
th { font-weight: 600; color: var(--faint); font-size: 13px; }
th:first-child, td:first-child { text-align: left; }
tr:last-child td { border-bottom: none; }
figure { margin: 14px 0; background: #fff; border: 1px solid var(--line); border-radius: 8px; padding: 12px; }
figure svg, figure img { max-width: 100%; height: auto; display: block; margin: 0 auto; }
figcaption { color: var(--faint); font-size: 13.5px; margin-top: 8px; max-width: 100ch; }
.gallery { display: grid; grid-template-columns: repeat(auto-fill, minmax(480px, 1fr)); gap: 12px; }
.gallery figure { margin: 0; padding: 8px; }
@media print { body { background: #fff; } figure { break-inside: avoid; } }
"""


def page(title: str, lead: str, blocks: Sequence[Html]) -> str:
    """The whole file."""
    return (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>{escape(title)}</title>'
        f'<meta name="viewport" content="width=device-width"><style>{STYLE}</style></head>\n<body><main>\n'
        f'<h1>{escape(title)}</h1>\n<p class="lead">{escape(lead)}</p>\n' + "\n".join(blocks) + "\n</main></body></html>\n"
    )


def heading(text: str) -> Html:
    return Html(f"<h2>{escape(text)}</h2>")


def paragraph(text: str) -> Html:
    return Html(f"<p>{escape(text)}</p>")


def tiles(figures: Sequence[tuple[str, str]]) -> Html:
    """The figures that matter most, with their names."""
    inside = "".join(f'<div class="tile"><b>{escape(value)}</b><span>{escape(name)}</span></div>' for name, value in figures)
    return Html(f'<div class="tiles">{inside}</div>')


def warnings(texts: Sequence[str], none: str) -> Html:
    """One box for each; `none` is said where there is none."""
    if not texts:
        return Html(f'<div class="good">{escape(none)}</div>')
    return Html("\n".join(f'<div class="warn">{escape(text)}</div>' for text in texts))


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> Html:
    names = "".join(f"<th>{escape(name)}</th>" for name in head)
    lines = "\n".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows)
    return Html(f"<table><thead><tr>{names}</tr></thead><tbody>\n{lines}\n</tbody></table>")


def figure(drawn: Figure, caption: str) -> Html:
    """As SVG: sharp at every size."""
    text = StringIO()
    drawn.savefig(text, format="svg", metadata={"Date": None})
    svg = text.getvalue()
    return Html(f"<figure>{svg[svg.index('<svg') :]}<figcaption>{escape(caption)}</figcaption></figure>")


def dense_figure(drawn: Figure, caption: str, dpi: int = 170) -> Html:
    """As PNG: for thousands of marks."""
    raw = BytesIO()
    drawn.savefig(raw, format="png", dpi=dpi)
    return _embedded(raw.getvalue(), "image/png", caption)


def photograph(image: Image, caption: str) -> Html:
    """(height, width, 3) uint8 in OpenCV's order of colours, as JPEG."""
    _, encoded = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    return _embedded(encoded.tobytes(), "image/jpeg", caption)


def gallery(figures: Sequence[Html]) -> Html:
    """Small pictures side by side."""
    return Html('<div class="gallery">' + "\n".join(figures) + "</div>")


def _embedded(raw: bytes, kind: str, caption: str) -> Html:
    data = b64encode(raw).decode()
    return Html(f'<figure><img alt="" src="data:{kind};base64,{data}"><figcaption>{escape(caption)}</figcaption></figure>')
