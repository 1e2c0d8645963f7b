"""What both kernels of the circle fit share: their rules, the profile of an edge, and what comes out."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import erfc, exp, pi, sqrt
from typing import NamedTuple, TypeAlias

import numpy as np

from trackerd.contract.model import Array, Image
from trackerd.vision.annulus import Ring
from trackerd.vision.curve import Curve, angles
from trackerd.vision.noise import NoiseModel

SIGMA_RANGE_PX = (0.3, 6.0)
TABLE_END, TABLE_STEPS = 8.0, 64  # of the edge profile, in units of the blur; between the steps a line: good to 2e-6
DAWN_END, DAWN_STEPS = 3.0, 16  # of the table of the limb term; between its steps lines: good to 4e-4
INTEGRAL_STEPS = 240


class Rules(NamedTuple):
    """Of the iteration. An argument of the compiled kernel: what it took from another file would be stale in its cache."""

    steps: float = 40.0
    least_steps: float = 2.0  # the second knows what the sectors' levels have in common, the third the ground's slope
    farthest_px: float = 6.0  # from the start, in x, y and r together
    settled_px: float = 0.01  # each step is a tenth of the one before or less: the rest is far below the noise
    blur_settled: float = 0.05  # of its variance, where it depends on the direction
    least_px2: float = SIGMA_RANGE_PX[0] ** 2  # variance of the blur
    most_px2: float = SIGMA_RANGE_PX[1] ** 2
    blind: float = 1e-4  # of its diagonal: a sector cut off by the image's border does not see both levels
    tukey: float = 4.685  # 95 % efficient for normal errors
    least_spread_dn: float = 0.1  # of the levels from sector to sector
    gradient_noise: float = 1.5  # of their common gradient: what of its square is put down to noise, in units of that
    firmest: float = 1e4  # DN^-2
    stands_out: float = 3.0  # a level farther from the others, in sigmas, is its own
    poor_sigmas: float = 2.0  # a sector whose chi2 is farther above 1 is played down
    no_slope: float = 1e-7  # of the edge's bell: deeper inside a pixel does not see the edge
    farthest_below: float = 6.0  # sigmas: a saturated pixel whose model is farther below is no surer for that
    harmonic_steps: float = 5.0  # with a limb of three harmonics, before a lamp is sought that gives it
    lamp_settled: float = 0.1  # of settled_px: it creeps where the light only grazes the rim
    ambient_spread_dn: float = 0.5  # of the light that comes from everywhere, round the rim of a ball that a lamp shines on
    ambient_spread: float = 0.05  # and this share of the lamp's
    doubted: float = 2.0  # of these spreads: from there on it is rather something else
    spot: float = 4.0  # typical deviations of the levels inside, from which one is a spot's
    least_spot_dn: float = 0.5  # added to those
    beside_spot: float = 4.0  # sectors into which it may shine
    dawn_end: float = DAWN_END
    dawn_steps: float = float(DAWN_STEPS)
    table_end: float = TABLE_END
    table_steps: float = float(TABLE_STEPS)


RULES = Rules()


class Sensor(NamedTuple):
    """A noise model in plain numbers."""

    dn_per_e: float
    floor_dn2: float
    saturated_dn: float
    rounded_dn: float = 0.5  # what is nearer to saturation was rounded up to it


def _profile() -> Array:
    """E(t) and its bell -E'(t), (n, 2), at steps from -TABLE_END on; one more at the end, for the line up to it."""
    t = np.arange(-TABLE_END * TABLE_STEPS, TABLE_END * TABLE_STEPS + 2.0) / TABLE_STEPS
    return np.array([(0.5 * erfc(v / sqrt(2.0)), exp(-0.5 * v * v) / sqrt(2.0 * pi)) for v in t.tolist()])


def _dawn() -> Array:
    """T(t, u) = int_{u^2}^inf (sqrt(v) - u) phi(t + v) dv and its slope by t, (k, n, 2): the root of the depth inside the rim,
    less u and never negative, blurred. Rows for u from 0, columns for t from -TABLE_END, a spare one each for the line."""
    u = np.arange(DAWN_END * DAWN_STEPS + 2.0)[:, None, None] / DAWN_STEPS
    t = (np.arange(2.0 * TABLE_END * DAWN_STEPS + 2.0) / DAWN_STEPS - TABLE_END)[None, :, None]
    step = sqrt(3.0 * TABLE_END) / INTEGRAL_STEPS
    z = (np.arange(INTEGRAL_STEPS) + 0.5) * step  # sqrt(v) = u + z takes the root out of the integral
    depth = t + (u + z) ** 2
    weighted = np.exp(-0.5 * depth * depth) * (2.0 * step / sqrt(2.0 * pi)) * z * (u + z)
    return np.ascontiguousarray(np.stack((weighted.sum(axis=2), -(weighted * depth).sum(axis=2)), axis=2))


PROFILE, DAWN = _profile(), _dawn()


@dataclass(frozen=True, slots=True)
class Sectors:
    """What each sector says, (S,)."""

    contrast_dn: Array  # D_j
    level_dn: Array  # of the middle of the edge
    offset_px: Array  # e_j, from the circle
    information: Array  # 1 / variance of e_j, px^-2
    chi2: Array  # per degree of freedom


@dataclass(frozen=True, slots=True)
class Start:
    """Where an iteration begins, and which of its unknowns are free."""

    x_px: float
    y_px: float
    r_px: float
    blur_px2: tuple[float, ...]  # variance: (1,) alike all round, or (3,) with its cos and sin of twice the angle (motion)
    limb_dn: tuple[float, ...] = ()  # the lamp's x, y and towards the camera; (): no limb term


@dataclass(frozen=True, slots=True)
class CircleFit:
    x_px: float
    y_px: float
    r_px: float
    blur_px2: Array  # as in Start
    limb_dn: Array
    sigma_px: float  # blur of the edge, where it is widest
    cov_px2: Array  # (3, 3) of x, y, r, by the noise of the pixels alone
    limb_cov_dn2: Array  # (3, 3); (0, 0) without a limb term
    sectors: Sectors
    weight: Array  # (S,) Tukey's, of the last step
    chi2: float  # median of the sectors'
    clipped: float  # share of the ring's pixels that are saturated
    settled: bool
    curve: Curve

    @property
    def lit_sectors(self) -> Sectors:
        """The sectors, with the light that the lamp sheds on the rim in their levels."""
        if len(self.limb_dn) == 0:
            return self.sectors
        middle = angles(len(self.weight))
        rim_dn = np.maximum(self.limb_dn[0] * np.cos(middle) + self.limb_dn[1] * np.sin(middle), 0.0)
        return replace(
            self.sectors, contrast_dn=self.sectors.contrast_dn + rim_dn, level_dn=self.sectors.level_dn + 0.5 * rim_dn
        )

    @property
    def outline_px(self) -> Array:
        """The outline's points (S, 2) in the middles of the sectors."""
        middle, radius = angles(len(self.weight)), self.r_px + self.curve.bulge[:, 0]
        return np.column_stack((self.x_px + radius * np.cos(middle), self.y_px + radius * np.sin(middle)))


Converge: TypeAlias = Callable[[Image, Ring, Curve, Start, NoiseModel], CircleFit | None]
