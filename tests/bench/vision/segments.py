"""What may happen before a tracker within some seconds: a target that moves, hides and jumps, a second ball, clutter, holes.

Frames are composed from a bank that is rendered once. A ball of another look may pass in front of the target. One of the same
look stays, passes beside it or behind it. What no image can tell is not played: a ball of the same look that passes in front
and hides the target, that is where the target is when this hides or jumps, or that is seen for the first time meanwhile.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from math import hypot, sin
from typing import Literal

import numpy as np
from stage import LENS, RADIUS_MM, Circle, Light, Noise, Sprite, backdrop, compose, door, sprite

from trackerd.contract.model import Image
from trackerd.sim.ball import Surface
from trackerd.sim.picture import Background, Picture, Stem, probe_seen_at

SIZE_PX = (640, 480)
FRAMES = 500  # of a segment: 4.5 s at 110 frames a second
BACKDROPS, LOOKS, PHASES = 16, 10, 3
THINGS, HOLES = 10, 2  # of clutter on a backdrop, and how many of it at most are round
RADII_PX = 24.0, 64.0
STEM_PX = 620.0  # longer than any way to the image's border
FASTEST_PX = 25.0  # per frame
VISIBLE, HIDDEN = (20, 160), (1, 41)  # frames between two spells, and of a spell
BESIDE_PX = 15.0  # nearer outlines are within the reach of one gate
SLIDE = 5  # frames in which a door comes and goes
SECOND = {"none": 0.3, "equal, still": 0.2, "equal, moving": 0.25, "another": 0.25}  # share of the segments
JUMPING = 0.25  # share of the segments in which the target jumps once
JUMP_PX = 100.0, 260.0

Random = np.random.Generator
Situation = Literal["clear", "second ball near", "hidden"]


@dataclass(frozen=True, slots=True)
class Bank:
    """Rendered once, used over and over."""

    backdrops: list[Light]
    looks: list[list[Sprite]]  # of one ball, at several fractions of a pixel, about (0, 0)


@dataclass(frozen=True, slots=True)
class Seen:
    """One frame and what is true of it. `image` is reused three frames later."""

    image: Image
    target: Circle
    other: Circle | None
    situation: Situation


def make_bank(seed: int) -> Bank:
    random = np.random.default_rng((seed, 4))
    return Bank(
        [backdrop(random, SIZE_PX, THINGS, int(random.integers(0, HOLES + 1))) for _ in range(BACKDROPS)],
        [_look(random, stem=n % 2 == 1) for n in range(LOOKS)],
    )


@dataclass(frozen=True, slots=True)
class _Path:
    """Two sines in x and two in y, in px; a jump at one frame."""

    amplitude_px: np.ndarray
    turn_rad: np.ndarray  # per frame
    phase_rad: np.ndarray
    jump_at: int
    jump_px: tuple[float, float]

    def at(self, n: int) -> tuple[float, float]:
        x, y = (self.amplitude_px * np.sin(self.turn_rad * n + self.phase_rad)).sum(axis=1).tolist()
        dx, dy = self.jump_px if n >= self.jump_at else (0.0, 0.0)
        return _within(0.5 * SIZE_PX[0] + x + dx, SIZE_PX[0]), _within(0.5 * SIZE_PX[1] + y + dy, SIZE_PX[1])


class Segment:
    """One target from its selection on. Everything follows from the seed."""

    def __init__(self, seed: int, bank: Bank) -> None:
        random = np.random.default_rng((seed, 5))
        self._backdrop = bank.backdrops[random.integers(BACKDROPS)]
        look, other = random.permutation(LOOKS)[:2]
        self._look = bank.looks[look]
        self.second = str(random.choice(list(SECOND), p=list(SECOND.values())))
        self._other = None if self.second == "none" else bank.looks[other if self.second == "another" else look]
        self._is_equal = self.second.startswith("equal")
        self._in_front = self.second == "another" and random.random() < 0.5
        self._path = _path(random, FASTEST_PX, random.random() < JUMPING)
        self._other_path = self._other_way(random)
        self._hidden = self._fair(_spells(random))
        self._behind_door = random.random(FRAMES) < 0.5
        self._door = door(random, 2.6 * self._look[0].circle[2] + 60.0, random.uniform(20.0, 180.0))
        self._phases = random.integers(0, PHASES, (FRAMES, 2))

    def frames(self, noise: Noise) -> Iterator[Seen]:
        canvas = np.empty((SIZE_PX[1], SIZE_PX[0]), np.float32)
        images = [np.empty(canvas.shape, np.uint8) for _ in range(3)]
        for n in range(FRAMES):
            target = _put(self._look[self._phases[n, 0]], self._path.at(n))
            other = None if self._other is None else _put(self._other[self._phases[n, 1]], self._other_path.at(n))
            light = compose(self._backdrop, self._layers(n, target, other), canvas)
            circle = None if other is None else other.circle
            yield Seen(noise.expose(light, images[n % 3]), target.circle, circle, self._situation(n, target, other))

    def _layers(self, n: int, target: Sprite, other: Sprite | None) -> list[Sprite]:
        """From the back to the front. A ball of the same look is never hidden by the door: only the target is."""
        layers = [] if self._is_gone(n) else [target]
        slide = self._slide(n)
        if slide < 1.0:
            x, y, _ = target.circle
            layers.append(_put(self._door, (x + slide * self._door.light.shape[1], y)))
        if other is None:
            return layers
        over_door = self._is_equal and slide < 1.0
        return [*layers, other] if self._in_front or over_door else [other, *layers]

    def _situation(self, n: int, target: Sprite, other: Sprite | None) -> Situation:
        if self._hidden[n] or self._slide(n) < 1.0:
            return "hidden"
        if other is not None and _apart(target.circle, other.circle) < target.circle[2] + other.circle[2] + BESIDE_PX:
            return "second ball near"
        return "clear"

    def _is_gone(self, n: int) -> bool:
        """Hidden without anything to be seen in front of it."""
        return bool(self._hidden[n]) and not self._behind_door[self._hidden[n]]

    def _slide(self, n: int) -> float:
        """Where the door is: 0 before the ball, 1 out of the way."""
        near = range(max(n - SLIDE, 0), min(n + SLIDE + 1, FRAMES))
        closed = [abs(m - n) for m in near if self._hidden[m] and self._behind_door[self._hidden[m]]]
        return min(closed, default=SLIDE) / SLIDE

    def _fair(self, spells: np.ndarray) -> np.ndarray:
        """Without the spells that begin while a ball of the same look is where the target is."""
        for number in range(1, int(spells.max()) + 1) if self._is_equal else ():
            begin = int(np.argmax(spells == number))
            if any(self._is_near(n) for n in range(max(begin - SLIDE - 1, 0), min(begin + 2, FRAMES))):
                spells[spells == number] = 0
        return spells

    def _is_near(self, n: int) -> bool:
        (x, y), (u, v) = self._path.at(n), self._other_path.at(n)
        return hypot(x - u, y - v) < 2.0 * self._look[0].circle[2] + BESIDE_PX

    def _other_way(self, random: Random) -> _Path:
        """The second ball's path; when the target is first chosen, both are apart."""
        jump_at = self._path.jump_at
        fastest = 1e-9 if self.second == "equal, still" else FASTEST_PX
        while True:
            path = _path(random, fastest, jumps=False)
            x, y = self._path.at(0)
            if hypot(path.at(0)[0] - x, path.at(0)[1] - y) > 2.0 * RADII_PX[1] + 20.0:
                self._other_path = path
                if not (self._is_equal and jump_at < FRAMES and (self._is_near(jump_at - 1) or self._is_near(jump_at))):
                    return path


# ---- what they are made of -------------------------------------------------------------------------------------------


def _look(random: Random, stem: bool) -> list[Sprite]:
    r = random.uniform(*RADII_PX)
    ground, level = random.uniform(40.0, 100.0), random.uniform(120.0, 220.0)
    width, height = round(2.6 * r + 40.0), round(2.6 * r + 40.0 + (STEM_PX if stem else 0.0))
    x, y = 0.5 * width, height - 1.3 * r - 20.0
    bar = Stem(-0.5 * np.pi, random.uniform(0.2, 0.5), random.uniform(40.0, 160.0)) if stem else None
    surface = Surface(level, limb=random.uniform(0.0, 0.15))
    looks = []
    for dx, dy in random.uniform(-0.5, 0.5, (PHASES, 2)).tolist():
        probe_mm = probe_seen_at((x + dx, y + dy, r), RADIUS_MM, LENS)
        picture = Picture((width, height), LENS, probe_mm, RADIUS_MM, surface=surface, background=Background(ground), stem=bar)
        looks.append(sprite(picture).moved(-round(x), -round(y)))
    return looks


def _path(random: Random, fastest_px: float, jumps: bool) -> _Path:
    amplitude = random.uniform(0.2, 1.0, (2, 2)) * ((170.0, 50.0), (110.0, 40.0))
    speed = random.uniform(0.02, 1.0) * fastest_px
    turn = speed / amplitude / 2.0
    turn[:, 1] = np.minimum(turn[:, 1], 0.25)
    way = random.uniform(0.0, 2.0 * np.pi)
    far = random.uniform(*JUMP_PX)
    jump_at = int(random.integers(30, FRAMES)) if jumps else FRAMES
    return _Path(amplitude, turn, random.uniform(0.0, 2.0 * np.pi, (2, 2)), jump_at, (far * np.cos(way), far * sin(way)))


def _spells(random: Random) -> np.ndarray:
    """The number of the spell for each frame; 0 where the target can be seen."""
    spell, n, number = np.zeros(FRAMES, np.int64), int(random.integers(*VISIBLE)), 1
    while n < FRAMES:
        end = n + int(random.integers(*HIDDEN))
        spell[n:end] = number
        n, number = end + int(random.integers(*VISIBLE)), number + 1
    return spell


def _put(one: Sprite, at: tuple[float, float]) -> Sprite:
    return one.moved(round(at[0]), round(at[1]))


def _within(place: float, size: int) -> float:
    """A ball of the greatest radius is wholly in the image."""
    return min(max(place, RADII_PX[1] + 4.0), size - RADII_PX[1] - 4.0)


def _apart(a: Circle, b: Circle) -> float:
    return hypot(a[0] - b[0], a[1] - b[1])
