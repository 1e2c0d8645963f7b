"""`python tests/bench/vision/false_locks.py`: how often a tracker says LOCKED and means something that is not its target.

Runs the engine's tracker, frame by frame, as the daemon does, over seeded segments of a second ball, clutter, round holes,
hidden spells and jumps. A target is chosen by its pixel, as an operator does, and chosen again where it has been in plain
sight for half a second without a lock: a tracker may refuse what it cannot know. A lock is false that is farther from the
target's true centre than max(1 px, 8 sigma of its own covariance). Beside it stands how often the target was locked: who
never locks has no false locks either.
"""

import sys
from argparse import ArgumentParser, Namespace
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, field
from math import hypot, sqrt
from multiprocessing import get_context
from os import environ
from pathlib import Path
from time import perf_counter

import cv2

sys.path.insert(0, str(Path(__file__).parent))

from limits import upper_95
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from segments import FRAMES, SIZE_PX, Bank, Seen, Segment, make_bank
from stage import LENS, RADIUS_MM, Noise
from tables import WIDTH, Table

from trackerd.contract.clock import HostNs
from trackerd.contract.model import AxisAngles, Found, Frame, TrackState
from trackerd.engine.track import Step, Tracker
from trackerd.formats.settings import CameraSettings, SteeringSettings, TrackingSettings
from trackerd.geometry.gimbal import Station
from trackerd.geometry.rigid import Rigid
from trackerd.geometry.sightline import Instants
from trackerd.sim.sensor import Sensor
from trackerd.vision import kernels

RATE_HZ = 110.0
PERIOD_NS, ARRIVAL_NS, EXPOSURE_NS = round(1e9 / RATE_HZ), 8_000_000, 2_000_000
ORIGIN_PX = 704, 528
FALSE_PX, FALSE_SIGMAS = 1.0, 8.0
ON_IT = 0.15  # of the radius: an outline nearer to a ball than this is that ball's
PROCESSES = 2
BATCH = 5  # segments that a process plays at once
PATIENCE = 55  # frames in sight without a lock: then the operator chooses again
TOLD = 20  # false locks that are told one by one

SENSOR = Sensor()
CAMERA = CameraSettings(
    driver="synthetic", frame_rate_hz=RATE_HZ, width_px=SIZE_PX[0], height_px=SIZE_PX[1], offset_x_px=ORIGIN_PX[0],
    offset_y_px=ORIGIN_PX[1], gain_e_per_dn=SENSOR.gain_e_per_dn, read_noise_e=SENSOR.read_noise_e,
)  # fmt: skip
STATION = Station("bench", Rigid.identity(), Rigid.identity(), LENS)
ANGLES = AxisAngles(0.0, 0.0, 1e-5, 0.0, None, 0.0, "latch")  # the axes stand still


@dataclass(slots=True)
class Counted:
    """Frames by situation, and what was said in them."""

    frames: Counter[str] = field(default_factory=Counter)
    right: Counter[str] = field(default_factory=Counter)
    false: Counter[str] = field(default_factory=Counter)
    off: Counter[str] = field(default_factory=Counter)  # of the false ones: on the target, but badly measured
    begun: Counter[str] = field(default_factory=Counter)  # times that a false lock began: one may last
    told: list[str] = field(default_factory=list)
    chosen: int = 0  # times that the operator chose
    step_s: float = 0.0

    @property
    def counts(self) -> tuple[Counter[str], ...]:
        return self.frames, self.right, self.false, self.off, self.begun

    def add(self, other: "Counted") -> None:
        for mine, its in zip(self.counts, other.counts, strict=True):
            mine.update(its)
        self.told += other.told
        self.chosen += other.chosen
        self.step_s += other.step_s


def play(seed: int, bank: Bank) -> Counted:
    """One segment."""
    segment, counted, was_false, waited = Segment(seed, bank), Counted(), False, PATIENCE
    tracker = Tracker(STATION, RADIUS_MM, CAMERA, SteeringSettings(), TrackingSettings())
    for n, seen in enumerate(segment.frames(Noise(seed, SENSOR))):
        if waited >= PATIENCE and seen.situation == "clear":
            waited, counted.chosen = 0, counted.chosen + 1
            tracker.select((seen.target[0] + ORIGIN_PX[0], seen.target[1] + ORIGIN_PX[1]))
        begin = perf_counter()
        step = _step(tracker, n, seen)
        counted.step_s += perf_counter() - begin
        verdict, on_target = judged(step, seen)
        waited = 0 if verdict == "right" else waited + (seen.situation == "clear")
        counted.frames[seen.situation] += 1
        counted.right[seen.situation] += verdict == "right"
        counted.false[seen.situation] += verdict == "false"
        counted.off[seen.situation] += verdict == "false" and on_target
        if verdict == "false" and not was_false:
            counted.begun[seen.situation] += 1
            counted.told.append(_told(seed, n, segment, seen, step))
        was_false = verdict == "false" or (was_false and verdict != "right")
    return counted


def judged(step: Step, seen: Seen) -> tuple[str, bool]:
    """right | false | none: what the lock is worth, if it is one; and whether it is the target that was measured."""
    if step.state is not TrackState.LOCKED or not isinstance(step.outline, Found):
        return "none", False
    x, y = step.outline.x_px - ORIGIN_PX[0], step.outline.y_px - ORIGIN_PX[1]
    sigma_px = sqrt(max(step.outline.cov_px2[0, 0], step.outline.cov_px2[1, 1]))
    off_px = hypot(x - seen.target[0], y - seen.target[1])
    return "right" if off_px <= max(FALSE_PX, FALSE_SIGMAS * sigma_px) else "false", off_px < ON_IT * seen.target[2]


def _step(tracker: Tracker, n: int, seen: Seen) -> Step:
    exposed = HostNs(n * PERIOD_NS)
    frame = Frame(seen.image, n, None, HostNs(exposed + ARRIVAL_NS), EXPOSURE_NS, ORIGIN_PX)
    return tracker.step(frame, ANGLES, Instants(exposed, 0.0, frame.arrived))


def _told(seed: int, n: int, segment: Segment, seen: Seen, step: Step) -> str:
    assert isinstance(step.outline, Found)
    x, y, r = step.outline.x_px - ORIGIN_PX[0], step.outline.y_px - ORIGIN_PX[1], step.outline.r_px
    what = "something else"
    if seen.other is not None and hypot(x - seen.other[0], y - seen.other[1]) < ON_IT * seen.other[2]:
        what = "the second ball"
    if hypot(x - seen.target[0], y - seen.target[1]) < ON_IT * seen.target[2]:
        what = "the target, badly measured"
    where = f"seed {seed} frame {n}, {seen.situation}, second {segment.second}"
    return f"{where}: {what} at ({x:.1f}, {y:.1f}, {r:.1f}), target " + "({:.1f}, {:.1f}, {:.1f})".format(*seen.target)


# ---- processes -------------------------------------------------------------------------------------------------------

_bank: list[Bank] = []  # of this process


def _prepare(seed: int) -> None:
    cv2.setNumThreads(1)
    kernels.warm_up()
    _bank.append(make_bank(seed))


def _batch(seeds: range) -> Counted:
    counted = Counted()
    for seed in seeds:
        counted.add(play(seed, _bank[0]))
    return counted


def run(seed: int, frames: int) -> Iterator[tuple[int, Counted]]:
    """Frames of a batch and what came of them, until all are played."""
    segments = -(-frames // FRAMES)
    seeds = range(seed * 1_000_000, seed * 1_000_000 + segments)
    environ["OPENBLAS_NUM_THREADS"] = "1"  # each process has one thread
    with ProcessPoolExecutor(PROCESSES, get_context("spawn"), _prepare, (seed,)) as pool:
        waiting = [pool.submit(_batch, seeds[n : n + BATCH]) for n in range(0, segments, BATCH)]
        for done in as_completed(waiting):
            counted = done.result()
            yield counted.frames.total(), counted


def table(counted: Counted) -> Table:
    falsely = ("falsely locked", "of these on the target", "times")
    drawn = Table("False locks", ("frames", "locked on the target, %", *falsely, "at 95 % less than, per hour"))
    for situation in sorted(counted.frames):
        drawn.add(situation, *_row([count[situation] for count in counted.counts]))
    verdict = "MISSED" if counted.false.total() else "met"
    drawn.add("all", *_row([count.total() for count in counted.counts]), verdict=verdict, limit="0 false locks")
    return drawn


def _row(counts: list[int]) -> tuple[int | float, ...]:
    frames, right, false, off, begun = counts
    return frames, 100.0 * right / frames, false, off, begun, _per_hour(begun, frames)


def _per_hour(begun: int, frames: int) -> float:
    """The rate of false locks that the count leaves possible, in hours of frames at RATE_HZ."""
    return upper_95(begun, frames / (3600.0 * RATE_HZ))


def main(asked: Namespace) -> None:
    console, counted, begin = Console(width=WIDTH, highlight=False), Counted(), perf_counter()
    if asked.segment is not None:
        _prepare(asked.segment // 1_000_000)
        counted = play(asked.segment, _bank[0])
    else:
        columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()
        with Progress(*columns, transient=True, console=Console(stderr=True)) as progress:
            task = progress.add_task("frames", total=asked.frames)
            for frames, part in run(asked.seed, asked.frames):
                counted.add(part)
                progress.update(task, advance=frames, description=f"{counted.begun.total()} false locks, frames")
    table(counted).print(console)
    for line in sorted(counted.told)[:TOLD]:
        console.print(f"  {line}")
    frames, took_s = counted.frames.total(), perf_counter() - begin
    each = f"{1e3 * counted.step_s / frames:.2f} ms a step of the tracker, {1e3 * took_s / frames:.2f} ms a frame in all"
    console.print(f"\nthe target was chosen {counted.chosen} times")
    console.print(f"{each}, {took_s / 60.0:.1f} min")


if __name__ == "__main__":
    parser = ArgumentParser(prog="python tests/bench/vision/false_locks.py", description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=int, default=1_000_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--segment", type=int, metavar="SEED", help="this one alone: the seed of a false lock that was told")
    main(parser.parse_args())
