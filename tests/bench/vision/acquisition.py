"""A ball somewhere in a full frame of 2048x1536 with clutter, and nobody knows where."""

from collections.abc import Callable, Iterator
from math import exp, log

import numpy as np
from limits import FOUND_BLURS, Limit, upper_95
from speed import Yardstick
from stage import LENS, RADIUS_MM, Light, backdrop, compose, sprite
from tables import Table
from trials import Circle

from trackerd.contract.model import Found, Image, Outline
from trackerd.sim.ball import Surface
from trackerd.sim.picture import Background, Picture, Stem, probe_seen_at
from trackerd.sim.sensor import Sensor, expose
from trackerd.vision.locate import search
from trackerd.vision.noise import NoiseModel

SIZE_PX = (2048, 1536)
RADII_PX = (14.0, 120.0)
CONTRAST_DN = (16.0, 110.0)  # to what is behind the ball's middle
STEMS = 0.5  # share of the balls that have one
BALLS_PER_BACKDROP = 10
THINGS = 30  # of clutter in a frame
SENSOR = Sensor()
NOISE = NoiseModel(SENSOR.gain_e_per_dn, SENSOR.read_noise_e, SENSOR.saturation_dn)
FOUND_PX = 1.0  # from the true centre, at most
ALL = Limit("missed", 0.0)


def acquisition_table(seed: int, count: int, yardstick: Yardstick, advance: Callable[[], object]) -> Table:
    ratios, outcomes = [], []
    for image, circle in full_frames(seed, count):
        answers: list[Outline] = []
        took, _ = yardstick.ratios([lambda image=image, answers=answers: answers.append(search(image, NOISE))])
        ratios += took
        outcomes.append(_outcome(answers[0], circle))
        advance()
    table = Table(f"Acquisition in {SIZE_PX[0]}x{SIZE_PX[1]} with clutter, without a guess", ("value", "frames"))
    found, wrong, middle = outcomes.count("found"), outcomes.count("wrong"), float(np.median(ratios))
    table.add("found", found, count, verdict=ALL.verdict(count - found), limit=f"{count} of {count}")
    table.add("something else was taken for it", wrong, count, verdict=ALL.verdict(wrong), limit="none")
    table.add("median, blurs", middle, count, verdict=FOUND_BLURS.verdict(middle), limit=FOUND_BLURS.told())
    table.add("95 %, blurs", float(np.percentile(ratios, 95)), count)
    table.add("not found, at 95 % less than, %", 100.0 * upper_95(count - found, count), count)
    return table


def full_frames(seed: int, count: int) -> Iterator[tuple[Image, Circle]]:
    random = np.random.default_rng((seed, 3))
    behind = canvas = np.empty((SIZE_PX[1], SIZE_PX[0]), np.float32)
    for n in range(count):
        if n % BALLS_PER_BACKDROP == 0:
            behind = backdrop(random, SIZE_PX, THINGS)
            canvas = np.empty_like(behind)
        ball = sprite(_ball(random, behind))
        yield expose(compose(behind, [ball], canvas), SENSOR, random), ball.circle


def _ball(random: np.random.Generator, behind: Light) -> Picture:
    """Wholly in the frame, brighter or darker than what is behind its middle."""
    r = exp(random.uniform(*map(log, RADII_PX)))
    x, y = random.uniform(1.3 * r, np.subtract(SIZE_PX, 1.3 * r)).tolist()
    ground, contrast = float(behind[round(y), round(x)]), random.uniform(*CONTRAST_DN)
    level = ground - contrast if ground - contrast > 8.0 and random.random() < 0.5 else ground + contrast
    stem = Stem(random.uniform(-np.pi, np.pi), random.uniform(0.2, 0.6), random.uniform(15.0, 200.0))
    return Picture(
        SIZE_PX,
        LENS,
        probe_seen_at((x, y, r), RADIUS_MM, LENS),
        RADIUS_MM,
        surface=Surface(level_dn=level),
        background=Background(ground),
        stem=stem if random.random() < STEMS else None,
    )


def _outcome(outline: Outline, circle: Circle) -> str:
    if not isinstance(outline, Found):
        return "missed"
    return "found" if np.hypot(outline.x_px - circle[0], outline.y_px - circle[1]) <= FOUND_PX else "wrong"
