"""What a detector costs, in units that travel: one thread's time over that of a 5x5 Gaussian blur of a 2048x1536 frame.

The blur is timed between the calls, not before them: on a shared machine both slow down together, and it leaves the caches as
cold as the rest of a frame's work would.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from statistics import median
from time import thread_time

import cv2
import numpy as np
from limits import FIT_BLURS
from peers import PEERS, near_guess
from tables import Table
from trials import Trial

from trackerd.vision import by_numpy, fit, kernels
from trackerd.vision.limb import LimbChoice
from trackerd.vision.locate import locate, refine

BLURRED = (1536, 2048)
BLUR_SIGMA_PX = 1.1
JUDGED = "locate, guess off by up to 6 px"  # the limb term is chosen once for a set-up, before
WARM = 3  # calls before the first that is timed

Call = Callable[[], object]


class Yardstick:
    """The blur of a fixed frame."""

    def __init__(self) -> None:
        self._frame = np.random.default_rng(1).integers(0, 255, BLURRED, dtype=np.uint8)
        self._blurred = np.empty_like(self._frame)

    def __call__(self) -> None:
        cv2.GaussianBlur(self._frame, (5, 5), BLUR_SIGMA_PX, dst=self._blurred)

    def ratios(self, calls: Sequence[Call]) -> tuple[list[float], float]:
        """Of the calls, one after the other with a blur after each, and the blur's median in ms."""
        own, blurs = [], []
        for call in calls:
            own.append(_seconds(call))
            blurs.append(_seconds(self))
        blur = median(blurs)
        return [seconds / blur for seconds in own], 1e3 * blur


@dataclass(frozen=True, slots=True)
class Cost:
    median_blurs: float
    p95_blurs: float
    median_us: float


def cost(calls: Sequence[Call], yardstick: Yardstick) -> Cost:
    for call in calls[:WARM]:
        call()
    ratios, blur_ms = yardstick.ratios(calls)
    return Cost(median(ratios), float(np.percentile(ratios, 95)), 1e3 * blur_ms * median(ratios))


def fit_table(frames: Sequence[Trial], yardstick: Yardstick) -> Table:
    """The fit with a guess, by both kernels; frames of r = 60."""
    table = Table("The fit with a guess at r = 60, in blurs; the plain circle unless said", ("median", "95 %", "us"))
    for kernel in _kernels():
        with _used(kernel):
            for name, calls in _ways(frames).items():
                took = cost(calls, yardstick)
                limit = FIT_BLURS[kernel] if name == JUDGED else None
                verdict, told = (limit.verdict(took.median_blurs), limit.told()) if limit else ("", "")
                values = took.median_blurs, took.p95_blurs, took.median_us
                table.add(f"{kernel}: {name}", *values, verdict=verdict, limit=told)
    return table


def peers_table(frames: Sequence[Trial], yardstick: Yardstick) -> Table:
    """Everybody on the same frames of r = 60, in the crop about the guess."""
    table = Table("Time of one frame at r = 60, in blurs", ("median", "95 %", "us"))
    rivals: dict[str, list[Call]] = {"ours": _ways(frames)[JUDGED]}
    for name, peer in PEERS.items():
        rivals[name] = [lambda t=t, peer=peer: near_guess(peer, t.image, t.guess) for t in frames]
    for name, calls in rivals.items():
        took = cost(calls, yardstick)
        table.add(name, took.median_blurs, took.p95_blurs, took.median_us)
    return table


def _ways(frames: Sequence[Trial]) -> dict[str, list[Call]]:
    """How the fit is called: about a guess, about a prediction; a tracker keeps the choice of the limb term, and its view."""
    limb, seen_limb, refined_limb, view = LimbChoice(), LimbChoice(), LimbChoice(), frames[0].view
    seen = [(t, t.truth.circle) for t in frames if t.truth is not None]
    return {
        JUDGED: [lambda t=t: locate(t.image, t.guess, t.noise, limb=limb) for t, _ in seen],
        "locate, limb term to be chosen": [lambda t=t: locate(t.image, t.guess, t.noise) for t, _ in seen],
        "locate, sphere behind a lens": [
            lambda t=t: locate(t.image, t.guess, t.noise, view=view, limb=seen_limb) for t, _ in seen
        ],
        "refine, predicted to 1 px": [
            lambda t=t, p=(x + 0.7, y - 0.7, r): refine(t.image, p, t.noise, limb=refined_limb) for t, (x, y, r) in seen
        ],
    }


def _kernels() -> tuple[str, ...]:
    return ("numpy",) if kernels.name() == "numpy" else (kernels.name(), "numpy")


@contextmanager
def _used(kernel: str) -> Iterator[None]:
    chosen = fit.converge
    if kernel == "numpy":
        fit.converge = lambda: by_numpy.converge
    try:
        yield
    finally:
        fit.converge = chosen


def _seconds(call: Call) -> float:
    begin = thread_time()
    call()
    return thread_time() - begin
