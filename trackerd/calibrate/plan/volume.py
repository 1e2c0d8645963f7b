"""The work volume, points that fill it, and a short way through them."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.stats import qmc

from trackerd.contract.model import Array

Indices = npt.NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class Box:
    """A box of W along its axes."""

    low_mm: Array  # (3,)
    high_mm: Array  # (3,)

    @classmethod
    def around(cls, centre_mm: Array, size_mm: Array) -> "Box":
        return cls(centre_mm - size_mm / 2.0, centre_mm + size_mm / 2.0)

    @classmethod
    def of(cls, p_mm: Array) -> "Box":
        """The least one that holds points (n, 3)."""
        return cls(p_mm.min(axis=0), p_mm.max(axis=0))

    @property
    def centre_mm(self) -> Array:
        return (self.low_mm + self.high_mm) / 2.0

    @property
    def size_mm(self) -> Array:
        return self.high_mm - self.low_mm

    def grid(self, steps: int) -> Array:
        """(steps^3, 3), from face to face."""
        axes = [np.linspace(low, high, steps) for low, high in zip(self.low_mm, self.high_mm, strict=True)]
        return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def well_spread(box: Box, count: int, seed: int) -> Array:
    """Points that fill the box, also in depth, whatever their number: a scrambled Halton sequence, (count, 3).

    Its first and last thirds are as well spread as all of it, so that the last points can be check points. The corners, which
    hold an adjustment best, are reached by stretching the points to the faces of the box.
    """
    unit = qmc.Halton(d=3, scramble=True, rng=seed).random(count)
    low, high = unit.min(axis=0), unit.max(axis=0)
    stretched = (unit - low) / np.where(high > low, high - low, 1.0)
    return np.asarray(box.low_mm + stretched * box.size_mm)


def short_tour(p_mm: Array) -> Indices:
    """An order of the points (n, 3) with a short way: the nearest next, then crossings undone (2-opt)."""
    distance = np.linalg.norm(p_mm[:, None] - p_mm[None], axis=2)
    order = [int(np.argmin(p_mm.sum(axis=1)))]
    left = set(range(len(p_mm))) - set(order)
    while left:
        order.append(min(left, key=lambda i: float(distance[order[-1], i])))
        left.remove(order[-1])
    return _uncrossed(np.array(order, np.intp), distance)


def _uncrossed(order: Indices, distance: Array) -> Indices:
    improved = True
    while improved:
        improved = False
        for i in range(1, len(order) - 1):
            ends = np.arange(i + 1, len(order))
            after = np.where(ends + 1 < len(order), distance[order[i], order[np.minimum(ends + 1, len(order) - 1)]], 0.0)
            before = np.where(ends + 1 < len(order), distance[order[ends], order[np.minimum(ends + 1, len(order) - 1)]], 0.0)
            gain = distance[order[i - 1], order[i]] + before - distance[order[i - 1], order[ends]] - after
            best = int(np.argmax(gain))
            if gain[best] > 1e-9:
                order[i : ends[best] + 1] = order[i : ends[best] + 1][::-1].copy()
                improved = True
    return order
