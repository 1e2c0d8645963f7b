"""Whether a fit is an outline: enough of it carries an edge that is strong, well placed and on the circle."""

from math import inf

import numpy as np

from trackerd.contract.model import Found, Missed, Outline
from trackerd.vision.convergence import CircleFit, Sectors
from trackerd.vision.noise import NoiseModel

LEAST_COVERAGE = 0.50  # of the outline, where a guess led here
LEAST_COVERAGE_SEARCHED = 0.55  # where anything round was tried
LEAST_CONTRAST = 2.0  # in units of one pixel's noise: 3 grey levels at 39 e- a level
WORST_EDGE_PX = 0.5  # sigma of a sector's edge
NEAR_PX, NEAR_SIGMA = 0.35, 4.0  # an edge this near to the circle is on it
POOR_CHI2 = 12.0  # a sector that looks like no edge at all


def verified(fit: CircleFit, noise: NoiseModel, least_coverage: float) -> Outline:
    if not fit.settled:
        return Missed("the circle fit did not settle")
    good = edge_sectors(fit.sectors, noise)
    coverage = np.count_nonzero(good) / len(fit.weight)
    if coverage < least_coverage:
        return Missed(f"only {100 * coverage:.0f} % of the outline carry an edge ({100 * least_coverage:.0f} % needed)")
    if not all(0.0 < variance < inf for variance in fit.cov_px2.diagonal().tolist()):
        return Missed("the outline does not determine a circle")
    weight = float(fit.weight.sum())
    chi2 = float(fit.sectors.chi2 @ fit.weight) / weight if weight > 0.0 else 0.0
    contrast, middle = float(np.median(fit.sectors.contrast_dn[good])), float(np.median(fit.sectors.level_dn[good]))
    return Found(
        fit.x_px,
        fit.y_px,
        fit.r_px,
        fit.cov_px2,
        coverage,
        chi2,
        fit.clipped,
        blur_px=fit.sigma_px,
        inside_dn=middle + 0.5 * contrast,
        outside_dn=middle - 0.5 * contrast,
    )


def edge_sectors(sectors: Sectors, noise: NoiseModel) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """The sectors (S,) that speak for the circle."""
    sigma_dn = np.sqrt(np.maximum(sectors.level_dn, 0.0) / noise.gain_e_per_dn + noise.floor_dn2)
    sigma_px = 1.0 / np.sqrt(sectors.information)
    strong = np.abs(sectors.contrast_dn) > LEAST_CONTRAST * sigma_dn
    near = np.abs(sectors.offset_px) < np.maximum(NEAR_PX, NEAR_SIGMA * sigma_px)
    good: np.ndarray[tuple[int], np.dtype[np.bool_]] = strong & (sigma_px < WORST_EDGE_PX) & near & (sectors.chi2 < POOR_CHI2)
    return good
