"""Gate, tracker's box and search as one chain, and the OpenCV trackers behind their pitfalls."""

import cv2
import numpy as np
import pytest
from vision_pictures import NOISE, Ball

from trackerd.contract.clock import HostNs
from trackerd.contract.model import Found, Missed
from trackerd.formats.settings import TrackingSettings
from trackerd.vision.acquire import Acquisition, Expected
from trackerd.vision.drift import Drift
from trackerd.vision.locate import search
from trackerd.vision.tracker import KEPT_EVERY, BoxTracker

BALL = Ball(clutter=True)


def moved(ball: Ball, dx: float, dy: float) -> Ball:
    return Ball(ball.x_px + dx, ball.y_px + dy, ball.r_px, stem=ball.stem, clutter=ball.clutter)


def circle(ball: Ball) -> tuple[float, float, float]:
    return ball.x_px, ball.y_px, ball.r_px


@pytest.mark.parametrize(("kind", "tolerance_px"), [("kcf", 6.0), ("mosse", 18.0), ("csrt", 8.0)])
def test_a_tracker_points_at_the_ball_after_it_has_moved(kind: str, tolerance_px: float) -> None:
    tracker, ball = BoxTracker(kind), Ball(stem=True, clutter=True)  # type: ignore[arg-type]
    tracker.start(ball.noisy(0), circle(ball))
    there = moved(ball, 12.0, 6.0)
    box = tracker.update(there.noisy(1))
    assert box is not None
    assert np.abs(np.subtract(box, circle(there))).max() < tolerance_px


def test_kcf_carries_no_offset_and_keeps_up_over_many_frames() -> None:
    tracker = BoxTracker("kcf")
    tracker.start(BALL.noisy(0), circle(BALL))
    off = []
    for n in range(1, 12):
        there = moved(BALL, 3.0 * n, -2.0 * n)
        box = tracker.update(there.noisy(n))
        assert box is not None
        off.append((box[0] - there.x_px, box[1] - there.y_px))
    assert np.abs(np.mean(off, axis=0)).max() < 2.0


def test_kcf_says_when_the_ball_is_gone() -> None:
    tracker = BoxTracker("kcf")
    tracker.start(BALL.noisy(0), circle(BALL))
    assert tracker.update(Ball(contrast_dn=0.0, clutter=True).noisy(1)) is None


def test_a_tracker_keeps_its_own_copy_of_what_it_saw() -> None:
    tracker = BoxTracker("kcf")
    image = BALL.noisy(0)
    tracker.start(image, circle(BALL))
    image[:] = 0
    assert tracker.update(BALL.noisy(1)) is not None


@pytest.mark.parametrize("kind", ["kcf", "none"])
def test_a_tracker_that_was_never_started_or_has_forgotten_knows_nothing(kind: str) -> None:
    tracker = BoxTracker(kind)  # type: ignore[arg-type]
    assert tracker.update(BALL.noisy(0)) is None
    tracker.start(BALL.noisy(0), circle(BALL))
    tracker.forget()
    assert tracker.update(BALL.noisy(0)) is None


def test_few_images_are_copied_for_the_tracker_but_the_next_one_after_its_memory_was_used(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    copied: list[int] = []
    resize = cv2.resize
    monkeypatch.setattr(cv2, "resize", lambda *args, **named: copied.append(1) or resize(*args, **named))
    tracker, image = BoxTracker("kcf"), BALL.noisy(0)
    for _ in range(2 * KEPT_EVERY):
        tracker.start(image, circle(BALL))
    assert len(copied) == 2
    assert tracker.update(image) is not None
    copied.clear()
    tracker.start(image, circle(BALL))
    assert len(copied) == 1


def test_a_ball_at_the_edge_of_the_picture_is_not_learnt() -> None:
    tracker = BoxTracker("kcf")
    ball = Ball(x_px=40.0)
    tracker.start(ball.noisy(0), circle(ball))
    assert tracker.update(ball.noisy(1)) is None


def acquisition(**settings: object) -> Acquisition:
    return Acquisition(NOISE, TrackingSettings(**settings))  # type: ignore[arg-type]


def outline(found: object) -> Found:
    assert isinstance(found, Found), found
    return found


@pytest.mark.parametrize("tracker", ["kcf", "none"])
def test_a_ball_that_left_the_gate_is_found_again_in_the_same_frame(tracker: str) -> None:
    looking = acquisition(tracker=tracker)
    looking.learn(BALL.noisy(0), outline(search(BALL.noisy(0), NOISE)))
    there = moved(BALL, 70.0, -40.0)
    found = outline(looking.near(there.noisy(1), Expected(circle(BALL), 0)))
    assert (found.x_px, found.y_px) == pytest.approx((there.x_px, there.y_px), abs=0.05)


def test_a_ball_of_another_size_is_not_the_target() -> None:
    looking = acquisition()
    other = Ball(r_px=72.0)
    missed = looking.near(other.noisy(0), Expected((other.x_px, other.y_px, 60.0), 0))
    assert isinstance(missed, Missed)
    assert "not the target's" in missed.reason


def test_an_outline_outside_the_admitted_radius_is_refused() -> None:
    looking = acquisition(radius_px=(70.0, 100.0))
    assert isinstance(looking.anywhere(BALL.noisy(0), 0, None), Missed)
    missed = looking.near(BALL.noisy(0), Expected(circle(BALL), 0))
    assert isinstance(missed, Missed)
    assert "not admitted" in missed.reason


def test_the_ball_nearest_to_the_chosen_pixel_is_taken() -> None:
    left, right = Ball(160.2, 240.0, 40.0), Ball(480.7, 230.0, 40.0)
    picture = np.maximum(left.noisy(1), right.noisy(2))
    looking = acquisition()
    for ball in (left, right):
        found = outline(looking.anywhere(picture, 0, (ball.x_px + 25.0, ball.y_px - 35.0)))
        assert found.x_px == pytest.approx(ball.x_px, abs=0.1)


def test_a_pixel_without_a_ball_near_chooses_none() -> None:
    missed = acquisition().anywhere(Ball(160.2, 240.0, 40.0).noisy(1), 0, (600.0, 400.0))
    assert isinstance(missed, Missed)
    assert "no ball at pixel (600, 400)" in missed.reason


def test_a_full_sensor_is_searched_in_every_second_frame() -> None:
    looking = acquisition()
    large = Ball(1200.0, 700.0, size_px=(2048, 1536)).noisy(0)
    assert isinstance(looking.anywhere(large, 4, None), Found)
    assert isinstance(looking.anywhere(large, 5, None), Missed)


def test_the_gate_grows_with_every_frame_missed() -> None:
    reaches = [Expected((0.0, 0.0, 60.0), missed).reach_px for missed in range(8)]
    assert reaches[0] < reaches[3] < reaches[5]
    assert max(reaches) <= 30.0


def test_drift_goes_on_with_the_last_velocity() -> None:
    drift = Drift()
    assert drift.predict(HostNs(0)) is None
    drift.update(HostNs(0), 100.0, 50.0)
    assert drift.predict(HostNs(20_000_000)) == (100.0, 50.0)
    drift.update(HostNs(20_000_000), 104.0, 49.0)
    drift.update(HostNs(20_000_000), 900.0, 900.0)  # the same stamp again: ignored
    assert drift.predict(HostNs(40_000_000)) == pytest.approx((108.0, 48.0))
