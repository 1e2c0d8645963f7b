"""Whatever is done to the data of a cell, it is calibrated right or refused: never wrong with a good face."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from unit.made_cells import Cell, calibration_error_mm, cell, predicted_mm, probe_data

from trackerd.calibrate.cell import Observations, Options, Targets, calibrate_cell
from trackerd.contract.errors import ConfigError, Undetermined
from trackerd.geometry.gimbal import AxisOrder

Spoil = Callable[[Observations, Targets, np.random.Generator], tuple[Observations, Targets]]
RIGHT = 5.0  # times the error that the calibration says of itself


def a_fifth(seen: Observations, rng: np.random.Generator) -> np.ndarray:
    return rng.choice(len(seen), len(seen) // 5, replace=False)


def pixels_anywhere(seen: Observations, targets: Targets, rng: np.random.Generator) -> tuple[Observations, Targets]:
    q = seen.q_px.copy()
    bad = a_fifth(seen, rng)
    q[bad] += rng.normal(0.0, 10.0 ** rng.uniform(0.5, 3.0), (len(bad), 2))
    return replace(seen, q_px=q), targets


def points_mixed_up(seen: Observations, targets: Targets, rng: np.random.Generator) -> tuple[Observations, Targets]:
    point = seen.point.copy()
    bad = a_fifth(seen, rng)
    point[bad] = rng.permutation(point[bad])
    return replace(seen, point=point), targets


def angles_jumped(seen: Observations, targets: Targets, rng: np.random.Generator) -> tuple[Observations, Targets]:
    angles = seen.angles_rad.copy()
    views = rng.choice(len(angles), len(angles) // 5, replace=False)
    angles[views] += rng.normal(0.0, 10.0 ** rng.uniform(-3.5, -1.0), (len(views), 2))
    return replace(seen, angles_rad=angles), targets


def views_shuffled(seen: Observations, targets: Targets, rng: np.random.Generator) -> tuple[Observations, Targets]:
    order = rng.permutation(len(seen.gimbal))
    order = order[np.argsort(seen.gimbal[order], kind="stable")]
    return replace(seen, angles_rad=seen.angles_rad[order]), targets


def degrees(seen: Observations, targets: Targets, rng: np.random.Generator) -> tuple[Observations, Targets]:
    return replace(seen, angles_rad=np.degrees(seen.angles_rad)), targets


def targets_moved(seen: Observations, targets: Targets, rng: np.random.Generator) -> tuple[Observations, Targets]:
    """A tenth of the points is 1 to 100 mm from where the list says."""
    p_mm = targets.p_mm.copy()
    bad = rng.choice(len(p_mm), max(1, len(p_mm) // 10), replace=False)
    p_mm[bad] += rng.normal(0.0, 10.0 ** rng.uniform(0.0, 2.0), (len(bad), 3))
    return seen, replace(targets, p_mm=p_mm)


def one_axis_reversed(seen: Observations, targets: Targets, rng: np.random.Generator) -> tuple[Observations, Targets]:
    return replace(seen, angles_rad=seen.angles_rad * np.array([(1.0, -1.0), (-1.0, 1.0)][int(rng.integers(2))])), targets


def right_or_refused(made: Cell, seen: Observations, targets: Targets) -> bool:
    """True where it is calibrated."""
    try:
        result = calibrate_cell(seen, targets, made.nominal, Options(more_distortion=False))
    except (ConfigError, Undetermined):
        return False
    assert calibration_error_mm(made, result) < RIGHT * predicted_mm(result)
    return True


@given(
    st.integers(0, 10_000),
    st.sampled_from(
        [pixels_anywhere, points_mixed_up, angles_jumped, views_shuffled, degrees, targets_moved, one_axis_reversed]
    ),
)
@settings(max_examples=10, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
def test_spoilt_data_are_calibrated_right_or_refused(seed: int, spoil: Spoil) -> None:
    rng = np.random.default_rng(seed)
    made = cell(rng, f_px=float(rng.choice([8000.0, 18900.0, 31000.0])))
    right_or_refused(made, *spoil(*probe_data(made, rng, 16), rng))


@given(st.integers(0, 10_000), st.sampled_from(AxisOrder), st.sampled_from([(1, 1), (1, -1), (-1, 1), (-1, -1)]))
@settings(max_examples=8, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
def test_sound_data_are_calibrated_right(seed: int, order: AxisOrder, signs: tuple[int, int]) -> None:
    rng = np.random.default_rng(seed)
    made = cell(rng, order=order, signs=signs)
    nominal = {name: replace(s, order=order, az_sign=signs[0], el_sign=signs[1]) for name, s in made.nominal.items()}
    assert right_or_refused(Cell(made.true, nominal), *probe_data(made, rng, 15))
