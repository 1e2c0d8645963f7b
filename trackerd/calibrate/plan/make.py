"""A plan: where the probe stops, and what every gimbal does there; refused where a gimbal cannot see a place."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from trackerd.calibrate.plan.looks import Eye, looks_at
from trackerd.calibrate.plan.volume import Box, short_tour, well_spread
from trackerd.contract.errors import ConfigError, Degenerate
from trackerd.contract.model import Array
from trackerd.formats.looks import FACES, Errand, Face
from trackerd.formats.mover import CHECK, Stop
from trackerd.geometry.rigid import rotation_about

MOST_TOLD = 5  # places that cannot be seen


@dataclass(frozen=True, slots=True)
class Pace:
    """How long a look takes: the axes go there and come to rest, then so many frames are averaged."""

    frames: int
    frame_rate_hz: float
    settle_s: float = 1.0
    margin_s: float = 2.0  # a stop, for the mover to come to rest

    def dwell_s(self, looks: int) -> float:
        return self.margin_s + looks * (self.settle_s + self.frames / self.frame_rate_hz)


def plan_stops(
    eyes: Sequence[Eye], box: Box, count: int, checks: int, pace: Pace, seed: int = 1, tilt_rad: float | None = None
) -> list[Stop]:
    """`count` stops for the adjustment and `checks` more outside it, in a short tour, each as long as its slowest gimbal.

    `tilt_rad`: a robot turns its tool by up to this about a level axis, so that the ball's place in its flange can be told.
    Raises ConfigError for a volume that a gimbal cannot see all of.
    """
    p_mm = well_spread(box, count + checks, seed)
    is_check = np.arange(len(p_mm)) >= count  # each run of the sequence fills the volume
    order = short_tour(p_mm)
    stops = []
    for number, index in enumerate(order):
        kind = CHECK if is_check[index] else "P"
        turn = None if tilt_rad is None else _tilted(number, len(p_mm), tilt_rad)
        stops.append(Stop(f"{kind}{number + 1:03d}", p_mm[index], 0.0, turn))
    planned = errands(eyes, stops)
    return [replace(errand.stop, dwell_s=round(pace.dwell_s(max(map(len, errand.looks.values()))), 1)) for errand in planned]


def errands(eyes: Sequence[Eye], stops: Sequence[Stop], faces: Sequence[Face] = FACES) -> list[Errand]:
    """What every gimbal does at every stop. Raises ConfigError, a line for each place that one cannot see, and why."""
    found: list[Errand] = []
    refused: list[str] = []
    for turn, stop in enumerate(stops):
        looks = {}
        for eye in eyes:
            try:
                looks[eye.name] = tuple(looks_at(eye, stop.p_mm, turn, faces))
            except Degenerate as error:
                refused.append(f"plan: {stop.name} at {_shown(stop.p_mm)} mm cannot be seen: {error}")
        found.append(Errand(stop, looks))
    if refused:
        if len(refused) > MOST_TOLD:
            refused[MOST_TOLD:] = [f"plan: and {len(refused) - MOST_TOLD} places more: move or shrink the volume"]
        raise ConfigError("\n".join(refused))
    return found


def two_faced(planned: Sequence[Errand], gimbal: str) -> int:
    """At how many stops this gimbal looks in its second face, too."""
    return sum(any(look.face == 2 for look in errand.looks[gimbal]) for errand in planned)


def _tilted(number: int, count: int, tilt_rad: float) -> Array:
    """The tool down, turned about a level axis that goes round, by more and less."""
    about = 2.0 * np.pi * number * 0.381966
    axis = np.array((np.cos(about), np.sin(about), 0.0))
    down = np.diag((1.0, -1.0, -1.0))
    return rotation_about(axis, tilt_rad * np.sqrt((number + 0.5) / count)) @ down


def _shown(p_mm: Array) -> str:
    return f"({', '.join(f'{x:.1f}' for x in p_mm.tolist())})"
