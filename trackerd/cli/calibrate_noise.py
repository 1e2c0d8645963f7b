"""`trackerd calibrate`: what a cell's file says of its devices, measured."""

import asyncio
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from trackerd.calibrate.noise import CameraNoise, measure_noise
from trackerd.calibrate.photon_plot import ENDINGS, draw
from trackerd.calibrate.still_frames import FEWEST_FRAMES
from trackerd.cli.telling import print_rows, progress
from trackerd.contract.errors import ConfigError
from trackerd.contract.model import Image
from trackerd.formats.config import CellConfig
from trackerd.formats.settings import CameraSettings
from trackerd.formats.stills import stills
from trackerd.wiring.cell import load
from trackerd.wiring.grab import camera_of, grab


@dataclass(frozen=True, slots=True)
class NoiseRequest:
    """What is asked for: the pictures of `path`, or so many frames of a cell's camera."""

    path: Path | None
    out: Path
    config: Path | None = None
    camera: str | None = None
    frames: int = 100
    overrides: Sequence[str] = ()


def noise(request: NoiseRequest) -> None:
    """Prints gain and read noise, and draws the curve; for a recording, of each station.

    Raises ConfigError, DeviceError, and Undetermined where the pictures do not tell it.
    """
    if request.out.suffix.lower() not in ENDINGS:
        raise ConfigError(f"--out {request.out}: must end in {', '.join(ENDINGS)}")
    if request.path is None:
        _from_camera(request)
    else:
        _from_files(request, request.path)


def _from_files(request: NoiseRequest, path: Path) -> None:
    cell = None if request.config is None else load(request.config, request.overrides)
    series = stills(path)
    for one in series:
        for note in one.notes:
            print(f"note: {note}", file=sys.stderr)
        out = request.out if len(series) == 1 else request.out.with_stem(f"{request.out.stem}.{one.name}")
        with progress("reading", 2 * one.count) as advance:
            found = measure_noise(one.frames, advance)
        _tell(found, one.name, _camera_of(cell, request.camera, one.station), out)


def _camera_of(cell: CellConfig | None, name: str | None, station: str | None) -> tuple[str, CameraSettings | None]:
    """The camera's name, as far as it is known, and what the cell's file says of it now."""
    if cell is None:
        return name or "NAME", None
    if name is None and station in cell.gimbals:
        name = cell.gimbals[station].camera
    return ("NAME", None) if name is None else (name, camera_of(cell, name))


def _from_camera(request: NoiseRequest) -> None:
    if request.config is None or request.camera is None:
        raise ConfigError("calibrate noise: needs PATH, pictures of a still scene, or --config FILE and --camera NAME")
    if request.frames < FEWEST_FRAMES:
        raise ConfigError(f"--frames {request.frames}: needs at least {FEWEST_FRAMES}")
    cell = load(request.config, request.overrides)
    camera = camera_of(cell, request.camera)
    with progress("grabbing", request.frames) as advance:
        images = asyncio.run(grab(cell, request.camera, request.frames, request.overrides, lambda _: advance()))

    def frames() -> Iterator[tuple[str, Image]]:
        yield from ((f"frame {n}", image) for n, image in enumerate(images))

    with progress("computing", 2 * len(images)) as advance:
        found = measure_noise(frames, advance)
    _tell(found, request.camera, (request.camera, camera), request.out)


def _tell(found: CameraNoise, name: str, camera: tuple[str, CameraSettings | None], out: Path) -> None:
    """The figures, and the lines for the cell's file last."""
    draw(found, f"{name}: {found.frames} pictures", out)
    table, now = camera
    rows = list(_rows(found))
    if now is not None:
        rows.append(("the file says", f"gain_e_per_dn = {now.gain_e_per_dn:g}, read_noise_e = {now.read_noise_e:g}"))
    print_rows(name, rows)
    for note in found.notes:
        print(f"note: {note}", file=sys.stderr)
    print(f"written: {out}")
    print(f"\n[camera.{table}]\ngain_e_per_dn = {found.gain_e_per_dn:#.4g}\nread_noise_e = {found.read_noise_e:#.3g}")


def _rows(found: CameraNoise) -> Iterator[tuple[str, str]]:
    points, line, below = found.points, found.line, found.read_below_e
    yield "gain", f"{found.gain_e_per_dn:.4g} ± {found.gain_sigma_e_per_dn:.2g} e-/DN"
    seen = "" if below is None else f"; not above its own sigma: below {below:.3g} e- (95 %)"
    yield "read noise", f"{found.read_noise_e:.3g} ± {found.read_sigma_e:.2g} e-{seen}"
    yield "rounding", f"{found.rounding_dn2:.3g} DN², taken out (steps of {found.step_dn} DN)"
    yield "line", f"chi2 {line.chi2:.1f} of {line.freedom} degrees of freedom, {len(points.level_dn)} levels"
    yield "levels", f"{points.level_dn[0]:.1f} to {points.level_dn[-1]:.1f} DN"
    yield "saturation", "not reached" if found.saturation_dn is None else f"{found.saturation_dn} DN"
    yield "light", f"flickers by {found.flicker:.2%} (1 sigma), drifts by {found.drift:+.2%} over the stack"
    yield "shake", f"{found.shake_px:.2f} px (1 sigma, from frame to frame)" if found.shake_px else "none to be seen"
    yield "pixels", f"{found.used:.1%} of the picture, {found.frames} frames"
