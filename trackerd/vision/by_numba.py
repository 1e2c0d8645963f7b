"""The circle fit's iteration in machine code: by_numpy's, eight times as fast, and other threads go on meanwhile.

Needs numba (extra `fast`). Importing this module loads the machine code from numba's cache on disk (0.5 s), or makes it (10 s,
once per installation). Signatures are fixed, so nothing is ever compiled later.
"""

from math import ceil
from typing import Any

import numba
import numpy as np

from trackerd.contract.model import Image
from trackerd.vision import rays
from trackerd.vision.annulus import Ring
from trackerd.vision.compiled import COMMON, fit
from trackerd.vision.compiled_rays import RayRules, first
from trackerd.vision.convergence import DAWN, PROFILE, RULES, CircleFit, Rules, Sectors, Sensor, Start
from trackerd.vision.curve import Curve, View, angles
from trackerd.vision.noise import NoiseModel
from trackerd.vision.rays import Circle


def _compile(pixel: Any) -> None:
    whole, table = numba.types.int32, numba.types.Array(numba.float64, 2, "C", readonly=True)
    fit.compile((  # type: ignore[attr-defined]
        numba.types.Array(pixel, 2, "A", readonly=True, aligned=False),  # a part of an image too, or one not to be written to
        whole[:, ::1], whole[:, ::1], whole[::1], table, table, table, table, numba.types.boolean,
        numba.types.UniTuple(numba.float64, 2), table, numba.types.Array(numba.float64, 3, "C", readonly=True),
        *(numba.types.NamedUniTuple(numba.float64, len(kind._fields), kind) for kind in (Rules, Sensor)),
        numba.float64[::1], numba.int64, numba.int64, numba.float64[:, ::1], numba.float64[:, ::1],
    ))  # fmt: skip


def _compile_first(pixel: Any) -> None:
    table = numba.types.Array(numba.float64, 2, "C", readonly=True)
    drawn = numba.types.Array(numba.int64, 2, "C", readonly=True)
    first.compile((  # type: ignore[attr-defined]
        numba.types.Array(pixel, 2, "A", readonly=True, aligned=False), numba.float64, numba.float64, table,
        numba.types.Array(numba.float64, 1, "C", readonly=True), drawn, drawn,
        numba.types.NamedUniTuple(numba.float64, len(RayRules._fields), RayRules), numba.float64[::1],
    ))  # fmt: skip


for _pixel in (numba.uint8, numba.uint16):
    _compile(_pixel)
    _compile_first(_pixel)
fit.disable_compile()  # type: ignore[attr-defined]
first.disable_compile()  # type: ignore[attr-defined]

WAYS = np.column_stack((np.cos(angles(rays.RAYS)), np.sin(angles(rays.RAYS))))
NO_BULGE = np.zeros(rays.RAYS)


def first_circle(
    image: Image, guess: Circle, noise: NoiseModel, reach_px: float = rays.REACH_PX, view: View | None = None
) -> Circle | None:
    """As rays.first_circle."""
    x, y, r = guess
    least, most = rays.radius_range(r, reach_px)
    nearest = max(1.0, (1.0 - rays.REACH_RATIO) * r - reach_px)
    samples = ceil((1.0 + rays.REACH_RATIO) * r + reach_px + 1.0 - nearest)
    rules = RayRules(
        nearest, float(samples), 1.0 / noise.gain_e_per_dn, noise.floor_dn2, rays.WEAKEST, rays.WEAKEST_SIGMA, least, most,
        rays.NEAR_PX, rays.TUKEY_PX, float(rays.ENOUGH_RAYS),
    )  # fmt: skip
    bulge = None if view is None else rays.bulge_of(view, guess)
    circle = np.empty(3)
    found = first(
        image, x, y, WAYS, NO_BULGE if bulge is None else bulge, rays.TRIPLE_RAYS, rays.TRIPLE_EDGES, rules, circle
    )  # fmt: skip
    return (float(circle[0]), float(circle[1]), float(circle[2])) if found else None


def converge(image: Image, pixels: Ring, curve: Curve, start: Start, noise: NoiseModel) -> CircleFit | None:
    """The best fit near a start. None: it ran away, or the image does not determine a circle."""
    blurs, limbs = len(start.blur_px2), len(start.limb_dn)
    size = 3 + blurs + limbs
    circle = np.array((start.x_px, start.y_px, start.r_px, *start.blur_px2, *start.limb_dn, 0.0, 0.0, 0.0, 0.0))
    cov, said = np.empty((size + COMMON, size + COMMON)), np.empty((6, len(pixels.count)))
    saturated_dn = noise.saturation_of(255 if image.dtype == np.uint8 else 65535)
    sensor = Sensor(1.0 / noise.gain_e_per_dn, noise.floor_dn2, saturated_dn)
    if not fit(
        image, pixels.column, pixels.row, pixels.count, pixels.middle, curve.design, pixels.blur_design, curve.bulge,
        not curve.round, (pixels.inside_px, pixels.outside_px), PROFILE, DAWN, RULES, sensor, circle, blurs, limbs, cov, said,
    ):  # fmt: skip
        return None
    x, y, r = circle[:3].tolist()
    clipped, chi2, sigma, settled = circle[-4:].tolist()
    contrast, level, offset, information, chi2_of, weight = said
    return CircleFit(
        x,
        y,
        r,
        circle[3 : 3 + blurs],
        circle[3 + blurs : size],
        sigma,
        cov[:3, :3],
        cov[3 + blurs : size, 3 + blurs : size],
        Sectors(contrast, level, offset, information, chi2_of),
        weight,
        chi2,
        clipped,
        settled > 0.0,
        curve,
    )
