"""`python tests/bench/vision/sequence.py`: a ball that rushes, hides and jumps, before every tracker.

Four seconds at 55 frames a second of a full sensor, 2048x1536, with clutter and holes: slow, then up to 75 px a frame (smeared
by the exposure), hidden for 40 frames, and a jump of 780 px. First the engine's tracker with each OpenCV tracker as its second
hypothesis; then the OpenCV trackers alone, started with a perfect box: what they add, and what they do without the fit.
"""

import sys
from argparse import ArgumentParser
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from math import cos, hypot, nan, pi, sin, sqrt
from pathlib import Path
from statistics import median
from typing import Any

import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).parent))

from false_locks import ANGLES, FALSE_PX, FALSE_SIGMAS, SENSOR, STATION
from limits import Limit
from rich.console import Console
from rich.progress import Progress
from speed import Yardstick
from stage import LENS, RADIUS_MM, Circle, Noise, Sprite, backdrop, compose, sprite
from tables import WIDTH, Table

from trackerd.contract.clock import HostNs
from trackerd.contract.model import Found, Frame, Image, TrackState
from trackerd.engine.track import Tracker
from trackerd.formats.settings import CameraSettings, SteeringSettings, TrackingSettings
from trackerd.geometry.sightline import Instants
from trackerd.sim.ball import Surface
from trackerd.sim.picture import Background, Picture, Stem, probe_seen_at
from trackerd.vision import kernels

_cv2: Any = cv2  # its stubs lack the trackers

SIZE_PX, R_PX = (2048, 1536), 60.0
PERIOD_NS, ARRIVAL_NS, EXPOSURE_NS = 18_181_818, 16_000_000, 2_000_000
FAST, HIDDEN, JUMP, END = 40, 110, 190, 220  # frames at which these parts begin
SEEN_AGAIN = 150  # the frame in which the ball is back
SWING_PX = 434.0  # of the rush to and fro: 75 px a frame where it is fastest
JUMP_PX = 624.0, -468.0  # 780 px
THINGS, HOLES = 30, 2  # of clutter
BOX_RADII = 2.4  # side of the box that a bare tracker is started with
BARE_OFF = 0.5  # of the radius: a box farther off is wrong
CAMERA = CameraSettings(driver="synthetic", gain_e_per_dn=SENSOR.gain_e_per_dn, read_noise_e=SENSOR.read_noise_e)
NONE = Limit("wrong", 0.0)
AT_ONCE = Limit("late", 0.0)


@dataclass(frozen=True, slots=True)
class Seen:
    number: int
    image: Image
    circle: Circle
    visible: bool


Answer = tuple[float, float, float] | None  # a place, and how far off it may be; None: it says that it does not see the ball
Follower = Callable[[Seen], Answer]  # is shown one frame after the other


@dataclass(slots=True)
class Record:
    """What one follower said, frame by frame."""

    right: list[bool] = field(default_factory=list)
    wrong: int = 0
    errors_px: list[float] = field(default_factory=list)
    blurs: list[float] = field(default_factory=list)

    def add(self, seen: Seen, answer: Answer, blurs: float) -> None:
        off_px = nan if answer is None else hypot(answer[0] - seen.circle[0], answer[1] - seen.circle[1])
        is_right = answer is not None and seen.visible and off_px <= answer[2]
        self.right.append(is_right)
        self.wrong += answer is not None and not is_right
        self.blurs.append(blurs)
        if is_right:
            self.errors_px.append(off_px)

    def late(self, first: int, end: int) -> float:
        """Frames from the first in which the ball can be seen to the first in which it is; NaN: never."""
        part = self.right[first:end]
        return float(part.index(True)) if True in part else nan


# ---- the sequence ----------------------------------------------------------------------------------------------------


def place(n: int) -> tuple[float, float]:
    """Centre of the ball in frame n."""
    x, y = 1000.0 + 60.0 * sin(0.04 * n), 800.0 + 60.0 * cos(0.05 * n)
    if FAST <= n < HIDDEN:
        part = (n - FAST) / (HIDDEN - FAST)
        x += SWING_PX * sin(pi * part) * sin(4.0 * pi * part)
    if n >= JUMP:
        x, y = x + JUMP_PX[0], y + JUMP_PX[1]
    return x, y


def sequence(seed: int) -> Iterator[Seen]:
    random, noise = np.random.default_rng((seed, 6)), Noise(seed, SENSOR)
    behind = backdrop(random, SIZE_PX, THINGS, HOLES)
    canvas = np.empty_like(behind)
    for n in range(END):
        ball, visible = _ball(n), not HIDDEN <= n < SEEN_AGAIN
        light = compose(behind, [ball] if visible else [], canvas)
        yield Seen(n, noise.expose(light, np.empty(light.shape, np.uint8)), ball.circle, visible)


def _ball(n: int) -> Sprite:
    """On a stem of four radii, smeared over the way that it goes while the shutter is open."""
    (x, y), (u, v) = place(n), place(n + 1) if n + 1 != JUMP else place(n)
    share = EXPOSURE_NS / PERIOD_NS
    motion_px = ((u - x) * share, (v - y) * share)
    left, top, width, height = round(x) - 110, round(y) - 290, 220, 400
    probe_mm = probe_seen_at((x - left, y - top, R_PX), RADIUS_MM, LENS, (left, top))
    stem = Stem(-0.5 * pi, 0.4, 120.0, length=4.0)
    picture = Picture(
        (width, height), LENS, probe_mm, RADIUS_MM, (left, top), motion_px,
        surface=Surface(180.0, limb=0.1), background=Background(60.0), stem=stem,
    )  # fmt: skip
    return sprite(picture).moved(left, top)


# ---- the followers ---------------------------------------------------------------------------------------------------


class Ours:
    """The engine's tracker, with its target chosen by a pixel."""

    def __init__(self, kind: str, first: Circle) -> None:
        tracking = TrackingSettings(tracker=kind, target_px=first[:2])  # type: ignore[arg-type]
        self._tracker = Tracker(STATION, RADIUS_MM, CAMERA, SteeringSettings(), tracking)

    def __call__(self, seen: Seen) -> Answer:
        exposed = HostNs(seen.number * PERIOD_NS)
        frame = Frame(seen.image, seen.number, None, HostNs(exposed + ARRIVAL_NS), EXPOSURE_NS)
        step = self._tracker.step(frame, ANGLES, Instants(exposed, 0.0, frame.arrived))
        if step.state is not TrackState.LOCKED or not isinstance(step.outline, Found):
            return None
        sigma_px = sqrt(max(step.outline.cov_px2[0, 0], step.outline.cov_px2[1, 1]))
        return step.outline.x_px, step.outline.y_px, max(FALSE_PX, FALSE_SIGMAS * sigma_px)


class Bare:
    """An OpenCV tracker and nothing else, on a frame that is smaller by a whole number."""

    def __init__(self, make: Callable[[], Any], scale: int) -> None:
        self._make, self._scale = make, scale
        self._tracker: Any = None
        self._off_px = 0.0  # of the box's centre from the ball's, since boxes are whole pixels

    def __call__(self, seen: Seen) -> Answer:
        k, (x, y, r) = self._scale, seen.circle
        image = seen.image if k == 1 else cv2.resize(seen.image, None, fx=1.0 / k, fy=1.0 / k, interpolation=cv2.INTER_AREA)
        if self._tracker is None:
            side = round(BOX_RADII * r / k)
            left, top = (round((q + 0.5) / k - 0.5 - 0.5 * (side - 1)) for q in (x, y))
            self._tracker = self._make()
            self._tracker.init(image, (left, top, side, side))
        found, box = self._tracker.update(image)  # on the first frame, too: KCF only learns in update
        if not found:
            return None
        centre = (box[0] + 0.5 * (box[2] - 1), box[1] + 0.5 * (box[3] - 1))
        return (centre[0] + 0.5) * k - 0.5, (centre[1] + 0.5) * k - 0.5, BARE_OFF * r


def _kcf() -> Any:
    settings = _cv2.TrackerKCF_Params()
    settings.desc_pca = settings.desc_npca = _cv2.TrackerKCF_GRAY  # its default throws on grey images
    settings.compressed_size = 1
    return _cv2.TrackerKCF_create(settings)


BARE: dict[str, Callable[[], Bare]] = {
    "KCF alone, quarter size": lambda: Bare(_kcf, 4),
    "KCF alone, full size": lambda: Bare(_kcf, 1),
    "MOSSE alone, quarter size": lambda: Bare(_cv2.legacy.TrackerMOSSE_create, 4),
    "MOSSE alone, full size": lambda: Bare(_cv2.legacy.TrackerMOSSE_create, 1),
    "CSRT alone, quarter size": lambda: Bare(_cv2.TrackerCSRT_create, 4),
    "CSRT alone, full size": lambda: Bare(_cv2.TrackerCSRT_create, 1),
}


# ---- the run ---------------------------------------------------------------------------------------------------------


def run(seed: int, advance: Callable[[], object]) -> dict[str, Record]:
    """All of them on the same frames, one after the other, with a blur between."""
    followers: dict[str, Follower] = {name: make() for name, make in BARE.items()}
    records: dict[str, Record] = {}
    yardstick = Yardstick()
    for seen in sequence(seed):
        if seen.number == 0:
            ours = {f"ours, tracker = {kind!r}": Ours(kind, seen.circle) for kind in ("kcf", "mosse", "csrt", "none")}
            followers = {**ours, **followers}
            records = {name: Record() for name in followers}
        answers: dict[str, Answer] = {}
        calls = [partial(_ask, answers, name, follower, seen) for name, follower in followers.items()]
        ratios, _ = yardstick.ratios(calls)
        for (name, record), blurs in zip(records.items(), ratios, strict=True):
            record.add(seen, answers[name], blurs)
        advance()
    return records


def _ask(answers: dict[str, Answer], name: str, follower: Follower, seen: Seen) -> None:
    answers[name] = follower(seen)


def table(records: dict[str, Record]) -> Table:
    late_columns = ("late after hidden", "late after jump")
    columns = ("right, slow %", "right, fast %", "wrong frames", *late_columns, "error px", "95 % px", "blurs", "95 %")
    drawn = Table("220 frames: 40 slow, 70 fast, 40 hidden, 40 slow, a jump, 30 slow. Late in frames; - is never", columns)
    for name, record in records.items():
        late = record.late(SEEN_AGAIN, JUMP), record.late(JUMP, END)
        slow = [*record.right[2:FAST], *record.right[SEEN_AGAIN:]]
        error = (median(record.errors_px), float(np.percentile(record.errors_px, 95))) if record.errors_px else (nan, nan)
        met = NONE.verdict(record.wrong) != "MISSED" and all(AT_ONCE.verdict(value) != "MISSED" for value in late)
        verdict = ("met" if met else "MISSED") if name.startswith("ours") else ""
        limit = "0 wrong, back at once" if name.startswith("ours") else ""
        drawn.add(
            name, _percent(slow), _percent(record.right[FAST:HIDDEN]), record.wrong, *late, *error, median(record.blurs),
            float(np.percentile(record.blurs, 95)), verdict=verdict, limit=limit,
        )  # fmt: skip
    return drawn


def _percent(right: list[bool]) -> float:
    return 100.0 * sum(right) / len(right)


if __name__ == "__main__":
    parser = ArgumentParser(prog="python tests/bench/vision/sequence.py", description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=1)
    cv2.setNumThreads(1)
    kernels.warm_up()
    with Progress(transient=True, console=Console(stderr=True)) as progress:
        task = progress.add_task("frames", total=END)
        records = run(parser.parse_args().seed, lambda: progress.advance(task))
    table(records).print(Console(width=WIDTH, highlight=False))
    print(f"Right: within max(1 px, 8 sigma) of the true centre; bare trackers: within {BARE_OFF:g} r")
