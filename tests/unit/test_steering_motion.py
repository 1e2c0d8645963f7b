"""The target's motion in encoder angles: honest while it knows little, then ahead of the target by the loop's delay."""

import numpy as np
import pytest

from trackerd.contract.clock import HostNs
from trackerd.steering.motion import Motion, white_jerk

ARCSEC = np.pi / 648_000.0
FRAME_NS = 18_181_818


def fed(motion: Motion, path: object, frames: int, noise_rad: float = 0.0, seed: int = 0) -> HostNs:
    """Feeds `path(t_s) -> (az, el)`; the instant of the last frame."""
    random = np.random.default_rng(seed)
    instant = HostNs(0)
    for n in range(frames):
        instant = HostNs(n * FRAME_NS)
        az, el = path(instant * 1e-9)  # type: ignore[operator]
        motion.update(instant, az + noise_rad * random.standard_normal(), el + noise_rad * random.standard_normal())
    return instant


def test_nothing_is_predicted_before_anything_was_seen() -> None:
    assert Motion().predict(HostNs(0)) is None


@pytest.mark.parametrize(("frames", "rad_s"), [(1, 0.3), (2, 0.0002)])
def test_rates_are_zero_until_two_samples_stand_out_of_their_noise(frames: int, rad_s: float) -> None:
    motion = Motion()
    last = fed(motion, lambda t: (0.1, rad_s * t), frames)
    predicted = motion.predict(HostNs(last + FRAME_NS))
    assert predicted is not None
    assert (predicted.az_rad_s, predicted.el_rad_s) == (0.0, 0.0)


def test_a_target_that_flies_through_the_view_has_its_rate_after_two_samples() -> None:
    motion = Motion()
    last = fed(motion, lambda t: (0.1, 0.12 * t), 2)
    predicted = motion.predict(HostNs(last + FRAME_NS))
    assert predicted is not None
    assert predicted.el_rad_s == pytest.approx(0.12, rel=0.1)


def test_a_constant_velocity_is_known_after_three_samples() -> None:
    motion = Motion()
    last = fed(motion, lambda t: (0.1 + 0.2 * t, -0.05 * t), 3)
    predicted = motion.predict(HostNs(last + 30_000_000))
    assert predicted is not None
    assert (predicted.az_rad_s, predicted.el_rad_s) == pytest.approx((0.2, -0.05), rel=0.05)
    assert predicted.az_rad == pytest.approx(0.1 + 0.2 * (last * 1e-9 + 0.03), abs=5e-4)


def test_an_accelerating_target_is_predicted_a_loop_delay_ahead() -> None:
    motion, w = Motion(), 3.0

    def path(t: float) -> tuple[float, float]:
        return 0.5 / w**2 * np.sin(w * t), 0.5 / w**2 * np.cos(w * t)  # 0.5 rad/s^2: 1 m/s^2 at 2 m

    errors = []
    for frames in range(40, 140):
        motion.reset()
        last = fed(motion, path, frames, 2.0 * ARCSEC, seed=frames)
        then = HostNs(last + 30_000_000)
        predicted, truth = motion.predict(then), path(then * 1e-9)
        assert predicted is not None
        errors.append((predicted.az_rad - truth[0], predicted.el_rad - truth[1]))
    assert np.abs(errors).max() < 12 * 6.6 * ARCSEC


def test_a_target_at_rest_has_no_rate_however_noisy_its_angles() -> None:
    motion = Motion()
    for seed in range(20):
        motion.reset()
        last = fed(motion, lambda t: (0.1, 0.2), 40, 2.0 * ARCSEC, seed)
        predicted = motion.predict(HostNs(last + FRAME_NS))
        assert predicted is not None
        assert (predicted.az_rad_s, predicted.el_rad_s) == (0.0, 0.0)


def test_a_long_gap_starts_anew_and_old_stamps_are_ignored() -> None:
    motion = Motion()
    last = fed(motion, lambda t: (0.2 * t, 0.0), 10)
    motion.update(HostNs(last - 1), 9.0, 9.0)
    motion.update(last, 9.0, 9.0)
    assert motion.samples == 10
    motion.update(HostNs(last + 600_000_000), 1.0, 1.0)
    assert motion.samples == 1


def test_a_prediction_far_ahead_goes_on_with_a_constant_velocity() -> None:
    motion = Motion()
    last = fed(motion, lambda t: (0.25 * t * t, 0.0), 60)
    near, far = (motion.predict(HostNs(last + ms * 1_000_000)) for ms in (100, 300))
    assert near is not None
    assert far is not None
    assert far.az_rad_s == near.az_rad_s
    assert far.az_rad == pytest.approx(near.az_rad + 0.2 * near.az_rad_s)


def test_reset_forgets() -> None:
    motion = Motion()
    fed(motion, lambda t: (t, t), 10)
    motion.reset()
    assert motion.predict(HostNs(0)) is None


def test_two_steps_of_white_jerk_are_one_step_of_twice_the_length() -> None:
    def step(dt_s: float) -> np.ndarray:
        return np.array(((1.0, dt_s, 0.5 * dt_s**2), (0.0, 1.0, dt_s), (0.0, 0.0, 1.0)))

    twice = step(0.02) @ white_jerk(0.02) @ step(0.02).T + white_jerk(0.02)
    assert twice == pytest.approx(white_jerk(0.04), rel=1e-9)
