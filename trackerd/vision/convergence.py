"""What both kernels of the circle fit share: their rules, the profile of an edge, and what comes out."""

from collections.abc import Callable
from dataclasses import dataclass
from math import erfc, exp, pi, sqrt
from typing import NamedTuple, TypeAlias

import numpy as np

from trackerd.contract.model import Array, Image
from trackerd.vision.annulus import Ring
from trackerd.vision.noise import NoiseModel
from trackerd.vision.rays import Circle

SIGMA_RANGE_PX = (0.3, 6.0)
TABLE_END, TABLE_STEPS = 8.0, 128  # of the edge profile, in units of the blur; between the steps a line: good to 2e-6


class Rules(NamedTuple):
    """Of the iteration. An argument of the compiled kernel: what it took from another file would be stale in its cache."""

    steps: float = 10.0
    farthest_px: float = 6.0  # from the start, in x, y and r together
    settled_px: float = 0.01  # each step is a tenth of the one before or less: the rest is far below the noise
    blur_settled: float = 0.05  # of its variance, where it depends on the direction
    least_px2: float = SIGMA_RANGE_PX[0] ** 2  # variance of the blur
    most_px2: float = SIGMA_RANGE_PX[1] ** 2
    blind: float = 1e-4  # of its diagonal: a sector cut off by the image's border does not see both levels
    tukey: float = 4.685  # 95 % efficient for normal errors
    poor_chi2: float = 3.0  # a sector that fits worse than this is played down
    table_end: float = TABLE_END
    table_steps: float = float(TABLE_STEPS)


RULES = Rules()


class Sensor(NamedTuple):
    """A noise model in plain numbers."""

    dn_per_e: float
    floor_dn2: float
    saturated_dn: float


def _profile() -> Array:
    """E(t) and its bell -E'(t), (n, 2), at steps from -TABLE_END on; one more at the end, for the line up to it."""
    t = np.arange(-TABLE_END * TABLE_STEPS, TABLE_END * TABLE_STEPS + 2.0) / TABLE_STEPS
    return np.array([(0.5 * erfc(v / sqrt(2.0)), exp(-0.5 * v * v) / sqrt(2.0 * pi)) for v in t.tolist()])


PROFILE = _profile()


@dataclass(frozen=True, slots=True)
class Sectors:
    """What each sector says, (S,)."""

    contrast_dn: Array  # D_j
    level_dn: Array  # of the middle of the edge
    offset_px: Array  # e_j, from the circle
    information: Array  # 1 / variance of e_j, px^-2
    chi2: Array  # per degree of freedom


@dataclass(frozen=True, slots=True)
class CircleFit:
    x_px: float
    y_px: float
    r_px: float
    sigma_px: float  # blur of the edge, where it is widest
    cov_px2: Array  # (3, 3) of x, y, r
    sectors: Sectors
    weight: Array  # (S,) Tukey's, of the last step
    chi2: float  # median of the sectors'
    clipped: float  # share of the ring's pixels that are saturated
    settled: bool


Blur: TypeAlias = tuple[float, ...]  # variance: (1,) alike all round, or (3,) with its cos and sin of twice the angle (motion)
Converge: TypeAlias = Callable[[Image, Ring, Circle, Blur, NoiseModel], CircleFit | None]
