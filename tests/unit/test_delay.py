"""A latch of a neighbouring exposure is noticed by the time that the frame takes to the host."""

import pytest

from trackerd.engine.delay import FRAMES, DelayWatch

MS = 1_000_000
EXPOSURE, TRANSFER, PERIOD = 2 * MS, 8 * MS, 18 * MS
USUAL = EXPOSURE // 2 + TRANSFER


def heard(watch: DelayWatch, delays_ns: list[int]) -> list[str]:
    return [watch.objection(delay_ns) for delay_ns in delays_ns]


def test_usual_delays_with_stalls_in_between_raise_nothing() -> None:
    stalls = [USUAL + (40 * MS if n % 3 else 200_000) for n in range(4 * FRAMES)]
    assert heard(DelayWatch(EXPOSURE, TRANSFER, PERIOD), stalls) == [""] * len(stalls)


@pytest.mark.parametrize(("frames_off", "words"), [(1, "27.0 ms after mid-exposure, where 9.0 ms are usual"), (2, "45.0 ms")])
def test_the_latch_of_an_earlier_exposure_is_noticed(frames_off: int, words: str) -> None:
    told = heard(DelayWatch(EXPOSURE, TRANSFER, PERIOD), [USUAL + frames_off * PERIOD] * FRAMES)
    assert told[:-1] == [""] * (FRAMES - 1)
    assert words in told[-1]


def test_the_latch_of_a_later_exposure_is_noticed_at_once_also_where_the_transfer_is_not_known() -> None:
    assert "10.0 ms before the end of its exposure" in DelayWatch(EXPOSURE, 0, PERIOD).objection(USUAL - PERIOD)


def test_without_a_known_transfer_no_delay_is_too_long() -> None:
    assert heard(DelayWatch(EXPOSURE, 0, PERIOD), [USUAL + PERIOD] * 2 * FRAMES) == [""] * 2 * FRAMES


def test_a_new_stream_is_judged_by_its_own_frames() -> None:
    watch = DelayWatch(EXPOSURE, TRANSFER, PERIOD)
    heard(watch, [USUAL + PERIOD] * (FRAMES - 1))
    watch.reset()
    assert heard(watch, [USUAL + PERIOD, *[USUAL] * FRAMES]) == [""] * (FRAMES + 1)
