"""`trackerd calibrate plan`: a mover's program, checked without moving anything."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import radians
from pathlib import Path

import numpy as np

from trackerd.calibrate.plan.looks import Eye
from trackerd.calibrate.plan.make import Pace, errands, plan_stops, two_faced
from trackerd.calibrate.plan.predicted import Noise, predicted
from trackerd.calibrate.plan.predicted_page import draw
from trackerd.calibrate.plan.volume import Box
from trackerd.contract.errors import ConfigError, TrackerdError
from trackerd.formats.atomic import write_atomically
from trackerd.formats.config import CellConfig
from trackerd.formats.mover import ENDINGS, ProgramFormat, Stop, write_program
from trackerd.wiring.capture import eyes_of
from trackerd.wiring.cell import load

ROBOTS = (ProgramFormat.KRL, ProgramFormat.RAPID)
SIGMA_MM = {"cnc": 0.005, "robot": 0.65}  # of a mover's coordinate, where nobody says
PIXEL_PX = 0.1  # of the ball's middle in one frame, where nothing has been measured yet


@dataclass(frozen=True, slots=True)
class PlanRequest:
    config: Path
    overrides: Sequence[str]
    points: int
    check: int
    format: str
    volume: tuple[tuple[float, ...], tuple[float, ...]]
    output: Path
    frames: int
    mm_s: float
    sigma_mm: float | None  # None: that of such a mover
    seed: int
    tilt_deg: float


def plan(request: PlanRequest) -> None:
    """Writes the program and the map beside it. Raises ConfigError for a volume that a gimbal cannot see all of."""
    kind = ProgramFormat(request.format)
    endings = [ending for ending, of in ENDINGS.items() if of is kind]
    if request.output.suffix.lower() not in endings:
        raise ConfigError(f"--output {request.output}: a {kind} program ends in {', '.join(endings)}")
    cell = load(request.config, request.overrides)
    eyes = eyes_of(cell)
    size, centre = (np.array(part) for part in request.volume)
    box = Box.around(centre, size)
    stops = _stops(request, cell, eyes, box, kind in ROBOTS)
    planned = errands(eyes, stops)
    found = predicted(planned, eyes, box, _noise(request, cell, kind in ROBOTS))
    page = request.output.with_suffix(".predicted.png")
    title = f"trackerd: {request.points} stops to calibrate {cell.name}, {request.check} to check it"
    try:
        write_atomically(request.output, write_program(stops, kind, request.mm_s, title))
    except OSError as error:
        raise TrackerdError(f"{request.output}: cannot be written: {error.strerror}") from error
    draw(found, planned, f"{cell.name}: predicted error of targets, calibrated by {request.points} stops", page)
    for eye in eyes:
        looks = sum(len(errand.looks[eye.name]) for errand in planned)
        print(f"{eye.name}: {looks} looks, in two faces at {two_faced(planned, eye.name)} of {len(stops)} stops")
    way_mm = float(np.linalg.norm(np.diff([stop.p_mm for stop in stops], axis=0), axis=1).sum())
    minutes = (sum(stop.dwell_s for stop in stops) + way_mm / request.mm_s) / 60.0
    print(f"way: {way_mm:.0f} mm, {minutes:.0f} min with the looks")
    print(f"predicted: {found.words}")
    if kind in ROBOTS:
        print("note: that is by the robot's places alone; bars give it the scale, and are measured beside it")
    print(f"written: {request.output}\nwritten: {page}")


def _stops(request: PlanRequest, cell: CellConfig, eyes: Sequence[Eye], box: Box, robot: bool) -> list[Stop]:
    pace = Pace(request.frames, min(camera.frame_rate_hz for camera in cell.cameras.values()))
    tilt_rad = radians(request.tilt_deg) if robot else None
    return plan_stops(eyes, box, request.points, request.check, pace, request.seed, tilt_rad)


def _noise(request: PlanRequest, cell: CellConfig, robot: bool) -> Noise:
    """The gimbal with the worst encoders counts."""
    white = max(gimbal.encoder_sigma_rad for gimbal in cell.gimbals.values())
    fixed = max(gimbal.encoder_fixed_rad for gimbal in cell.gimbals.values())
    point_mm = request.sigma_mm or SIGMA_MM["robot" if robot else "cnc"]
    return Noise(point_mm, PIXEL_PX, white, fixed, request.frames)
