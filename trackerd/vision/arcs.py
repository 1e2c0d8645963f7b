"""Circles that chains of edge pixels lie on, by the votes of their arcs."""

from collections.abc import Sequence
from math import pi
from typing import Any

import numpy as np
import numpy.typing as npt

from trackerd.vision.rays import Circle

SHORTEST = 12  # pixels of a chain that can tell a circle
SPANS = (4, 8, 16, 32, 64, 128)  # pixels of a chain from the first to the middle one of three points; each is good for a range
SPAN_RADII = (0.8, 3.2)  # of radii: of its own length
NEAR_PX, NEAR_RADII = 1.0, 0.02  # the points half-way between the three lie on the circle to this
STEPS_A_PX = 0.9  # of a chain along a circle, which goes straight or diagonally
CELL = 0.25  # of the radius: votes nearer than this are for one circle
PEAKS = 12  # cells that are looked at
LEAST_VOTES = 0.28  # of a whole circle's: half an outline, with gaps in its edges
SAME = 0.2  # of the radius

Votes = npt.NDArray[np.float32]  # (4, n): x, y, r and share of that circle's outline


def circles_on(chains: Sequence[npt.NDArray[Any]], radius_px: tuple[float, float], most: int) -> list[Circle]:
    """The circles with the most votes, best first, at most `most`. Chains are (n, 1, 2) pixels in order, x and y."""
    chains = [chain for chain in chains if len(chain) >= SHORTEST]
    if not chains:
        return []
    lengths = np.array([len(chain) for chain in chains])
    points = np.concatenate(chains)[:, 0].astype(np.float32)
    x, y = np.ascontiguousarray(points[:, 0]), np.ascontiguousarray(points[:, 1])
    to_end = np.repeat(np.cumsum(lengths), lengths) - np.arange(len(x))
    votes = np.concatenate([_votes(x, y, to_end, span, radius_px) for span in SPANS], axis=1)
    return _peaks(votes, most) if votes.shape[1] else []


def _votes(x: Votes, y: Votes, to_end: npt.NDArray[np.intp], span: int, radius_px: tuple[float, float]) -> Votes:
    """Circles through three points of a chain, `span` pixels apart, that two more points between them agree with."""
    smallest, largest = max(SPAN_RADII[0] * span, radius_px[0]), min(SPAN_RADII[1] * span, radius_px[1])
    step = max(span // 4, 1)
    i = np.arange(0, len(x), step)
    i = i[to_end[i] > 2 * span]
    if smallest >= largest or len(i) == 0:
        return np.zeros((4, 0), np.float32)
    ax, ay = x[i + span] - x[i], y[i + span] - y[i]
    bx, by = x[i + 2 * span] - x[i], y[i + 2 * span] - y[i]
    double = 2.0 * (ax * by - ay * bx)
    double = np.where(np.abs(double) < 1e-3, np.float32(1e-3), double)
    a2, b2 = ax * ax + ay * ay, bx * bx + by * by
    ux, uy = (by * a2 - ay * b2) / double, (ax * b2 - bx * a2) / double
    r = np.sqrt(ux * ux + uy * uy)
    fit = np.flatnonzero((r > smallest) & (r < largest))
    i, r = i[fit], r[fit]
    cx, cy = ux[fit] + x[i], uy[fit] + y[i]
    for between in (span // 2, span + span // 2):
        off = np.sqrt((x[i + between] - cx) ** 2 + (y[i + between] - cy) ** 2) - r
        fit = np.flatnonzero(np.abs(off) < NEAR_PX + NEAR_RADII * r)
        i, cx, cy, r = i[fit], cx[fit], cy[fit], r[fit]
    return np.stack((cx, cy, r, step / (2.0 * pi * STEPS_A_PX * r)))


def _peaks(votes: Votes, most: int) -> list[Circle]:
    """Cells whose size goes with the radius, then the median of the votes near to the fullest."""
    x, y, r, share = votes
    octave = np.round(np.log(r) / CELL)
    cell = CELL * np.exp(octave * CELL)
    key = ((octave * 4096.0 + np.round(x / cell) + 1024.0).astype(np.int64) << 13) + np.round(y / cell).astype(np.int64) + 1024
    _, first, which = np.unique(key, return_index=True, return_inverse=True)
    filled = np.bincount(which, share)
    found: list[tuple[float, Circle]] = []
    for peak in np.argsort(-filled)[:PEAKS]:
        circle: Circle = tuple(votes[:3, first[peak]].tolist())
        if any(_alike(circle, other, CELL) for _, other in found):
            continue
        near = np.zeros(0, np.intp)
        for _ in range(2):
            reach = CELL * circle[2]
            near = np.flatnonzero(
                (np.abs(x - circle[0]) < reach) & (np.abs(y - circle[1]) < reach) & (np.abs(r - circle[2]) < reach)
            )
            if len(near) == 0:
                break
            circle = tuple(np.sort(votes[:3, near], axis=1)[:, len(near) // 2].tolist())
        sum_of_shares = float(share[near].sum())
        if sum_of_shares > LEAST_VOTES and not any(_alike(circle, other, SAME) for _, other in found):
            found.append((sum_of_shares, circle))
    return [circle for _, circle in sorted(found, reverse=True)[:most]]


def _alike(a: Circle, b: Circle, share: float) -> bool:
    reach = share * b[2]
    return abs(a[0] - b[0]) < reach and abs(a[1] - b[1]) < reach and abs(a[2] - b[2]) < reach
