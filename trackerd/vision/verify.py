"""Whether a fit is an outline: enough of it carries an edge that is strong, well placed and on the circle."""

from math import inf, sqrt

import numpy as np
import numpy.typing as npt

from trackerd.contract.model import Array, Found, Missed, Outline
from trackerd.vision.convergence import CircleFit, Sectors
from trackerd.vision.curve import angles
from trackerd.vision.noise import NoiseModel

Flags = npt.NDArray[np.bool_]  # (S,)

LEAST_COVERAGE = 0.50  # of the outline, where a guess led here
LEAST_COVERAGE_SEARCHED = 0.55  # where anything round was tried
LEAST_CONTRAST = 2.0  # in units of one pixel's noise: 3 grey levels at 39 e- a level
WORST_EDGE_PX = 0.5  # sigma of a sector's edge
NEAR_PX, NEAR_SIGMA, FARTHEST_PX = 0.35, 4.0, 0.8  # an edge this near to the circle is on it, a weak one too
SHARPEST_PX = 0.32  # a pixel alone blurs by 0.29 px, and every lens by more than 0.14
POOR_CHI2 = 12.0  # a sector that looks like no edge at all


MOST_LEFT_OUT = 0.03  # of the outline
LITTLE, BAD_CHI2 = 0.65, 6.0  # of the outline: where little of it is seen, what is seen must be an edge
BRIGHT_RIM = 0.25  # of the blur: by this a ball's glow at its rim makes the radius small
CORNERS = (3, 4, 5, 6)
SURE_PX = 0.1  # no edge counts as surer than this: a corner is larger, what a spot does to a few sectors is not
SMOOTH_PX = 0.05  # rms: of an outline so round no corner is asked
AMPLITUDE_SIGMAS, LEAST_AMPLITUDE_PX, LEAST_SMEARED_PX = 4.5, 0.1, 0.25
WIDE_GAP, BESIDE = 0.12, 3  # share of the outline; sectors
CORNER_SIGMAS, LEAST_CORNER_PX, CORNER_BLURS = 1.7, 0.08, 0.08  # typical distance of the edges from the circle
SIGNIFICANT = 2.0  # sigmas by which the sectors' scatter must exceed the noise before the covariance grows
STRUCTURED_CHI2 = 1.06  # half of the sectors worse than this: something else than noise is in the picture
KEPT_BY_TUKEY = 0.74  # of the square of a normal deviate, by its own weight; that weight's square taken out
ODD_WEIGHT, ODD_SHARE = 0.3, 0.1  # sectors that know their edge and are not believed: something lies across the outline
NEIGHBOURS = 3  # sectors over which it may go on


def verified(fit: CircleFit, noise: NoiseModel, least_coverage: float) -> Outline:
    sectors = fit.lit_sectors
    good = edge_sectors(sectors, noise)
    coverage = float(np.count_nonzero(good) / len(fit.weight))
    weight = float(fit.weight.sum())
    chi2 = float(fit.sectors.chi2 @ fit.weight) / weight if weight > 0.0 else 0.0
    refusal = _no_edge(fit, coverage, least_coverage, chi2) or corners(fit, edge_sectors(sectors, noise, farthest_px=inf))
    if refusal is not None:
        return Missed(refusal)
    if not all(0.0 < variance < inf for variance in fit.cov_px2.diagonal().tolist()):
        return Missed("the outline does not determine a circle")
    growth, why = scatter(fit)
    cov_px2 = fit.cov_px2 * growth
    if len(fit.limb_dn) > 0:
        cov_px2, why = _under_lamps(fit, cov_px2, why)
    contrast, middle = median(sectors.contrast_dn[good]), median(sectors.level_dn[good])
    return Found(
        fit.x_px,
        fit.y_px,
        fit.r_px,
        cov_px2,
        coverage,
        chi2,
        fit.clipped,
        blur_px=fit.sigma_px,
        inside_dn=middle + 0.5 * contrast,
        outside_dn=middle - 0.5 * contrast,
        inflated=why,
    )


def _no_edge(fit: CircleFit, coverage: float, least_coverage: float, chi2: float) -> str | None:
    """Why what the fit ended on is no edge of a ball; None: it may be."""
    if not fit.settled:
        return "the circle fit did not settle"
    if fit.sigma_px <= SHARPEST_PX:
        return "the edge is sharper than pixels can show: it is no picture of a ball"
    if coverage < least_coverage:
        return f"only {100 * coverage:.0f} % of the outline carry an edge ({100 * least_coverage:.0f} % needed)"
    if coverage < LITTLE and chi2 > BAD_CHI2:
        return f"{100 * coverage:.0f} % of the outline carry an edge, and fit badly (chi-square {chi2:.1f})"
    return None


def _under_lamps(fit: CircleFit, cov_px2: Array, why: str) -> tuple[Array, str]:
    """The covariance where the light is not only one lamp's: spots at the rim, or a rim that is brighter than the ball."""
    left_out = np.count_nonzero((fit.weight == 0.0) & (fit.sectors.information > 1.0))
    if left_out > MOST_LEFT_OUT * len(fit.weight):
        cov_px2, why = 2.0 * cov_px2, why or "spots at the rim"
    if fit.limb_dn[2] < 0.0:
        cov_px2 = cov_px2 + np.diag((0.0, 0.0, (BRIGHT_RIM * fit.sigma_px) ** 2))
        why = why or "the rim is brighter than the ball: the radius is uncertain"
    return cov_px2, why


def median(values: Array) -> float:
    """A tenth of np.median's time for a hundred values."""
    ordered = np.sort(values)
    return 0.5 * (float(ordered[(len(ordered) - 1) // 2]) + float(ordered[len(ordered) // 2]))


def corners(fit: CircleFit, good: Flags) -> str | None:
    """Why the outline is no circle, where its sectors' edges lie about it as a polygon's do; None: they do not.

    Each edge may be within its own noise, as those of a weak square are; together they are not.
    """
    away = np.abs(fit.sectors.offset_px - _even(fit))[good]
    scatter_px = 1.4826 * median(away)
    sigmas = 1.4826 * median(away * np.sqrt(fit.sectors.information[good]))
    if sigmas > CORNER_SIGMAS and scatter_px > max(LEAST_CORNER_PX, CORNER_BLURS * fit.sigma_px):
        return f"the edges are {scatter_px:.2f} px off any circle, {sigmas:.1f} times their noise"
    return None if float(away @ away) < SMOOTH_PX**2 * len(away) else _polygon(fit, good)


def _polygon(fit: CircleFit, good: Flags) -> str | None:
    """Corners by the harmonics of the sectors' edges; not those beside a wide gap, where something lies across."""
    middle = angles(len(good))
    weight = np.minimum(fit.sectors.information, SURE_PX**-2) * _inland(good)
    orders = [1, 2, *CORNERS]
    design = np.column_stack([np.ones(len(middle)), *(f(n * middle) for n in orders for f in (np.cos, np.sin))])
    inverse = np.linalg.inv((design * weight[:, None]).T @ design + 1e-9 * np.eye(design.shape[1]))
    amplitude = inverse @ (design.T @ (weight * fit.sectors.offset_px))
    least_px = LEAST_AMPLITUDE_PX if len(fit.blur_px2) == 1 else max(LEAST_SMEARED_PX, CORNER_BLURS * fit.sigma_px)
    for k, n in enumerate(CORNERS, start=2):
        cosine, sine = 1 + 2 * k, 2 + 2 * k
        size = float(np.hypot(amplitude[cosine], amplitude[sine]))
        noise = sqrt(0.5 * float(inverse[cosine, cosine] + inverse[sine, sine]) * max(fit.chi2, 1.0))
        if size > max(least_px, AMPLITUDE_SIGMAS * noise):
            return f"the outline has {n} corners of {size:.2f} px: it is no ball's"
    return None


def _inland(good: Flags) -> Flags:
    """The sectors that are not beside a wide gap."""
    wide, kept = round(WIDE_GAP * len(good)), good.copy()
    gap = ~good
    for n in range(1, wide):
        gap = gap & np.roll(~good, -n)  # begins a gap at least as wide
    for start in np.flatnonzero(gap):
        kept[np.arange(start - BESIDE, start + wide + BESIDE) % len(good)] = False
    return kept


def scatter(fit: CircleFit) -> tuple[float, str]:
    """By how much the covariance of the noise is to be multiplied so that it explains the sectors' own scatter round the
    outline, and why; 1 where the scatter is that of noise.

    What is not noise (a texture behind the ball, a cluttered outline) goes on from sector to sector: there their covariances
    count too (Newey and West 1987).
    """
    u = np.sqrt(fit.sectors.information) * fit.weight * (fit.sectors.offset_px - _even(fit))
    expected = KEPT_BY_TUKEY * float(fit.weight @ fit.weight) * max(1.0 - 4.0 / max(float(fit.weight.sum()), 5.0), 0.2)
    ratio = float(u @ u) / expected
    telling = fit.sectors.information > 1.0
    odd = np.count_nonzero(telling & (fit.weight < ODD_WEIGHT)) / len(u)
    structured = fit.chi2 > STRUCTURED_CHI2 or odd > ODD_SHARE
    if structured:
        ratio += (
            2.0 * sum((1.0 - n / (NEIGHBOURS + 1.0)) * float(u @ np.roll(u, n)) for n in range(1, NEIGHBOURS + 1)) / expected
        )
    sigma = sqrt((2.0 + 4.0 * structured) / len(u))
    if ratio < 1.0 + SIGNIFICANT * sigma:
        return 1.0, ""
    return ratio, "structure round the outline" if structured else "the sectors scatter"


def _even(fit: CircleFit) -> Array:
    """What a smear, no Gaussian blur, does to the sectors' edges, (S,): alike on opposite sides, it moves no centre."""
    if len(fit.blur_px2) == 1:
        return np.zeros(len(fit.weight))
    middle = angles(len(fit.weight))
    design = np.column_stack([np.ones(len(middle)), *(f(n * middle) for n in (2, 4, 6) for f in (np.cos, np.sin))])
    weighted = design * (fit.weight * fit.sectors.information)[:, None]
    amplitude = np.linalg.solve(weighted.T @ design + 1e-9 * np.eye(design.shape[1]), weighted.T @ fit.sectors.offset_px)
    return np.asarray(design @ amplitude)


def edge_sectors(sectors: Sectors, noise: NoiseModel, farthest_px: float = FARTHEST_PX) -> Flags:
    """The sectors (S,) that speak for the circle."""
    sigma_dn = np.sqrt(np.maximum(sectors.level_dn, 0.0) / noise.gain_e_per_dn + noise.floor_dn2)
    sigma_px = 1.0 / np.sqrt(sectors.information)
    strong = np.abs(sectors.contrast_dn) > LEAST_CONTRAST * sigma_dn
    near = np.abs(sectors.offset_px) < np.clip(NEAR_SIGMA * sigma_px, NEAR_PX, farthest_px)
    good: Flags = strong & (sigma_px < WORST_EDGE_PX) & near & (sectors.chi2 < POOR_CHI2)
    return good
