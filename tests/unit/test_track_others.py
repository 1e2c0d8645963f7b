"""Another ball or a round hole in view does not take over the lock; what moves, hides and jumps is followed all the same."""

from collections.abc import Sequence

import numpy as np
import pytest
from ball_scenes import Disc, Place, Scenes, Watcher, locked_off_px

from trackerd.contract.model import AxisAngles, Found, Missed, TrackState
from trackerd.engine.track import Step
from trackerd.formats.settings import TrackingSettings

HOLE_DN = 25.0
HOME = (130.0, 180.0)
ELSEWHERE = (360.0, 200.0)

Moment = tuple[Place | None, Sequence[Disc]]  # where the target is, None while it is hidden; and the other things in view


def watched(moments: Sequence[Moment], size_px: tuple[int, int] = (480, 360), in_front: bool = False) -> list[Step]:
    """The steps of a tracker that was told which ball it is to follow; fails where it is locked on anything else."""
    scenes, first = Scenes(size_px), moments[0][0]
    watcher, steps = Watcher(size_px, TrackingSettings(target_px=first)), []
    for n, (place, others) in enumerate(moments):
        target = [] if place is None else [Disc(*place)]
        step = watcher.see(scenes.picture([*target, *others] if in_front else [*others, *target]))
        assert locked_off_px(step, place) < 1.0, f"frame {n}: {step.outline}, target at {place}"
        steps.append(step)
    return steps


def all_locked(steps: Sequence[Step]) -> bool:
    return all(step.state is TrackState.LOCKED and isinstance(step.outline, Found) for step in steps)


@pytest.mark.parametrize("frames", [1, 2, 9, 12, 40])
@pytest.mark.parametrize("level_dn", [170.0, HOLE_DN], ids=["a ball", "a hole"])
def test_what_stays_in_view_while_the_target_is_hidden_is_not_taken_for_it(frames: int, level_dn: float) -> None:
    other = [Disc(*ELSEWHERE, level_dn=level_dn)]
    steps = watched([(HOME, other)] * 8 + [(None, other)] * frames + [(HOME, other)] * 3)
    assert all_locked(steps[-3:])  # back in the first frame in which it is seen


def test_a_ball_that_moves_while_the_target_is_hidden_stays_another_ball() -> None:
    away = [Disc(360.0 - 5.0 * n, 200.0 + 3.0 * n) for n in range(30)]
    moments = [(HOME, away[:1])] * 8 + [(None, [disc]) for disc in away] + [((180.0, 60.0), away[-1:])] * 3
    assert all_locked(watched(moments)[-3:])


def test_another_ball_is_still_none_when_the_target_has_long_been_given_up() -> None:
    other = [Disc(*ELSEWHERE)]
    steps = watched([(HOME, other)] * 8 + [(None, other)] * 80 + [(HOME, other)] * 2)
    assert steps[-3].why == "another ball is in view, not the target"
    assert all_locked(steps[-2:])


@pytest.mark.parametrize("px_a_frame", [3.0, 7.0, 19.0])
@pytest.mark.parametrize("in_front", [False, True])
def test_a_ball_that_crosses_the_target_does_not_take_the_lock_along(px_a_frame: float, in_front: bool) -> None:
    passing = [Disc(20.0 + px_a_frame * n, 182.0) for n in range(int(440.0 / px_a_frame))]
    steps = watched([((240.0, 180.0), [disc]) for disc in passing], in_front=in_front)
    assert all_locked(steps[-3:])
    refused = [step.why for step in steps[2:] if isinstance(step.outline, Missed)]
    assert len(refused) < 0.2 * len(steps)


def test_where_two_balls_cover_each_other_the_tracker_says_so() -> None:
    passing = [Disc(20.0 + 3.0 * n, 180.0) for n in range(146)]
    steps = watched([((240.0, 180.0), [disc]) for disc in passing])
    assert any("cannot be told" in step.why for step in steps)


def test_balls_that_cross_each_other_in_motion_keep_their_names() -> None:
    moments = [((40.0 + 5.0 * n, 150.0 + n), [Disc(440.0 - 5.0 * n, 150.0 + n)]) for n in range(80)]
    assert all_locked(watched(moments, in_front=True)[-20:])


def test_the_target_may_pass_over_a_hole() -> None:
    hole = [Disc(240.0, 180.0, level_dn=HOLE_DN)]
    steps = watched([((40.0 + 6.0 * n, 180.0), hole) for n in range(66)])
    assert all_locked(steps[1:])


def test_a_jump_past_another_ball_is_followed_in_the_same_frame() -> None:
    other = [Disc(*ELSEWHERE)]
    steps = watched([(HOME, other)] * 6 + [((250.0, 60.0), other)] * 3 + [((360.0, 120.0), other)] * 3)
    assert all_locked(steps[1:])


def test_a_jump_across_the_whole_image_is_followed_in_the_same_frame() -> None:
    steps = watched([((150.0, 300.0), [])] * 5 + [((930.0, 420.0), [])] * 3, (1080, 700))
    assert all_locked(steps[1:])


def test_seventy_five_pixels_a_frame_are_followed_in_every_frame() -> None:
    way = [abs((n + 5) % 10 - 5) * 75.0 for n in range(24)]
    assert all_locked(watched([((50.0 + x, 180.0), []) for x in way])[1:])


def test_forty_hidden_frames_in_motion_end_in_the_first_frame_in_which_it_is_seen() -> None:
    way = [(40.0 + 4.0 * n, 180.0) for n in range(80)]
    steps = watched([(place if not 20 <= n < 60 else None, []) for n, place in enumerate(way)])
    assert all_locked(steps[1:20])
    assert all_locked(steps[60:])


def test_a_ball_that_comes_in_while_the_target_is_hidden_is_refused() -> None:
    coming = [Disc(500.0 - 4.0 * n, 150.0) for n in range(40)]
    steps = watched([(HOME, [])] * 6 + [(None, [disc]) for disc in coming] + [(HOME, coming[-1:])] * 2)
    assert any("came in over the image's edge" in step.why for step in steps)
    assert all_locked(steps[-2:])


def test_two_new_balls_as_near_as_each_other_are_not_guessed_between() -> None:
    scenes, watcher = Scenes(), Watcher()
    for _ in range(4):
        watcher.see(scenes.picture([Disc(240.0, 180.0)]))
    step = watcher.see(scenes.picture([Disc(120.0, 180.0), Disc(365.0, 180.0)]))
    assert step.state is TrackState.COASTING
    assert "2 balls are in view" in step.why


def test_with_the_axes_in_motion_another_ball_at_rest_is_known_where_it_has_moved_to() -> None:
    """The image moves by 60 px a frame while the target is hidden: the other ball comes to the target's place and past it."""
    scenes, watcher = Scenes(clutter=False), Watcher(tracking=TrackingSettings(target_px=(240.0, 180.0)))
    rad_per_px, why = 1.0 / 31000.0, []
    for n in range(14):
        swing_px = 60.0 * max(n - 6, 0)
        discs = [Disc(400.0 - swing_px, 180.0)] + ([Disc(240.0, 180.0)] if n < 7 else [])
        angles = AxisAngles(0.0, 0.0 + swing_px * rad_per_px, 1e-5, 0.0, None, 0.0, "latch")
        step = watcher.see(scenes.picture(discs), angles)
        assert locked_off_px(step, (240.0, 180.0) if n < 7 else None) < 1.0, n
        why.append(step.why)
    assert all("another ball" in reason for reason in why[7:11])


def test_after_a_long_time_whatever_is_found_is_the_target() -> None:
    scenes, watcher = Scenes((240, 240), clutter=False), Watcher((240, 240))
    for _ in range(4):
        watcher.see(scenes.picture([Disc(120.0, 120.0, level_dn=170.0)]))
    for _ in range(20):
        assert watcher.see(scenes.picture([Disc(150.0, 110.0, level_dn=HOLE_DN)])).state is not TrackState.LOCKED
    states = [watcher.see(scenes.picture([Disc(150.0, 110.0, level_dn=HOLE_DN)])).state for _ in range(300)]
    assert states[-1] is TrackState.LOCKED


def test_a_guess_chooses_the_ball_at_it() -> None:
    scenes, balls = Scenes(), [Disc(120.0, 180.0), Disc(350.0, 180.0, 24.0)]
    watcher = Watcher(tracking=TrackingSettings(target_px=(345.0, 184.0), target_radius_px=25.0))
    step = [watcher.see(scenes.picture(balls)) for _ in range(2)][-1]
    assert locked_off_px(step, (350.0, 180.0)) < 0.2
    assert (step.state, step.target_selected) == (TrackState.LOCKED, "guess")
    watcher.tracker.select((130.0, 170.0), 30.0)
    step = [watcher.see(scenes.picture(balls)) for _ in range(2)][-1]
    assert step.state is TrackState.LOCKED
    assert locked_off_px(step, (120.0, 180.0)) < 0.2


def test_a_guess_that_is_far_off_finds_the_nearest_ball_of_its_size() -> None:
    scenes, balls = Scenes(), [Disc(120.0, 180.0, 50.0), Disc(215.0, 180.0, 20.0)]
    watcher = Watcher(tracking=TrackingSettings(target_px=(190.0, 210.0), target_radius_px=18.0))
    step = [watcher.see(scenes.picture(balls)) for _ in range(2)][-1]
    assert step.state is TrackState.LOCKED
    assert locked_off_px(step, (215.0, 180.0)) < 0.2


def wandering(random: np.random.Generator, frames: int, margin_px: float, px_a_frame: float) -> np.ndarray:
    """A smooth random path inside the image, (frames, 2)."""
    low, high = np.array((margin_px, margin_px)), np.array((480.0, 360.0)) - margin_px
    place, speed, path = random.uniform(low, high), random.normal(0.0, px_a_frame / 2.0, 2), []
    for _ in range(frames):
        speed = np.clip(speed + random.normal(0.0, px_a_frame / 12.0, 2), -px_a_frame, px_a_frame)
        place = place + speed
        speed = np.where((place < low) | (place > high), -speed, speed)
        place = np.clip(place, low, high)
        path.append(place)
    return np.array(path)


@pytest.mark.parametrize("seed", range(8))
def test_drops_hides_and_jumps_in_any_order_never_end_on_the_other_ball(seed: int) -> None:
    random = np.random.default_rng(seed)
    frames, r_px, level_dn = 120, float(random.uniform(15.0, 40.0)), float(random.choice((75.0, 110.0, 200.0)))
    target = wandering(random, frames, 1.6 * r_px, float(random.choice((2.0, 6.0, 10.0))))
    other = wandering(random, frames, 0.6 * r_px, float(random.choice((2.0, 6.0, 10.0))))
    other += (target[0] + (240.0, 180.0)) % (480.0, 360.0) - other[0] if np.hypot(*(target[0] - other[0])) < 3.0 * r_px else 0.0
    scenes, watcher = Scenes(seed=seed), Watcher(tracking=TrackingSettings(target_px=tuple(target[0].tolist())))
    hidden_until, locked, visible, waited = 0, 0, 0, 0
    for n in range(frames):
        if n > 10 and random.random() < 0.02:
            hidden_until = n + int(random.integers(1, 41))
        if n > 10 and random.random() < 0.01:  # a jump
            target[n:] = np.clip(
                target[n:] + random.uniform(-200.0, 200.0, 2), 1.6 * r_px, (480.0 - 1.6 * r_px, 360.0 - 1.6 * r_px)
            )
        if random.random() < 0.04:  # a frame that never came
            watcher.frame_id += 1
            continue
        place = None if n < hidden_until else tuple(target[n].tolist())
        discs = [Disc(*other[n], r_px, level_dn)] + ([] if place is None else [Disc(*place, r_px, level_dn)])
        step = watcher.see(scenes.picture(discs))
        assert locked_off_px(step, place) < max(1.0, 0.05 * r_px), f"frame {n}"
        locked += step.state is TrackState.LOCKED
        visible += place is not None
        waited = 0 if step.state is TrackState.LOCKED else waited + 1
        if waited > 10 and place is not None and np.hypot(*(target[n] - other[n])) > 2.5 * r_px:
            waited = 0
            watcher.tracker.select(place)  # an operator sees which one it is
    assert locked > 0.3 * visible  # it does not refuse everything either
