"""Round spots in pictures: where they are, to a fraction of a pixel, by the centre of their light."""

from dataclasses import dataclass

import cv2
import numpy as np

from trackerd.calibrate.corners import noise_of
from trackerd.contract.model import Array, Image

BLUR_PX = 1.0  # before the search: single hot pixels are no spots
GROUND_SHARE = 8  # of the picture's smaller side: the ground's level is taken over windows of this part of it
SEEN = 6.0  # sigmas above the ground
RISE = 0.3  # of the highest rise in the picture: dimmer ones are reflections
FEWEST_PX, MOST_SHARE = 4, 0.02  # of a spot; the upper bound is a share of the picture
ROUNDEST = 0.35  # of the smaller to the larger axis: a dot seen from 70 degrees aside
FULLEST = 0.75  # of a spot's area to that of the ellipse of its moments
FLOOR_PX = 0.01  # of the centre, from rendered pictures
MARGIN_SHARE, MARGIN_PX, FRINGE_PX = 0.1, 2.5, 2  # beyond the spot's edge: its blur belongs to it, another's does not


@dataclass(frozen=True, slots=True)
class Spots:
    q_px: Array  # (n, 2)
    sigma_px: Array  # (n,)
    area_px2: Array  # (n,) by the light, as a spot of even brightness has it

    def __len__(self) -> int:
        return len(self.q_px)


def find_spots(image: Image, dark: bool) -> Spots:
    """All spots of one polarity in `image` (height, width), with those that touch the picture's rim left out."""
    grey = image.astype(np.float32)
    noise_dn = noise_of(grey)
    rise = _above_ground(grey, dark)
    smooth = cv2.GaussianBlur(rise, (0, 0), BLUR_PX)
    level = max(SEEN * noise_dn / 3.0, RISE * float(np.quantile(smooth, 0.9999)))  # the blur takes two thirds of the noise
    count, labels, boxes, _ = cv2.connectedComponentsWithStats((smooth > level).astype(np.uint8), connectivity=8)
    rows = [
        row for n in range(1, count) if _sized(boxes[n], grey.shape) and (row := _measure(rise, labels, n, boxes[n], noise_dn))
    ]
    table = np.array(rows).reshape(-1, 4)
    return Spots(table[:, :2], table[:, 2], table[:, 3])


def _above_ground(grey: Image, dark: bool) -> Image:
    """How much each pixel rises out of the level round it, by a median over windows of a small picture."""
    height, width = grey.shape
    scale = max(1.0, min(height, width) / 128.0)
    small = cv2.resize(grey, (round(width / scale), round(height / scale)), interpolation=cv2.INTER_AREA)
    window = 2 * (min(small.shape) // GROUND_SHARE) + 1
    lowest, highest = float(small.min()), max(float(np.ptp(small)), 1.0)
    levels = np.rint((small - lowest) * (255.0 / highest)).astype(np.uint8)
    ground = cv2.medianBlur(levels, window).astype(np.float32) * (highest / 255.0) + lowest
    wide = cv2.resize(ground, (width, height), interpolation=cv2.INTER_LINEAR)
    return np.asarray(wide - grey if dark else grey - wide)


def _sized(box: Image, shape: tuple[int, ...]) -> bool:
    x, y, width, height, area = (int(v) for v in box)
    inside = x > 0 and y > 0 and x + width < shape[1] and y + height < shape[0]
    return inside and FEWEST_PX <= area <= MOST_SHARE * shape[0] * shape[1]


def _measure(rise: Image, labels: Image, n: int, box: Image, noise_dn: float) -> tuple[float, float, float, float] | None:
    """x, y, sigma, area of a spot; None for what is not round."""
    x, y, width, height, _ = (int(v) for v in box)
    margin = int(np.ceil(MARGIN_SHARE * max(width, height) + MARGIN_PX))
    top, left = max(0, y - margin), max(0, x - margin)
    patch = rise[top : y + height + margin, left : x + width + margin].astype(np.float64)
    mine = labels[top : y + height + margin, left : x + width + margin]
    reach = cv2.dilate((mine == n).astype(np.uint8), cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * margin + 1,) * 2)) > 0
    others = cv2.dilate(((mine != n) & (mine != 0)).astype(np.uint8), np.ones((2 * FRINGE_PX + 1,) * 2, np.uint8)) > 0
    reach &= ~others
    light = np.where(reach, patch - _ground(patch, reach), 0.0)
    if not _is_round(mine == n):
        return None
    total = light.sum()
    if total <= 0.0:
        return None
    v, u = np.mgrid[: patch.shape[0], : patch.shape[1]].astype(np.float64)
    cx, cy = float((light * u).sum() / total), float((light * v).sum() / total)
    lever = np.where(reach, (u - cx) ** 2 + (v - cy) ** 2, 0.0).sum() / 2.0
    plateau = float(np.quantile(patch[mine == n], 0.8))
    return left + cx, top + cy, float(np.hypot(FLOOR_PX, noise_dn * np.sqrt(lever) / total)), float(total / plateau)


def _ground(patch: Array, reach: Image) -> float:
    """Level on the rim of what belongs to the spot."""
    rim = reach & (cv2.erode(reach.astype(np.uint8), np.ones((3, 3), np.uint8), borderValue=0) == 0)
    return float(np.median(patch[rim]))


def _is_round(mask: Image) -> bool:
    v, u = np.nonzero(mask)
    spread = np.cov(np.stack((u, v))) + np.eye(2) / 12.0  # of the pixel itself
    small, large = np.sqrt(np.linalg.eigvalsh(spread))
    return bool(small > ROUNDEST * large and u.size > FULLEST * 4.0 * np.pi * small * large)
