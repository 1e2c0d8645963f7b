"""`trackerd calibrate latency`: how late the encoders' angles are, from a recording of a sweep."""

import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from trackerd.calibrate.latency import Latency, latency_of
from trackerd.calibrate.latency_plot import draw
from trackerd.calibrate.latency_refusals import AXES
from trackerd.calibrate.photon_plot import ENDINGS
from trackerd.calibrate.still_target import Angles, Shown, follow_still_target
from trackerd.calibrate.sweep import Sightings, sweep_of_latches
from trackerd.cli.telling import print_rows, progress
from trackerd.contract.errors import ConfigError, Undetermined
from trackerd.contract.model import Found, Image, Missed
from trackerd.formats.calibration import load_calibration
from trackerd.formats.config import CellConfig
from trackerd.formats.recorded import recorded_angles
from trackerd.formats.settings import ARCSEC
from trackerd.formats.stills import Stills, read_still, stills
from trackerd.geometry.gimbal import Station
from trackerd.geometry.sphere import centre_and_range
from trackerd.inspection.camera import camera_of
from trackerd.inspection.detector import detector_for
from trackerd.wiring.cell import load

ENCODER_ARCSEC = 2.0  # where no configuration tells it
RANGE_MM = 2000.0  # where none tells the ball's radius: a tenth or two off changes nothing
LEAST_SEEN = 0.7  # of the frames: those without the ball are often the fast ones
SAME = 3.0  # sigmas by which the axes may differ and still be given one latency


@dataclass(frozen=True, slots=True)
class LatencyRequest:
    path: Path
    out: Path
    station: str | None = None
    config: Path | None = None
    overrides: Sequence[str] = ()


def latency(request: LatencyRequest) -> None:
    """Prints the latencies of each station of the recording with the lines for the cell's file, and draws them.

    Raises ConfigError; where stations do not tell it, an ExceptionGroup of one Undetermined each, after all were looked at.
    """
    if request.out.suffix.lower() not in ENDINGS:
        raise ConfigError(f"--out {request.out}: must end in {', '.join(ENDINGS)}")
    cell = None if request.config is None else load(request.config, request.overrides)
    series, refused = _chosen(request), []
    for one in series:
        out = request.out if len(series) == 1 else request.out.with_stem(f"{request.out.stem}.{one.name}")
        try:
            _tell(_found(one, cell), one.name, out)
        except Undetermined as error:
            refused.append(Undetermined(f"{one.name}: {error}"))
    if refused:
        raise ExceptionGroup("not determined", refused)


def _chosen(request: LatencyRequest) -> list[Stills]:
    recorded = [one for one in stills(request.path) if one.station is not None]
    if not recorded:
        raise ConfigError(f"{request.path}: no recording: needs angles.csv, and a folder of frames with its NAME.csv")
    names = ", ".join(str(one.station) for one in recorded)
    chosen = [one for one in recorded if request.station in (None, one.station)]
    if not chosen:
        raise ConfigError(f"{request.path}: --station {request.station}: there is no such station (there are: {names})")
    return chosen


def _found(pictures: Stills, cell: CellConfig | None) -> Latency:
    station = _station(pictures, cell)
    if pictures.instants_ns is None:
        raise ConfigError(f"{pictures.files[0].parent}.csv: is missing: it tells when each frame was exposed")
    shown = _shown(pictures, station, cell)
    seen = [(one, one.outline) for one in shown if isinstance(one.outline, Found)]
    _refuse_unseen(shown, len(seen))
    settings = None if cell is None else cell.gimbals.get(pictures.name)
    exposure_us = 0.0 if cell is None or settings is None else cell.cameras[settings.camera].exposure_us
    sightings = Sightings(
        np.array([pictures.instants_ns[one.frame] - pictures.instants_ns[0] for one, _ in seen]) * 1e-9,
        np.array([(found.x_px, found.y_px) for _, found in seen]),
        np.array([found.cov_px2[:2, :2] for _, found in seen]),
        exposure_us * 1e-6,
    )
    sigma_rad = (ENCODER_ARCSEC if settings is None else settings.encoder_sigma_arcsec) * ARCSEC
    sweep = sweep_of_latches(sightings, np.array([one.angles for one, _ in seen]), sigma_rad)
    return latency_of(station, sweep, _range_mm(seen[0][1], station, cell))


def _refuse_unseen(shown: list[Shown], seen: int) -> None:
    if not shown:
        raise Undetermined("angles.csv has no row for any of its frames")
    if seen >= LEAST_SEEN * len(shown):
        return
    why, _ = Counter(one.outline.reason for one in shown if isinstance(one.outline, Missed)).most_common(1)[0]
    raise Undetermined(
        f"the ball is found in {seen} of {len(shown)} frames, most often because of this: {why}: expose shorter, sweep"
        " slower or less far, keep the ball in the image"
    )


def _station(pictures: Stills, cell: CellConfig | None) -> Station:
    """From the recording's own calibration, else the cell's. Raises ConfigError."""
    file = pictures.calibration or (None if cell is None else cell.calibration)
    if file is None:
        raise ConfigError(f"{pictures.files[0].parent.parent}: has no calibration.toml: --config FILE, the cell that has one")
    stations = load_calibration(file).stations
    if pictures.name not in stations:
        raise ConfigError(f"{file}: no station {pictures.name!r} (there are: {', '.join(stations)})")
    return stations[pictures.name]


def _shown(pictures: Stills, station: Station, cell: CellConfig | None) -> list[Shown]:
    """The frames that show the ball. Without a configuration the camera's region is taken to be the middle of its sensor."""
    angles = recorded_angles(pictures.files[0].parent.parent / "angles.csv", pictures.name)
    first = read_still(pictures.files[0])
    camera = None if cell is None else camera_of(cell, None, pictures.name)
    (width, height), (rows, columns) = station.lens.sensor_px, first.shape
    origin_px = ((width - columns) // 2, (height - rows) // 2) if camera is None else camera.origin_of(first)
    with progress(f"looking at {pictures.name}", pictures.count) as advance:

        def frames() -> Iterator[tuple[int, Image, Angles]]:
            for number, file in enumerate(pictures.files):
                advance()
                if number in angles:
                    yield number, read_still(file), angles[number]

        return follow_still_target(frames(), station, detector_for(first, camera).locate, origin_px, RANGE_MM)


def _range_mm(found: Found, station: Station, cell: CellConfig | None) -> float:
    """By the ball's radius, where it is known."""
    if cell is None:
        return RANGE_MM
    return centre_and_range(np.array((found.x_px, found.y_px)), found.r_px, cell.probe.radius_mm, station.lens)[1]


def _tell(found: Latency, name: str, out: Path) -> None:
    """The figures, and the lines for the cell's file last."""
    draw(found, f"{name}: {len(found.rates_rad_s)} frames of a sweep", out)
    print_rows(name, list(_rows(found)))
    for note in found.notes:
        print(f"note: {note}", file=sys.stderr)
    print(f"written: {out}")
    late_s, sigma_s = found.offset_s, found.sigma_s
    if found.apart < SAME:
        late_s, sigma_s = np.full(2, found.common_s), np.full(2, found.common_sigma_s)
    late, sigma = (f"[{az * 1e6:.1f}, {el * 1e6:.1f}]" for az, el in (late_s, sigma_s))
    print(f"\n[gimbal.{name}]\nlatch_offset_us = {late}\nlatch_offset_sigma_us = {sigma}")


def _rows(found: Latency) -> Iterator[tuple[str, str]]:
    for axis, offset_s, sigma_s in zip(AXES, found.offset_s, found.sigma_s, strict=True):
        yield f"latency {axis}", f"{offset_s * 1e6:+.1f} ± {sigma_s * 1e6:.1f} us"
    same = "they differ by" if found.apart < SAME else "THE AXES DIFFER by"
    yield "together", f"{found.common_s * 1e6:+.1f} ± {found.common_sigma_s * 1e6:.1f} us; {same} {found.apart:.1f} sigma"
    loose = (
        f"{axis} {late * 1e6:+.0f} ± {sigma * 1e6:.0f}"
        for axis, late, sigma in zip(AXES, found.loose_s, found.loose_sigma_s, strict=True)
    )
    yield "with a hysteresis left free", f"{', '.join(loose)} us"
    yield "fit", f"chi2 {found.chi2:.0f} of {found.freedom} degrees of freedom"
    yield "frames", f"{len(found.rates_rad_s)}, {found.left_out} left out"
    fastest = np.degrees(np.abs(found.rates_rad_s).max(axis=0))
    smear = f", smeared by up to {found.smear_px:.1f} px" if found.smear_px else ""
    yield "fastest", f"AZ {fastest[0]:.1f} deg/s, EL {fastest[1]:.1f} deg/s{smear}"
