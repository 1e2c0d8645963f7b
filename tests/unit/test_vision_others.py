"""The look of a target, and who is another ball: by values, without pictures."""

import numpy as np
import pytest

from trackerd.contract.clock import HostNs
from trackerd.contract.model import Found
from trackerd.vision.drift import Drift
from trackerd.vision.look import Look, same_size
from trackerd.vision.others import DOUBTED_NEW, FORGOTTEN, Others, Place

FAR = Place((1000.0, 1000.0, 40.0), 0)  # where the target is expected: out of the way


def outline(x: float, y: float, r: float = 40.0, inside: float = 160.0, outside: float = 60.0) -> Found:
    return Found(x, y, r, np.eye(3) * 1e-4, 1.0, 1.0, 0.0, inside_dn=inside, outside_dn=outside)


@pytest.mark.parametrize(
    ("inside", "outside", "same"),
    [
        (160.0, 60.0, True),
        (130.0, 60.0, True),  # a shadow
        (160.0, 180.0, True),  # before something that is brighter
        (40.0, 60.0, False),  # a hole
        (60.0, 20.0, False),  # a darker ball
        (255.0, 60.0, False),  # one that shines
    ],
)
def test_a_ball_is_known_by_its_grey_level_and_by_the_side_to_which_it_stands_out(
    inside: float, outside: float, same: bool
) -> None:
    assert Look.of(outline(0.0, 0.0)).has_levels(outline(0.0, 0.0, inside=inside, outside=outside)) is same


@pytest.mark.parametrize("contrast_dn", [8.0, 15.0, 100.0])
def test_a_hole_as_deep_as_the_ball_is_bright_is_told_apart(contrast_dn: float) -> None:
    ball, hole = outline(0.0, 0.0, inside=60.0 + contrast_dn), outline(0.0, 0.0, inside=60.0 - contrast_dn)
    assert not Look.of(ball).has_levels(hole)


def test_a_look_follows_a_slow_change_and_not_one_odd_picture() -> None:
    look = Look.of(outline(0.0, 0.0))
    for level in np.linspace(160.0, 60.0, 40):
        look = look.with_newer(outline(0.0, 0.0, inside=float(level), outside=10.0))
        assert look.has_levels(outline(0.0, 0.0, inside=float(level), outside=10.0))
    assert Look.of(outline(0.0, 0.0)).with_newer(outline(0.0, 0.0, inside=60.0, outside=10.0)).inside_dn > 130.0


def test_sizes_are_compared_both_ways() -> None:
    assert [same_size(r, 60.0, 0.15) for r in (51.0, 53.0, 68.0, 70.0)] == [False, True, True, False]


def test_a_ball_in_steady_motion_is_followed_and_given_to_nobody() -> None:
    others = Others()
    others.add([outline(100.0, 100.0)])
    for n in range(1, 20):
        others.go_on((0.0, 0.0))
        assert others.claim([outline(100.0 + 25.0 * n, 100.0 + 5.0 * n)], FAR) == []
    assert others.known[0].sure


def test_what_another_ball_cannot_have_reached_is_given_back() -> None:
    others = Others()
    others.add([outline(100.0, 100.0)])
    others.go_on((0.0, 0.0))
    there, new = outline(103.0, 100.0), outline(400.0, 300.0)
    assert others.claim([new, there], FAR) == [new]
    others.go_on((0.0, 0.0))
    assert others.claim([new], FAR) == [new]


def test_the_nearest_of_two_outlines_is_the_other_ball_s() -> None:
    others = Others()
    others.add([outline(100.0, 100.0)])
    others.go_on((0.0, 0.0))
    near, far = outline(110.0, 100.0), outline(180.0, 100.0)
    assert others.claim([far, near], FAR) == [far]


def test_an_outline_of_another_size_or_brightness_is_not_the_other_ball_s() -> None:
    others = Others()
    others.add([outline(100.0, 100.0)])
    others.go_on((0.0, 0.0))
    strange = [outline(100.0, 100.0, r=60.0), outline(100.0, 100.0, inside=30.0)]
    assert others.claim(strange, FAR) == strange


def test_what_lies_in_the_target_s_very_place_is_the_target_s() -> None:
    others = Others()
    others.add([outline(100.0, 100.0)])
    others.go_on((0.0, 0.0))
    found = outline(152.0, 100.0)
    assert others.claim([found], Place((150.0, 100.0, 40.0), 0)) == [found]


def test_after_some_time_out_of_sight_it_may_be_anywhere_and_what_it_took_is_in_doubt() -> None:
    others = Others()
    others.add([outline(100.0, 100.0)])
    for _ in range(20):
        others.go_on((0.0, 0.0))
    assert others.claim([outline(400.0, 300.0)], FAR) == []
    assert not others.known[0].sure
    others.confirm()
    assert others.known[0].sure


def test_doubt_ends_and_so_does_the_memory_of_what_is_out_of_sight() -> None:
    others = Others()
    others.add([outline(100.0, 100.0)], doubted=DOUBTED_NEW)
    others.add([outline(900.0, 100.0)])
    for _ in range(DOUBTED_NEW):
        others.go_on((0.0, 0.0))
    assert len(others.known) == 1
    for _ in range(FORGOTTEN - DOUBTED_NEW + 1):
        others.go_on((0.0, 0.0))
    assert others.known == []


def test_balls_at_rest_move_with_the_image() -> None:
    others = Others()
    others.add([outline(100.0, 100.0)])
    others.go_on((300.0, -40.0))
    assert others.claim([outline(401.0, 61.0)], FAR) == []
    assert others.known[0].speed_px == pytest.approx((1.0, 1.0))


def test_one_ball_is_not_kept_twice() -> None:
    others = Others()
    others.add([outline(100.0, 100.0)])
    others.add([outline(104.0, 100.0)])
    assert len(others.known) == 1


def drift(*seen_px: float) -> tuple[float, float]:
    motion = Drift()
    for n, x in enumerate(seen_px):
        motion.update(HostNs(20_000_000 * n), x, 0.0)
    predicted = motion.predict(HostNs(20_000_000 * len(seen_px)))
    assert predicted is not None
    return predicted


def test_a_leap_is_no_speed_until_a_second_one_is_like_it() -> None:
    assert drift(0.0, 0.0, 75.0)[0] == pytest.approx(75.0)
    assert drift(0.0, 0.0, 75.0, 150.0)[0] == pytest.approx(225.0)
    assert drift(0.0, 8.0, 16.0)[0] == pytest.approx(24.0)


def test_a_ball_that_went_out_of_sight_before_a_hole_is_not_forgotten_for_it() -> None:
    others = Others(for_good=True)
    others.add([outline(100.0, 100.0), outline(110.0, 100.0, r=52.0, inside=20.0)])
    assert len(others.known) == 1  # at first, one outline so near to another is the same thing's
    others.add([outline(170.0, 100.0, r=52.0, inside=20.0)])
    others.known[0].x_px = 150.0
    others.go_on((0.0, 0.0))
    assert others.claim([outline(170.0, 100.0, r=52.0, inside=20.0)], FAR) == []
    assert [(other.look.r_px, other.unseen) for other in others.known] == [(52.0, 0), (40.0, 1)]


def test_where_a_target_was_chosen_no_doubt_ends_and_nobody_is_forgotten() -> None:
    others = Others(for_good=True)
    others.add([outline(100.0, 100.0)])
    for _ in range(20):
        others.go_on((0.0, 0.0))
    others.claim([outline(400.0, 300.0)], FAR)
    for _ in range(2 * FORGOTTEN):
        others.go_on((0.0, 0.0))
    assert [other.sure for other in others.known] == [False]
