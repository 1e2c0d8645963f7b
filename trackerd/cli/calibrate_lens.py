"""`trackerd calibrate lens`: intrinsics of a camera from pictures of a board."""

import glob
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from hashlib import sha256
from math import degrees
from pathlib import Path
from typing import TypeVar

from trackerd import __version__
from trackerd.calibrate.board_kinds import Board, Charuco, Chessboard, CircleGrid, Detection, DotArray, Missed
from trackerd.calibrate.boards import detect, eight_bits
from trackerd.calibrate.lens import LensOptions, calibrate_lens
from trackerd.calibrate.lens_report import lens_report, parameter_rows
from trackerd.calibrate.lens_result import LensResult
from trackerd.cli.telling import print_rows, progress
from trackerd.contract.errors import ConfigError, TrackerdError
from trackerd.contract.model import Image
from trackerd.formats.atomic import write_atomically
from trackerd.formats.dot_file import read_dots
from trackerd.formats.lens_file import LensRecord, UsedPicture, add_lens, load_lenses
from trackerd.formats.stills import read_still, stills
from trackerd.geometry.optics import angle_of_view, field_of_view, focal_length_mm

Given = TypeVar("Given")

MAGIC = "*?["
ONE_SETTING = "default"


@dataclass(frozen=True, slots=True)
class BoardRequest:
    """As a person describes a board; what its kind needs is told by `board_of`."""

    kind: str = "chessboard"
    size: tuple[int, int] | None = None
    square_mm: float | None = None
    marker_mm: float | None = None
    dictionary: str = "4X4_50"
    legacy: bool = False
    points: Path | None = None


@dataclass(frozen=True, slots=True)
class LensRequest:
    images: Sequence[str]
    board: BoardRequest
    output: Path
    report: Path | None = None
    zoom: str | None = None
    options: LensOptions = field(default_factory=LensOptions)
    pixel_um: float | None = None
    range_mm: float | None = None


@dataclass(frozen=True, slots=True)
class _Found:
    """What the pictures of one zoom setting show."""

    detections: list[tuple[str, Detection]]
    files: dict[str, Path]
    sensor_px: tuple[int, int]


def lens(request: LensRequest) -> None:
    """Prints the figures, writes the lens file and the report of each zoom setting. Raises ConfigError, Undetermined."""
    board = board_of(request.board)
    _check_places(request)
    settings = _settings(request)
    for zoom, files in settings.items():
        found = _look(files, board)
        result = calibrate_lens(found.detections, board, found.sensor_px, request.options)
        report = request.report or request.output.with_suffix(".html")
        report = report if len(settings) == 1 else report.with_stem(f"{report.stem}.{zoom}")
        _write(request, zoom, board, found, result, report)
        _tell(request, zoom, board, result)
        print(f"written: {request.output} [lens.{zoom}], {report}")


def _check_places(request: LensRequest) -> None:
    """Before the work: a foreign file is not written over, and folders are there. Raises ConfigError."""
    for option, path in (("--output", request.output), ("--report", request.report)):
        if path is not None and not path.parent.is_dir():
            raise ConfigError(f"{option} {path}: there is no folder {path.parent}")
    if request.output.exists():
        load_lenses(request.output)


def board_of(request: BoardRequest) -> Board:
    """Raises ConfigError for what its kind needs and does not have."""
    if request.kind == "leds":
        dots = read_dots(_needed(request.points, "--points FILE", "leds"))
        return DotArray(dots.p_mm, f"array {request.points.name if request.points else ''}", dots.facing, dots.dark)
    size = _needed(request.size, "--board COLUMNSxROWS", request.kind)
    square_mm = _needed(request.square_mm, "--square-mm MM", request.kind)
    if request.kind == "chessboard":
        return Chessboard(size, square_mm)
    if request.kind == "charuco":
        marker_mm = _needed(request.marker_mm, "--marker-mm MM", request.kind)
        return Charuco(size, square_mm, marker_mm, request.dictionary, request.legacy)
    return CircleGrid(size, square_mm, asymmetric=request.kind == "asymmetric")


def _needed(value: Given | None, option: str, kind: str) -> Given:
    if value is None:
        raise ConfigError(f"calibrate lens: a board of type {kind} needs {option}")
    return value


def _settings(request: LensRequest) -> dict[str, list[Path]]:
    """Several folders are several zoom settings, named as they are; all else is one."""
    paths = [Path(one) for text in request.images for one in _globbed(text)]
    folders = [path for path in paths if path.is_dir()]
    if request.zoom is None and len(folders) > 1 and len(folders) == len(paths):
        names = Counter(folder.resolve().name for folder in folders)
        if twice := [name for name, count in names.items() if count > 1]:
            raise ConfigError(f"calibrate lens: two folders are named {twice[0]}: give one at a time, and --zoom NAME")
        return {folder.resolve().name: _files(folder) for folder in folders}
    files = [file for path in paths for file in _files(path)]
    return {request.zoom or ONE_SETTING: list(dict.fromkeys(files))}


def _globbed(text: str) -> list[str]:
    if Path(text).exists() or not any(mark in text for mark in MAGIC):
        return [text]
    found = sorted(glob.glob(text))  # noqa: PTH207 a pattern with its folders, as the shell has it
    if not found:
        raise ConfigError(f"{text}: no file is named so")
    return found


def _files(path: Path) -> list[Path]:
    return [file for series in stills(path) for file in series.files]


def _look(files: Sequence[Path], board: Board) -> _Found:
    """Every picture that cannot be read, is of another size, or shows no board is named with its reason."""
    names = _names(files)
    images: dict[str, tuple[int, int]] = {}
    detections: list[tuple[str, Detection]] = []
    with progress("looking for the board", len(files)) as advance:
        for name, file in names.items():
            try:
                image = read_still(file)
            except ConfigError as error:
                detections.append((name, Missed(str(error).removeprefix(f"{file}: "))))
            else:
                images[name] = (image.shape[1], image.shape[0])
                detections.append((name, detect(board, image)))
            advance()
    sensor_px = Counter(images.values()).most_common(1)[0][0] if images else (0, 0)
    for n, (name, _) in enumerate(detections):
        if images.get(name, sensor_px) != sensor_px:
            (width, height), (usual, high) = images[name], sensor_px
            detections[n] = (name, Missed(f"is {width} x {height} px, the others are {usual} x {high} px"))
    return _Found(detections, names, sensor_px)


def _names(files: Sequence[Path]) -> dict[str, Path]:
    """The files' names, with their folders where two are alike."""
    counts = Counter(file.name for file in files)
    return {file.name if counts[file.name] == 1 else str(file): file for file in files}


def _write(request: LensRequest, zoom: str, board: Board, found: _Found, result: LensResult, report: Path) -> None:
    created = datetime.now(UTC).isoformat(timespec="seconds")
    used = {
        one.name: UsedPicture(one.rms_px, one.points, sha256(found.files[one.name].read_bytes()).hexdigest(), one.rejected)
        for one in result.pictures
    }
    record = LensRecord(
        lens=result.lens,
        covariance=result.covariance,
        created=created,
        software=f"trackerd {__version__}",
        board=board.name,
        rms_px=result.rms_px,
        sigma_px=result.sigma_px,
        inflation=result.inflation,
        pictures=used,
        left_out={one.name: one.reason for one in result.left_out},
        warnings=result.warnings,
        pixel_um=request.pixel_um,
    )

    def picture(name: str) -> Image:
        return eight_bits(read_still(found.files[name]))

    lead = f"{board.name}; {created}, trackerd {__version__}; pictures {record.sha256[:12]}"
    html = lens_report(result, board, f"Lens at zoom setting {zoom}", lead, list(_optics(request, result)), picture)
    try:
        add_lens(zoom, record, request.output)
        write_atomically(report, html)
    except OSError as error:
        raise TrackerdError(f"{error.filename or request.output}: cannot be written: {error.strerror}") from error


def _tell(request: LensRequest, zoom: str, board: Board, result: LensResult) -> None:
    rows = [("board", board.name), *_figures(result), *_optics(request, result)]
    print_rows(f"lens at zoom setting {zoom}", rows)
    for one in result.pictures:
        rejected = f", left out: points {', '.join(map(str, one.rejected))}" if one.rejected else ""
        print(f"  {one.name}: rms {one.rms_px:.3f} px, {one.points} points{rejected}")
    for lost in result.left_out:
        print(f"left out: {lost.name}: {lost.reason}")
    for text in result.warnings:
        print(f"warning: {text}", file=sys.stderr)


def _figures(result: LensResult) -> Iterator[tuple[str, str]]:
    lost = len(result.left_out)
    yield "pictures", f"{len(result.pictures)} used, {lost} left out"
    yield "points", f"{len(result.views.q_px)} used, {result.rejected} rejected"
    yield "residuals", f"rms {result.rms_px:.3f} px, sigma of a coordinate {result.sigma_px:.3f} px"
    for name, value, sigma in parameter_rows(result):
        if sigma != "held":
            yield name.removesuffix("_px"), f"{value} ± {sigma}" + (" px" if name.endswith("_px") else "")
    yield "coefficients", f"{result.coefficients} of distortion" + (" (by BIC)" if len(result.tried) > 1 else " (as asked)")
    yield "coverage", f"{result.coverage.share:.0%} of the sensor, out to {result.coverage.radius_share:.0%} of the corner"
    if result.inflation > 1.0:
        yield "sigmas", f"widened {result.inflation:.2f} times, as the pictures disagree"


def _optics(request: LensRequest, result: LensResult) -> Iterator[tuple[str, str]]:
    """In the words of the lens' maker."""
    found = result.lens
    if request.pixel_um is not None:
        x_mm, y_mm = focal_length_mm(found, (request.pixel_um, request.pixel_um))
        sigma_mm = result.sigmas["fx_px"] * request.pixel_um * 1e-3
        yield "focal length", f"{x_mm:.4f} ± {sigma_mm:.4f} mm along x, {y_mm:.4f} mm along y"
    angle = angle_of_view(found)
    across, down, diagonal = map(degrees, (angle.horizontal_rad, angle.vertical_rad, angle.diagonal_rad))
    yield "angle of view", f"{across:.3f}° x {down:.3f}°, diagonal {diagonal:.3f}°"
    if request.range_mm is not None:
        view = field_of_view(found, request.range_mm)
        yield (
            f"field of view at {request.range_mm:g} mm",
            f"{view.width_mm:.2f} x {view.height_mm:.2f} mm, {view.x_mm_per_px * 1e3:.2f} um a pixel",
        )
