"""What follows is watched: wiring that changes after the test, an error that grows, and honest targets that do not trip it."""

from itertools import product

import numpy as np
import pytest
from closed_loop import MS, ClosedLoop, circling

from trackerd.contract.clock import HostNs
from trackerd.contract.model import AxisAngles, Missed, TrackState
from trackerd.engine.axes import AxesState
from trackerd.engine.divergence import DivergenceWatch
from trackerd.engine.track import Step

FRAME_NS = 18_181_818
A, J = "twin.path.acceleration_mm_s2", "twin.path.jerk_mm_s3"
PX_PER_RAD = 31_000.0
WIRINGS = [wiring for wiring in product((1, -1), (1, -1), (False, True)) if wiring != (1, 1, False)]
CIRCLE = ("twin.path.kind=circle", "twin.path.radius_mm=150", "twin.path.speed_mm_s=250")


def frames_to_the_hold(loop: ClosedLoop, within_s: float = 2.0) -> int:
    before = len(loop.steps)
    loop.until_state(AxesState.HELD, within_s)
    return len(loop.steps) - before


@pytest.mark.parametrize(("az_sign", "el_sign", "swapped"), WIRINGS)
def test_a_wiring_that_changes_while_following_ends_held(az_sign: int, el_sign: int, swapped: bool) -> None:
    loop = circling()
    loop.run(3.0)
    assert loop.state is AxesState.FOLLOWING
    since_ns = loop.now_ns
    loop.miswire(az_sign, el_sign, swapped)
    assert frames_to_the_hold(loop) <= 6
    loop.run(1.0)
    snapshot = loop.snapshot()
    assert snapshot.reason.startswith("loop diverges: ")
    assert (snapshot.state, snapshot.armed, snapshot.tested) == (AxesState.HELD, False, False)  # although automatic
    assert loop.cycles[-1].fastest_deg_s == 0.0
    assert loop.excursion_deg(since_ns) < 2.0


def test_what_diverged_is_tested_again_before_it_follows() -> None:
    loop = circling()
    loop.run(3.0)
    loop.miswire(az_sign=-1)
    frames_to_the_hold(loop)
    loop.run(0.2)
    loop.show_probe()
    loop.run(0.3)
    loop.axes.arm()
    loop.until(lambda loop: not loop.snapshot().armed, 5.0)
    assert "axis test: az moved the image" in loop.snapshot().reason


def test_a_wiring_that_changes_at_rest_is_noticed_once_the_probe_moves() -> None:
    loop = circling()
    loop.run(2.35)
    assert loop.state is AxesState.FOLLOWING
    loop.miswire(az_sign=-1, el_sign=-1)
    loop.until_state(AxesState.HELD, 2.0)
    assert loop.snapshot().reason.startswith("loop diverges: ")
    assert loop.excursion_deg(2_400 * MS) < 2.0


@pytest.mark.parametrize(
    ("path", "worst_px"),
    [
        ((*CIRCLE, f"{A}=800"), 20.0),
        ((*CIRCLE, f"{A}=950", f"{J}=8000"), 20.0),
        ((*CIRCLE, f"{A}=950", f"{J}=100000"), 25.0),
        (
            (
                "twin.path.kind=random",
                "twin.path.radius_mm=100",
                "twin.path.speed_mm_s=600",
                "twin.path.acceleration_mm_s2=1000",
            ),
            20.0,
        ),
        (("twin.path.kind=raster", "twin.path.radius_mm=60", f"{A}=1000", f"{J}=20000"), 30.0),  # turns round: 2 m/s^2 at once
        ((*CIRCLE, f"{A}=8000", f"{J}=1e6"), 200.0),
    ],
    ids=["circle", "circle-1-m/s2", "circle-1-m/s2-at-once", "random-1-m/s2", "raster-1-m/s2", "circle-8-m/s2"],
)
def test_an_honest_target_is_kept_near_the_middle_and_trips_nothing(path: tuple[str, ...], worst_px: float) -> None:
    loop = circling(*path)
    loop.until_state(AxesState.FOLLOWING)
    loop.run(4.5 - loop.now_ns * 1e-9)
    worst = max(loop.since(2_400 * MS), key=lambda cycle: cycle.off_px)
    accelerations = (float(np.linalg.norm(loop.scene.truth(t * MS)[2])) for t in range(2_400, 4_500, 5))
    print(f"{path}: {worst.off_px:.1f} px at most, accelerations up to {max(accelerations):.0f} mm/s^2")
    assert loop.state is AxesState.FOLLOWING
    assert {step.state for step in loop.steps[10:]} == {TrackState.LOCKED}
    assert worst.off_px < worst_px


class Steps:
    """What a tracker says of a target (px, from the aim) and of angles (px, as they would move the image)."""

    def __init__(self, frames: int = 10) -> None:
        self.watch = DivergenceWatch(frames)
        self.n = 0

    def __call__(self, offset_px: tuple[float, float] | None, turned_px: tuple[float, float] = (0.0, 0.0)) -> str:
        self.n += 1
        az, el = turned_px[0] / PX_PER_RAD, turned_px[1] / PX_PER_RAD
        angles = AxisAngles(az, el, 1e-5, 0.0, None, 0.0, "latch")
        state = TrackState.COASTING if offset_px is None else TrackState.LOCKED
        return self.watch.diverges(
            Step(
                self.n, HostNs(self.n * FRAME_NS), state, Missed("not made here"), None, None, offset_px, angles,
                PX_PER_RAD * np.eye(2), "itself", "",
            )
        )  # fmt: skip


def test_an_error_that_grows_against_the_axes_is_told_after_the_configured_frames() -> None:
    """The axes are too weak for what they chase: no surprise, but no following either."""
    steps = Steps(frames=5)
    told = [steps((20.0 + 4.0 * n, 0.0), (-5.0 * n, 0.0)) for n in range(8)]
    assert told[:5] == [""] * 5
    assert told[5] == "the pixel error grows although the axes move against it"


def test_one_frame_on_which_the_error_shrinks_starts_the_count_again() -> None:
    steps = Steps(frames=3)
    offsets = [20.0, 24.0, 28.0, 27.0, 30.0, 33.0]
    assert [steps((x, 0.0), (-5.0 * n, 0.0)) for n, x in enumerate(offsets)] == [""] * 6


def test_an_error_that_grows_while_the_axes_rest_is_the_targets_own() -> None:
    steps = Steps(frames=3)
    assert [steps((20.0 + 4.0 * n, 0.0)) for n in range(8)] == [""] * 8


def test_small_errors_may_grow() -> None:
    steps = Steps(frames=3)
    assert [steps((1.0 + n, 0.0), (-2.0 * n, 0.0)) for n in range(8)] == [""] * 8


def test_a_loss_right_after_a_suspicion_confirms_it() -> None:
    steps = Steps()
    steps((0.0, 0.0))
    steps((0.0, 0.0))
    assert steps((50.0, 0.0), (-50.0, 0.0)) == ""
    assert steps(None) == "the target was driven out of sight, as if az turned the other way"


def test_a_loss_without_a_suspicion_is_only_a_loss() -> None:
    steps = Steps()
    for n in range(4):
        steps((0.0, 0.0), (60.0 * n, 0.0))
    assert steps(None) == ""
    assert steps((5.0, 0.0), (300.0, 0.0)) == ""


def test_a_frame_missed_in_between_hides_nothing() -> None:
    steps = Steps()
    steps((0.0, 0.0))
    steps((0.0, 0.0))
    assert steps(None) == ""
    assert steps((50.0, 0.0), (-50.0, 0.0)) == ""
    assert steps((100.0, 0.0), (-100.0, 0.0)) == "the image moves as if az turned the other way"


def test_a_target_that_starts_with_a_jerk_is_believed_after_two_frames() -> None:
    """Neither wiring explains it: the axes were at rest."""
    steps = Steps()
    assert [steps((40.0 * n, 0.0)) for n in (0, 0, 0, 1, 2, 3, 4)] == [""] * 7


def test_after_a_gap_nothing_is_compared() -> None:
    steps = Steps()
    steps((0.0, 0.0))
    steps((0.0, 0.0))
    steps.n += 20
    assert steps((150.0, 0.0), (-150.0, 0.0)) == ""
    assert steps((150.0, 0.0), (-150.0, 0.0)) == ""


@pytest.mark.parametrize("offset_px", [(30.0, 10.0), (-30.0, 40.0)])
def test_the_wiring_is_named(offset_px: tuple[float, float]) -> None:
    x, y = offset_px
    steps = Steps()
    told = [steps((0.0, 0.0)), steps((0.0, 0.0)), *(steps((n * x, n * y), (n * y, n * x)) for n in (1, 2))]
    assert told[-1] == "the image moves as if az and el were exchanged"
