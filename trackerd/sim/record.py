"""A recording of the scene, made as fast as the machine allows: what a cell of pylon's emulated cameras plays.

LEFT/000000.bmp ...   the frames of gimbal `left`; its folder has the gimbal's name
LEFT.csv              frame,t_ns                      mid-exposure
angles.csv            gimbal,frame,t_ns,az_rad,el_rad the encoders as they were latched: the mean of both edges
truth.csv             t_ns,x_mm,y_mm,z_mm             the probe in W at every mid-exposure
"""

import csv
import shutil
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

import cv2

from trackerd.sim.render import Renderer
from trackerd.sim.scene import Scene
from trackerd.sim.trigger import Trigger

Row: TypeAlias = Sequence[object]
Progress: TypeAlias = Callable[[int, int], None]

LEAD_NS = 1_000_000_000  # of the probe's standing still: time to lock
TICK_NS = 10_000_000  # of the aiming
SECOND_NS = 1_000_000_000


@dataclass(frozen=True, slots=True)
class Shot:
    """One exposure to take."""

    begin_ns: int
    end_ns: int
    gimbal: str
    frame: int

    @property
    def mid_ns(self) -> int:
        return (self.begin_ns + self.end_ns) // 2


def record(
    scene: Scene,
    folder: Path,
    duration_s: float,
    calibration: Path | None = None,
    progress: Progress | None = None,
) -> int:
    """Write `duration_s` of the scene, from one second before the probe moves; returns the number of frames.

    The gimbals start aimed, and follow the true probe through their axes' dynamics, or sweep beside it where the settings say
    so. The scene is spent afterwards; `progress` is told the frames done and in all. Raises OSError.
    """
    start_ns = max(0, round(scene.settings.path.dwell_s * 1e9) - LEAD_NS)
    scene.place()
    shots = _shots({name: scene.trigger(name) for name in scene.gimbals}, start_ns, round(duration_s * SECOND_NS))
    for name in scene.gimbals:
        (folder / name).mkdir(parents=True, exist_ok=True)
    angles = _expose(scene, shots, folder, progress)
    _write_tables(scene, shots, angles, folder)
    if calibration is not None:
        shutil.copyfile(calibration, folder / "calibration.toml")
    return len(shots)


def _shots(triggers: dict[str, Trigger], start_ns: int, duration_ns: int) -> list[Shot]:
    """All exposures within the time, in the order in which they begin."""
    shots = []
    for name, trigger in triggers.items():
        first = trigger.first_from(start_ns)
        count = trigger.first_from(start_ns + duration_ns) - first
        for frame in range(count):
            begin_ns = trigger.begin_ns(first + frame)
            shots.append(Shot(begin_ns, begin_ns + trigger.exposure_ns, name, frame))
    return sorted(shots, key=lambda shot: (shot.begin_ns, shot.gimbal))


def _expose(scene: Scene, shots: list[Shot], folder: Path, progress: Progress | None) -> list[Row]:
    """Write the frames; the rows of angles.csv."""
    renderers = {name: scene.renderer(name) for name in scene.gimbals}
    rows: list[Row] = []
    tick_ns = shots[0].begin_ns if shots else 0
    for done, shot in enumerate(shots, start=1):
        while tick_ns <= shot.end_ns:
            scene.follow(tick_ns, tick_ns + TICK_NS)
            tick_ns += TICK_NS
        _write_frame(scene, renderers[shot.gimbal], shot, folder)
        az, el = scene.latched(shot.gimbal, shot.begin_ns, shot.end_ns)
        rows.append((shot.gimbal, shot.frame, shot.mid_ns, f"{az:.12f}", f"{el:.12f}"))
        if progress is not None:
            progress(done, len(shots))
    return rows


def _write_frame(scene: Scene, renderer: Renderer, shot: Shot, folder: Path) -> None:
    view = scene.view(shot.gimbal, shot.begin_ns, shot.end_ns)
    path = folder / shot.gimbal / f"{shot.frame:06d}.bmp"
    if not cv2.imwrite(str(path), renderer.render(view.poses, view.probes_mm, shot.frame)):
        raise OSError(f"{path}: could not be written")


def _write_tables(scene: Scene, shots: list[Shot], angles: list[Row], folder: Path) -> None:
    _write(folder / "angles.csv", ("gimbal", "frame", "t_ns", "az_rad", "el_rad"), angles)
    for name in scene.gimbals:
        rows = ((shot.frame, shot.mid_ns) for shot in shots if shot.gimbal == name)
        _write(folder / f"{name}.csv", ("frame", "t_ns"), rows)
    instants = sorted({shot.mid_ns for shot in shots})
    truth = ((t_ns, *(f"{x:.6f}" for x in scene.truth(t_ns)[0])) for t_ns in instants)
    _write(folder / "truth.csv", ("t_ns", "x_mm", "y_mm", "z_mm"), truth)


def _write(path: Path, header: Row, rows: Iterable[Row]) -> None:
    with path.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header)
        writer.writerows(rows)
