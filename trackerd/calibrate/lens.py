"""Intrinsics of a lens at one zoom setting, from pictures of a board: estimate, covariance, and what they are worth.

Least squares over all views with the poses of the board; gross errors are named and left out, the number of distortion
coefficients is the one that the pictures ask for (Schwarz's BIC).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import log, sqrt
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from trackerd.calibrate.board_kinds import Board, Detected, Detection
from trackerd.calibrate.lens_judgement import cover, judge
from trackerd.calibrate.lens_model import Estimate, Views, jacobian, residuals
from trackerd.calibrate.lens_result import Ladder, LeftOut, LensResult, PictureFit
from trackerd.calibrate.lens_solve import Solved, covariance, pose_correlation, reduced, robust, solve, start
from trackerd.contract.errors import ConfigError, Undetermined
from trackerd.contract.model import Array
from trackerd.geometry.lens import Lens

Mask: TypeAlias = npt.NDArray[np.bool_]

LADDER: dict[int, tuple[int, ...]] = {  # coefficients -> columns of INTRINSICS
    0: (),
    1: (4,),
    2: (4, 5),
    4: (4, 5, 6, 7),
    5: (4, 5, 6, 7, 8),
}  # coefficients -> columns of INTRINSICS
ROUGH = 2  # coefficients while gross errors are looked for
FEWEST_PICTURES, FEWEST_POINTS = 3, 6
RAYLEIGH_MEDIAN = 1.1774  # of a distance whose coordinates have a sigma of 1
REJECT_SIGMAS = 4.5  # chance leaves out 1 corner of 25 000
WORST_PICTURE = 4.0  # times the usual median of a picture's distances: another board, or one that was counted wrongly
FLOOR_PX = 0.02  # of that median: below it, noise-free pictures would reject each other
MOST_REJECTED = 0.2  # of a picture's corners: beyond it the whole picture is doubtful
DISAGREE = 4.0  # sigmas of chi-square: what pictures of a flat board and a true lens never reach
SMALLEST_PULL = 1e-6  # of a picture's covariance of pulls, relative: below it, it tells nothing
ROUNDS = 8


@dataclass(frozen=True, slots=True)
class LensOptions:
    fix_aspect: bool = False  # fx = fy, as square pixels have it
    fix_centre: bool = False  # the principal point stays in the image's middle: for narrow fields, where it cannot be told
    coefficients: int | None = None  # of distortion: 0, 1, 2, 4 or 5; None: as many as the pictures ask for

    def __post_init__(self) -> None:
        if self.coefficients is not None and self.coefficients not in LADDER:
            raise ConfigError(f"coefficients = {self.coefficients}: must be one of {', '.join(map(str, LADDER))}")


@dataclass(frozen=True, slots=True)
class _Data:
    """Pictures that are used, with the points of each that are not rejected."""

    names: tuple[str, ...]
    points: tuple[Detected, ...]
    kept: tuple[Mask, ...]  # bool (k,) each
    left_out: tuple[LeftOut, ...]

    def views(self, board_mm: Array) -> Views:
        pairs = list(zip(self.points, self.kept, strict=True))
        return Views(
            np.concatenate([board_mm[one.index[kept]] for one, kept in pairs]),
            np.concatenate([one.q_px[kept] for one, kept in pairs]),
            np.repeat(np.arange(len(pairs)), [np.count_nonzero(kept) for _, kept in pairs]),
            len(pairs),
        )

    def without(self, reasons: dict[int, str]) -> "_Data":
        stay = [n for n in range(len(self.names)) if n not in reasons]
        gone = tuple(LeftOut(self.names[n], reason) for n, reason in reasons.items())
        names, points, kept = (tuple(group[n] for n in stay) for group in (self.names, self.points, self.kept))
        return _Data(names, points, kept, (*self.left_out, *gone))  # type: ignore[arg-type]


def calibrate_lens(
    detections: Sequence[tuple[str, Detection]],
    board: Board,
    sensor_px: tuple[int, int],
    options: LensOptions = LensOptions(),
) -> LensResult:
    """`detections`: the picture's name and what was found in it. Raises Undetermined where they do not tell the lens."""
    data, rough = _without_wrong_boards(_gather(detections, len(board.points_mm)), board, sensor_px, options)
    data, solved, tried, coefficients = _without_outliers(data, board, rough, options)
    views, free = data.views(board.points_mm), _free(options, coefficients)
    freedom = _freedom(views, free)
    variance_px2 = solved.rss_px2 / freedom
    cov = covariance(solved.normal, free) * variance_px2
    inflation = _inflation(views, solved, free, cov, variance_px2)
    held = np.abs(free).sum(1) == 0.0
    full = free @ (cov * inflation**2) @ free.T
    result = LensResult(
        lens=_lens(solved.estimate, sensor_px),
        covariance=(full + full.T) / 2.0,
        correlation=np.where(held, 0.0, np.abs(free) @ pose_correlation(solved.normal, free, cov)),
        rms_px=sqrt(solved.rss_px2 / len(views.q_px)),
        sigma_px=sqrt(variance_px2),
        freedom=freedom,
        inflation=inflation,
        coefficients=coefficients,
        tried=tried,
        pictures=_fits(data, views, solved.estimate),
        left_out=data.left_out,
        coverage=cover(views.q_px, sensor_px),
        warnings=(),
        views=views,
        residuals_px=residuals(views, solved.estimate),
        estimate=solved.estimate,
    )
    return replace(result, warnings=tuple(judge(result)))


def _gather(detections: Sequence[tuple[str, Detection]], points: int) -> _Data:
    """`points`: of the board."""
    judged = [(name, one, _unfit(one, points)) for name, one in detections]
    found = [(name, one) for name, one, reason in judged if isinstance(one, Detected) and not reason]
    missed = tuple(LeftOut(name, reason) for name, _, reason in judged if reason)
    kept = tuple(np.ones(len(one.index), bool) for _, one in found)
    return _enough(_Data(tuple(name for name, _ in found), tuple(one for _, one in found), kept, missed))


def _unfit(one: Detection, points: int) -> str:
    """Why a picture cannot be used; empty where it can."""
    if not isinstance(one, Detected):
        return one.reason
    if len(one.index) < FEWEST_POINTS:
        return f"{len(one.index)} points, {FEWEST_POINTS} are needed"
    if not np.isfinite(one.q_px).all():
        return "a pixel is no number"
    if one.index.min() < 0 or one.index.max() >= points or len(np.unique(one.index)) < len(one.index):
        return f"its points are not those of a board of {points}"
    return ""


def _enough(data: _Data) -> _Data:
    if len(data.names) >= FEWEST_PICTURES:
        return data
    told = "".join(f"\n  {one.name}: {one.reason}" for one in data.left_out)
    raise Undetermined(f"{len(data.names)} pictures with the board, {FEWEST_PICTURES} are the least, 10 to 20 are good{told}")


def _without_wrong_boards(
    data: _Data, board: Board, sensor_px: tuple[int, int], options: LensOptions
) -> tuple[_Data, Estimate]:
    """Pictures that contradict the others are left out whole, before their corners are looked at one by one."""
    while True:
        views = data.views(board.points_mm)
        rough = _rough(views, sensor_px, options)
        distance = np.linalg.norm(residuals(views, rough), axis=1)
        middle = np.array([np.median(distance[views.view == n]) for n in range(views.count)])
        usual = max(float(np.median(middle)), FLOOR_PX)
        words = "contradicts the other pictures: half of its points are off by more than"
        reasons = {
            int(n): f"{words} {middle[n]:.2f} px, theirs by {usual:.2f} px"
            for n in np.flatnonzero(middle > WORST_PICTURE * usual)
        }
        if not reasons:
            return data, rough
        data = _enough(data.without(reasons))


def _rough(views: Views, sensor_px: tuple[int, int], options: LensOptions) -> Estimate:
    """Released in stages: the focal length, then the rest; gross errors do not pull."""
    first = robust(views, start(views, sensor_px), _free(LensOptions(True, True), 0), rounds=2)
    return robust(views, first, _free(options, min(ROUGH, ROUGH if options.coefficients is None else options.coefficients)))


def _without_outliers(
    data: _Data, board: Board, estimate: Estimate, options: LensOptions
) -> tuple[_Data, Solved, tuple[Ladder, ...], int]:
    """Corner by corner, until no more are found; those that are far off the robust start do not enter the first solution."""
    for turn in range(ROUNDS):
        everything = replace(data, kept=tuple(np.ones(len(one.index), bool) for one in data.points))
        kept = _judged(everything.views(board.points_mm), data.views(board.points_mm), estimate)
        doubtful = {
            n: f"{np.mean(~mask):.0%} of its corners are gross errors"
            for n, mask in enumerate(kept)
            if np.mean(~mask) > MOST_REJECTED
        }
        same = all(np.array_equal(a, b) for a, b in zip(kept, data.kept, strict=True))
        if turn > 0 and same and not doubtful:
            break
        data = _enough(replace(data, kept=kept).without(doubtful))
        stay = [n for n in range(len(kept)) if n not in doubtful]
        begin = Estimate(estimate.intrinsics, estimate.rotation[stay], estimate.translation_mm[stay])
        solved, tried, coefficients = _chosen(data.views(board.points_mm), begin, options)
        estimate = solved.estimate
    return data, solved, tried, coefficients


def _judged(everything: Views, used: Views, estimate: Estimate) -> tuple[Mask, ...]:
    """Of each picture, which corners are within chance; the sigma is the picture's own where that is the larger one."""
    distance = np.linalg.norm(residuals(everything, estimate), axis=1)
    common = max(float(np.median(np.linalg.norm(residuals(used, estimate), axis=1))) / RAYLEIGH_MEDIAN, 1e-9)
    masks = []
    for n in range(everything.count):
        mine = distance[everything.view == n]
        masks.append(mine <= REJECT_SIGMAS * max(common, float(np.median(mine)) / RAYLEIGH_MEDIAN))
    return tuple(masks)


def _chosen(views: Views, estimate: Estimate, options: LensOptions) -> tuple[Solved, tuple[Ladder, ...], int]:
    """The set of coefficients with the lowest BIC; the one that was asked for, where one was."""
    wanted = LADDER if options.coefficients is None else (options.coefficients,)
    solutions, tried = {}, []
    for count in wanted:
        free = _free(options, count)
        begin = replace(estimate, intrinsics=_held(estimate.intrinsics, free))
        solutions[count] = solve(views, begin, free)
        n, rss = 2 * len(views.q_px), max(solutions[count].rss_px2, 1e-18)
        tried.append(Ladder(count, sqrt(rss / len(views.q_px)), n * log(rss / n) + free.shape[1] * log(n)))
    best = min(tried, key=lambda one: one.bic).coefficients
    return solutions[best], tuple(tried), best


def _held(intrinsics: Array, free: Array) -> Array:
    """Coefficients that are not estimated are 0."""
    used = np.abs(free).sum(1) > 0.0
    used[:4] = True
    return np.where(used, intrinsics, 0.0)


def _free(options: LensOptions, coefficients: int) -> Array:
    """(9, p), one column for each combination that is estimated."""
    unit = np.eye(9)
    columns = [unit[0] + unit[1]] if options.fix_aspect else [unit[0], unit[1]]
    columns += [] if options.fix_centre else [unit[2], unit[3]]
    return np.column_stack([*columns, *(unit[n] for n in LADDER[coefficients])])


def _freedom(views: Views, free: Array) -> int:
    freedom = int(2 * len(views.q_px) - free.shape[1] - 6 * views.count)
    if freedom < 1:
        raise Undetermined(f"{len(views.q_px)} points are too few for {free.shape[1]} intrinsics and {views.count} poses")
    return freedom


def _inflation(views: Views, solved: Solved, free: Array, cov: Array, variance_px2: float) -> float:
    """How much less the pictures agree with each other than the corners of one picture do; 1 where chance explains it.

    Each picture pulls at the intrinsics. Its pull has a covariance that its corners tell (less what it shares in the estimate),
    and so a chi-square of known mean. A board that is not flat makes the corners of one picture err together: it pulls harder.
    """
    by_intrinsics, by_pose = jacobian(views, solved.estimate)
    r, scale = residuals(views, solved.estimate), np.sqrt(np.diag(reduced(solved.normal, free)))
    scaled = cov / variance_px2 * np.outer(scale, scale)
    chi2, freedom = 0.0, 0
    for n in range(views.count):
        mine = views.view == n
        ji, jp = (part[mine].reshape(-1, part.shape[2]) for part in (by_intrinsics @ (free / scale), by_pose))
        across = ji - jp @ np.linalg.lstsq(jp, ji, rcond=None)[0]
        own = across.T @ across
        values, vectors = np.linalg.eigh(own - own @ scaled @ own)
        told = values > SMALLEST_PULL * values[-1]
        pull = vectors[:, told].T @ (across.T @ r[mine].ravel())
        chi2 += float((pull**2 / values[told]).sum() / variance_px2)
        freedom += int(np.count_nonzero(told))
    return sqrt(chi2 / freedom) if chi2 > freedom + DISAGREE * sqrt(2.0 * freedom) else 1.0


def _fits(data: _Data, views: Views, estimate: Estimate) -> tuple[PictureFit, ...]:
    rms = _rms_by_view(views, residuals(views, estimate))
    return tuple(
        PictureFit(name, float(rms[n]), int(np.count_nonzero(kept)), tuple(int(i) for i in points.index[~kept]))
        for n, (name, points, kept) in enumerate(zip(data.names, data.points, data.kept, strict=True))
    )


def _rms_by_view(views: Views, r: Array) -> Array:
    counts = np.bincount(views.view, minlength=views.count)
    return np.asarray(np.sqrt(np.bincount(views.view, np.square(r).sum(1), views.count) / counts))


def _lens(estimate: Estimate, sensor_px: tuple[int, int]) -> Lens:
    fx, fy, cx, cy, k1, k2, p1, p2, k3 = estimate.intrinsics.tolist()
    return Lens(sensor_px, fx, fy, cx, cy, (k1, k2, p1, p2, k3))
