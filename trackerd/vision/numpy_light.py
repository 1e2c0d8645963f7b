"""What NumPy's kernel makes of an edge and of a lamp's light on the rim, from the tables that both kernels share."""

from dataclasses import dataclass

import numpy as np

from trackerd.contract.model import Array
from trackerd.vision.convergence import DAWN, DAWN_END, DAWN_STEPS, PROFILE, TABLE_END, TABLE_STEPS

_EDGE, _BELL = (np.ascontiguousarray(column) for column in PROFILE.T)
_EDGE_RISE, _BELL_RISE = np.diff(_EDGE), np.diff(_BELL)


def profile_at(t: Array) -> tuple[Array, Array]:
    """E(t) and its bell."""
    place = np.minimum(np.maximum((t + TABLE_END) * TABLE_STEPS, 0.0), 2.0 * TABLE_END * TABLE_STEPS)
    index = place.astype(np.intp)
    share = place - index
    return _EDGE.take(index) + share * _EDGE_RISE.take(index), _BELL.take(index) + share * _BELL_RISE.take(index)


@dataclass(frozen=True, slots=True)
class Light:
    """The limb term, (S, n)."""

    level: Array
    rim: Array  # the part of it that goes with the root of the blur
    slope: Array  # its change with the edge's offset


def limb_light(columns: Array, distance: Array, t: Array, sigma: Array, lamp_dn: tuple[Array, Array], r_px: float) -> Light:
    """The lamp's light, of a strength along each sector and towards the camera, (S, 1) each; in columns 4 and 5 its derivatives
    by these."""
    along, towards = lamp_dn
    lit = (along >= 0.0) | (towards <= 0.0)
    dawn = np.where(
        lit, 0.0, np.sqrt(np.maximum(1.0 - towards / np.maximum(np.hypot(along, towards), 1e-9), 0.0) * r_px / sigma)
    )
    root, rise = _dawn_at(t, dawn)
    scale = np.sqrt(2.0 * sigma / r_px) * np.sqrt(1.0 - np.minimum(np.maximum(-distance / (2.0 * r_px), 0.0), 0.5))
    deeper = t + dawn * dawn
    share, bell = profile_at(deeper)
    fade = (sigma / r_px) * (bell - deeper * share)
    rim = towards * scale * root
    columns[:, 4] = share - fade
    columns[:, 5] = scale * root
    columns[:, 5] -= np.where(lit, 0.0, along / np.where(lit, 1.0, towards)) * share
    return Light(
        rim + along * (lit * share - fade),
        rim,
        np.asarray((along * (lit * bell) - towards * scale * rise) / sigma - (along / r_px) * share),
    )


def _dawn_at(t: Array, u: Array) -> tuple[Array, Array]:
    """T(t, u) and its slope by t, t (S, n) and u (S, 1); deeper than the table without the blur."""
    last_row, last_column = len(DAWN) - 2, DAWN.shape[1] - 2
    row = np.minimum(u * DAWN_STEPS, last_row)
    k = row.astype(np.intp)
    rows = DAWN[k[:, 0]] + (row - k)[:, :, None] * (DAWN[k[:, 0] + 1] - DAWN[k[:, 0]])  # (S, n, 2): each sector's own
    place = np.minimum(np.maximum((t + TABLE_END) * DAWN_STEPS, 0.0), last_column)
    i = place.astype(np.intp)
    share = (place - i)[:, :, None]
    sector = np.arange(len(t))[:, None]
    found = rows[sector, i] * (1.0 - share) + rows[sector, i + 1] * share
    depth = np.maximum(-t, 1.0)
    second = 0.125 / (depth * depth)
    deep = (t < -TABLE_END) | (u > DAWN_END)
    root = np.sqrt(depth)
    beyond = root * (1.0 - second) - u
    seen = beyond > 0.0
    rise = -0.5 / root * (1.0 + 3.0 * second)
    return (
        np.where(deep, np.where(seen, beyond, 0.0), found[:, :, 0]),
        np.where(deep, np.where(seen, rise, 0.0), found[:, :, 1]),
    )
