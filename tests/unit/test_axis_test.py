"""The test of the axes on the whole loop: what it moves, what it accepts, and what it says of what it does not."""

from dataclasses import replace
from itertools import product
from math import radians

import numpy as np
import pytest
from closed_loop import ClosedLoop, quick

from trackerd.contract.clock import HostNs
from trackerd.contract.model import AxisAngles
from trackerd.engine.axes import AxesState
from trackerd.engine.axis_test import AxisTest, Verdict
from trackerd.engine.proof import UNCLEAR_TESTS, Proof
from trackerd.formats.settings import SteeringSettings
from trackerd.geometry.gimbal import Station

STILL = ("twin.path.kind=still", "gimbal.left.tracking.tracker=none")
SLIGHTLY_DEG = 0.25  # a test of 0.2 deg to either side, and no more
WIRINGS = [wiring for wiring in product((1, -1), (1, -1), (False, True)) if wiring != (1, 1, False)]


def wired(az_sign: int, el_sign: int, swapped: bool) -> ClosedLoop:
    error = "twin.error.left"
    return ClosedLoop(
        *STILL, f"{error}.az_sign={az_sign}", f"{error}.el_sign={el_sign}", f"{error}.swapped={str(swapped).lower()}"
    )


def judged(loop: ClosedLoop, within_s: float = 6.0) -> str:
    """Runs until the axes need a person; their reason."""
    loop.until(lambda loop: not loop.snapshot().armed, within_s)
    return loop.snapshot().reason


def test_it_moves_each_axis_by_the_test_angle_and_slowly() -> None:
    loop = ClosedLoop(*STILL)
    loop.until_state(AxesState.FOLLOWING)
    testing = [cycle for cycle in loop.cycles if cycle.state is AxesState.TESTING]
    assert max(cycle.fastest_deg_s for cycle in loop.cycles) <= 1.0
    for axis in (0, 1):
        turned = [cycle.turned_deg[axis] for cycle in testing]
        assert (min(turned), max(turned)) == pytest.approx((-0.2, 0.2), abs=0.005)


def test_it_keeps_to_the_speed_that_is_configured() -> None:
    loop = ClosedLoop(*STILL, "gimbal.left.steering.test_deg_s=0.4")
    loop.until_state(AxesState.TESTING)
    assert max(cycle.fastest_deg_s for cycle in loop.run(2.0).cycles) <= 0.4


@pytest.mark.parametrize(("az_sign", "el_sign", "swapped"), WIRINGS)
def test_wrong_wiring_ends_held_and_names_axis_and_numbers(az_sign: int, el_sign: int, swapped: bool) -> None:
    loop = wired(az_sign, el_sign, swapped)
    reason = judged(loop)
    first_wrong = "el" if (az_sign, swapped) == (1, False) else "az"
    assert f"axis test: {first_wrong} moved the image by (" in reason
    assert "px, the calibration says (" in reason
    loop.run(0.3)
    assert loop.excursion_deg() <= SLIGHTLY_DEG
    assert (loop.state, loop.snapshot().tested) == (AxesState.HELD, False)
    assert loop.cycles[-1].fastest_deg_s == 0.0


@pytest.mark.parametrize("scale", [0.6, 1.4])
def test_a_wrong_scale_fails(scale: float) -> None:
    def believed(station: Station) -> Station:
        lens = station.lens
        return replace(station, lens=replace(lens, fx_px=scale * lens.fx_px, fy_px=scale * lens.fy_px))

    loop = ClosedLoop(*STILL, believed=believed)
    assert "scale of the axes is wrong" in judged(loop)
    assert loop.excursion_deg() <= SLIGHTLY_DEG


def test_axes_that_do_not_go_where_they_are_told_fail_with_how_far_they_are_off() -> None:
    loop = ClosedLoop(*STILL, "twin.axes.max_deg_s=0.02")
    reason = judged(loop)
    assert "the axes did not go where they were told (az -0.1" in reason
    assert loop.excursion_deg() <= SLIGHTLY_DEG


def test_a_failed_test_needs_a_person_and_is_then_done_again() -> None:
    loop = wired(1, -1, swapped=False)
    judged(loop)
    loop.run(0.5)
    assert loop.state is AxesState.HELD
    assert loop.axes.arm() == "armed"
    loop.until_state(AxesState.TESTING, 0.1)
    assert "el moved the image" in judged(loop)


def test_a_target_that_moves_makes_it_unclear_and_it_is_tried_again() -> None:
    loop = ClosedLoop(*STILL, *(f"twin.path.{s}" for s in ("kind=circle", "radius_mm=2", "speed_mm_s=4", "dwell_s=0")))
    loop.until(lambda loop: "the target moved by" in loop.snapshot().reason, 6.0)
    assert loop.snapshot().armed
    loop.run(0.5)
    assert loop.state is AxesState.TESTING
    loop.stand_still()
    loop.until_state(AxesState.FOLLOWING)
    assert loop.snapshot().reason == ""
    assert max(max(map(abs, c.turned_deg)) for c in loop.cycles if c.state is AxesState.TESTING) <= SLIGHTLY_DEG


def test_a_target_that_is_lost_in_the_test_is_waited_for_and_the_axes_go_no_farther() -> None:
    loop = ClosedLoop(*STILL)
    for _ in range(3):
        loop.until(lambda loop: loop.cycles[-1].turned_deg[0] > 0.19, 3.0)
        loop.hidden = True
        loop.until_state(AxesState.HELD)
        assert loop.snapshot().reason == "axis test: the target was lost"
        loop.run(0.3)
        loop.hidden = False
        loop.until_state(AxesState.TESTING)
    loop.until_state(AxesState.FOLLOWING)
    assert loop.excursion_deg() <= SLIGHTLY_DEG


def test_a_camera_that_stops_in_the_test_spoils_it_and_does_not_fail_it() -> None:
    loop = quick()
    loop.until_state(AxesState.TESTING)
    loop.run(0.2)
    loop.stopped = True
    loop.until_state(AxesState.HELD)
    assert loop.snapshot().reason == "axis test: no frames came"
    assert loop.run(3.0).snapshot().armed
    loop.stopped = False
    loop.until_state(AxesState.FOLLOWING)


def test_angles_that_fail_in_the_test_are_waited_for() -> None:
    loop = quick()
    loop.until_state(AxesState.TESTING)
    loop.run(0.1)
    loop.angles_fail = "its latch did not come"
    loop.run(3.5)
    assert loop.snapshot().armed
    loop.angles_fail = ""
    loop.until_state(AxesState.FOLLOWING)


def test_after_too_many_unclear_attempts_a_person_is_asked() -> None:
    proof = Proof(SteeringSettings())
    verdicts = [proof.spoilt("the target was lost") for _ in range(UNCLEAR_TESTS)]
    assert verdicts == [Verdict.UNCLEAR] * (UNCLEAR_TESTS - 1) + [Verdict.FAILED]
    assert f"after {UNCLEAR_TESTS} attempts: let it stand still, then arm" in proof.reason
    proof.renew()
    assert proof.spoilt("the target was lost") is Verdict.UNCLEAR


def test_an_image_that_hardly_moves_proves_nothing() -> None:
    """A target close to the axes' centre, or a lens that is far too short."""
    test, verdict, n = AxisTest(np.zeros(2), SteeringSettings()), Verdict.RUNNING, 0
    px_per_rad = 5.0 / radians(0.4)
    while verdict is Verdict.RUNNING:
        az, el = test.target
        n += 1
        angles = AxisAngles(az, el, 1e-5, 0.0, None, 0.0, "latch")
        verdict = test.seen(px_per_rad * np.array((az, el)), angles, px_per_rad * np.eye(2), HostNs(18_000_000 * n))
    assert verdict is Verdict.FAILED
    assert test.reason == "the test angle moves the image by 5.0 px only"
