from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from made_lines import PERIOD_NS, SIGMA_RAD, STATIONS, circle, line, nees, still

from trackerd.contract.model import Sightline
from trackerd.estimate.pairing import Pairing
from trackerd.geometry.triangulate import triangulate

PAIR = ("left", "right")
SIMULTANEOUS_NS = 1_000_000
WAIT_NS = 100_000_000


def pairing(stations: Sequence[str] = PAIR) -> Pairing:
    return Pairing(stations, SIMULTANEOUS_NS, WAIT_NS)


def fed(paired: Pairing, lines: Sequence[Sightline]) -> list[tuple[Sightline, ...]]:
    return [members for one in lines for members in paired.add(one)]


def stream(station: str, frames: range, late_ns: int = 0, period_ns: int = PERIOD_NS) -> list[Sightline]:
    return [line(circle, station, n * period_ns + late_ns) for n in frames]


def in_time(*streams: list[Sightline]) -> list[Sightline]:
    return sorted((one for lines in streams for one in lines), key=lambda one: one.instant)


def arrival_ns(lines: list[Sightline], rng: np.random.Generator) -> list[int]:
    """Up to two frames late, in order within the station."""
    return np.maximum.accumulate([one.instant + rng.integers(0, 40_000_000) for one in lines]).tolist()


def worst_mm(sets: list[tuple[Sightline, ...]]) -> float:
    return max(float(np.linalg.norm(triangulate(s).p_mm - circle(s[0].instant * 1e-9))) for s in sets)


def test_triggered_stations_pair_at_once_frame_by_frame() -> None:
    paired = pairing()
    sizes = [len(paired.add(one)) for one in in_time(stream("left", range(20)), stream("right", range(20)))]
    assert sizes == [0, 1] * 20
    assert paired.statistics().sets == 20


@pytest.mark.parametrize("late_ns", [0, 300_000, PERIOD_NS // 3])
def test_the_order_of_arrival_across_stations_does_not_matter(late_ns: int) -> None:
    left, right = stream("left", range(30)), stream("right", range(30), late_ns)
    rng = np.random.default_rng(31)
    expected = [tuple(one.direction.tolist() for one in s) for s in fed(pairing(), in_time(left, right))]
    for _ in range(5):
        arrivals = [(t, one) for lines in (left, right) for t, one in zip(arrival_ns(lines, rng), lines, strict=True)]
        shuffled = [one for _, one in sorted(arrivals, key=lambda arrival: arrival[0])]
        assert [tuple(one.direction.tolist() for one in s) for s in fed(pairing(), shuffled)] == expected
    assert len(expected) >= 28


def test_a_nearly_simultaneous_line_is_moved_by_its_own_motion() -> None:
    sets = fed(pairing(), in_time(stream("left", range(30)), stream("right", range(30), -400_000)))
    assert len(sets) >= 28
    assert all(a.instant == b.instant for a, b in sets)
    assert worst_mm(sets[3:]) < 1e-3


@pytest.mark.parametrize("late_ns", [2_000_000, PERIOD_NS // 2, PERIOD_NS - 2_000_000])
def test_free_running_stations_are_interpolated_one_frame_late(late_ns: int) -> None:
    paired = pairing()
    sets = fed(paired, in_time(stream("left", range(40)), stream("right", range(40), late_ns)))
    assert len(sets) >= 38
    assert worst_mm(sets[2:]) < 5e-3


def test_the_slower_station_gives_the_instants() -> None:
    fast, slow = stream("left", range(150), period_ns=5_000_000), stream("right", range(30), 1_700_000, 25_000_000)
    sets = fed(pairing(), in_time(fast, slow))
    assert 28 <= len(sets) <= 30
    assert [b.instant for _, b in sets[2:]] == [one.instant for one in slow[1:]][-len(sets[2:]) :]
    assert worst_mm(sets[2:]) < 1e-3


def test_a_missing_frame_costs_no_more_than_its_own_instant() -> None:
    right = [one for one in stream("right", range(30)) if one.instant != 12 * PERIOD_NS]
    sets = fed(pairing(), in_time(stream("left", range(30)), right))
    assert len(sets) == 30
    assert worst_mm(sets) < 0.05


def test_after_a_gap_too_long_to_join_pairs_go_on() -> None:
    right = [one for one in stream("right", range(60), PERIOD_NS // 2) if not 20 <= one.instant // PERIOD_NS < 30]
    sets = fed(pairing(), in_time(stream("left", range(60)), right))
    assert 46 <= len(sets) <= 49
    assert worst_mm(sets[2:]) < 0.05


def test_the_covariance_of_moved_and_interpolated_lines_is_honest() -> None:
    rng = np.random.default_rng(32)
    for late_ns in (-900_000, PERIOD_NS // 2):
        lines = [
            line(circle, s, n * PERIOD_NS + late, rng) for n in range(1500) for s, late in (("left", 0), ("right", late_ns))
        ]
        points = [(triangulate(s), circle(s[0].instant * 1e-9)) for s in fed(pairing(), lines)]
        errors = np.array([point.p_mm - true for point, true in points])
        assert 0.9 < nees(errors, np.array([point.cov_mm2 for point, _ in points])) < 1.1


def test_the_sigma_of_an_instant_enters_as_the_swing_it_stands_for() -> None:
    rng = np.random.default_rng(33)
    sigma_ns, lines = 200_000.0, []
    for n in range(1200):
        for station in PAIR:
            wrong = line(circle, station, n * PERIOD_NS + round(rng.normal(0.0, sigma_ns)), instant_sigma_ns=sigma_ns)
            lines.append(replace(wrong, instant=n * PERIOD_NS, cov_rad2=wrong.cov_rad2 * 0.01))
    points = [(triangulate(s), circle(s[0].instant * 1e-9)) for s in fed(pairing(), lines)[5:]]
    errors = np.array([point.p_mm - true for point, true in points])
    assert errors.std() > 0.01
    covs = np.array([point.cov_mm2 for point, _ in points])
    assert 0.8 < errors.var(axis=0).sum() / covs.trace(axis1=1, axis2=2).mean() < 1.2


def test_three_stations_wait_for_the_third_and_then_go_without_it() -> None:
    paired = pairing(tuple(STATIONS))
    all_three = in_time(*(stream(s, range(10)) for s in STATIONS))
    assert [len(s) for s in fed(paired, all_three)] == [3] * 10
    two = in_time(*(stream(s, range(10, 30)) for s in PAIR))
    sets = fed(paired, two)
    assert [len(s) for s in sets] == [2] * 20
    assert fed(paired, in_time(*(stream(s, range(30, 33)) for s in PAIR))) != []


def test_a_station_known_to_be_absent_is_not_waited_for() -> None:
    paired = pairing(tuple(STATIONS))
    fed(paired, in_time(*(stream(s, range(5)) for s in STATIONS)))
    assert fed(paired, in_time(*(stream(s, range(5, 6)) for s in PAIR))) == []
    assert [len(s) for s in paired.absent("top")] == [2]
    assert fed(paired, in_time(*(stream(s, range(6, 7)) for s in PAIR))) == []
    assert [len(s) for s in fed(paired, stream("top", range(6, 7)))] == [3]


def test_a_station_that_comes_back_first_waits_for_the_other() -> None:
    paired = pairing()
    fed(paired, in_time(stream("left", range(5)), stream("right", range(5))))
    for station in PAIR:
        paired.absent(station)
    assert len(fed(paired, in_time(stream("left", range(40, 50)), stream("right", range(40, 50))))) == 10


def test_one_station_alone_gives_nothing_and_is_counted() -> None:
    paired = pairing()
    assert fed(paired, stream("left", range(40))) == []
    assert paired.statistics().alone > 30


def bad_lines() -> dict[str, Sightline]:
    good = line(still, "left", 10 * PERIOD_NS)
    return {
        "unknown station": replace(good, station="third"),
        "not finite": replace(good, direction=good.direction * np.nan),
        "no direction": replace(good, direction=good.direction * 2),
        "covariance not positive": replace(good, cov_rad2=-good.cov_rad2),
        "from the future": replace(good, instant=good.received + 2_000_000_000),
        "older than the window": replace(good, instant=good.instant - 500_000_000),
        "duplicate": line(still, "left", 9 * PERIOD_NS),
    }


@pytest.mark.parametrize("reason", bad_lines())
def test_a_line_that_is_no_measurement_is_refused_and_counted(reason: str) -> None:
    paired = pairing()
    fed(paired, [line(still, "left", n * PERIOD_NS) for n in range(10)])
    assert paired.add(bad_lines()[reason]) == []
    assert paired.statistics().refused == ((reason, 1),)
    assert paired.statistics().lines == 10


def test_an_indefinite_covariance_is_refused() -> None:
    paired = pairing()
    good = line(still, "left", 0)
    side = np.cross(good.direction, (0.0, 1.0, 0.0))
    paired.add(replace(good, cov_rad2=good.cov_rad2 - 1.5 * SIGMA_RAD**2 * np.outer(side, side) / (side @ side)))
    assert paired.statistics().refused == (("covariance not positive", 1),)


def test_memory_is_bounded_whatever_comes() -> None:
    paired = pairing()
    fed(paired, [line(still, "left", n * 1000) for n in range(3000)])
    assert max(len(track.lines) for track in paired._tracks.values()) <= 512


def test_reset_forgets_the_lines() -> None:
    paired = pairing()
    fed(paired, in_time(stream("left", range(5)), stream("right", range(5))))
    paired.reset()
    assert len(fed(paired, in_time(stream("left", range(5)), stream("right", range(5))))) == 5
