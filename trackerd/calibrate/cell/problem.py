"""The data of one adjustment in the form that its arithmetic wants: segments of image points of one view and one body."""

from dataclasses import dataclass, replace

import numpy as np

from trackerd.calibrate.cell.observations import Observations
from trackerd.calibrate.cell.state import Indices, Layout, State, layout_of
from trackerd.calibrate.cell.targets import Targets
from trackerd.contract.model import Array

ENOUGH_IN_A_VIEW = 8  # image points, for a start


@dataclass(frozen=True, slots=True)
class Bucket:
    """S segments of up to k image points each; rows beyond the last one are padding. Sorted by station and body.

    `alone`: each is all that its view shows, so that the encoders' corrections are eliminated within it. `own`: each is one
    image point of a point that is not exact, whose columns it carries.
    """

    rows: Indices  # (S, k) into the image points; n: padding
    view: Indices  # (S,)
    station: Indices  # (S,)
    body: Indices  # (S,)
    groups: Indices  # (G,) where another pair of station and body begins
    alone: bool
    own: bool


@dataclass(frozen=True, slots=True)
class Known:
    """What is known beforehand, about `centre`."""

    centre: State
    station: Array  # (23 K, 23 K) information
    ball: Array  # (B,) information of each axis
    count: int  # how many observations they are worth


@dataclass(frozen=True, slots=True)
class Problem:
    observations: Observations
    targets: Targets
    layout: Layout
    known: Known
    square_pixels: bool
    fy_per_fx: Array  # (K,)
    encoder_sigma_rad: Array  # (v,) of both parts
    buckets: tuple[Bucket, ...]
    point_information: Array  # (slots, 3, 3), 0 for a free point

    @property
    def n(self) -> int:
        return len(self.observations.view)

    @property
    def v(self) -> int:
        return len(self.observations.gimbal)


def problem_of(observations: Observations, targets: Targets, known: Known, square_pixels: bool) -> Problem:
    """Points that nothing sees are left out; so are bars with such an end."""
    seen = np.unique(observations.point)
    measured = np.isin(targets.bar_points, seen).all(axis=1)
    targets = replace(
        targets,
        bar_points=targets.bar_points[measured],
        bar_mm=targets.bar_mm[measured],
        bar_sigma_mm=targets.bar_sigma_mm[measured],
    )
    layout = layout_of(len(known.centre.axes), targets, seen)
    covs = targets.cov_mm2[layout.slot >= 0]
    free = targets.free[layout.slot >= 0]
    information = np.zeros_like(covs)
    information[~free] = np.linalg.pinv(covs[~free], hermitian=True)
    return Problem(
        observations=observations,
        targets=targets,
        layout=layout,
        known=known,
        square_pixels=square_pixels,
        fy_per_fx=known.centre.lens[:, 1] / known.centre.lens[:, 0],
        encoder_sigma_rad=np.hypot(observations.encoder_sigma_rad, observations.encoder_fixed_rad),
        buckets=_buckets(observations, targets, layout),
        point_information=information,
    )


def part_of(observations: Observations, rows: Indices) -> Observations:
    """Only some image points, and the views that show them."""
    rows = np.sort(rows)
    views, view = np.unique(observations.view[rows], return_inverse=True)
    return Observations(
        gimbals=observations.gimbals,
        views=tuple(observations.views[v] for v in views),
        gimbal=observations.gimbal[views],
        angles_rad=observations.angles_rad[views],
        encoder_sigma_rad=observations.encoder_sigma_rad[views],
        encoder_fixed_rad=observations.encoder_fixed_rad[views],
        view=view.ravel(),
        point=observations.point[rows],
        q_px=observations.q_px[rows],
        sigma_px=observations.sigma_px[rows],
    )


def thinned(observations: Observations, rows: Indices, most: int) -> Indices:
    """About `most` of some image points, spread over views and in each view: enough for a start."""
    rows = rows[np.argsort(observations.view[rows], kind="stable")]
    if len(rows) <= most:
        return rows
    _, starts, counts = np.unique(observations.view[rows], return_index=True, return_counts=True)
    chosen = np.linspace(0, len(starts) - 1, min(len(starts), max(most // ENOUGH_IN_A_VIEW, 1))).astype(int)
    kept = [
        rows[start + np.unique(np.linspace(0, count - 1, min(int(count), ENOUGH_IN_A_VIEW)).astype(int))]
        for start, count in zip(starts[chosen], counts[chosen], strict=True)
    ]
    return np.concatenate(kept)


def _buckets(observations: Observations, targets: Targets, layout: Layout) -> tuple[Bucket, ...]:
    """Segments of like kind and size together: the size is rounded up to a power of two, or to the largest of its like."""
    n, bodies = len(observations.view), len(targets.bodies)
    segment = observations.view * bodies + targets.body[observations.point]
    order = np.argsort(segment, kind="stable")
    keys, starts, counts = np.unique(segment[order], return_index=True, return_counts=True)
    view, body = keys // bodies, keys % bodies
    inexact = np.maximum.reduceat(layout.slot[observations.point[order]] >= 0, starts)
    own = inexact & (counts == 1)
    alone = (np.bincount(view, minlength=len(observations.gimbal))[view] == 1) & (own | ~inexact)
    kind = np.ceil(np.log2(counts)).astype(int) * 4 + alone * 2 + own
    station = observations.gimbal[view]
    buckets = []
    for of_kind in np.unique(kind):
        mine = np.flatnonzero(kind == of_kind)
        mine = mine[np.lexsort((body[mine], station[mine]))]
        places = starts[mine][:, None] + np.arange(int(counts[mine].max()))
        inside = np.arange(places.shape[1]) < counts[mine][:, None]
        rows = np.where(inside, order[np.where(inside, places, 0)], n)
        pair = station[mine] * bodies + body[mine]
        groups = np.flatnonzero(np.diff(pair, prepend=-1))
        flags = bool(of_kind & 2), bool(of_kind & 1)
        buckets.append(Bucket(rows, view[mine], station[mine], body[mine], groups, *flags))
    return tuple(buckets)
