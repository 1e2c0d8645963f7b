"""Category by category, the same images through every detector."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

import numpy as np
from limits import INFLATED, LIMITS, TRUE, Limit, nees_limit, upper_95, worst
from peers import PEERS, near_guess
from score import Score, rms
from tables import Table, marked, number
from trials import Trial, ours

from trackerd.contract.model import Array, Found
from trackerd.geometry.sphere import centre_and_range
from trackerd.vision.sphere import sphere_of

NUDGE_PX = 1e-3
TOLD = 3  # seeds of frames that a reason names
SPHERES = ("wide", "tele")  # the categories in which direction and range have limits of their own


@dataclass(slots=True)
class Directions:
    """Errors of the direction, across it (2), and of the range, each over its bound."""

    across: list[Array] = field(default_factory=list)
    ranges: list[float] = field(default_factory=list)

    def add(self, trial: Trial, outline: Found) -> None:
        assert trial.truth is not None
        assert trial.bound_px2 is not None
        sphere = sphere_of(outline, trial.picture.lens, trial.picture.radius_mm, trial.picture.origin_px)
        axes = _across(trial.truth.direction)
        error = np.append(axes @ (sphere.direction - trial.truth.direction), sphere.range_mm - trial.truth.range_mm)
        slopes = _slopes(trial, axes)
        worth = error / np.sqrt((slopes @ trial.bound_px2 @ slopes.T).diagonal())
        self.across.append(worth[:2])
        self.ranges.append(float(worth[2]))


@dataclass(slots=True)
class Judged:
    """One category: ours, and every peer."""

    category: str
    ours: Score = field(default_factory=Score)
    peers: dict[str, Score] = field(default_factory=lambda: {name: Score() for name in PEERS})
    spheres: Directions = field(default_factory=Directions)

    def measured(self, limit: Limit) -> float:
        return {
            "k": lambda: self.ours.k,
            "p95": lambda: self.ours.p95_px,
            "direction k": lambda: rms(np.array(self.spheres.across)),
            "range k": lambda: rms(np.array(self.spheres.ranges)),
        }[limit.quantity]()

    def verdicts(self) -> dict[str, str]:
        """Of each limit, told in words; a failure is one, too."""
        verdicts = {}
        for limit in LIMITS[self.category]:
            value = self.measured(limit)
            told = limit.told() if limit.quantity in {"k", "p95"} else f"{limit.told()} is {number(value)}"
            verdicts[told] = limit.verdict(value)
        verdicts["NEES/2"] = nees_limit(self.category, self.ours.inflated_share).verdict(self.ours.nees_2)
        return verdicts | {"fails": "MISSED" if self.ours.failures else "stretch"}


def judge(category: str, frames: Iterable[Trial], with_peers: bool) -> Judged:
    judged = Judged(category)
    for trial in frames:
        outline = ours(trial)
        judged.ours.add_outline(trial, outline)
        if category in SPHERES and isinstance(outline, Found):
            judged.spheres.add(trial, outline)
        for name, peer in PEERS.items() if with_peers else ():
            judged.peers[name].add(trial, near_guess(peer, trial.image, trial.guess))
    return judged


# ---- tables ----------------------------------------------------------------------------------------------------------


def ours_table(judged: list[Judged]) -> Table:
    table = Table(
        f"Ours: error over the bound of each frame. NEES/2 {TRUE.told()}, or from {INFLATED.reach[0]:g} where it is told why",
        ("k", "k of r", "bias x", "bias y", "bias r px", "rms px", "95 % px", "fails", "NEES/2", "NEES/3", "inflated"),
    )
    for one in judged:
        score, verdicts = one.ours, one.verdicts()
        table.add(
            one.category,
            *(score.k, score.k_r, *score.bias_px.tolist(), score.rms_px, score.p95_px),
            f"{score.failures}/{score.frames}",
            *(score.nees_2, score.nees_3, f"{100 * score.inflated_share:.0f} %"),
            verdict=worst(list(verdicts.values())),
            limit=", ".join(f"{told} {marked(verdict)}" for told, verdict in verdicts.items()),
        )
    return table


def failures_table(judged: list[Judged]) -> Table:
    table = Table(
        "Failures of all categories: nothing found, or farther off than max(1 px, 8 bounds)", ("fails", "frames", "< %")
    )
    names = ["ours", *(name for name in PEERS if judged[0].peers[name].frames)]
    for name in names:
        scores = [one.ours if name == "ours" else one.peers[name] for one in judged]
        failures, frames = sum(score.failures for score in scores), sum(score.frames for score in scores)
        verdict = ("MISSED" if failures else "met") if name == "ours" else ""
        limit = "0 failures" if name == "ours" else ""
        table.add(name, failures, frames, 100 * upper_95(failures, frames), verdict=verdict, limit=limit)
    return table


def reasons_table(judged: list[Judged]) -> Table:
    table = Table("Why: nothing found, or a covariance larger than the noise says", ("frames", "seeds"))
    for one in judged:
        for reason, seeds in sorted(one.ours.reasons.items()):
            table.add(f"{one.category}: {reason}", len(seeds), ", ".join(map(str, seeds[:TOLD])))
    return table


def peers_tables(judged: list[Judged]) -> list[Table]:
    """k, bias and sigma, failures: a row for each detector, a column for each category."""
    columns = tuple(one.category for one in judged)
    kinds: dict[str, Callable[[Score], float | str]] = {
        "k: rms error over the bound": lambda score: score.k,
        "sigma in px, about the bias": lambda score: score.sigma_px,
        "bias of x, y in px": lambda score: float(np.hypot(*score.bias_px[:2])),
        "bias of r in px": lambda score: float(score.bias_px[2]),
        "failures in %": lambda score: 100.0 * score.failures / max(score.frames, 1),
    }
    tables = []
    for title, value in kinds.items():
        table = Table(f"The same images, {title}", columns)
        table.add("ours", *(value(one.ours) for one in judged))
        for name in PEERS:
            table.add(name, *(value(one.peers[name]) for one in judged))
        tables.append(table)
    return tables


# ---- geometry --------------------------------------------------------------------------------------------------------


def _across(direction: Array) -> Array:
    """Two unit vectors (2, 3) normal to a direction."""
    first = np.cross(direction, (0.0, 1.0, 0.0))
    first /= np.linalg.norm(first)
    return np.array((first, np.cross(direction, first)))


def _slopes(trial: Trial, axes: Array) -> Array:
    """d (direction across, range) / d (x, y, r), (3, 3), at the truth."""
    assert trial.truth is not None
    picture = trial.picture
    place = np.add(trial.truth.circle, (*picture.origin_px, 0.0))
    slopes = np.empty((3, 3))
    for n, nudge in enumerate(NUDGE_PX * np.eye(3)):
        (d1, r1), (d0, r0) = (
            centre_and_range(p[:2], float(p[2]), picture.radius_mm, picture.lens) for p in (place + nudge, place - nudge)
        )
        slopes[:2, n], slopes[2, n] = axes @ (d1 - d0) / (2.0 * NUDGE_PX), (r1 - r0) / (2.0 * NUDGE_PX)
    return slopes
