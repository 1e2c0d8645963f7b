"""The circle fit's iteration in machine code: by_numpy's, eight times as fast, and other threads go on meanwhile.

Needs numba (extra `fast`). Importing this module loads the machine code from numba's cache on disk (0.5 s), or makes it (10 s,
once per installation). Signatures are fixed, so nothing is ever compiled later.
"""

from typing import Any

import numba
import numpy as np

from trackerd.contract.model import Image
from trackerd.vision.annulus import Ring
from trackerd.vision.compiled import fit
from trackerd.vision.convergence import PROFILE, RULES, Blur, CircleFit, Rules, Sectors, Sensor
from trackerd.vision.noise import NoiseModel
from trackerd.vision.rays import Circle


def _compile(pixel: Any) -> None:
    whole, table = numba.types.int32, numba.types.Array(numba.float64, 2, "C", readonly=True)
    fit.compile((  # type: ignore[attr-defined]
        numba.types.Array(pixel, 2, "A", readonly=True, aligned=False),  # a part of an image too, or one not to be written to
        whole[:, ::1], whole[:, ::1], whole[::1], table, table, table,
        *(numba.types.NamedUniTuple(numba.float64, len(kind._fields), kind) for kind in (Rules, Sensor)),
        numba.float64[::1], numba.float64[:, ::1], numba.float64[:, ::1],
    ))  # fmt: skip


for _pixel in (numba.uint8, numba.uint16):
    _compile(_pixel)
fit.disable_compile()  # type: ignore[attr-defined]


def converge(image: Image, pixels: Ring, start: Circle, blur_px2: Blur, noise: NoiseModel) -> CircleFit | None:
    """The best fit near a start. None: it ran away, or the image does not determine a circle."""
    circle = np.array((*start, *blur_px2, 0.0, 0.0, 0.0, 0.0))
    cov, said = np.empty((3, 3)), np.empty((6, len(pixels.count)))
    saturated_dn = noise.saturation_of(255 if image.dtype == np.uint8 else 65535)
    sensor = Sensor(1.0 / noise.gain_e_per_dn, noise.floor_dn2, saturated_dn)
    if not fit(
        image, pixels.column, pixels.row, pixels.count, pixels.design, pixels.blur_design, PROFILE, RULES,
        sensor, circle, cov, said,
    ):  # fmt: skip
        return None
    x, y, r, *_, clipped, chi2, sigma, settled = circle.tolist()
    contrast, level, offset, information, chi2_of, weight = said
    sectors = Sectors(contrast, level, offset, information, chi2_of)
    return CircleFit(x, y, r, sigma, cov, sectors, weight, chi2, clipped, settled > 0.0)
