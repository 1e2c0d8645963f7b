import numpy as np
import pytest
from made_lines import nees

from trackerd.contract.clock import HostNs
from trackerd.contract.model import Array
from trackerd.estimate.kalman import MotionFilter, MotionModel

COV = np.diag((0.02**2, 0.02**2, 0.05**2))
MODELS = {MotionModel.CONSTANT_VELOCITY: 3e4, MotionModel.CONSTANT_ACCELERATION: 3e4}


def wander(model: MotionModel, noise: float, rng: np.random.Generator, steps_ns: Array) -> Array:
    """Positions (n, 3) of a target that moves as the model says, from rest."""
    order = 2 if model is MotionModel.CONSTANT_VELOCITY else 3
    state, positions = np.zeros((order, 3)), []
    for step_ns in steps_ns:
        for _ in range(20):
            dt = step_ns * 1e-9 / 20
            state[-1] += rng.normal(0.0, np.sqrt(noise * dt), 3)
            for k in range(order - 2, -1, -1):
                state[k] += state[k + 1] * dt
        positions.append(state[0].copy())
    return np.array(positions)


@pytest.mark.parametrize(("model", "noise"), MODELS.items())
def test_the_covariance_of_a_target_that_moves_as_modelled_is_honest_at_irregular_instants(
    model: MotionModel, noise: float
) -> None:
    rng = np.random.default_rng(21)
    steps_ns = rng.integers(8_000_000, 40_000_000, 1500)
    path = wander(model, noise, rng, steps_ns)
    motion = MotionFilter(model, noise, gate_chi2=30.0)
    errors, covs, instant = [], [], 0
    for p, step_ns in zip(path, steps_ns, strict=True):
        instant += int(step_ns)
        assert motion.update(HostNs(instant), rng.multivariate_normal(p, COV), COV).accepted
        state = motion.predict(HostNs(instant))
        errors.append(state.p_mm - p)
        covs.append(state.cov_mm2)
    assert 0.85 < nees(np.array(errors)[50:], np.array(covs)[50:]) < 1.1


@pytest.mark.parametrize("model", MODELS)
def test_a_still_target_is_smoothed_and_its_speed_found(model: MotionModel) -> None:
    rng = np.random.default_rng(22)
    motion = MotionFilter(model, 1e3, gate_chi2=30.0)
    for n in range(400):
        p = np.array((1.0, 2.0, 3.0)) + 20.0 * n / 55
        motion.update(HostNs(n * 18_181_818), rng.multivariate_normal(p, COV), COV)
    state = motion.predict(HostNs(400 * 18_181_818))
    assert np.allclose(state.v_mm_s, 20.0, atol=2.0)
    assert np.allclose(state.p_mm, (1.0 + 20 * 400 / 55, 2.0 + 20 * 400 / 55, 3.0 + 20 * 400 / 55), atol=0.15)
    assert np.all(np.diag(motion.predict(HostNs(399 * 18_181_818)).cov_mm2) < np.diag(COV))


def test_predicting_does_not_move_the_filter_and_grows_the_covariance() -> None:
    motion = MotionFilter(MotionModel.CONSTANT_ACCELERATION, 1e4, gate_chi2=30.0)
    for n in range(20):
        motion.update(HostNs(n * 10_000_000), np.zeros(3), COV)
    before = motion.predict(HostNs(190_000_000))
    far = motion.predict(HostNs(290_000_000))
    again = motion.predict(HostNs(190_000_000))
    assert np.array_equal(before.p_mm, again.p_mm)
    assert np.all(np.diag(far.cov_mm2) > 10 * np.diag(before.cov_mm2))


def test_a_far_point_fails_the_gate_and_leaves_the_state_alone() -> None:
    motion = MotionFilter(MotionModel.CONSTANT_ACCELERATION, 1e4, gate_chi2=30.0)
    for n in range(30):
        motion.update(HostNs(n * 18_000_000), np.zeros(3), COV)
    innovation = motion.update(HostNs(30 * 18_000_000), np.array((50.0, 0.0, 0.0)), COV)
    assert not innovation.accepted
    assert innovation.chi2 > 30.0
    assert motion.instant == 29 * 18_000_000
    assert np.allclose(motion.predict(HostNs(29 * 18_000_000)).p_mm, 0.0)


def test_a_hard_turn_raises_the_process_noise_instead_of_losing_the_target() -> None:
    """At rest, then 5 m/s^2 from one frame to the next."""
    rng = np.random.default_rng(23)
    motion = MotionFilter(MotionModel.CONSTANT_ACCELERATION, 3e4, gate_chi2=30.0)
    errors = []
    for n in range(160):
        t_s = max(0.0, (n - 100) / 55)
        p = np.array((2500.0 * t_s**2, 0.0, 0.0))
        assert motion.update(HostNs(n * 18_181_818), rng.multivariate_normal(p, COV), COV).accepted
        errors.append(np.linalg.norm(motion.predict(HostNs(n * 18_181_818)).p_mm - p))
    assert np.max(errors[50:]) < 0.25
    calm = np.diag(motion.predict(HostNs(159 * 18_181_818)).cov_mm2)
    assert np.all(calm < np.diag(COV))


def test_an_older_point_is_not_accepted() -> None:
    motion = MotionFilter(MotionModel.CONSTANT_VELOCITY, 1e4, gate_chi2=30.0)
    motion.update(HostNs(100), np.zeros(3), COV)
    assert not motion.update(HostNs(100), np.zeros(3), COV).accepted
    assert not motion.update(HostNs(50), np.zeros(3), COV).accepted


def test_a_filter_without_a_point_has_no_state() -> None:
    motion = MotionFilter(MotionModel.CONSTANT_VELOCITY, 1e4, gate_chi2=30.0)
    assert motion.instant is None
    with pytest.raises(ValueError, match="without a point"):
        motion.predict(HostNs(0))
    motion.update(HostNs(0), np.zeros(3), COV)
    motion.reset()
    assert motion.instant is None
