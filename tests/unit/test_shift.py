"""How far a new calibration puts the work from where the old one had it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from trackerd.calibrate.shift import grid, shift_between
from trackerd.contract.errors import Degenerate
from trackerd.formats.calibration import load_calibration
from trackerd.geometry.gimbal import Station
from trackerd.geometry.rigid import Rigid, rotation_about

STATIONS = load_calibration(Path(__file__).parents[2] / "config" / "demo-calibration.toml").stations
VOLUME = grid((-200.0, -200.0, -150.0), (200.0, 200.0, 150.0), 3)


def moved(station: Station, motion: Rigid) -> Station:
    return replace(station, world_from_gimbal=motion @ station.world_from_gimbal)


def test_the_same_calibration_shifts_nothing() -> None:
    found = shift_between(STATIONS, STATIONS, VOLUME)
    assert found.max_mm < 1e-8
    assert (len(found.p_mm), found.out_of_reach) == (27, 0)


def test_a_cell_that_was_moved_as_a_whole_shifts_the_work_just_so() -> None:
    motion = Rigid(rotation_about(np.array((0.0, 0.6, 0.8)), 1e-3), np.array((0.5, -1.0, 2.0)))
    found = shift_between(STATIONS, {name: moved(station, motion) for name, station in STATIONS.items()}, VOLUME)
    assert np.allclose(found.p_mm + found.shift_mm, motion.move(found.p_mm), rtol=0, atol=1e-8)
    assert found.mean_mm == pytest.approx((0.5, -1.0, 2.0), abs=0.01)
    assert found.max_mm == pytest.approx(float(np.linalg.norm(motion.move(found.worst_mm) - found.worst_mm)))


def test_a_camera_that_was_turned_by_a_pixel_shifts_the_work_across_its_line() -> None:
    left = STATIONS["left"]
    swapped = {**STATIONS, "left": replace(left, lens=replace(left.lens, cy_px=left.lens.cy_px + 1.0))}
    found = shift_between(STATIONS, swapped, np.zeros((1, 3)))
    assert found.max_mm == pytest.approx(1990.0 / 31000.0 / 2.0, rel=0.03)  # 1 px at 2 m, shared between two lines


def test_one_station_in_common_compares_nothing() -> None:
    with pytest.raises(Degenerate, match="two stations or more that both have, here 1"):
        shift_between(STATIONS, {"left": STATIONS["left"], "top": STATIONS["right"]}, VOLUME)


def test_points_out_of_reach_are_counted_and_none_in_reach_is_told() -> None:
    behind = np.array(((0.0, 0.0, -1920.0), (-550.0, 0.0, -1920.0)))
    found = shift_between(STATIONS, STATIONS, np.vstack((VOLUME, behind[1:])))
    assert (len(found.p_mm), found.out_of_reach) == (27, 1)
    with pytest.raises(Degenerate, match="no point of the volume can be looked at by two stations"):
        shift_between(STATIONS, STATIONS, behind[1:])


def test_a_grid_fills_its_box_to_the_corners() -> None:
    found = grid((0.0, 1.0, 2.0), (4.0, 1.0, 3.0), 5)
    assert found.shape == (125, 3)
    assert (found.min(axis=0).tolist(), found.max(axis=0).tolist()) == ([0.0, 1.0, 2.0], [4.0, 1.0, 3.0])
