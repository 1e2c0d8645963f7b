"""What a stack of pictures of a still scene tells of each pixel: its level, and how it scatters from one frame to the next.

The light may flicker and drift: every frame is divided by its own factor, and only successive frames are compared. Two passes
over the pictures, one picture in memory at a time; arrays are (height, width), grey values in DN.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import TypeAlias

import cv2
import numpy as np
import numpy.typing as npt

from trackerd.contract.errors import ConfigError, Undetermined
from trackerd.contract.model import Array, Image

Frames: TypeAlias = Callable[[], Iterable[tuple[str, Image]]]  # names and pictures, from the first one at every call
Grey: TypeAlias = npt.NDArray[np.float32]

FEWEST_FRAMES = 8
SMALLEST_PX = 32
BLOCK_PX = (
    8  # means over such blocks tell the light's factor: exact to a few 1e-4, where a pixel's grey levels are whole numbers
)
LEVELS = 64
DARKEST_BLOCK_DN, FULLEST = 5.0, 0.9  # blocks that tell the factor: not near 0, not near saturation
PILE = 10  # pixels that rest on the greatest value: that is where the sensor ends
USUAL = 7.5  # medians of a difference's size: 5 sigmas
GREATEST_FLICKER = 0.2  # beyond it the frames are different scenes


@dataclass(frozen=True, slots=True)
class Levels:
    """The first pass."""

    mean_dn: Array
    factors: Array  # (frames,): the light of each frame, its mean is 1
    step_dn: int  # 16 where 12 bits were stored in the upper bits of 16
    saturation_dn: int | None  # None: not reached
    band: npt.NDArray[np.intp]  # each pixel's level in 0 .. LEVELS - 1

    @property
    def frames(self) -> int:
        return len(self.factors)

    @property
    def rounding_dn2(self) -> float:
        return self.step_dn**2 / 12.0

    @property
    def flicker(self) -> float:
        """Standard deviation of the light's factor from frame to frame, without its drift."""
        return float(np.std(np.diff(self.factors)) / np.sqrt(2.0))

    @property
    def drift(self) -> float:
        """Of the light's factor from the first to the last frame."""
        count = self.frames
        return float(np.polyfit(np.linspace(-0.5, 0.5, count), self.factors, 1)[0])


@dataclass(frozen=True, slots=True)
class Scatter:
    """The second pass."""

    variance_dn2: Array  # half the mean square of successive differences
    change_dn: Array  # mean of the second half of the frames - mean of the first
    last_dn: Grey  # the last difference


def look_at_levels(frames: Frames, progress: Callable[[], None]) -> Levels:
    """Raises Undetermined for frames that are too few, equal or of other light, ConfigError where they differ in size."""
    sums, blocks, top, bits = None, [], _Top(), 0
    for image in _distinct(frames()):
        sums = np.zeros(image.shape) if sums is None else sums
        sums += image
        top.see(image)
        bits |= int(np.bitwise_or.reduce(image, axis=None))
        blocks.append(_block_means(image))
        progress()
    if sums is None or len(blocks) < FEWEST_FRAMES:
        raise Undetermined(f"{len(blocks)} frames: the noise needs at least {FEWEST_FRAMES} of the same still scene")
    mean_dn = sums / len(blocks)
    saturation_dn = top.saturation_dn(bits)
    factors = _factors(np.array(blocks), saturation_dn or np.inf)
    return Levels(mean_dn, factors, bits & -bits, saturation_dn, _bands(mean_dn))


def look_at_scatter(frames: Frames, levels: Levels, progress: Callable[[], None]) -> Scatter:
    """What is common to all pixels of one level in a difference is the light's, and is taken out."""
    halves, squares = np.zeros((2, *levels.mean_dn.shape)), np.zeros(levels.mean_dn.shape)
    last, usual = np.zeros(levels.mean_dn.shape, np.float32), None
    for n, (before, after) in enumerate(pairwise(_scaled(frames, levels))):
        usual = _usual(after - before, levels.band) if usual is None else usual
        last = _without_light(after - before, levels.band, usual)
        squares += np.square(last, dtype=np.float64)
        halves[2 * n // (levels.frames - 1)] += after
        progress()
    pairs = levels.frames - 1
    first = (pairs + 1) // 2
    change = (halves[1] / (pairs - first) - halves[0] / first).astype(np.float32)
    change = _without_light(change, levels.band, _usual(change, levels.band))
    return Scatter(squares / (2.0 * pairs), change.astype(np.float64), last)


def _distinct(pictures: Iterable[tuple[str, Image]]) -> Iterator[Image]:
    """All of one size and depth, and none the copy of the one before."""
    last_name, last = "", None
    for name, image in pictures:
        if last is None and min(image.shape) < SMALLEST_PX:
            raise Undetermined(f"{name}: {_kind(image)}: the noise needs pictures of at least {SMALLEST_PX} x {SMALLEST_PX} px")
        if last is not None and (image.shape, image.dtype) != (last.shape, last.dtype):
            raise ConfigError(f"{name}: {_kind(image)}, but {last_name} is {_kind(last)}: all must be of one camera and region")
        if last is not None and np.array_equal(image, last):
            raise Undetermined(f"{last_name} and {name} {_why_equal(image)}")
        yield image
        last_name, last = name, image.copy()


class _Top:
    """The greatest value, and how many pixels rest on it."""

    def __init__(self) -> None:
        self._value, self._frames, self._seen = -1, 0, np.zeros(0, np.uint32)

    def see(self, image: Image) -> None:
        greatest = int(image.max())
        if greatest > self._value:
            self._value, self._seen = greatest, np.zeros(image.shape, np.uint32)
        self._frames += 1
        self._seen += image == self._value

    def saturation_dn(self, bits: int) -> int | None:
        """The greatest value where it is all ones in the bits that are in use, or where many pixels rest on it."""
        full = self._value in {(2**n - 1) * (bits & -bits) for n in (8, 10, 12, 14, 16)}
        piled = np.count_nonzero(self._seen > 0.5 * self._frames) >= PILE
        return self._value if full or piled else None


def _block_means(image: Image) -> Grey:
    height, width = (side // BLOCK_PX for side in image.shape)
    whole = image[: height * BLOCK_PX, : width * BLOCK_PX].astype(np.float32)
    return np.asarray(cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA), np.float32)


def _factors(blocks: Grey, ceiling_dn: float) -> Array:
    """The light of each frame, (frames,), from block means (frames, rows, columns): the median over blocks, so that what moves
    in a few of them does not count."""
    mean = blocks.mean(axis=0)
    telling = (mean > DARKEST_BLOCK_DN) & (mean < FULLEST * ceiling_dn)
    if not telling.any():
        dark = bool(np.median(mean) <= DARKEST_BLOCK_DN)
        raise Undetermined(
            "the picture is black: raise exposure or light"
            if dark
            else f"the picture is saturated at {ceiling_dn:g} DN: lower exposure, gain or light"
        )
    factors: Array = np.median(blocks[:, telling] / mean[telling], axis=1).astype(np.float64)
    factors /= factors.mean()
    if np.abs(factors - 1.0).max() > GREATEST_FLICKER:
        raise Undetermined(
            f"the light changes from {factors.min():.0%} to {factors.max():.0%} of its mean: all frames must show one scene, "
            "at one exposure and gain"
        )
    return factors


def _bands(mean_dn: Array) -> npt.NDArray[np.intp]:
    low, high = float(mean_dn.min()), float(mean_dn.max())
    return np.minimum((mean_dn - low) * (LEVELS / max(high - low, 1e-9)), LEVELS - 1).astype(np.intp)


def _scaled(frames: Frames, levels: Levels) -> Iterator[Grey]:
    """The frames under the mean of the light."""
    for (_, image), factor in zip(frames(), levels.factors, strict=True):
        yield image.astype(np.float32) / np.float32(factor)


def _usual(difference: Grey, band: npt.NDArray[np.intp]) -> Grey:
    """The most that noise makes of a difference at each level, (LEVELS,), by the median: what moves is more."""
    bands, size = band.ravel(), np.abs(difference).ravel()
    by_level = size[np.lexsort((size, bands))]
    counts = np.bincount(bands, minlength=LEVELS)
    middle = np.minimum(np.cumsum(counts) - counts + counts // 2, bands.size - 1)
    return np.asarray(USUAL * np.maximum(by_level[middle], 0.5), np.float32)


def _without_light(difference: Grey, band: npt.NDArray[np.intp], usual: Grey) -> Grey:
    """Less the mean over the pixels of the same level, where no more than noise is to be seen."""
    counted = np.abs(difference) <= usual[band]
    bands = band[counted]
    counts = np.bincount(bands, minlength=LEVELS)
    shift = np.bincount(bands, difference[counted], minlength=LEVELS) / np.maximum(counts, 1)
    return difference - shift.astype(np.float32)[band]


def _why_equal(image: Image) -> str:
    if image.min() == image.max():
        return f"are {image.min()} DN all over: saturated, black, or no camera's picture"
    return "are identical: not two exposures (a copy, or an emulated camera)"


def _kind(image: Image) -> str:
    return f"{image.shape[1]} x {image.shape[0]} px of {image.dtype.name}"
