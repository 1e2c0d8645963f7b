"""Which pixels of a stack may tell the noise: neither clipped nor on an edge nor hot, and nothing moves there."""

from collections.abc import Iterator
from dataclasses import dataclass
from math import sqrt
from typing import TypeAlias

import cv2
import numpy as np
import numpy.typing as npt

from trackerd.calibrate.still_frames import Levels, Scatter
from trackerd.contract.errors import Undetermined
from trackerd.contract.model import Array

Mask: TypeAlias = npt.NDArray[np.bool_]

CLIPPED = 5.0  # sigmas from black and from saturation: nearer, a part of the noise is cut off
MOST_ROUNDED_DN = 0.4  # sigma, in steps: below it rounding is no noise of 1/12 (at 0.4 it is 0.06 % off, at 0.3 1.6 %)
STEEP, FEWEST_STEEP = 3.0, 50  # sigmas of a pixel's noise per px, and pixels: they show how the picture shakes
SHAKE_SEEN = 3.0  # sigmas
LEAST_SHAKE_PX, MOST_SHAKE_PX = (
    0.02,
    0.3,
)  # what vibration is always allowed for, and what is none any more: it shows as movement
MOST_SHAKEN = 0.01  # of the variance, by shake on an edge
SINGULAR = 6.0  # sigmas off the pixels round it: hot, stuck or under dust
HOT = 5.2  # sigmas of its own chi-square: 1 of 10^7 sound pixels
BLOCK_PX = 16
BLOCK_SHARE = 0.25  # of a block's pixels, so that it is judged
RESTLESS, CHANGED = 1.5, 0.5  # of the variance: successive differences, and the two halves of the stack
LOUDEST = 10.0  # no single pixel counts for more variances than this: hot ones are told one by one
MOST_MOVING = 0.05  # of the picture
FEWEST_STILL = 500  # pixels


@dataclass(frozen=True, slots=True)
class Still:
    pixels: Mask  # (height, width)
    shake_px: float  # rms movement of the picture's edges from frame to frame; 0 where it has none to see it by
    notes: tuple[str, ...]  # what was left out because it moves


def still_pixels(levels: Levels, scatter: Scatter, noise_dn2: Array, slack: float) -> Still:
    """`noise_dn2`: the variance that is expected of each pixel, without rounding, known but for the share `slack`.

    Raises Undetermined where too few are left, or where something moves.
    """
    step_dn = levels.step_dn
    variance = np.maximum(noise_dn2, (0.1 * step_dn) ** 2) + step_dn**2 / 12.0
    unclipped = _unclipped(levels, np.sqrt(variance))
    loud = noise_dn2 >= (MOST_ROUNDED_DN * step_dn) ** 2
    slope = _slope(levels.mean_dn)
    rough = (1.0 + slack) * variance
    flat = ~_edges(_shake(levels.frames, scatter, slope, rough, unclipped), slope, variance)
    candidates = unclipped & loud & flat
    moving = _moving(levels.frames, scatter, variance, candidates)
    shake_px = _shake(levels.frames, scatter, slope, rough, unclipped & ~moving)
    sound = _sound(levels, scatter, variance)
    still = candidates & ~moving & sound
    if np.count_nonzero(still) < FEWEST_STILL:
        lost = {
            "clipped at black or saturation": ~unclipped,
            "with a noise below 0.4 grey levels (open the camera's gain, or use more bits)": unclipped & ~loud,
            f"on edges (the picture shakes by {shake_px:.2f} px)": unclipped & loud & ~flat,
            "hot or moving": candidates & ~still,
        }
        told = ", ".join(f"{np.mean(mask):.0%} {what}" for what, mask in lost.items() if mask.any())
        raise Undetermined(
            f"only {np.count_nonzero(still)} pixels of the picture can tell the noise, {FEWEST_STILL} are needed: {told}"
        )
    return Still(still, shake_px, tuple(_notes(moving, shake_px)))


def _notes(moving: Mask, shake_px: float) -> Iterator[str]:
    if moving.any():
        yield f"something moves or changes in {moving.mean():.1%} of the picture: left out"
    if shake_px > MOST_SHAKE_PX:
        yield f"edges move by {shake_px:.1f} px from frame to frame (something moves, or the camera shakes): left out"


def correlation(difference: npt.NDArray[np.float32], pixels: Mask) -> tuple[float, float]:
    """Of neighbouring pixels' noise, along x and y together, and its sigma where there is none."""
    total, squares, pairs = 0.0, 0.0, 0
    for turned, mask in ((difference, pixels), (difference.T, pixels.T)):
        both = mask[:-1] & mask[1:]
        one, other = turned[:-1][both].astype(np.float64), turned[1:][both].astype(np.float64)
        total += float(one @ other)
        squares += sqrt(float(one @ one) * float(other @ other))
        pairs += len(one)
    return (total / squares, 1.0 / sqrt(pairs)) if squares else (0.0, 1.0)


def freedom_of(frames: int) -> float:
    """Of a chi-square that varies as one pixel's mean square of successive differences, which share frames: of K - 1 of them
    the relative variance is (3 K - 4) / (K - 1)^2 (von Neumann et al., The mean square successive difference, 1941)."""
    return 2.0 * (frames - 1.0) ** 2 / (3.0 * frames - 4.0)


def median_of_mean(frames: int) -> float:
    """Median over mean of the variances that many like pixels show (Wilson and Hilferty's chi-square)."""
    return (1.0 - 2.0 / (9.0 * freedom_of(frames))) ** 3


def _unclipped(levels: Levels, sigma_dn: Array) -> Mask:
    inside = levels.mean_dn > CLIPPED * sigma_dn
    if levels.saturation_dn is not None:
        inside &= levels.mean_dn < levels.saturation_dn - CLIPPED * sigma_dn
    return np.asarray(inside)


def _slope(mean_dn: Array) -> Array:
    """Of the levels, DN/px, in the picture smoothed over about a pixel, where single pixels that differ do not count."""
    smooth = cv2.GaussianBlur(mean_dn.astype(np.float32), (0, 0), 1.0)
    along = [cv2.Sobel(smooth, cv2.CV_32F, x, y, ksize=3, scale=0.125) for x, y in ((1, 0), (0, 1))]
    return np.hypot(*along).astype(np.float64)


def _shake(frames: int, scatter: Scatter, slope: Array, variance: Array, unclipped: Mask) -> float:
    """What makes steep pixels scatter more than the others."""
    steep = unclipped & (slope > STEEP * np.sqrt(variance))
    if np.count_nonzero(steep) < FEWEST_STEEP:
        return 0.0
    worth_px2 = 2.0 * variance[steep] / np.square(slope[steep])  # of a variance that is twice the noise
    excess = scatter.variance_dn2[steep] / median_of_mean(frames) / variance[steep] - 1.0
    shake_px2 = float(np.median(excess * worth_px2))
    sigma_px2 = 1.25 * sqrt(2.0 / freedom_of(frames) / np.count_nonzero(steep)) * float(np.median(worth_px2))
    return sqrt(shake_px2) if shake_px2 > SHAKE_SEEN * sigma_px2 else 0.0


def _edges(shake_px: float, slope: Array, variance: Array) -> Mask:
    """Pixels whose level changes too much as the picture shakes, and those round them."""
    steep = 0.5 * (np.clip(shake_px, LEAST_SHAKE_PX, MOST_SHAKE_PX) * slope) ** 2 > MOST_SHAKEN * variance
    return np.asarray(cv2.dilate(steep.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0)


def _sound(levels: Levels, scatter: Scatter, variance: Array) -> Mask:
    """Neither singular among their neighbours nor louder than chance allows (Wilson and Hilferty's chi-square)."""
    mean = levels.mean_dn.astype(np.float32)
    alike = np.abs(mean - cv2.medianBlur(mean, 5)) < SINGULAR * np.sqrt(variance)
    freedom = freedom_of(levels.frames)
    greatest = (1.0 - 2.0 / (9.0 * freedom) + HOT * sqrt(2.0 / (9.0 * freedom))) ** 3
    return np.asarray(alike & (scatter.variance_dn2 < greatest * variance))


def _moving(frames: int, scatter: Scatter, variance: Array, candidates: Mask) -> Mask:
    """Blocks that scatter, or change over the stack, more than noise does. Raises Undetermined where they are many."""
    restless = np.minimum(scatter.variance_dn2 / variance, LOUDEST)
    changed = np.minimum(np.square(scatter.change_dn) / variance, LOUDEST)
    by_noise = 4.0 / (frames - 1.0)  # of the difference of two means over half the frames each
    share, restless_of, changed_of = (_blocks(row * candidates) for row in (np.ones_like(variance), restless, changed))
    judged = share > BLOCK_SHARE
    share = np.maximum(share, BLOCK_SHARE)
    moving = judged & ((restless_of / share > RESTLESS) | (changed_of / share - by_noise > CHANGED))
    if moving.sum() > MOST_MOVING * judged.sum():
        raise Undetermined(f"the scene is not still: {_where(moving)}: fix camera and scene, and shield what moves")
    wide = cv2.dilate(moving.astype(np.uint8), np.ones((3, 3), np.uint8))
    whole = np.kron(wide, np.ones((BLOCK_PX, BLOCK_PX), np.uint8)) > 0
    return np.asarray(whole[: variance.shape[0], : variance.shape[1]])


def _blocks(values: Array) -> Array:
    """Means over blocks; those at the right and lower edge are filled up with zeros."""
    height, width = (-(-side // BLOCK_PX) for side in values.shape)
    whole = np.zeros((height * BLOCK_PX, width * BLOCK_PX))
    whole[: values.shape[0], : values.shape[1]] = values
    return np.asarray(whole.reshape(height, BLOCK_PX, width, BLOCK_PX).mean(axis=(1, 3)))


def _where(moving: Mask) -> str:
    rows, columns = np.nonzero(moving)
    (left, right), (top, bottom) = ((part.min() * BLOCK_PX, (part.max() + 1) * BLOCK_PX - 1) for part in (columns, rows))
    return f"{moving.mean():.0%} of it moves or changes, within x {left} to {right}, y {top} to {bottom} px"
