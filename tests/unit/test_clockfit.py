from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pytest

from trackerd.contract.clock import HostNs
from trackerd.estimate.clockfit import ClockFit, OneWayFit, Sample

OFFSET_NS = -123_456_789_000_000
START_NS = 1_000_000_000_000


@dataclass(frozen=True)
class Exchange:
    device_ns: int
    sent: HostNs
    received: HostNs
    true_ns: float


def exchanges(
    seed: int, rate: float, duration_s: float = 12.0, rate_hz: float = 200.0, jump_ns: int = 0, jump_s: float = 1e9
) -> Iterator[Exchange]:
    """Request and reply are each delayed by 60 us and a log-normal share; the device counts whole microseconds."""
    rng = np.random.default_rng(seed)
    for n in range(int(duration_s * rate_hz)):
        there, back = 60e3 + 40e3 * np.exp(0.8 * rng.standard_normal(2))
        true_ns = START_NS + n * 1e9 / rate_hz + there
        jumped = jump_ns if n / rate_hz >= jump_s else 0
        device_ns = int((true_ns - START_NS) * (1 + rate)) // 1000 * 1000 + START_NS + OFFSET_NS + jumped
        yield Exchange(device_ns, HostNs(int(true_ns - there)), HostNs(int(true_ns + back)), true_ns)


def errors_and_sigmas(fit: ClockFit, stream: Iterator[Exchange]) -> np.ndarray:
    """(n, 3): seconds, error in ns, sigma in ns of every exchange from the first that can be converted on."""
    rows = []
    for x in stream:
        fit.add(x.device_ns, x.sent, x.received)
        converted = fit.host(x.device_ns)
        if converted is not None:
            rows.append(((x.sent - START_NS) * 1e-9, converted[0] - x.true_ns, converted[1]))
    return np.array(rows)


@pytest.mark.parametrize("rate", [0.0, 80e-6, -300e-6])
@pytest.mark.parametrize("seed", [1, 2])
def test_a_converged_fit_is_unbiased_and_its_sigma_honest(rate: float, seed: int) -> None:
    fit = ClockFit()
    rows = errors_and_sigmas(fit, exchanges(seed, rate))
    late = rows[rows[:, 0] > 5.0]
    assert abs(late[:, 1].mean()) < 3e3
    assert late[:, 1].std() < 3e3
    assert np.all(np.abs(late[:, 1]) < 3 * late[:, 2])
    assert late[-1, 2] < 30e3
    assert fit.statistics().rate_ppm == pytest.approx(-rate * 1e6, abs=1.0)
    assert fit.statistics().samples == len(rows) + 7


@pytest.mark.parametrize("rate", [0.0, 80e-6, -100e-6])
@pytest.mark.parametrize("seed", [3, 4])
def test_it_is_usable_after_a_few_samples_and_does_not_jump_later(rate: float, seed: int) -> None:
    rows = errors_and_sigmas(ClockFit(), exchanges(seed, rate, duration_s=4.0))
    assert rows[0, 0] < 0.05
    assert np.abs(rows[:, 1]).max() < 60e3
    assert np.all(np.abs(rows[:, 1]) < 3 * rows[:, 2])
    settled = rows[rows[:, 0] > 0.1]
    assert np.abs(np.diff(settled[:, 1])).max() < 50e3


def test_unequal_delays_shift_the_clock_by_half_their_difference_and_the_sigma_covers_it() -> None:
    rng = np.random.default_rng(5)
    fit = ClockFit()
    for n in range(1000):
        there, back = 50e3 + 5e3 * rng.random(), 80e3 + 5e3 * rng.random()
        true_ns = int(n * 5e6 + there)
        fit.add(true_ns, HostNs(int(n * 5e6)), HostNs(int(true_ns + back)))
    converted = fit.host(true_ns)
    assert converted is not None
    assert converted[0] - true_ns == pytest.approx(15e3, abs=2e3)
    assert converted[1] > 15e3


def test_a_busy_second_does_not_move_the_clock() -> None:
    rng = np.random.default_rng(6)
    fit, errors = ClockFit(), []
    for n, x in enumerate(exchanges(6, 50e-6, duration_s=8.0)):
        busy_ns = int(2e6 * rng.random()) if 800 <= n < 1000 else 0
        fit.add(x.device_ns, x.sent, HostNs(x.received + busy_ns))
        converted = fit.host(x.device_ns)
        if converted is not None and n > 600:
            errors.append(converted[0] - x.true_ns)
    assert np.abs(errors).max() < 15e3


@pytest.mark.parametrize("jump_ns", [20_000_000, -3_000_000_000])
def test_a_step_of_the_devices_clock_is_reported_and_starts_the_fit_again(jump_ns: int) -> None:
    fit, answers, errors = ClockFit(), [], []
    for x in exchanges(7, 20e-6, duration_s=6.0, jump_ns=jump_ns, jump_s=3.0):
        answers.append(fit.add(x.device_ns, x.sent, x.received))
        converted = fit.host(x.device_ns)
        if converted is not None and x.sent - START_NS > 3.2e9:
            errors.append(converted[0] - x.true_ns)
    assert answers.count(Sample.STEPPED) == fit.statistics().steps == 1
    assert answers.count(Sample.REFUSED) == fit.statistics().refused == 2
    assert np.abs(errors).max() < 60e3


def test_one_stray_stamp_is_refused_and_nothing_starts_again() -> None:
    fit = ClockFit()
    for n, x in enumerate(exchanges(8, 0.0, duration_s=2.0)):
        stray = 50_000_000 if n == 200 else 0
        assert fit.add(x.device_ns + stray, x.sent, x.received) is (Sample.REFUSED if stray else Sample.TAKEN)
    assert fit.ready


def test_a_bracket_that_ends_before_it_begins_is_refused() -> None:
    fit = ClockFit()
    assert fit.add(0, HostNs(10), HostNs(9)) is Sample.REFUSED
    assert fit.host(0) is None


def test_reset_forgets_the_clock_and_keeps_the_count() -> None:
    fit = ClockFit()
    errors_and_sigmas(fit, exchanges(9, 0.0, duration_s=1.0))
    fit.reset()
    assert not fit.ready
    assert fit.host(START_NS) is None
    assert fit.statistics().samples == 200
    assert fit.statistics().sigma_ns == float("inf")


def arrivals(seed: int, rate: float, duration_s: float = 20.0) -> Iterator[tuple[int, HostNs, float]]:
    """Frames at 55 fps, stamped at mid-exposure, complete 5 ms later and handed over after a log-normal delay."""
    rng = np.random.default_rng(seed)
    for n in range(int(duration_s * 55)):
        true_ns = n * 1e9 / 55
        yield int(true_ns * (1 + rate)), HostNs(int(true_ns + 5e6 + 30e3 * np.exp(0.8 * rng.standard_normal()))), true_ns


@pytest.mark.parametrize("rate", [0.0, 100e-6])
def test_a_one_way_stream_is_fitted_through_its_least_delays(rate: float) -> None:
    fit, rows = OneWayFit(delay_ns=5_000_000), []
    for device_ns, arrived, true_ns in arrivals(10, rate):
        assert fit.add(device_ns, arrived) is Sample.TAKEN
        converted = fit.host(device_ns)
        if converted is not None and true_ns > 8e9:
            rows.append((converted[0] - true_ns, converted[1]))
    errors = np.array(rows)[:, 0]
    assert 0.0 < errors.mean() < 30e3
    assert errors.std() < 10e3
    assert fit.statistics().gap_ns == 0.0


def test_a_camera_that_is_late_for_a_while_has_not_stepped_but_one_ahead_has() -> None:
    fit = OneWayFit()
    stream = list(arrivals(11, 0.0, duration_s=5.0))
    for device_ns, arrived, _ in stream[:200]:
        fit.add(device_ns, arrived)
    late = [fit.add(device_ns, HostNs(arrived + 30_000_000)) for device_ns, arrived, _ in stream[200:230]]
    assert set(late) == {Sample.REFUSED}
    ahead = [fit.add(device_ns + 30_000_000, arrived) for device_ns, arrived, _ in stream[230:240]]
    assert ahead[:3] == [Sample.REFUSED, Sample.REFUSED, Sample.STEPPED] or Sample.STEPPED in ahead[:3]
