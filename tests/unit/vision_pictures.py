"""Pictures of a ball by brute force (a sharp disc, supersampled and blurred): nothing of the fit's model is in them."""

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
import numpy.typing as npt

from trackerd.vision.noise import NoiseModel

FINE = 5  # subpixels a side
NOISE = NoiseModel(gain_e_per_dn=39.0, read_noise_e=3.0)

Grey = npt.NDArray[np.uint8]


@dataclass(frozen=True)
class Ball:
    x_px: float = 320.3
    y_px: float = 240.6
    r_px: float = 60.0
    contrast_dn: float = 100.0
    background_dn: float = 60.0
    blur_px: float = 0.9
    stem: bool = False
    clutter: bool = False
    size_px: tuple[int, int] = (640, 480)

    @cached_property
    def clean(self) -> npt.NDArray[np.float64]:
        """The picture in grey levels, (height, width), without noise."""
        width, height = self.size_px
        picture = np.full((height, width), self.background_dn)
        if self.clutter:
            self._draw_clutter(picture)
        if self.stem:
            self._draw_stem(picture)
        share = self._share()
        picture += share * (self.background_dn + self.contrast_dn - picture)
        return picture

    def noisy(self, seed: int) -> Grey:
        random = np.random.default_rng(seed)
        sigma = np.sqrt(self.clean / NOISE.gain_e_per_dn + (NOISE.read_noise_e / NOISE.gain_e_per_dn) ** 2)
        return np.clip(np.rint(self.clean + sigma * random.standard_normal(self.clean.shape)), 0, 255).astype(np.uint8)

    def _share(self) -> npt.NDArray[np.float64]:
        """How much of each pixel is ball, seen through the blur."""
        width, height = self.size_px
        reach = int(self.r_px + 6 * self.blur_px) + 3
        x0, y0, side = round(self.x_px) - reach, round(self.y_px) - reach, 2 * reach + 1
        fine = (np.arange(side * FINE) + 0.5) / FINE - 0.5
        distance = np.hypot(fine[None, :] + x0 - self.x_px, fine[:, None] + y0 - self.y_px)
        disc = np.clip((self.r_px - distance) * FINE + 0.5, 0.0, 1.0)
        disc = cv2.GaussianBlur(disc, (0, 0), self.blur_px * FINE)
        coarse = disc.reshape(side, FINE, side, FINE).mean(axis=(1, 3))
        share = np.zeros((height + 2 * side, width + 2 * side))  # a margin, for balls that the image's edge cuts
        left, top = x0 + side, y0 + side
        if 0 <= left <= width + side and 0 <= top <= height + side:
            share[top : top + side, left : left + side] = coarse
        return share[side:-side, side:-side]

    def _draw_stem(self, picture: npt.NDArray[np.float64]) -> None:
        mask = np.zeros_like(picture)
        half = 0.3 * self.r_px
        corner = (round(self.x_px - half), 0), (round(self.x_px + half), round(self.y_px - 0.7 * self.r_px))
        cv2.rectangle(mask, *corner, 1.0, -1)
        mask = cv2.GaussianBlur(mask, (0, 0), self.blur_px)
        picture += mask * (self.background_dn + 0.8 * self.contrast_dn - picture)

    def _draw_clutter(self, picture: npt.NDArray[np.float64]) -> None:
        random = np.random.default_rng(7)
        for _ in range(12):
            x, y = int(random.integers(0, self.size_px[0])), int(random.integers(0, self.size_px[1]))
            w, h = random.integers(5, 80, 2).tolist()
            cv2.rectangle(picture, (x, y), (x + w, y + h), float(random.integers(30, 120)), -1)
        picture[:] = cv2.GaussianBlur(picture, (0, 0), self.blur_px)
