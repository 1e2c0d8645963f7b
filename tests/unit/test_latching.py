from collections.abc import Sequence

import pytest

from trackerd.contract.clock import CameraNs, ControllerUs
from trackerd.contract.model import Latch, NoAngle
from trackerd.estimate.latching import LatchMatcher, Match, Waiting

PERIOD_US = 18_182
CAMERA_ZERO_NS = 77_000_000_000


def mid_exposure(frame: int, rate: float = 60e-6) -> CameraNs:
    """By a camera's clock that runs fast."""
    return CameraNs(round(CAMERA_ZERO_NS + frame * PERIOD_US * 1000 * (1 + rate)))


def edges(frame: int, index: int) -> tuple[Latch, Latch]:
    """Falling and rising edge of a 2 ms exposure; the axes turn at 0.1 and -0.2 rad/s."""
    middle_us = 5_000_000 + frame * PERIOD_US

    def latch(offset_us: int) -> Latch:
        t_s = (frame * PERIOD_US + offset_us) * 1e-6
        return Latch(index, offset_us > 0, 0.1 * t_s, -0.2 * t_s, ControllerUs(middle_us + offset_us))

    return latch(1001), latch(-1000)


def ring(newest: int, shift: int = 0) -> tuple[Latch, ...]:
    """The last two exposures, newest first; their indices are `shift` ahead of the frames."""
    return edges(newest, newest + shift) + edges(newest - 1, newest - 1 + shift)


def test_both_edges_give_the_angles_of_mid_exposure_to_half_a_microsecond() -> None:
    answer = LatchMatcher(edges=2).match(3, mid_exposure(3), ring(3))
    assert isinstance(answer, Match)
    assert answer.index == 3
    assert answer.instant_ns == (5_000_000 + 3 * PERIOD_US) * 1000 + 500
    assert answer.az_rad == pytest.approx(0.1 * (3 * PERIOD_US + 0.5) * 1e-6, abs=1e-12)
    assert (answer.az_rad_s, answer.el_rad_s) == (pytest.approx(0.1), pytest.approx(-0.2))


def test_one_edge_is_taken_as_it_stands() -> None:
    entry = Latch(4, False, 0.5, -0.25, ControllerUs(1234))
    answer = LatchMatcher(edges=1).match(4, mid_exposure(4), (entry,))
    assert answer == Match(4, 0.5, -0.25, 0.0, 0.0, 1_234_000)


def test_a_latch_that_has_not_arrived_is_waited_for() -> None:
    matcher = LatchMatcher(edges=2)
    assert matcher.match(0, mid_exposure(0), ()) == Waiting()
    assert matcher.match(5, mid_exposure(5), ring(4)) == Waiting()
    rising = edges(5, 5)[1:] + ring(4)[:3]
    assert matcher.match(5, mid_exposure(5), rising) == Waiting()
    assert isinstance(matcher.match(5, mid_exposure(5), ring(5)), Match)


def test_an_overwritten_latch_is_no_angle() -> None:
    answer = LatchMatcher(edges=2).match(3, mid_exposure(3), ring(9))
    assert answer == NoAngle("latch 3 is overwritten: the ring begins at 8")


def test_dropped_frames_leave_the_indices_in_step() -> None:
    matcher = LatchMatcher(edges=2)
    for frame in (0, 1, 2, 7, 8, 300, 301):
        answer = matcher.match(frame, mid_exposure(frame), ring(frame))
        assert isinstance(answer, Match)
        assert answer.index == frame


def answers_after_a_jump(shift: int, frames: Sequence[int]) -> list[Match | Waiting | NoAngle]:
    matcher = LatchMatcher(edges=2)
    for frame in range(10):
        assert isinstance(matcher.match(frame, mid_exposure(frame), ring(frame)), Match)
    return [matcher.match(frame, mid_exposure(frame), ring(frame, shift)) for frame in frames]


@pytest.mark.parametrize("shift", [1, -1, 5, -6])
def test_a_jump_of_the_latch_index_is_found_by_time_and_believed_at_the_third_frame(shift: int) -> None:
    answers = answers_after_a_jump(shift, range(10, 15))
    assert all(isinstance(answer, NoAngle) for answer in answers[:2])
    assert [answer.index - shift for answer in answers[2:] if isinstance(answer, Match)] == [12, 13, 14]


def test_no_angle_after_a_jump_says_which_latch_would_fit() -> None:
    assert answers_after_a_jump(5, [10]) == [NoAngle("latch 10 expected, 15 fits by time (1 in a row)")]


def test_the_same_frame_asked_again_is_no_confirmation() -> None:
    answers = answers_after_a_jump(1, [10, 10, 10, 10])
    assert all(isinstance(answer, NoAngle) for answer in answers)


def test_a_latch_at_another_time_is_no_angle() -> None:
    matcher = LatchMatcher(edges=2)
    matcher.match(0, mid_exposure(0), ring(0))
    late = CameraNs(mid_exposure(1) - 400_000)
    assert matcher.match(1, late, ring(1)) == NoAngle("latch 1 is 0.399 ms off the camera's interval")


def test_without_a_camera_clock_the_index_alone_counts() -> None:
    matcher = LatchMatcher(edges=2)
    for frame in (0, 1, 2):
        assert isinstance(matcher.match(frame, None, ring(frame + 1, shift=-1)), Match)


def test_reset_numbers_from_zero_again() -> None:
    matcher = LatchMatcher(edges=2)
    for frame in range(10):
        matcher.match(frame, mid_exposure(frame), ring(frame))
    for frame in range(10, 14):
        matcher.match(frame, mid_exposure(frame), ring(frame, 1))
    matcher.reset()
    answer = matcher.match(0, mid_exposure(100), edges(100, 0))
    assert isinstance(answer, Match)


def test_a_recording_is_indexed_once_and_searched_whole() -> None:
    class Counted(tuple[Latch, ...]):
        walks = 0

        def __iter__(self):  # type: ignore[no-untyped-def]
            Counted.walks += 1
            return super().__iter__()

    recording = Counted(latch for frame in range(500) for latch in edges(frame, frame))
    matcher = LatchMatcher(edges=2)
    for frame in range(0, 500, 7):
        answer = matcher.match(frame, mid_exposure(frame, 0.0), recording)
        assert isinstance(answer, Match)
        assert answer.index == frame
    assert Counted.walks == 1
    assert matcher.match(500, mid_exposure(500, 0.0), recording) == Waiting()


def test_other_numbers_of_edges_are_refused() -> None:
    with pytest.raises(ValueError, match="1 or 2 latched edges, not 3"):
        LatchMatcher(edges=3)
