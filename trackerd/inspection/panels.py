"""The panels of an examination's page: each draws one aspect on axes that it is given."""

from math import degrees
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Circle, Ellipse, Rectangle

from trackerd.contract.model import Found, Image
from trackerd.inspection import style
from trackerd.inspection.examine import Edges, Examination, Profile, profile
from trackerd.inspection.numbers import ellipse_95
from trackerd.pictures.look import INK, QUIET
from trackerd.vision.convergence import CircleFit

AROUND_RADII = 1.45  # of the close-up
MAGNIFIED_PX = 3  # sides of the magnified centre
ABOVE: dict[str, Any] = {
    "loc": "lower right",
    "bbox_to_anchor": (1.0, 0.98),
    "borderpad": 0.1,
}  # of the axes, in the title's line
FEW_DOTS = 6000  # of the profile: more are a blot and a heavy file


def close_up(axes: Axes, examination: Examination, found: Found, edge: Edges) -> None:
    """The ball with its edge points by weight and the fitted outline."""
    x, y = found.x_px, found.y_px
    half = max(AROUND_RADII * found.r_px, found.r_px + 20.0)
    part = cut(examination.image, x, y, half)
    style.show(axes, examination.image, *style.stretch(part))
    axes.set(xlim=(x - half, x + half), ylim=(y + half, y - half))
    closed = np.vstack((edge.outline_px, edge.outline_px[:1]))
    axes.plot(*closed.T, color=style.FITTED, linewidth=0.9)
    kept = edge.kept
    px, py = edge.edge_px.T
    weights: dict[str, Any] = {"c": edge.weight[kept], "cmap": style.WEIGHTS, "vmin": 0.0, "vmax": 1.0}
    dots = axes.scatter(px[kept], py[kept], s=20, edgecolors="none", zorder=3, **weights)
    axes.plot(px[~kept], py[~kept], "x", color=style.REJECTED, markersize=5, markeredgewidth=1.2, zorder=3)
    axes.plot(x, y, "+", color=style.FITTED, markersize=10)
    assert axes.figure is not None
    bar = axes.figure.colorbar(dots, ax=axes, fraction=0.035, pad=0.02, shrink=0.6)
    bar.set_label("weight of the edge point")
    bar.outline.set_visible(False)
    rejected = int((~kept).sum())
    axes.set_title(f"Edge points and fitted outline{f'   (× {rejected} rejected)' if rejected else ''}")


def whole(axes: Axes, examination: Examination, found: Found) -> None:
    """Where in the image that is."""
    style.show(axes, examination.image, *style.stretch(examination.image))
    half = max(AROUND_RADII * found.r_px, found.r_px + 20.0)
    corner = (found.x_px - half, found.y_px - half)
    axes.add_patch(Rectangle(corner, 2 * half, 2 * half, fill=False, color=style.GUESS, linewidth=1.5))
    height, width = examination.image.shape
    axes.set_title(f"Whole image, {width} × {height} px")


def radial_profile(axes: Axes, examination: Examination) -> None:
    """Grey values against the distance from the outline, and the fitted edge."""
    found, seen = examination.found, profile(examination)
    assert found is not None
    assert seen is not None
    every = max(len(seen.level_dn) // FEW_DOTS, 1)
    for kept, colour, words in ((True, QUIET, "pixels"), (False, style.REJECTED, "pixels of rejected sectors")):
        which = np.flatnonzero(seen.kept == kept)[::every]
        if len(which):
            axes.plot(seen.distance_px[which], seen.level_dn[which], ".", color=colour, markersize=2.5, alpha=0.5, label=words)
    label = f"fitted edge, σ {found.blur_px:.2f} px" + (", without the rim's shading" if seen.shaded else "")
    axes.plot(seen.edge_distance_px, seen.edge_dn, color=style.FITTED, linewidth=1.6, label=label)
    axes.axvline(0.0, color=INK, linewidth=0.6)
    axes.set_xlim(float(seen.distance_px.min()) - 0.5, float(seen.distance_px.max()) + 0.5)
    _clip_line(axes, examination, seen)
    axes.set(xlabel="distance from the outline, px (outwards)", ylabel="grey value, DN")
    axes.set_title("Radial profile")
    axes.legend(loc="best", markerscale=3)


def magnified(axes: Axes, examination: Examination, found: Found) -> None:
    """The centre among the pixels, 100 x, and in a small frame as large as its 95 % ellipse needs."""
    x, y = found.x_px, found.y_px
    half = 0.5 * MAGNIFIED_PX
    part = cut(examination.image, x, y, half + 1.0)
    style.show(axes, examination.image, float(part.min()) - 8.0, float(part.max()) + 8.0)
    axes.set(xlim=(x - half, x + half), ylim=(y + half, y - half), aspect="equal")
    for line in range(-2, MAGNIFIED_PX):
        axes.axvline(round(x) + line + 0.5, color="white", alpha=0.45, linewidth=0.7)
        axes.axhline(round(y) + line + 0.5, color="white", alpha=0.45, linewidth=0.7)
    axes.plot(x, y, "+", color=style.FITTED, markersize=16, markeredgewidth=1.6)
    _add_ellipse(axes, found)
    axes.set_title("Centre on the pixel grid, 100×")
    axes.text(0.02, 0.02, f"pixel ({round(x)}, {round(y)})", transform=axes.transAxes, fontsize=8, color=INK,
              bbox={"facecolor": "white", "alpha": 0.8, "linewidth": 0, "pad": 2})  # fmt: skip
    _ellipse_inset(axes, found)


def sector_offsets(axes: Axes, edge: Edges, fit: CircleFit) -> None:
    """Residuals by sector, in the unit that their scatter needs."""
    kept, offset = edge.kept, fit.sectors.offset_px
    spread = float(np.percentile(np.abs(offset[kept]), 90)) if kept.any() else 1.0
    factor, name = style.unit(max(spread, float(np.median(edge.sigma_px[kept])) if kept.any() else 0.0))
    angle = np.degrees(edge.angle_rad)
    limit = factor * max(5.0 * spread, 4.0 * float(np.median(edge.sigma_px[kept])) if kept.any() else 1.0)
    axes.axhline(0.0, color=style.FITTED, linewidth=1.0)
    axes.errorbar(angle[kept], factor * offset[kept], factor * edge.sigma_px[kept], fmt="o", color=INK, markersize=3,
                  elinewidth=0.8, ecolor=QUIET)  # fmt: skip
    inside = np.clip(factor * offset[~kept], -0.94 * limit, 0.94 * limit)
    axes.plot(
        angle[~kept], inside, "x", color=style.REJECTED, markersize=5, label="rejected (those outside are drawn at the border)"
    )
    axes.set(ylim=(-limit, limit), ylabel=f"offset, {name}")
    axes.set_title("Residuals by sector: edge minus outline, ±1σ")
    if not kept.all():
        axes.legend(**ABOVE)


def sector_chi2(axes: Axes, edge: Edges, fit: CircleFit) -> None:
    angle, chi2 = np.degrees(edge.angle_rad), fit.sectors.chi2
    axes.axhline(1.0, color=style.FITTED, linewidth=1.0)
    axes.plot(angle[edge.kept], chi2[edge.kept], "o", color=INK, markersize=3)
    axes.plot(angle[~edge.kept], chi2[~edge.kept], "x", color=style.REJECTED, markersize=5)
    axes.set_yscale("log")
    style.plain_ticks(axes.yaxis)
    axes.set(ylabel="χ² / d.o.f.")
    axes.set_title("How well each sector looks like an edge")


def sector_levels(axes: Axes, edge: Edges, fit: CircleFit) -> None:
    """Levels on both sides of the edge, and so the contrast between them."""
    angle, kept = np.degrees(edge.angle_rad), edge.kept
    inside = fit.sectors.level_dn + 0.5 * fit.sectors.contrast_dn
    outside = fit.sectors.level_dn - 0.5 * fit.sectors.contrast_dn
    axes.vlines(angle[kept], outside[kept], inside[kept], color="#D9D9D9", linewidth=1.2, label="contrast")
    for level, colour, name in ((inside, style.INSIDE, "inside"), (outside, style.OUTSIDE, "outside")):
        axes.plot(angle[kept], level[kept], "o", color=colour, markersize=3, label=name)
        axes.plot(angle[~kept], level[~kept], "x", color=colour, markersize=4, alpha=0.6)
    axes.set(ylabel="level, DN", xlabel="direction from the centre: 0° right, 90° down")
    axes.set_title("Levels and contrast")
    axes.legend(**ABOVE, ncols=3)
    low, high = np.percentile(np.concatenate((inside[kept], outside[kept])), (0, 100)) if kept.any() else (0.0, 1.0)
    axes.set_ylim(low - 0.12 * (high - low) - 1.0, high + 0.12 * (high - low) + 1.0)


def looked(axes: Axes, examination: Examination) -> None:
    """An image without a ball: where the detector looked."""
    style.show(axes, examination.image, *style.stretch(examination.image))
    for number, look in enumerate(examination.looks, start=1):
        x, y, r = look.circle
        axes.add_patch(Circle((x, y), r, fill=False, color=style.GUESS, linewidth=1.4))
        axes.annotate(str(number), (x, y), color=style.GUESS, ha="center", va="center", fontweight="bold", annotation_clip=True)
    axes.set_title("Where it looked" if examination.looks else "Nothing round to look at")


def cut(image: Image, x: float, y: float, half: float) -> Image:
    """The part round a place, as far as it is in the image; at least one pixel."""
    height, width = image.shape
    left, top = min(max(int(x - half), 0), width - 1), min(max(int(y - half), 0), height - 1)
    return image[top : max(int(y + half) + 1, top + 1), left : max(int(x + half) + 1, left + 1)]


def _clip_line(axes: Axes, examination: Examination, seen: Profile) -> None:
    if float(seen.level_dn.max()) > 0.9 * examination.full_dn:
        axes.axhline(examination.full_dn, color=style.REJECTED, linewidth=0.8, linestyle="--", label="full scale")


def _add_ellipse(axes: Axes, found: Found) -> None:
    long, short, angle = ellipse_95(found)
    axes.add_patch(
        Ellipse(
            (found.x_px, found.y_px), 2 * long, 2 * short, angle=degrees(angle), fill=False, color=style.INSIDE, linewidth=1.6
        )
    )


def _ellipse_inset(axes: Axes, found: Found) -> None:
    long, _, _ = ellipse_95(found)
    half = 1.9 * long
    inset = axes.inset_axes((0.56, 0.56, 0.42, 0.42))
    inset.set(xlim=(found.x_px - half, found.x_px + half), ylim=(found.y_px + half, found.y_px - half), aspect="equal")
    inset.grid(visible=False)
    inset.set(xticks=(), yticks=(), facecolor="white")
    for spine in inset.spines.values():
        spine.set(visible=True, color=style.INSIDE)
    inset.plot(found.x_px, found.y_px, "+", color=style.FITTED, markersize=8)
    _add_ellipse(inset, found)
    length = _round_length(long)
    left, bottom = found.x_px - 0.88 * half, found.y_px + 0.90 * half
    inset.plot((left, left + length), (bottom, bottom), color=INK, linewidth=2.0)
    inset.text(left, bottom - 0.06 * half, f"{length:g} px", fontsize=8, va="bottom")
    inset.text(found.x_px, found.y_px - 0.92 * half, "95 %", fontsize=8, va="top", ha="center", color=style.INSIDE)


def _round_length(about_px: float) -> float:
    """1, 2 or 5 times a power of ten, at most as long."""
    power = 10.0 ** np.floor(np.log10(max(about_px, 1e-9)))
    return float(power * max(step for step in (1.0, 2.0, 5.0) if step * power <= about_px * 1.0000001))
