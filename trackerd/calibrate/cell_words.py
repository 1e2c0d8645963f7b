"""A cell's calibration in words and numbers: what the command prints and the report shows."""

from collections.abc import Iterator
from math import degrees

import numpy as np

from trackerd.calibrate.cell.result import CellResult
from trackerd.calibrate.cell_data import CellData
from trackerd.calibrate.cell_worth import Worth
from trackerd.calibrate.thesis import ThesisGimbal
from trackerd.formats.calibration import Calibration
from trackerd.formats.dataset import Dataset
from trackerd.geometry.gimbal import Station

Rows = list[tuple[str, str]]

ARCSEC = 206264.80624709636
MOST_TOLD = 5


def summary(dataset: Dataset, data: CellData, result: CellResult, worth: Worth, calibration: Calibration) -> Rows:
    o = data.observations
    rows = [
        (
            "data",
            f"{len(o.views)} views, {len(o)} image points of {len(np.unique(o.point))} points, {dataset.mover.kind} mover",
        ),
        ("chi2/dof", f"{result.chi2_per_dof:.3f} ({result.dof} degrees of freedom){' FORCED' if result.forced else ''}"),
        ("residuals", f"rms {result.rms_px():.3f} px"),
    ]
    rows += [(name, station_words(result, name)) for name in o.gimbals]
    rows += [(f"body {name}", _body_words(result, name)) for name, body in result.bodies.items() if _was_free(body)]
    rows.append(("rejected", _rejected_words(result)))
    across, depth = worth.total.worst()
    own_across, own_depth = worth.calibration.worst()
    size = " × ".join(f"{side:.0f}" for side in worth.box.size_mm)
    rows += [
        ("volume", f"{size} mm"),
        ("a target", f"in one frame: {worth.total.typical_mm():.4f} mm rms (3D, 1 sigma)"),
        ("U (k = 2)", f"at worst {across:.4f} mm across, {depth:.4f} mm in depth"),
        ("calibration's part", f"at worst {own_across:.4f} mm across, {own_depth:.4f} mm in depth (k = 2)"),
        *reliability_rows(worth),
        ("check points", _check_words(worth, calibration)),
    ]
    return rows


def station_words(result: CellResult, name: str) -> str:
    station, sigmas = result.stations[name], result.sigmas

    def sigma(parameter: str) -> float:
        return sigmas.get(f"{name}.{parameter}", 0.0)

    place = max(sigma(f"world_from_gimbal.{axis}_mm") for axis in "xyz")
    turn = max(sigma(f"world_from_gimbal.{axis}_rad") for axis in ("rx", "ry", "rz")) * ARCSEC
    lens, arm = station.lens, station.rg_from_camera.translation_mm
    signs = f"{station.az_sign:+d} {station.el_sign:+d}"
    return (
        f"{station.order}, signs {signs}; f {lens.fx_px:.1f} ± {sigma('lens.fx_px'):.1f} px;"
        f" pupil at z {arm[2]:.2f} ± {sigma('rg_from_camera.z_mm'):.2f} mm; place ± {place:.3f} mm, ± {turn:.1f}″"
    )


def reliability_rows(worth: Worth) -> Rows:
    """The least bias of an encoder that chi-square of one fix finds, and what an unseen one does, over the volume."""
    r = worth.reliability
    rows = []
    for i, name in enumerate(r.names):
        found, external = r.detectable_rad[:, i], r.external_mm[:, i]
        finite = np.isfinite(found)
        bias = f"{found[finite].min() * ARCSEC:.1f}″ to {found[finite].max() * ARCSEC:.1f}″" if finite.any() else "none"
        blind = "" if finite.all() else f" ({int((~finite).sum())} of {len(found)} places see none)"
        moves = f"{external.max():.2g} mm" if np.isfinite(external).all() else "anything"
        rows.append((f"bias of {name}", f"found from {bias}{blind}; unseen it moves a target by up to {moves}"))
    worst = f"{r.invisible_mm_per_arcsec.max():.4f} mm for each ″ of all axes (root of the sum of squares)"
    return [*rows, ("what no chi-square sees", worst)]


def thesis_rows(found: dict[str, ThesisGimbal]) -> Rows:
    """As its Table 4.12: mean ± standard deviation over the views."""
    rows = []
    for name, gimbal in found.items():
        angles = zip(("psi", "theta", "phi"), gimbal.euler_rad, gimbal.euler_sd_rad, strict=True)
        turned = ", ".join(f"{axis} {degrees(mean):.3f} ± {degrees(sd):.3f}°" for axis, mean, sd in angles)
        places = zip("xyz", gimbal.place_mm, gimbal.place_sd_mm, strict=True)
        place = ", ".join(f"{axis} {mean:.2f} ± {sd:.2f} mm" for axis, mean, sd in places)
        rows.append((name, f"rms {gimbal.rms_px:.3f} px; {place}; {turned} ({gimbal.views} views)"))
    return rows


def parameter_rows(result: CellResult) -> Iterator[tuple[str, str, str]]:
    """Name, value and sigma of every parameter, for the report's table."""
    for name, sigma in result.sigmas.items():
        station, _, rest = name.partition(".")
        value = _value(result.stations[station], rest)
        if name.endswith("_rad") and value is None:
            yield name, "", f"{sigma * ARCSEC:.3f}″"
        else:
            yield name, "" if value is None else f"{value:.6g}", f"{sigma:.3g}"


def _value(station: Station, parameter: str) -> float | None:
    """None for a rotation, which has no one number."""
    group, _, element = parameter.rpartition(".")
    if group in ("world_from_gimbal", "rg_from_camera"):
        place = getattr(station, group).translation_mm
        return float(place["xyz".index(element[0])]) if element.endswith("_mm") else None
    if group == "lens":
        distortion = dict(zip(("k1", "k2", "p1", "p2", "k3"), station.lens.distortion, strict=True))
        return float(distortion[element] if element in distortion else getattr(station.lens, element))
    return float(getattr(station, element))


def _was_free(body: object) -> bool:
    covariance = getattr(body, "covariance", None)
    ball = getattr(body, "ball_mm", None)
    return ball is not None or (covariance is not None and bool(np.any(covariance)))


def _body_words(result: CellResult, name: str) -> str:
    body = result.bodies[name]
    sd = np.sqrt(np.diag(body.covariance))
    words = f"place ± {sd[3:].max():.3f} mm, ± {sd[:3].max() * ARCSEC:.1f}″" if sd.any() else "its base is W"
    if body.ball_mm is None or body.ball_covariance_mm2 is None:
        return words
    ball_sd = np.sqrt(np.diag(body.ball_covariance_mm2))
    ball = ", ".join(f"{mean:.3f} ± {s:.3f}" for mean, s in zip(body.ball_mm, ball_sd, strict=True))
    return f"{words}; ball in the flange {ball} mm"


def _rejected_words(result: CellResult) -> str:
    if not result.rejected:
        return "none"
    told = [f"{r.view}{'' if r.point is None else f' {r.point}'} ({r.sigmas:.1f} sigma)" for r in result.rejected[:MOST_TOLD]]
    more = len(result.rejected) - len(told)
    return f"{len(result.rejected)}: {', '.join(told)}" + (f" and {more} more" if more else "")


def _check_words(worth: Worth, calibration: Calibration) -> str:
    if worth.checked is None:
        return "none outside the adjustment: UNVERIFIED"
    found = worth.checked.verification
    above = int((found.en > 1.0).sum())
    en = f"En up to {found.en.max():.2f}" + (f", {above} above 1" if above else "")
    figures = f"rms {found.rms_mm:.4f} mm, largest {found.max_mm:.4f} mm, {en}"
    verdict = "verified" if calibration.verified else "UNVERIFIED"
    assert calibration.verification is not None
    why = ", ".join(calibration.verification.shortcomings())
    return f"{len(worth.checked.names)}: {figures}: {verdict}" + (f" ({why})" if why else "")
