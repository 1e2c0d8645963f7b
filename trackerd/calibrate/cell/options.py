"""What is known beforehand, and how the adjustment goes about it."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np

from trackerd.contract.model import Array

ARCSEC = np.pi / 648_000.0


class Group(StrEnum):
    """Parameters of a station that are freed or held together."""

    POSE = "pose"  # world_from_gimbal
    AXES = "axes"  # eps and d
    HAND_EYE = "hand-eye"  # rg_from_camera
    LENS = "lens"


EVERYTHING = frozenset(Group)


@dataclass(frozen=True, slots=True)
class Priors:
    """1 sigma about the nominal values. They keep nearly degenerate pairs finite; inf: nothing is known."""

    mount_xy_mm: float = 1.0
    mount_z_mm: float = 100.0  # the entrance pupil along the optical axis
    mount_rotation_rad: float = 0.03
    eps_rad: float = 60.0 * ARCSEC
    d_mm: float = 0.2
    f_relative: float = 0.03
    centre_px: float = 30.0
    distortion_at_corner: float = 0.1  # each coefficient's share of the image's half diagonal, there


@dataclass(frozen=True, slots=True)
class Held:
    """An earlier calibration: what `free` does not name keeps to it within its covariance (0: exactly)."""

    parameters: tuple[str, ...]
    covariance: Array  # (p, p)


@dataclass(frozen=True, slots=True)
class Options:
    """How to calibrate.

    `find_axes`: try both orders and all signs of every gimbal, keep the lowest chi-square. `from_nominal`: the nominal poses
    are start values (else they are not looked at). `free`: which groups of which gimbals are adjusted, by name; None: all of
    every gimbal. What is not free keeps to the nominal values within `held` (no `held`: exactly).
    `stand_tilt_rad`: what a stand may turn by about each axis afterwards, 1 sigma: it widens the covariance; no data tell it.
    `distortion`: how many coefficients k1, k2, p1, p2, k3 are free; `more_distortion` frees further ones where chi-square asks.
    """

    priors: Priors = field(default_factory=Priors)
    find_axes: bool = False
    from_nominal: bool = False
    free: Mapping[str, frozenset[Group]] | None = None
    held: Held | None = None
    stand_tilt_rad: float = 0.0
    square_pixels: bool = True
    distortion: int = 1
    more_distortion: bool = True
    reject_sigma: float = 4.5  # of an image point, or of a view's encoder corrections
    worst_chi2_per_dof: float = 1.5  # beyond: refused, unless forced
    force: bool = False
    seed: int = 1  # of the random samples of the robust start
