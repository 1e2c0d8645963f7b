"""The circle fit's iteration in machine code: by_numpy's, eight times as fast, and other threads go on meanwhile.

Needs numba (extra `fast`). Importing this module loads the machine code from a cache on disk (0.5 s), or makes it (half a
minute, once per installation). Signatures are fixed, so nothing is ever compiled later.
"""

from math import ceil
from typing import Any

import numba
import numpy as np

from trackerd.contract.model import Image
from trackerd.vision import rays
from trackerd.vision.annulus import Ring
from trackerd.vision.compiled import COMMON, fit, gather
from trackerd.vision.compiled_rays import RayRules, first, strengths
from trackerd.vision.convergence import DAWN, PROFILE, RULES, CircleFit, Rules, Sectors, Sensor, Start
from trackerd.vision.curve import Curve, View, angles
from trackerd.vision.noise import NoiseModel
from trackerd.vision.rays import Circle


def _compile() -> None:
    whole, row, table = numba.types.int32, numba.float64[::1], numba.types.Array(numba.float64, 2, "C", readonly=True)
    for pixel in (numba.uint8, numba.uint16):
        image = numba.types.Array(
            pixel, 2, "A", readonly=True, aligned=False
        )  # a part of one, or one not to be written to, too
        ring = (whole[:, ::1], whole[:, ::1], whole[::1])
        span = numba.types.UniTuple(numba.float64, 2)
        gather.compile((image, *ring, numba.int64, numba.int64, row, table, table, numba.types.boolean, span))  # type: ignore[attr-defined]
        strengths.compile((image, numba.float64, numba.float64, table, numba.float64[:, ::1], RAY_RULES))  # type: ignore[attr-defined]
    fit.compile((  # type: ignore[attr-defined]
        numba.float32[:, :, ::1], whole[::1], table, table, table, table, numba.types.boolean, table,
        numba.types.Array(numba.float64, 3, "C", readonly=True), _values(Rules), _values(Sensor),
        row, numba.int64, numba.int64, numba.float64[:, ::1], numba.float64[:, ::1],
    ))  # fmt: skip
    drawn = numba.types.Array(numba.int64, 2, "C", readonly=True)
    first.compile((  # type: ignore[attr-defined]
        numba.float64[:, ::1], numba.float64, numba.float64, numba.float64, table,
        numba.types.Array(numba.float64, 1, "C", readonly=True), drawn, drawn, RAY_RULES, row,
    ))  # fmt: skip
    compiled: tuple[Any, ...] = gather, strengths, fit, first
    for function in compiled:
        function.disable_compile()


def _values(kind: Any) -> Any:
    """Of a named tuple of floats."""
    return numba.types.NamedUniTuple(numba.float64, len(kind._fields), kind)


RAY_RULES = _values(RayRules)
_compile()

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
    circle, strength = np.empty(3), np.empty((rays.RAYS, samples))
    floor_dn = strengths(image, x, y, WAYS, strength, rules)
    found = first(
        strength, floor_dn, x, y, WAYS, NO_BULGE if bulge is None else bulge, rays.TRIPLE_RAYS, rays.TRIPLE_EDGES, rules, circle
    )
    return (float(circle[0]), float(circle[1]), float(circle[2])) if found else None


def converge(image: Image, pixels: Ring, curve: Curve, start: Start, noise: NoiseModel) -> CircleFit | None:
    """The best fit near a start. None: it ran away, or the image does not determine a circle."""
    blurs, limbs = len(start.blur_px2), len(start.limb_dn)
    size = 3 + blurs + limbs
    column, row = round(start.x_px), round(start.y_px)
    circle = np.array((start.x_px - column, start.y_px - row, start.r_px, *start.blur_px2, *start.limb_dn, 0.0, 0.0, 0.0, 0.0))
    cov, said = np.empty((size + COMMON, size + COMMON)), np.empty((6, len(pixels.count)))
    saturated_dn = noise.saturation_of(255 if image.dtype == np.uint8 else 65535)
    sensor = Sensor(1.0 / noise.gain_e_per_dn, noise.floor_dn2, saturated_dn)
    seen, inside = gather(
        image, pixels.column, pixels.row, pixels.count, column, row, circle, pixels.middle, curve.bulge, not curve.round,
        (float(pixels.inside_px), float(pixels.outside_px)),
    )  # fmt: skip
    if not fit(
        seen, inside, pixels.middle, curve.design, pixels.blur_design, curve.bulge, not curve.round, PROFILE, DAWN, RULES,
        sensor, circle, blurs, limbs, cov, said,
    ):  # fmt: skip
        return None
    x, y, r = circle[:3].tolist()
    clipped, chi2, sigma, settled = circle[-4:].tolist()
    contrast, level, offset, information, chi2_of, weight = said
    return CircleFit(
        column + x,
        row + y,
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
