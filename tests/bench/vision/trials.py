"""Frames to be judged by: an image, what is true of it, its bound, and the guess that every detector is given."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scenes
from stage import LENS, RADIUS_MM

from trackerd.contract.model import Array, Image, Outline
from trackerd.sim.picture import Picture, Stem, Truth, expected, probe_seen_at
from trackerd.sim.picture import truth as truth_of
from trackerd.sim.sensor import Sensor, expose
from trackerd.vision.curve import View
from trackerd.vision.limb import LimbChoice
from trackerd.vision.locate import locate
from trackerd.vision.noise import NoiseModel

OFF_PX, OFF_R = 6.0, 0.08  # of the guess: in x, in y; as a share of r
GUESSED_PX = 12.0, 120.0  # radii guessed where there is no ball
TIMED_R_PX, TIMED_ORIGIN_PX = 60.0, (900, 700)
SEEDS = 1_000_000  # scenes of one run: those of two runs have none in common

Circle = tuple[float, float, float]  # x, y, r


@dataclass(frozen=True, slots=True)
class Trial:
    """One frame. `truth` and `bound_px2` (3, 3) are None where there is no ball."""

    seed: int  # of scene, noise and guess
    image: Image
    picture: Picture
    truth: Truth | None
    bound_px2: Array | None
    sensor: Sensor
    guess: Circle

    @property
    def sigma_px(self) -> Array:
        """The least that an estimate of x, y, r can scatter, (3,)."""
        assert self.bound_px2 is not None
        return np.asarray(np.sqrt(self.bound_px2.diagonal()))

    def error_px(self, circle: Circle) -> Array:
        assert self.truth is not None
        return np.subtract(circle, self.truth.circle)

    @property
    def noise(self) -> NoiseModel:
        """What a calibrated detector knows of the sensor."""
        return NoiseModel(self.sensor.gain_e_per_dn, self.sensor.read_noise_e, self.sensor.saturation_dn)

    @property
    def view(self) -> View:
        return View(self.picture.lens, self.picture.origin_px)


def trials(category: str, seed: int, count: int, cache: Path | None, advance: Callable[[], object]) -> Iterator[Trial]:
    """Each scene of the category once, with noise and a guess of its own."""
    seeds = [seed * SEEDS + n for n in range(count)]
    for scene_seed, frame in zip(seeds, scenes.frames(category, seeds, cache), strict=True):
        yield _trial(category, scene_seed, frame)
        advance()


def one_trial(category: str, scene_seed: int) -> Trial:
    """A frame that the tables named by its seed."""
    return _trial(category, scene_seed, next(scenes.frames(category, [scene_seed], None, 1)))


def _trial(category: str, scene_seed: int, frame: scenes.Frame) -> Trial:
    expected_dn, truth, bound_px2, sensor = frame
    random = np.random.default_rng((scene_seed, 1))
    image = expose(expected_dn, sensor, random)
    guess = any_guess(random, image) if truth is None else guess_about(random, truth.circle)
    return Trial(scene_seed, image, scenes.scene(category, scene_seed), truth, bound_px2, sensor, guess)


def guess_about(random: np.random.Generator, circle: Circle) -> Circle:
    dx, dy = random.uniform(-OFF_PX, OFF_PX, 2).tolist()
    return circle[0] + dx, circle[1] + dy, circle[2] * random.uniform(1.0 - OFF_R, 1.0 + OFF_R)


def any_guess(random: np.random.Generator, image: Image) -> Circle:
    height, width = image.shape
    return random.uniform(0.0, width), random.uniform(0.0, height), random.uniform(*GUESSED_PX)


def ours(trial: Trial, limb: LimbChoice | None = None) -> Outline:
    """The detector as a calibrated cell calls it: lens and noise are known."""
    return locate(trial.image, trial.guess, trial.noise, view=trial.view, limb=limb)


def timed_trials(seed: int, count: int) -> list[Trial]:
    """Frames of r = 60 with a stem, elsewhere each: for measuring time."""
    random = np.random.default_rng((seed, 2))
    made = []
    for n in range(count):
        circle = (*random.uniform(95.0, 105.0, 2).tolist(), TIMED_R_PX)
        probe_mm = probe_seen_at(circle, RADIUS_MM, LENS, TIMED_ORIGIN_PX)
        stem = Stem(-0.5 * np.pi, 0.4, 120.0)
        picture = Picture((200, 200), LENS, probe_mm, RADIUS_MM, TIMED_ORIGIN_PX, stem=stem)
        image = expose(expected(picture), Sensor(), random)
        made.append(Trial(n, image, picture, truth_of(picture), None, Sensor(), guess_about(random, circle)))
    return made
