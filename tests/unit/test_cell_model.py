"""The batched model of the calibration against the stations' own code and against finite differences."""

from dataclasses import replace

import numpy as np
import pytest
from made_cells import cell, turned

from trackerd.calibrate.cell import board, join, known_points, mover, unknown_points, with_bars
from trackerd.calibrate.cell.aiming import aim
from trackerd.calibrate.cell.known import freed, known_of, target_columns
from trackerd.calibrate.cell.model import linearise
from trackerd.calibrate.cell.normal import assemble, columns_of, evaluate
from trackerd.calibrate.cell.observations import Observations
from trackerd.calibrate.cell.options import ARCSEC, Options
from trackerd.calibrate.cell.problem import Problem, problem_of
from trackerd.calibrate.cell.state import (
    STATION_NAMES,
    State,
    difference,
    exponentials,
    layout_of,
    logarithms,
    moved,
    points_in_world,
    state_of,
)
from trackerd.calibrate.cell.targets import Targets
from trackerd.calibrate.cell.weights import everyone
from trackerd.contract.errors import Degenerate
from trackerd.contract.model import Array
from trackerd.geometry.gimbal import AxisOrder, Station
from trackerd.geometry.lens import Lens
from trackerd.geometry.rigid import Rigid

WIDE = Lens((2048, 1536), 3000.0, 3010.0, 1020.0, 770.0, (-0.1, 0.02, 0.001, -0.002, 0.03))


def stations() -> list[Station]:
    mount = Rigid(turned((0.01, 0.02, -0.015)), np.array((1.0, -124.5, 40.0)))
    left = Rigid(turned((0.02, 0.1, 0.03)), np.array((-550.0, 10.0, -1900.0)))
    right = Rigid(turned((0.01, -0.1, 0.03)), np.array((550.0, 10.0, -1900.0)))
    return [
        Station("left", left, mount, WIDE, AxisOrder.AZ_OUTER, 1, -1, 3e-4, 0.05),
        Station("right", right, mount, WIDE, AxisOrder.EL_OUTER, -1, 1, -2e-4, -0.3),
    ]


def many_targets() -> Targets:
    """Known, exact and inexact, on a board, of a mover, unknown, with bars between bodies."""
    rng = np.random.default_rng(1)
    pose = Rigid(turned((0.4, -0.2, 0.3)), np.array((20.0, -30.0, 10.0)))
    robot = mover(
        "robot", exponentials(rng.normal(0, 1, (3, 3))), rng.normal(0, 80, (3, 3)), (10.0, 20.0, 30.0),
        sigma_mm=0.1, ball_sigma_mm=5.0, world_from_base=pose,
    )  # fmt: skip
    parts = join(
        known_points(rng.normal(0, 100, (3, 3)), ["a", "b", "c"]),
        known_points(rng.normal(0, 100, (2, 3)), ["d", "e"], cov_mm2=0.04),
        board("plate", rng.normal(0, 40, (4, 3)), pose),
        robot,
        unknown_points(["x", "y"], rng.normal(0, 100, (2, 3))),
    )
    return with_bars(parts, [("a", "x"), ("plate:0", "robot:1"), ("d", "y")], 100.0, 0.01)


def scene() -> tuple[State, Targets, Array, Array, Array, Array]:
    """Six views, in each of which all points are seen."""
    targets = many_targets()
    gimbal = np.array([0, 1, 0, 1, 0, 1])
    angles = np.random.default_rng(2).normal(0.0, 0.03, (6, 2))
    view, point = np.repeat(np.arange(6), len(targets)), np.tile(np.arange(len(targets)), 6)
    state = replace(state_of(stations(), targets), delta_mm=np.random.default_rng(3).normal(0, 0.1, (len(targets), 3)))
    return state, targets, gimbal, angles, view, point


def observed() -> tuple[Observations, State, Targets]:
    state, targets, gimbal, angles, view, point = scene()
    q = linearise(state, targets, gimbal, angles, view, point).q_px
    rng = np.random.default_rng(4)
    seen = Observations(
        ("left", "right"), tuple(str(i) for i in range(6)), gimbal, angles, np.full(6, 30 * ARCSEC), np.zeros(6),
        view, point, q + rng.normal(0, 0.5, q.shape), rng.uniform(0.2, 0.6, len(q)),
    )  # fmt: skip
    return seen, state, targets


def test_pixels_are_those_of_the_stations_in_both_orders_and_signs() -> None:
    state, targets, gimbal, angles, view, point = scene()
    linear = linearise(state, targets, gimbal, angles, view, point)
    world, _ = points_in_world(state, targets, point)
    for i in range(0, len(view), 5):
        station = stations()[gimbal[view[i]]]
        assert np.allclose(station.pixel(world[i], *angles[view[i]]), linear.q_px[i], atol=1e-9)


def test_derivatives_are_those_of_finite_differences() -> None:
    state, targets, gimbal, angles, view, point = scene()
    layout = layout_of(2, targets, np.arange(len(targets)))
    linear = linearise(state, targets, gimbal, angles, view, point)
    claimed = np.zeros((len(view), 2, layout.columns))
    rows = np.arange(len(view))[:, None]
    for k in range(2):
        mine = gimbal[view] == k
        claimed[mine, :, 23 * k : 23 * k + 23] = linear.station[mine]
    body_at = layout.bodies_at + 9 * targets.body[point][:, None] + np.arange(9)
    claimed[rows, :, body_at] = linear.body.transpose(0, 2, 1)
    own = layout.slot[point] >= 0
    point_at = layout.points_at + 3 * layout.slot[point][own][:, None] + np.arange(3)
    claimed[rows[own], :, point_at] = linear.point[own].transpose(0, 2, 1)
    for column in range(layout.columns):
        small = column < 46 and STATION_NAMES[column % 23].endswith("rad")
        step = np.zeros(layout.columns)
        step[column] = 1e-6 if small else 1e-4
        plus, minus = (
            linearise(moved(state, sign * step, layout), targets, gimbal, angles, view, point).q_px for sign in (1, -1)
        )
        found = (plus - minus) / (2 * step[column])
        assert np.allclose(claimed[:, :, column], found, atol=2e-7 * max(1.0, np.abs(found).max())), column


def test_derivatives_by_the_encoders_are_those_of_finite_differences() -> None:
    state, targets, gimbal, angles, view, point = scene()
    linear = linearise(state, targets, gimbal, angles, view, point)
    for axis in range(2):
        step = np.zeros(2)
        step[axis] = 1e-6
        plus, minus = (linearise(state, targets, gimbal, angles + s * step, view, point).q_px for s in (1, -1))
        assert np.allclose(linear.encoder[:, :, axis], (plus - minus) / 2e-6, rtol=1e-6, atol=1e-4)


def problem_for(seen: Observations, targets: Targets, options: Options | None = None) -> tuple[Problem, Array]:
    options = options or Options(distortion=5)
    allowed, held = freed(stations(), options, options.distortion)
    problem = problem_of(seen, targets, known_of(stations(), targets, options, allowed, held), options.square_pixels)
    return problem, np.concatenate([np.flatnonzero(allowed), target_columns(problem)])


@pytest.mark.parametrize("bodies_apart", [False, True], ids=["views of several bodies", "views of one point"])
def test_the_normal_equations_are_those_of_whitened_rows(bodies_apart: bool) -> None:
    """Dense: px^2 I + E sigma_e^2 E^T of each view, priors and bars as rows."""
    seen, state, targets = observed()
    if bodies_apart:
        n = len(seen)
        seen = replace(
            seen, views=tuple(str(i) for i in range(n)), gimbal=seen.gimbal[seen.view], angles_rad=seen.angles_rad[seen.view],
            encoder_sigma_rad=seen.encoder_sigma_rad[seen.view], encoder_fixed_rad=np.zeros(n), view=np.arange(n),
        )  # fmt: skip
    problem, free = problem_for(seen, targets)
    layout, linear = problem.layout, evaluate(problem, state)
    normal = assemble(problem, state, linear, everyone(problem), columns_of(free, problem))
    p = layout.columns
    information, gradient, cost = np.zeros((p, p)), np.zeros(p), 0.0
    for v in range(problem.v):
        rows = seen.of_view(v)
        jacobian = np.zeros((len(rows), 2, p))
        for i, row in enumerate(rows):
            b, k, slot = targets.body[seen.point[row]], seen.gimbal[v], layout.slot[seen.point[row]]
            jacobian[i, :, 23 * k : 23 * k + 23] = linear.station[row]
            jacobian[i, :, layout.bodies_at + 9 * b : layout.bodies_at + 9 * b + 9] = linear.body[row]
            if slot >= 0:
                jacobian[i, :, layout.points_at + 3 * slot : layout.points_at + 3 * slot + 3] = linear.point[row]
        jacobian = jacobian.reshape(-1, p)
        encoder = linear.encoder[rows].reshape(-1, 2)
        cov = np.diag(np.repeat(seen.sigma_px[rows] ** 2, 2)) + seen.encoder_sigma_rad[v] ** 2 * encoder @ encoder.T
        residual = (linear.q_px - seen.q_px)[rows].ravel()
        weight = np.linalg.inv(cov)
        information += jacobian.T @ weight @ jacobian
        gradient += jacobian.T @ weight @ residual
        cost += float(residual @ weight @ residual)
    nothing = replace(seen, sigma_px=np.full(len(seen), 1e12), encoder_sigma_rad=np.full(problem.v, 1e-12))
    prior, _ = problem_for(nothing, targets)
    rest = assemble(prior, state, evaluate(prior, state), everyone(prior), columns_of(free, prior))
    at = np.ix_(free, free)
    expected = (information + rest.information)[at]
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    assert np.allclose(normal.information[at] / scale, expected / scale, atol=1e-9)
    assert np.allclose(normal.gradient[free], (gradient + rest.gradient)[free], rtol=1e-5, atol=1e-6)
    assert normal.cost == pytest.approx(cost + rest.cost, rel=1e-9)


def test_the_gradient_of_priors_and_bars_is_that_of_finite_differences() -> None:
    """Far from the nominal values, where a rotation's difference is no longer the step itself."""
    seen, state, targets = observed()
    nothing = replace(seen, sigma_px=np.full(len(seen), 1e9))
    problem, free = problem_for(nothing, targets)
    layout = problem.layout
    step = np.random.default_rng(6).normal(0.0, 0.05, layout.columns)
    state = moved(state, step, layout)
    columns = columns_of(free, problem)
    normal = assemble(problem, state, evaluate(problem, state), everyone(problem), columns)
    for column in free:
        size = np.zeros(layout.columns)
        size[column] = 1e-5
        costs = [
            assemble(problem, there, evaluate(problem, there), everyone(problem), columns).cost
            for there in (moved(state, sign * size, layout) for sign in (1, -1))
        ]
        slope = (costs[0] - costs[1]) / 4e-5
        assert normal.gradient[column] == pytest.approx(slope, rel=1e-4, abs=1e-4 * np.abs(normal.gradient).max()), column


def test_rotation_vectors_and_matrices_are_inverse_also_for_tiny_and_large_turns() -> None:
    vectors = np.array([(0.0, 0.0, 0.0), (1e-9, 0.0, 2e-9), (0.3, -0.2, 0.1), (2.0, 1.0, -2.0)])
    assert np.allclose(logarithms(exponentials(vectors)), vectors, atol=1e-12)


def test_a_step_is_found_again_as_a_difference() -> None:
    state, targets, *_ = scene()
    layout = layout_of(2, targets, np.arange(len(targets)))
    step = np.random.default_rng(1).normal(0.0, 0.1, layout.columns)
    assert np.allclose(difference(moved(state, step, layout), state).ravel(), step[:46], atol=1e-12)


@pytest.mark.parametrize("second_face", [False, True])
def test_many_points_are_aimed_at_as_a_station_does(second_face: bool) -> None:
    made = cell(np.random.default_rng(5), order=AxisOrder.EL_OUTER, signs=(-1, 1))
    points = np.random.default_rng(6).uniform(-150, 150, (8, 3))
    of = np.arange(8) % 2
    angles = aim(made.true, of, points, second_face=second_face)
    for k, p, (az, el) in zip(of, points, angles, strict=True):
        lens = made.true[k].lens
        assert np.allclose(made.true[k].pixel(p, az, el), (lens.cx_px, lens.cy_px), atol=1e-5)
    turned_over = np.cos(angles[:, 0]) < 0.0
    assert turned_over.all() if second_face else not turned_over.any()


def test_a_point_inside_the_lever_arm_cannot_be_aimed_at() -> None:
    station = stations()[0]
    near = station.world_from_gimbal.move(np.array((2000.0, 50.0, 20.0)))
    with pytest.raises(Degenerate, match="station left cannot be aimed at"):
        aim([station], np.zeros(1, np.intp), near[None])
