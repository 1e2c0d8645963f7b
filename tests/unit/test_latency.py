"""How late encoders are, from a sweep: found with a true sigma, or a refusal that says what it needs."""

import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from unit.made_sweeps import ARCSEC, STATIONS, Made

from trackerd.calibrate.latency import Latency, latency_of
from trackerd.calibrate.latency_plot import draw
from trackerd.calibrate.sweep import Sweep, sweep_of_history, sweep_of_latches
from trackerd.contract.errors import TrackerdError, Undetermined
from trackerd.contract.model import Array
from trackerd.geometry.gimbal import AxisOrder
from trackerd.geometry.rigid import Rigid

READ: dict[str, Callable[[Made], Sweep]] = {"latched": Made.latched, "history": Made.historied}


def found(made: Made, read: str = "latched") -> Latency:
    return latency_of(made.believed, READ[read](made))


def errors_us(made: Made, latency: Latency) -> Array:
    return np.asarray(latency.offset_s * 1e6 - np.array(made.late_us))


def off(made: Made, latency: Latency) -> float:
    """The larger error in its own sigmas."""
    return float(np.abs(errors_us(made, latency) / (latency.sigma_s * 1e6)).max())


# ---- the figures -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("read", "limit_us"), [("latched", 5.0), ("history", 2.5)])
def test_three_seconds_tell_the_latency_with_a_true_sigma(read: str, limit_us: float) -> None:
    """Encoders of 2 arcsec white and 2 arcsec as a function of the angle; a calibration that is a little off."""
    errors, squares, chi2 = [], [], []
    for seed in range(12):
        for station in STATIONS.values():
            made = Made(seed, station, fixed_arcsec=2.0)
            latency = found(made, read)
            errors.append(errors_us(made, latency))
            squares.append(errors[-1] @ np.linalg.solve(latency.cov_s2 * 1e12, errors[-1]) / 2.0)
            chi2.append(latency.chi2 / latency.freedom)
    assert np.sqrt(np.mean(np.square(errors))) < limit_us
    assert np.all(np.abs(np.mean(errors, axis=0)) < 4.0 * np.std(errors, axis=0) / np.sqrt(len(errors)))
    assert 0.7 < np.mean(squares) < 1.35
    assert 0.9 < np.mean(chi2) < 1.1


def test_without_noise_the_latency_is_exact() -> None:
    made = Made(white_arcsec=0.0, pixel_px=1e-4, pace_hz=(1.1, 1.3))
    assert np.abs(errors_us(made, found(made))).max() < 0.1


@pytest.mark.parametrize("order", AxisOrder)
@pytest.mark.parametrize("lever_mm", [0.0, -124.5])
def test_any_gimbal_will_do(order: AxisOrder, lever_mm: float) -> None:
    lever = np.array((0.0, lever_mm, 40.0) if order is AxisOrder.AZ_OUTER else (lever_mm, 0.0, 40.0))
    camera = Rigid(STATIONS["left"].rg_from_camera.rotation, lever)
    made = Made(station=replace(STATIONS["left"], order=order, az_sign=-1, rg_from_camera=camera), late_us=(-120.0, 60.0))
    latency = found(made)
    assert off(made, latency) < 3.5
    assert latency.sigma_s.max() < 5e-6


def test_a_rough_range_is_enough() -> None:
    made = Made()
    near, far = (latency_of(made.believed, made.latched(), range_mm) for range_mm in (1500.0, 2600.0))
    assert np.allclose(near.offset_s, far.offset_s, atol=0.5e-6)


def test_axes_that_are_equally_late_are_given_one_latency_and_others_are_told_apart() -> None:
    same, other = found(Made(late_us=(250.0, 250.0))), found(Made(late_us=(250.0, 200.0)))
    assert same.apart < 3.0 < other.apart
    assert same.common_s == pytest.approx(250e-6, abs=4.0 * same.common_sigma_s)
    assert same.common_sigma_s < same.sigma_s.min()


def test_frames_that_are_missing_or_badly_measured_cost_only_themselves() -> None:
    made, rng = Made(seconds=4.0), np.random.default_rng(3)
    seen = made.sightings()
    angles = made.readings(seen.t_s, rng)
    q_px = seen.q_px.copy()
    q_px[10:220:23] += (40.0, -25.0)
    kept = np.ones(len(q_px), bool)
    kept[[50, 51, 52, 100, 101]] = False
    seen = replace(seen, t_s=seen.t_s[kept], q_px=q_px[kept], cov_px2=seen.cov_px2[kept])
    latency = latency_of(made.believed, sweep_of_latches(seen, angles[kept], 2.0 * ARCSEC))
    assert off(made, latency) < 3.5
    assert 8 <= latency.left_out <= 11
    assert len(latency.rates_rad_s) < kept.sum() - 4


def test_a_target_that_drifts_slowly_does_no_harm() -> None:
    made = Made(moves_mm=lambda t_s: np.outer(t_s, (0.1, -0.05, 0.2)))
    latency = found(made)
    assert off(made, latency) < 3.5
    assert latency.chi2 / latency.freedom < 1.3


def test_a_triangle_tells_the_latency_and_what_it_cannot_tell() -> None:
    made = Made(kind="triangle")
    latency = found(made, "history")
    assert off(made, latency) < 3.5
    assert len(latency.notes) == 2
    assert all("at one speed only: a hysteresis would pass for a latency" in note for note in latency.notes)


def test_turns_that_are_too_sharp_for_one_latch_a_frame_are_refused_or_do_no_harm() -> None:
    refused = 0
    for seed in range(10):
        made = Made(seed, kind="triangle")
        try:
            assert off(made, found(made)) < 4.0
        except Undetermined as error:
            assert "turns too sharp for the frame rate" in str(error)  # noqa: PT017 - some are refused, not all
            refused += 1
    assert 0 < refused < 10


def test_a_sine_bounds_what_a_hysteresis_would_do() -> None:
    latency = found(Made())
    assert latency.notes == ()
    assert np.all(latency.loose_sigma_s > 2.0 * latency.sigma_s)
    assert np.abs((latency.loose_s * 1e6 - np.array((250.0, -80.0))) / (latency.loose_sigma_s * 1e6)).max() < 3.5


def test_the_history_tells_the_noise_of_the_encoders_itself() -> None:
    quiet, loud = (Made(white_arcsec=arcsec).historied().sigma_rad for arcsec in (0.5, 4.0))
    assert loud / quiet == pytest.approx(8.0, rel=0.05)
    assert 0.3 < loud / (4.0 * ARCSEC) < 0.6  # a cubic through 17 samples


def test_frames_outside_the_history_are_left_out() -> None:
    made = Made()
    t_s, angles = made.history()
    seen, inside = made.sightings(), (t_s > 1.0) & (t_s < 2.5)
    sweep = sweep_of_history(seen, t_s[inside], angles[inside])
    assert 1.0 < sweep.t_s[0] < 1.03
    assert 2.47 < sweep.t_s[-1] < 2.5


# ---- refusals --------------------------------------------------------------------------------------------------------


def circling(t_s: Array) -> Array:
    return np.column_stack((5.0 * np.cos(1.7 * t_s), 5.0 * np.sin(1.7 * t_s), 0.0 * t_s))


def shaking(t_s: Array) -> Array:
    return np.column_stack((0.2 * np.sin(2.0 * np.pi * 23.0 * t_s), 0.2 * np.cos(2.0 * np.pi * 17.0 * t_s), 0.0 * t_s))


@pytest.mark.parametrize(
    ("made", "words"),
    [
        (Made(kind="one way"), "the AZ axis moves one way in 100% and the other in 0% of the frames"),
        (Made(swing_deg=(1.2, 0.0)), "the EL axis does not sweep"),
        (
            Made(swing_deg=(0.2, 0.9)),
            r"the AZ axis' latency is known to \d+ us only, 10 us are needed: sweep [2-3]\.\d times as",
        ),
        (Made(pace_hz=(0.3, 3.1)), r"the AZ axis' latency is known to \d+ us only"),
        (Made(seconds=0.7), r"34 frames of the sweep are usable, 40 are needed: sweep for 3 s or longer"),
        (Made(seconds=0.05), "3 frames with the target and angles: a sweep needs a hundred"),
        (Made(moves_mm=circling), "the target moves|the target or the stand moves"),
        (Made(moves_mm=shaking), "the target or the stand moves or shakes"),
        (Made(hysteresis_arcsec=4.0), "which is no latency: backlash or friction"),
        (Made(smear_arcsec=10.0), "which is no latency: backlash or friction between encoder and camera, smear"),
        (Made(late_us=(5200.0, 5200.0)), r"the angles are \+5\.2 ms late, more than 3 ms: they are another frame's"),
        (Made(exposure_s=0.004), r"smeared by \d+ px at the highest speed, 20 px are the most: expose \d\.\d times shorter"),
    ],
    ids=lambda value: "" if isinstance(value, Made) else re.sub(r"[^a-zA-Z ]", "", str(value))[:30],
)
def test_what_does_not_tell_it_is_refused_with_what_would(made: Made, words: str) -> None:
    with pytest.raises(Undetermined, match=words):
        found(made)


def test_a_sweep_whose_speed_is_a_function_of_the_angle_is_refused() -> None:
    """To and fro, but the way back is at another place: a latency and an error of the encoder are one and the same."""
    sweep = Made(seconds=4.0).latched()
    t_s = sweep.t_s - sweep.t_s[0]
    there = t_s < 2.0
    angles = np.where(there, 0.01 * t_s, 0.03 - 0.01 * (t_s - 2.0) - 0.1)[:, None] * np.ones(2)
    rates = np.where(there, 0.01, -0.01)[:, None] * np.ones(2)
    two = replace(sweep, angles_rad=sweep.angles_rad[0] + angles, rates_rad_s=rates)
    with pytest.raises(Undetermined, match="the AZ axis passes each angle at one speed only"):
        latency_of(STATIONS["left"], two)


@pytest.mark.parametrize("name", ["t_s", "q_px", "angles_rad", "rates_rad_s"])
def test_what_is_not_finite_is_refused(name: str) -> None:
    sweep = Made().latched()
    spoilt = getattr(sweep, name).copy()
    spoilt[5] = np.nan
    with pytest.raises(Undetermined, match="not a finite number"):
        latency_of(STATIONS["left"], replace(sweep, **{name: spoilt}))


def test_a_covariance_that_is_none_is_refused() -> None:
    sweep = replace(Made().latched(), sigma_rad=0.0)
    with pytest.raises(Undetermined, match="covariance that is not positive"):
        latency_of(STATIONS["left"], replace(sweep, cov_px2=0.0 * sweep.cov_px2))


def test_shuffled_frames_and_samples_are_refused() -> None:
    made = Made()
    seen, (t_s, angles) = made.sightings(), made.history()
    shuffled = replace(seen, t_s=seen.t_s[::-1])
    with pytest.raises(Undetermined, match="instants of the frames do not rise"):
        sweep_of_latches(shuffled, np.zeros((len(seen.t_s), 2)), 2.0 * ARCSEC)
    with pytest.raises(Undetermined, match="instants of the frames do not rise"):
        sweep_of_history(shuffled, t_s, angles)
    with pytest.raises(Undetermined, match="instants of the encoder samples do not rise"):
        sweep_of_history(seen, t_s * np.nan, angles)


def test_a_history_that_covers_no_frame_is_refused() -> None:
    made = Made()
    t_s, angles = made.history()
    with pytest.raises(Undetermined, match="no frame has 6 encoder samples within 8 ms of it on both sides"):
        sweep_of_history(made.sightings(), t_s + 100.0, angles)


def test_frames_with_gaps_everywhere_are_refused() -> None:
    made = Made()
    seen, kept = made.sightings(), np.arange(165) % 5 < 2
    seen = replace(seen, t_s=seen.t_s[kept], q_px=seen.q_px[kept], cov_px2=seen.cov_px2[kept])
    with pytest.raises(Undetermined, match="gaps everywhere"):
        sweep_of_latches(seen, made.readings(seen.t_s, np.random.default_rng(1)), 2.0 * ARCSEC)


# ---- the plot --------------------------------------------------------------------------------------------------------


def test_the_plot_tells_the_latencies_before_and_after(tmp_path) -> None:
    made = Made()
    latency = found(made)
    slope = [np.polyfit(latency.rates_rad_s[:, i], latency.before_rad[:, i], 1)[0] for i in range(2)]
    assert np.allclose(slope, latency.offset_s, atol=3e-6)
    draw(latency, "left: a sweep", tmp_path / "latency.svg")
    text = (tmp_path / "latency.svg").read_text()
    for words in ("left: a sweep", "AZ axis", "EL axis", "speed, deg/s", f"AZ {latency.offset_s[0] * 1e6:+.1f}"):
        assert words in text
    with pytest.raises(TrackerdError, match="cannot be written"):
        draw(latency, "left", tmp_path / "missing" / "latency.svg")
