"""Stacks of pictures of a still scene, by a camera of known gain and read noise: electrons, then rounded grey levels."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

Pixels = npt.NDArray[Any]
Levels = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Sensor:
    gain_e_per_dn: float = 10.0
    read_noise_e: float = 8.0
    bits: int = 8
    black_dn: float = 0.0
    well_e: float = np.inf  # electrons, beyond which only half of the light counts

    @property
    def greatest_dn(self) -> int:
        return int(2**self.bits - 1)

    def expose(self, light_dn: Levels, random: np.random.Generator) -> Pixels:
        photons = random.poisson(light_dn * self.gain_e_per_dn)
        electrons = np.minimum(photons, self.well_e + 0.5 * (photons - self.well_e) if np.isfinite(self.well_e) else np.inf)
        electrons = electrons + self.read_noise_e * random.standard_normal(light_dn.shape)
        grey = np.rint(electrons / self.gain_e_per_dn + self.black_dn)
        return np.clip(grey, 0, self.greatest_dn).astype(np.uint8 if self.bits == 8 else np.uint16)


@dataclass(frozen=True)
class Stack:
    """`frames` pictures of `scene`, or of a ramp from `low` to `high` of the range, with 1 % fixed pattern."""

    sensor: Sensor = Sensor()
    seed: int = 1
    frames: int = 16
    size_px: tuple[int, int] = (160, 120)
    low: float = 0.04
    high: float = 0.8
    flicker: float = 0.01
    drift: float = 0.0
    scene: Callable[[int], Levels] | None = None  # of the frame's number

    def with_(self, **changes: Any) -> "Stack":
        return replace(self, **changes)

    def pictures(self) -> list[Pixels]:
        random = np.random.default_rng(self.seed)
        ramp = self._ramp(random)
        light = 1.0 + self.flicker * random.standard_normal(self.frames) + self.drift * np.linspace(-0.5, 0.5, self.frames)
        scenes = (ramp if self.scene is None else self.scene(n) for n in range(self.frames))
        return [self.sensor.expose(scene * factor, random) for scene, factor in zip(scenes, light, strict=True)]

    def _ramp(self, random: np.random.Generator) -> Levels:
        width, height = self.size_px
        ramp = np.linspace(self.low, self.high, width) * self.sensor.greatest_dn * np.ones((height, 1))
        return np.asarray(ramp * (1.0 + 0.01 * random.standard_normal((height, width))))


def named(pictures: list[Pixels]) -> Callable[[], Iterator[tuple[str, Pixels]]]:
    return lambda: ((f"{n}.png", picture) for n, picture in enumerate(pictures))


def shaking_scene(shake_px: float, seed: int = 1) -> Callable[[int], Levels]:
    """A ball and bars with sharp edges on a wall that is lit from one side; each frame is shifted by `shake_px` (1 sigma)."""
    random = np.random.default_rng(seed)
    fine = 4
    sharp = np.linspace(40.0, 90.0, 240 * fine) * np.ones((180 * fine, 1))
    cv2.circle(sharp, (120 * fine, 90 * fine), 45 * fine, 190.0, -1)
    for left in range(20, 220, 40):
        cv2.rectangle(sharp, (left * fine, 10 * fine), ((left + 8) * fine, 35 * fine), 150.0, -1)
    sharp = cv2.GaussianBlur(sharp, (0, 0), 0.9 * fine)

    def scene(_: int) -> Levels:
        dx, dy = shake_px * fine * random.standard_normal(2)
        moved = cv2.warpAffine(
            sharp, np.array([[1.0, 0.0, dx], [0.0, 1.0, dy]]), None, flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE
        )
        return np.asarray(moved.reshape(180, fine, 240, fine).mean(axis=(1, 3)))

    return scene
