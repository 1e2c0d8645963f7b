"""Flat arrays to observations, and targets: what is accepted, and the words for what is not."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from trackerd.calibrate.cell import (
    WORLD,
    Body,
    Observations,
    board,
    join,
    known_points,
    mover,
    observations,
    unknown_points,
    with_bars,
)
from trackerd.contract.errors import ConfigError
from trackerd.geometry.rigid import Rigid

TARGETS = known_points(np.arange(12.0).reshape(4, 3), ["a", "b", "c", "d"])
ROWS: dict[str, Any] = {
    "gimbal": ["right", "left", "left", "right"],
    "view": [1, 1, 1, 2],
    "az_rad": [0.3, 0.1, 0.1, 0.4],
    "el_rad": [0.0, 0.2, 0.2, 0.1],
    "u_px": [10.0, 20.0, 30.0, 40.0],
    "v_px": [1.0, 2.0, 3.0, 4.0],
    "point": ["a", "b", "c", "d"],
    "targets": TARGETS,
    "sigma_px": 0.1,
    "encoder_sigma_rad": 1e-5,
}


def made(**changes: Any) -> Observations:
    return observations(**{**ROWS, **changes})


def test_rows_of_one_gimbal_and_view_are_one_view() -> None:
    seen = made(sigma_px=[0.1, 0.2, 0.3, 0.4])
    assert seen.gimbals == ("right", "left")
    assert seen.views == ("right/1", "left/1", "right/2")
    assert seen.gimbal.tolist() == [0, 1, 0]
    assert seen.angles_rad.tolist() == [[0.3, 0.0], [0.1, 0.2], [0.4, 0.1]]
    assert seen.view.tolist() == [0, 1, 1, 2]
    assert seen.point.tolist() == [0, 1, 2, 3]
    assert seen.q_px[:, 0].tolist() == [10.0, 20.0, 30.0, 40.0]
    assert seen.sigma_px.tolist() == [0.1, 0.2, 0.3, 0.4]
    assert seen.of_view(1).tolist() == [1, 2]
    assert len(seen) == 4


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"gimbal": []}, "there is no image point"),
        ({"u_px": [1.0]}, "u_px has 1 entries, gimbal has 4"),
        ({"sigma_px": [0.1, 0.1]}, "sigma_px has 2 entries: one, or one for each of 4 image points"),
        ({"v_px": [1.0, np.nan, 3.0, 4.0]}, r"v_px\[1\] = nan: must be a finite number \(1 are not\)"),
        ({"az_rad": [17.2, 0.1, 0.1, 0.4]}, r"az_rad\[0\] = 17\.2: more than a turn: angles are radians, not degrees"),
        ({"el_rad": [0.0, 0.2, 0.2, -9.0]}, r"el_rad\[3\] = -9\.0: more than a turn"),
        ({"sigma_px": 0.0}, r"sigma_px\[0\] = 0\.0: must be above 0"),
        ({"encoder_sigma_rad": 2.0}, r"encoder_sigma_rad = 2\.0: must be at most 0\.02 rad; 1 arcsec is 4\.8e-6 rad"),
        ({"encoder_fixed_rad": -1e-6}, r"encoder_fixed_rad\[0\] = -1e-06: must be 0 or more"),
        ({"point": ["a", "b", "c", "nobody"]}, "point nobody: no target has this name"),
        ({"el_rad": [0.0, 0.2, 0.3, 0.1]}, "view 1 of gimbal left: el_rad is 0.2 and 0.3: one view has one"),
        ({"point": ["a", "b", "b", "d"]}, "view 1 of gimbal left shows point b twice"),
    ],
)
def test_what_contradicts_itself_is_refused_with_its_place(changes: dict[str, Any], text: str) -> None:
    with pytest.raises(ConfigError, match=text):
        made(**changes)


def test_several_errors_are_told_at_once() -> None:
    with pytest.raises(ConfigError) as caught:
        made(u_px=[np.inf, 2.0, 3.0, 4.0], az_rad=[99.0, 0.1, 0.1, 0.4])
    assert len(str(caught.value).splitlines()) == 2


def test_bodies_keep_their_points_when_they_are_joined() -> None:
    pose = Rigid(np.eye(3), np.array((1.0, 2.0, 3.0)))
    bars = with_bars(unknown_points(["x", "y"]), [("x", "y")], 300.0, 0.005)
    together = join(TARGETS, board("plate", np.eye(3), pose), bars)
    assert [body.name for body in together.bodies] == ["world", "plate"]
    assert together.body.tolist() == [0, 0, 0, 0, 1, 1, 1, 0, 0]
    assert together.names[4:] == ("plate:0", "plate:1", "plate:2", "x", "y")
    assert together.bar_points.tolist() == [[7, 8]]
    assert together.free.tolist() == [False] * 7 + [True] * 2


def test_the_points_of_a_mover_are_its_flange_and_its_ball() -> None:
    robot = mover("robot", np.eye(3)[None], [[1.0, 2.0, 3.0]], (0.0, 0.0, 100.0), sigma_mm=0.65, fixed=True)
    assert robot.bodies[0].world_from_body is not None
    assert np.allclose(robot.cov_mm2[0], 0.4225 * np.eye(3))
    assert np.array_equal(robot.flange[0], np.eye(3))


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (lambda: known_points([[1.0, 2.0]]), r"points must be \(m, 3\), not \(1, 2\)"),
        (lambda: known_points([[1.0, 2.0, 3.0], [np.nan, 0.0, 0.0]]), "point 1 is not finite"),
        (lambda: known_points(np.eye(3), ["a", "b"]), "2 names for 3 points"),
        (lambda: known_points(np.eye(3), ["a", "b", "a"]), "point a is there twice"),
        (lambda: known_points(np.eye(3), cov_mm2=-np.tile(np.eye(3), (3, 1, 1))), "not positive semidefinite"),
        (lambda: known_points(np.eye(3), cov_mm2=np.eye(3)), r"covariances must be \(m, 3, 3\)"),
        (lambda: known_points(np.eye(3), body=Body("plate", fixed=True)), "body plate: it is fixed, so it needs its pose"),
        (lambda: mover("arm", np.ones((1, 3, 3)), np.zeros((1, 3)), np.zeros(3)), "its rotation is none"),
        (lambda: mover("arm", np.eye(3), np.zeros((1, 3)), np.zeros(3)), r"rotations must be \(m, 3, 3\)"),
        (lambda: mover("arm", np.eye(3)[None], np.zeros((1, 3)), np.zeros(3), sigma_mm=-1.0), "a sigma must be 0 or more"),
        (lambda: with_bars(TARGETS, [("a", "z")], 1.0, 1.0), "bars: point z: no target has this name"),
        (lambda: with_bars(TARGETS, [("a", "b")], -1.0, 1.0), "lengths and sigmas must be finite and above 0"),
        (lambda: join(TARGETS, TARGETS), "point a is there twice"),
        (
            lambda: join(TARGETS, known_points(np.eye(3), body=replace(WORLD, fixed=False))),
            "body world is there twice, and differs",
        ),
    ],
)
def test_targets_that_are_none_are_refused_in_words(make: Callable[[], object], text: str) -> None:
    with pytest.raises(ConfigError, match=text):
        make()
