"""The numbers of an examination and of a series, as rows of words: the same on the terminal and on the page."""

from math import isfinite

import numpy as np

from trackerd.contract.model import Found
from trackerd.inspection.advice import exposure_advice, level_at, light_advice
from trackerd.inspection.allan import Allan
from trackerd.inspection.detector import Detector
from trackerd.inspection.examine import Examination, edges
from trackerd.inspection.repeatability import Repeatability, Scatter

Rows = list[tuple[str, str]]
MOVES = 3.0  # standard deviation over Allan deviation at one frame; 1 for independent frames
ELLIPSE_95 = 5.991  # chi-square of two degrees of freedom: a 95 % ellipse has sqrt of it times the sigmas as semi-axes


def ellipse_95(found: Found) -> tuple[float, float, float]:
    """Semi-axes (long, short) of the centre's 95 % ellipse in px, and the direction of the long one, from x towards y."""
    values, vectors = np.linalg.eigh(found.cov_px2[:2, :2])
    short, long = np.sqrt(ELLIPSE_95 * np.maximum(values, 0.0)).tolist()
    return long, short, float(np.arctan2(vectors[1, 1], vectors[0, 1]))


def examination_rows(examination: Examination) -> Rows:
    height, width = examination.image.shape
    rows = [("image", f"{width} x {height}, {examination.image.dtype}")]
    found, fit = examination.found, examination.fit
    if found is None or fit is None:
        return [*rows, ("ball", "none found"), ("reason", getattr(examination.outline, "reason", "")), *_looked(examination)]
    sigma = np.sqrt(found.cov_px2.diagonal()).tolist()
    long, short, _ = ellipse_95(found)
    level = level_at(examination.image, found, examination.noise)
    kept = edges(fit, examination.noise).kept
    return [
        *rows,
        ("x", f"{found.x_px:.4f} ± {sigma[0]:.4f} px"),
        ("y", f"{found.y_px:.4f} ± {sigma[1]:.4f} px"),
        ("r", f"{found.r_px:.4f} ± {sigma[2]:.4f} px"),
        ("centre, 95 %", f"{long:.4f} x {short:.4f} px (semi-axes)"),
        ("edge width", f"{found.blur_px:.2f} px (sigma)"),
        ("inside / outside", f"{found.inside_dn:.1f} / {found.outside_dn:.1f} of {examination.full_dn:.0f} DN"),
        ("coverage", f"{100 * found.coverage:.0f} % ({np.count_nonzero(kept)} of {len(kept)} sectors)"),
        ("chi-square", f"{found.chi2:.2f} per degree of freedom"),
        ("clipped", f"{100 * found.clipped:.1f} % of the outline"),
        ("sigma is", f"enlarged: {found.inflated}" if found.inflated else "the pixels' noise alone"),
        ("rim", "shaded: with the limb term" if len(fit.limb_dn) else "evenly lit: without the limb term"),
        *_sphere(examination.detector, found),
        ("exposure", exposure_advice(found, level)),
        ("light", light_advice(found, level)),
        ("noise model", _noise(examination.detector)),
    ]


def series_rows(result: Repeatability) -> Rows:
    """Counts and Allan deviations; the scatter is a table of its own."""
    rows = [("frames", f"{result.found + result.missed}, found in {result.found}, missed in {result.missed}")]
    rows += [("missed", f"{count} x {reason}") for reason, count in result.reasons.items()]
    if any(scatter.neighbours * MOVES < scatter.deviation for scatter in result.scatter.values()):
        rows.append(("note", "it moved or drifted: the noise is what neighbouring frames differ by, not the deviation"))
    for name, allan in result.allan.items():
        if len(allan.frames):
            longest = f"{allan.deviation[-1]:.5f} px over {allan.frames[-1]:.0f}"
            shortest = f"{allan.deviation[0]:.5f} px over {allan.frames[0]:.0f} frame"
            rows.append((f"Allan of {name}", f"{shortest}, {longest}; {_averaging(allan)}"))
    return rows


SCATTER_COLUMNS = (
    "px", "mean", "std. deviation", "its 95 % interval", "peak to peak", "drift over all", "neighbours", "stated sigma",
    "ratio",
)  # fmt: skip


def scatter_rows(result: Repeatability) -> list[tuple[str, ...]]:
    """One row a quantity, columns as SCATTER_COLUMNS."""
    return [(name, *_scatter(scatter)) for name, scatter in result.scatter.items()]


def _scatter(s: Scatter) -> tuple[str, ...]:
    digits = _digits(s.deviation)
    drift_sigma = f" ± {s.drift_sigma:.{digits}f}" if isfinite(s.drift_sigma) else ""
    return (
        f"{s.mean:.4f}",
        f"{s.deviation:.{digits}f}",
        f"{s.interval[0]:.{digits}f} to {s.interval[1]:.{digits}f}",
        f"{s.peak_to_peak:.{digits}f}",
        f"{s.drift:+.{digits}f}{drift_sigma}",
        f"{s.neighbours:.{_digits(s.neighbours)}f}" if isfinite(s.neighbours) else "-",
        f"{s.stated:.{_digits(s.stated)}f}",
        f"{s.ratio:.2f}" if s.ratio < 100.0 else f"{s.ratio:.0f}",
    )


def _digits(sigma_px: float) -> int:
    return 5 if sigma_px < 0.05 else 3


def _averaging(allan: Allan) -> str:
    """Up to where means of neighbouring frames get better as those of independent frames do."""
    if allan.white_until == 1 and len(allan.frames) > 1:
        return "averaging does not help"
    least = " at least" if allan.white_until == allan.frames[-1] else ""
    return f"averaging helps up to {allan.white_until} frames{least}"


def _noise(detector: Detector) -> str:
    model = detector.noise
    told = "assumed: --config tells the camera's" if detector.camera is None else "as configured"
    return f"{model.gain_e_per_dn:.3g} e-/DN, read noise {model.read_noise_e:.3g} e- ({told})"


def _sphere(detector: Detector, found: Found) -> Rows:
    sphere = detector.sphere(found)
    if sphere is None or detector.camera is None:
        return []
    return [
        (
            "range",
            f"{sphere.range_mm:.2f} ± {sphere.range_sigma_mm:.2f} mm, for a radius of {detector.camera.probe_radius_mm:g} mm",
        )
    ]


def _looked(examination: Examination) -> Rows:
    return [
        ("looked at", f"({look.circle[0]:.0f}, {look.circle[1]:.0f}), r {look.circle[2]:.0f}: {look.reason}")
        for look in examination.looks
    ]
