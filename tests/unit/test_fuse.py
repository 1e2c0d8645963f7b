from dataclasses import replace

import numpy as np
import pytest
from made_lines import ARCSEC, LATENCY_NS, PERIOD_NS, STATIONS, Path, circle, line, nees, still

from trackerd.contract.clock import HostNs
from trackerd.contract.model import Fix, FixState, Sightline
from trackerd.engine.fuse import Fuser
from trackerd.formats.settings import FusionSettings

PAIR = ("left", "right")
SETTINGS = FusionSettings()
RADIUS_MM = 12.7


def fuser(settings: FusionSettings = SETTINGS, stations: tuple[str, ...] = PAIR) -> Fuser:
    return Fuser(stations, settings, RADIUS_MM, 0.05, PERIOD_NS)


def pair(path: Path, frame: int, rng: np.random.Generator | None = None, fixed_rad: float = 0.0) -> list[Sightline]:
    return [line(path, station, frame * PERIOD_NS, rng, fixed_rad=fixed_rad) for station in PAIR]


def fed(fused: Fuser, lines: list[Sightline]) -> list[Fix]:
    return [fix for one in lines for fix in fused.add(one, one.received)]


def tracking(path: Path = still, frames: int = 20, settings: FusionSettings = SETTINGS) -> Fuser:
    """After `frames` clean pairs."""
    fused = fuser(settings)
    fed(fused, [one for frame in range(frames) for one in pair(path, frame)])
    return fused


def at(frame: float) -> HostNs:
    """When the frame's lines come in."""
    return HostNs(round(frame * PERIOD_NS) + LATENCY_NS)


def test_a_target_is_confirmed_by_pairs_that_agree() -> None:
    fixes = fed(fuser(), [one for frame in range(8) for one in pair(still, frame)])
    assert [fix.state for fix in fixes] == [FixState.UNCONFIRMED] * 4 + [FixState.TRACKING] * 4
    assert fixes[1].reasons == ("unconfirmed: 2 of 5 agreeing pairs",)
    assert [fix.valid for fix in fixes] == [False] * 4 + [True] * 4
    assert [fix.sequence for fix in fixes] == list(range(1, 9))
    assert fixes[-1].stations == PAIR
    assert fixes[-1].received == fixes[-1].instant + LATENCY_NS


@pytest.mark.parametrize(("path", "limit_mm"), [(still, 0.047), (circle, 0.050)])
@pytest.mark.parametrize("late_ns", [0, PERIOD_NS // 2])
def test_fixes_are_accurate_at_their_own_stamp_and_their_covariance_honest(path: Path, limit_mm: float, late_ns: int) -> None:
    rng, fused, fixes = np.random.default_rng(41), fuser(), []
    for frame in range(800):
        for station, late in (("left", 0), ("right", late_ns)):
            fixes += fed(fused, [line(path, station, frame * PERIOD_NS + late, rng)])
    valid = [fix for fix in fixes[50:] if fix.valid]
    errors = np.array([fix.position_mm - path(fix.instant * 1e-9) for fix in valid])
    assert len(valid) > 740
    assert np.sqrt((errors**2).sum(axis=1).mean()) < limit_mm
    assert 0.8 < nees(errors, np.array([fix.cov_mm2 for fix in valid])) < 1.2


def test_the_systematic_part_is_carried_apart_and_averaging_does_not_reduce_it() -> None:
    fused, fixes = fuser(), []
    for frame in range(60):
        fixes += fed(fused, pair(still, frame, fixed_rad=3 * ARCSEC))
    first, last = fixes[0], fixes[-1]
    assert np.allclose(first.systematic_cov_mm2, last.systematic_cov_mm2)
    assert np.all(np.linalg.eigvalsh(last.cov_mm2 - last.systematic_cov_mm2) > 0.0)
    assert np.trace(last.cov_mm2) < np.trace(first.cov_mm2)


def test_silence_is_extrapolated_then_lost_then_nothing() -> None:
    fused = tracking(circle)
    fixes = [fix for n in range(20, 40) if (fix := fused.tick(at(n + 0.6))) is not None]
    assert [fix.state for fix in fixes] == [FixState.COASTING] * 5 + [FixState.SEARCHING]
    assert fixes[1].reasons == ("extrapolated for 36 ms",)
    assert not any(fix.valid for fix in fixes)
    errors = [np.linalg.norm(fix.position_mm - circle(fix.instant * 1e-9)) for fix in fixes[:5]]
    assert max(errors) < 1.0
    assert np.all(np.diff([np.trace(fix.cov_mm2) for fix in fixes[:5]]) > 0.0)
    assert np.isnan(fixes[-1].position_mm).all()
    assert fixes[-1].reasons == ("lost: no agreeing pair for 109 ms",)


def test_a_tick_while_pairs_come_on_time_or_a_little_late_makes_nothing_up() -> None:
    fused = tracking()
    for frame in range(20, 30):
        assert fused.tick(HostNs(at(frame) + 4_000_000)) is None
        fed(fused, pair(still, frame))
    assert fused.statistics().coasted == 0


def test_before_the_first_pair_a_tick_says_nothing() -> None:
    assert fuser().tick(at(100)) is None


def test_after_a_loss_the_target_is_unconfirmed_again() -> None:
    fused = tracking()
    for n in range(20, 40):
        fused.tick(at(n + 0.6))
    fixes = fed(fused, [one for frame in range(40, 46) for one in pair(still, frame)])
    assert [fix.state for fix in fixes] == [FixState.UNCONFIRMED] * 4 + [FixState.TRACKING] * 2


def test_one_station_alone_is_extrapolated_and_both_are_named() -> None:
    fused = tracking()
    assert fused.lost("right", "clipped at the left edge", at(20)) == []
    fed(fused, pair(still, 20)[:1])
    fix = fused.tick(at(20.6))
    assert fix is not None
    assert fix.reasons == ("extrapolated for 18 ms", "only one station: left", "right: clipped at the left edge")
    fed(fused, pair(still, 21))
    assert fused.tick(at(21.2)) is None


def test_a_stale_gimbal_says_its_age() -> None:
    fused = tracking()
    fused.lost("left", "the controller's status is 30 ms old", at(20))
    fix = fused.tick(at(20.6))
    assert fix is not None
    assert "left: the controller's status is 30 ms old" in fix.reasons


def shifted(one: Sightline, up_mm: float) -> Sightline:
    direction = one.direction + np.array((0.0, up_mm / one.range_mm, 0.0))
    return replace(one, direction=direction / np.linalg.norm(direction))


def test_lines_that_miss_each_other_do_not_move_the_fix() -> None:
    fused = tracking()
    left, right = pair(still, 20)
    (fix,) = fed(fused, [left, shifted(right, 3.1)])
    assert fix.state is FixState.COASTING
    assert fix.reasons == ("extrapolated for 18 ms", "miss distance 3.1 mm above 1 mm")
    assert np.allclose(fix.position_mm, still(0.0), atol=1e-3)
    (good,) = fed(fused, pair(still, 21))
    assert good.valid
    assert fused.statistics().refused == (("miss distance", 1),)


def test_lines_that_miss_each_other_before_confirmation_begin_it_anew() -> None:
    fused = fuser()
    fed(fused, [one for frame in range(3) for one in pair(still, frame)])
    left, right = pair(still, 3)
    (fix,) = fed(fused, [left, shifted(right, 5.0)])
    assert fix.state is FixState.UNCONFIRMED
    assert fix.reasons[0] == "unconfirmed: 0 of 5 agreeing pairs"
    assert fed(fused, pair(still, 4))[0].reasons == ("unconfirmed: 1 of 5 agreeing pairs",)


def test_a_sphere_of_another_size_is_another_target() -> None:
    left, right = pair(still, 0)
    fused = fuser()
    (fix,) = fed(fused, [replace(left, range_mm=left.range_mm / 2), right])
    assert fix.reasons[1] == "left: apparent diameter disagrees (as of 50.8 mm, set 25.4 mm)"


def test_a_jump_faster_than_the_target_can_move_is_refused_however_well_the_lines_agree() -> None:
    fused = tracking()
    (fix,) = fed(fused, pair(lambda _: still(0.0) + np.array((80.0, 0.0, 0.0)), 20))
    assert "jump of 80 mm in 18 ms" in fix.reasons
    assert np.allclose(fix.position_mm, still(0.0), atol=1e-3)


def test_a_jump_that_stays_is_lost_and_confirmed_anew() -> None:
    fused = tracking()
    there = still(0.0) + np.array((250.0, 0.0, 0.0))
    fixes = fed(fused, [one for frame in range(20, 36) for one in pair(lambda _: there, frame)])
    states = [fix.state for fix in fixes]
    assert states[:5] == [FixState.COASTING] * 5
    assert FixState.UNCONFIRMED in states
    assert states[-1] is FixState.TRACKING
    assert np.allclose(fixes[-1].position_mm, there, atol=1e-3)
    assert fused.statistics().losses == 1


def test_an_improbable_innovation_is_refused() -> None:
    fused = tracking(frames=60)
    (fix,) = fed(fused, pair(lambda _: still(0.0) + np.array((20.0, 0.0, 0.0)), 60))
    assert any(reason.startswith("innovation: chi2 ") and reason.endswith(" above 30") for reason in fix.reasons)
    assert fused.statistics().refused == (("innovation", 1),)


def test_an_old_exposure_is_not_valid() -> None:
    fused = tracking()
    left, right = pair(still, 20)
    fused.add(left, at(20))
    (fix,) = fused.add(right, HostNs(right.instant + 150_000_000))
    assert fix.state is FixState.TRACKING
    assert fix.reasons == ("too old: exposed 150 ms ago",)


def test_lines_that_do_not_meet_are_refused() -> None:
    fused = tracking()
    left, right = pair(still, 20)
    (fix,) = fed(fused, [left, replace(right, direction=-right.direction)])
    assert fix.state is FixState.COASTING
    assert "behind the camera of station right" in fix.reasons[1]
    assert fused.statistics().refused == (("degenerate", 1),)


def test_refused_lines_are_counted_beside_refused_pairs() -> None:
    fused = tracking(frames=10)
    left, _ = pair(still, 10)
    assert fused.add(replace(left, direction=left.direction * np.nan), at(10)) == []
    assert fused.add(replace(left, cov_rad2=np.zeros((3, 3))), at(10)) == []
    statistics = fused.statistics()
    assert statistics.refused == (("covariance not positive", 1), ("not finite", 1))
    assert (statistics.lines, statistics.pairs, statistics.fixes, statistics.losses) == (20, 10, 10, 0)


@pytest.mark.parametrize("model", ["constant_velocity", "constant_acceleration"])
def test_three_stations_go_on_with_two(model: str) -> None:
    fused = fuser(FusionSettings.model_validate({"model": model}), tuple(STATIONS))
    lines = [line(still, s, frame * PERIOD_NS) for frame in range(10) for s in STATIONS]
    assert fed(fused, lines)[-1].stations == tuple(STATIONS)
    fixes = []
    for frame in range(10, 15):
        assert fed(fused, pair(still, frame)) == []
        fixes += fused.lost("top", "not in view", at(frame))
    assert [fix.stations for fix in fixes] == [PAIR] * 5
    assert all(fix.valid for fix in fixes)
