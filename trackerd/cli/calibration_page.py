"""A calibration in words: what it is worth, its parameters with their sigmas, and what it changes against another one."""

import time
from collections.abc import Iterator, Mapping
from dataclasses import astuple
from math import acos, degrees, sqrt

import numpy as np

from trackerd.calibrate.shift import grid, shift_between
from trackerd.contract.errors import Degenerate
from trackerd.formats.calibration import Calibration, Volume
from trackerd.geometry.gimbal import Station
from trackerd.geometry.rigid import Rigid, euler_321_from_matrix

USUAL_VOLUME = Volume((-200.0, -200.0, -150.0), (200.0, 200.0, 150.0))  # where neither calibration tells one
ARCSEC_PER_RAD = 648_000.0 / np.pi


def standing_words(calibration: Calibration) -> str:
    return "; ".join(calibration.standing(time.time_ns()).notes) or "verified"


def calibration_lines(c: Calibration) -> Iterator[str]:
    yield f"id: {c.id}"
    yield f"created: {c.created} by {c.software}, method {c.method}" + (f", from {c.parent}" if c.parent else "")
    yield f"standing: {standing_words(c)}"
    if c.chi2_per_dof is not None:
        yield f"chi-square: {c.chi2_per_dof:.3f} per degree of freedom" + ("" if c.dof is None else f", {c.dof} of them")
    if c.data is not None:
        yield f"data: {c.data.name}, SHA-256 {c.data.sha256[:16]}..."
    if c.noise is not None:
        n = c.noise
        white, fixed = (value * ARCSEC_PER_RAD for value in (n.encoder_rad, n.encoder_fixed_rad))
        yield f"noise: {n.pixel_px:g} px, encoders {white:.3g} arcsec white and {fixed:.3g} angle-fixed"
    if c.volume is not None:
        yield f"volume: {_box(c.volume)}"
    if c.verification is not None:
        v = c.verification
        figures = f"rms {v.rms_mm:.4g} mm, maximum {v.max_mm:.4g} mm, En {v.en_max:.3g}"
        yield f"check points: {v.points} on {v.date}, {figures}" + (f", good until {v.expires}" if v.expires else "")
    sigmas = dict(zip(c.parameters, np.sqrt(np.maximum(np.diag(c.covariance), 0.0)).tolist(), strict=True))
    for name, station in c.stations.items():
        yield from _station_lines(station, c.zooms.get(name), sigmas)


def difference_lines(old: Calibration, new: Calibration, volume: Volume | None) -> Iterator[str]:
    """What the new one changes against the old: the work first, then each station."""
    box = volume or new.volume or old.volume or USUAL_VOLUME
    yield f"against {old.id}, in {_box(box)}:"
    try:
        shift = shift_between(old.stations, new.stations, grid(box.min_mm, box.max_mm))
        x, y, z = shift.mean_mm
        where = ", ".join(f"{value:.0f}" for value in shift.worst_mm)
        yield f"  the work shifts by {shift.rms_mm:.4g} mm rms, {shift.max_mm:.4g} mm at most (at {where} mm)"
        yield f"  of it common to all: {x:+.4f}, {y:+.4f}, {z:+.4f} mm"
        if shift.out_of_reach:
            every = len(shift.p_mm) + shift.out_of_reach
            yield f"  {shift.out_of_reach} of {every} points cannot be looked at by every station"
    except Degenerate as why:
        yield f"  the shift of the work cannot be told: {why}"
    for name in old.stations.keys() - new.stations.keys():
        yield f"  station {name} is gone"
    for name, station in new.stations.items():
        yield f"  {_change(old.stations.get(name), station)}"


def _station_lines(s: Station, zoom: str | None, sigmas: Mapping[str, float]) -> Iterator[str]:
    def value(name: str, number: float, digits: int, factor: float = 1.0) -> str:
        sigma = sigmas.get(f"{s.name}.{name}")
        return f"{number * factor:.{digits}f}" + ("" if sigma is None else f" ± {sigma * factor:.2g}")

    yield f"station {s.name}: {s.order}, signs {s.az_sign:+d} {s.el_sign:+d}" + (f", zoom {zoom}" if zoom else "")
    for group, pose in (("world_from_gimbal", s.world_from_gimbal), ("rg_from_camera", s.rg_from_camera)):
        places = (value(f"{group}.{axis}_mm", x, 4) for axis, x in zip("xyz", pose.translation_mm.tolist(), strict=True))
        angles = zip("zyx", np.degrees(euler_321_from_matrix(pose.rotation)).tolist(), strict=True)
        turns = [sigmas.get(f"{s.name}.{group}.r{axis}_rad") for axis in "xyz"]
        known = [f"{turn * ARCSEC_PER_RAD:.2g}" for turn in turns if turn is not None]
        about = f" ± {', '.join(known)} arcsec about x, y, z" if len(known) == 3 else ""
        yield f"  {group}: {', '.join(places)} mm; {', '.join(f'{axis} {a:.5f}' for axis, a in angles)} deg (321){about}"
    eps, d = value("eps_rad", s.eps_rad, 2, ARCSEC_PER_RAD), value("d_mm", s.d_mm, 4)
    yield f"  axes: {eps} arcsec off the right angle, {d} mm apart"
    f = ", ".join(f"{key} {value(f'lens.{key}_px', getattr(s.lens, f'{key}_px'), 2)}" for key in ("fx", "fy", "cx", "cy"))
    coefficients = zip(("k1", "k2", "p1", "p2", "k3"), s.lens.distortion, strict=True)
    k = ", ".join(f"{key} {value('lens.' + key, number, 6)}" for key, number in coefficients)
    yield f"  lens: {s.lens.sensor_px[0]} x {s.lens.sensor_px[1]} px, {f} px"
    yield f"  distortion: {k}"


def _change(old: Station | None, new: Station) -> str:
    if old is None:
        return f"station {new.name} is new"
    words = []
    if (old.order, old.az_sign, old.el_sign) != (new.order, new.az_sign, new.el_sign):
        words.append("another order or sign of the axes")
    for what, a, b in (
        ("gimbal", old.world_from_gimbal, new.world_from_gimbal),
        ("camera on it", old.rg_from_camera, new.rg_from_camera),
    ):
        moved, turned = _motion(a, b)
        if moved or turned:
            words.append(f"{what} moved by {moved:.4g} mm and turned by {turned:.3g} arcsec")
    if (old.eps_rad, old.d_mm) != (new.eps_rad, new.d_mm):
        turned = (new.eps_rad - old.eps_rad) * ARCSEC_PER_RAD
        words.append(f"axes {turned:+.3g} arcsec, {new.d_mm - old.d_mm:+.3g} mm")
    if old.lens != new.lens:
        steps = (
            f"{key} {getattr(new.lens, f'{key}_px') - getattr(old.lens, f'{key}_px'):+.4g}" for key in ("fx", "fy", "cx", "cy")
        )
        words.append(f"lens {', '.join(steps)} px")
    return f"station {new.name}: {'; '.join(words) or 'as it was'}"


def _motion(a: Rigid, b: Rigid) -> tuple[float, float]:
    """Distance, mm, and angle, arcsec; exactly 0 where nothing was changed."""
    if np.array_equal(a.rotation, b.rotation):
        angle_rad = 0.0
    else:
        off = float(np.linalg.norm(a.rotation - b.rotation))  # of a small angle: sqrt(2) times it
        angle_rad = (
            off / sqrt(2.0) if off < 1e-2 else acos(max(-1.0, min(1.0, (np.trace(a.rotation.T @ b.rotation) - 1.0) / 2.0)))
        )
    return float(np.linalg.norm(b.translation_mm - a.translation_mm)), degrees(angle_rad) * 3600.0


def _box(volume: Volume) -> str:
    low, high = astuple(volume)
    return " x ".join(f"{a:g}..{b:g}" for a, b in zip(low, high, strict=True)) + " mm"
