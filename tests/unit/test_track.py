"""The tracker's states over sequences of pictures, with the axes in motion, without angles, and with targets chosen."""

from dataclasses import dataclass, field
from math import hypot

import numpy as np
import pytest
from vision_pictures import Ball

from trackerd.contract.clock import HostNs
from trackerd.contract.model import AxisAngles, Found, Frame, Missed, NoAngle, TrackState
from trackerd.engine.track import Step, Tracker
from trackerd.formats.settings import CameraSettings, SteeringSettings, TrackingSettings
from trackerd.geometry.gimbal import Station
from trackerd.geometry.lens import Lens
from trackerd.geometry.rigid import Rigid
from trackerd.geometry.sightline import Instants

ORIGIN_PX = (704, 528)
CENTRE_PX = (1023.5, 767.5)
FRAME_NS = 18_181_818
LENS = Lens((2048, 1536), 31000.0, 31000.0, 1023.5, 767.5)
STATION = Station("left", Rigid.identity(), Rigid(np.eye(3), np.array((0.0, -124.5, 0.0))), LENS)
CAMERA = CameraSettings(driver="none", width_px=640, height_px=480, offset_x_px=ORIGIN_PX[0], offset_y_px=ORIGIN_PX[1])
EMPTY = Ball(contrast_dn=0.0)


def at(x_px: float, y_px: float = 240.0, r_px: float = 60.0) -> Ball:
    """In image coordinates."""
    return Ball(x_px, y_px, r_px)


def turned(az_rad: float = 0.01, el_rad: float = 0.02) -> AxisAngles:
    return AxisAngles(az_rad, el_rad, 1e-5, 0.0, None, 0.0, "latch")


@dataclass
class Run:
    """A tracker and its camera."""

    tracking: TrackingSettings = field(default_factory=TrackingSettings)
    steering: SteeringSettings = field(default_factory=SteeringSettings)
    frame_id: int = 0

    def __post_init__(self) -> None:
        self.tracker = Tracker(STATION, 4.0, CAMERA, self.steering, self.tracking)

    def see(self, ball: Ball | np.ndarray, angles: AxisAngles | NoAngle | None = None) -> Step:
        image = ball if isinstance(ball, np.ndarray) else ball.noisy(self.frame_id)
        exposed = HostNs(self.frame_id * FRAME_NS)
        arrived = HostNs(exposed + 10_000_000)
        frame = Frame(image, self.frame_id, None, arrived, 2_000_000, ORIGIN_PX)
        self.frame_id += 1
        return self.tracker.step(frame, turned() if angles is None else angles, Instants(exposed, 0.0, arrived))

    def lock(self, ball: Ball) -> Step:
        self.see(ball)
        return self.see(ball)


def test_two_consistent_outlines_make_a_lock() -> None:
    run = Run()
    first, second = run.see(at(330.0)), run.see(at(332.0))
    assert (first.state, second.state) == (TrackState.SEARCHING, TrackState.LOCKED)
    assert isinstance(first.outline, Found)
    assert (first.sightline, first.set_point) == (None, None)
    assert first.why
    assert second.sightline is not None
    assert second.set_point is not None
    assert second.why == ""


def test_the_outline_is_in_sensor_coordinates_and_the_offset_is_from_the_centre_of_the_region() -> None:
    step = Run().lock(at(330.25, 236.5))
    assert isinstance(step.outline, Found)
    assert (step.outline.x_px, step.outline.y_px) == pytest.approx((1034.25, 764.5), abs=0.03)
    assert step.offset_px == pytest.approx((1034.25 - CENTRE_PX[0], 764.5 - CENTRE_PX[1]), abs=0.03)


def test_the_aim_pixel_can_be_set() -> None:
    step = Run(steering=SteeringSettings(aim_px=(1000.0, 760.0))).lock(at(330.0, 240.0))
    assert step.offset_px == pytest.approx((34.0, 8.0), abs=0.05)


def test_the_set_point_turns_towards_the_target() -> None:
    step = Run(steering=SteeringSettings(gain=1.0, feed_forward=False)).lock(at(350.0, 250.0))
    assert step.set_point is not None
    assert step.jacobian is not None
    assert step.offset_px is not None
    turn = np.array((step.set_point.az_rad - 0.01, step.set_point.el_rad - 0.02))
    assert step.jacobian @ turn == pytest.approx(-np.array(step.offset_px), abs=1e-6)
    assert step.set_point.at > step.instant


def test_the_line_of_sight_points_at_the_target() -> None:
    step = Run().lock(at(350.0, 250.0))
    assert step.sightline is not None
    p_mm = step.sightline.origin_mm + step.sightline.range_mm * step.sightline.direction
    assert STATION.pixel(p_mm, 0.01, 0.02) == pytest.approx((1054.0, 778.0), abs=0.05)
    assert step.sightline.range_mm == pytest.approx(31000.0 * 4.0 / 60.0, rel=1e-3)


def test_a_hidden_target_is_coasted_and_found_again() -> None:
    run = Run()
    for n in range(6):
        run.see(at(300.0 + 4.0 * n))
    gone = [run.see(EMPTY) for _ in range(3)]
    assert {step.state for step in gone} == {TrackState.COASTING}
    assert all(isinstance(step.outline, Missed) and step.why and step.sightline is None for step in gone)
    assert all(step.set_point is not None for step in gone)
    back = run.see(at(300.0 + 4.0 * 9))
    assert back.state is TrackState.LOCKED
    assert isinstance(back.outline, Found)


def test_coasting_ends_in_searching_after_the_frames_allowed() -> None:
    run = Run(TrackingSettings(coast_frames=3))
    run.lock(at(330.0))
    states = [run.see(EMPTY).state for _ in range(5)]
    assert states == [TrackState.COASTING] * 3 + [TrackState.SEARCHING] * 2
    step = run.see(EMPTY)
    assert (step.set_point, step.sightline, step.offset_px) == (None, None, None)


def test_a_lost_target_is_found_anywhere_afterwards() -> None:
    run = Run(TrackingSettings(coast_frames=0))
    run.lock(at(150.0, 150.0))
    assert run.see(EMPTY).state is TrackState.SEARCHING
    assert run.lock(at(500.0, 350.0, 40.0)).state is TrackState.LOCKED


def test_a_fast_target_is_held_in_every_frame() -> None:
    run = Run()
    states = [run.see(at(80.0 + 22.0 * n + 1.2 * n * n, 300.0 - 8.0 * n)).state for n in range(14)]
    assert set(states[1:]) == {TrackState.LOCKED}


def test_a_jump_of_the_target_is_caught_in_the_same_frame() -> None:
    run = Run()
    run.lock(at(200.0))
    step = run.see(at(330.0, 300.0))
    assert step.state is TrackState.LOCKED
    assert isinstance(step.outline, Found)


def test_axes_in_motion_do_not_throw_the_target_out_of_the_gate(monkeypatch: pytest.MonkeyPatch) -> None:
    run = Run(TrackingSettings(tracker="none"))
    first = run.lock(at(320.0, 100.0))
    assert first.jacobian is not None
    monkeypatch.setattr("trackerd.vision.acquire.search", lambda *_: Missed("no search: prediction has to do"))
    for n in range(1, 6):
        turn_rad = 0.0017 * n * (n + 1) / 2.0  # the target stands still; the image moves by 10, 20, ... 50 px a frame
        dx, dy = first.jacobian @ np.array((turn_rad, 0.0)) / 5.0
        assert run.see(at(320.0 + dx, 100.0 + dy), turned(0.01 + turn_rad / 5.0)).state is TrackState.LOCKED


def test_without_angles_the_image_goes_on_but_neither_line_nor_set_point() -> None:
    run = Run()
    for n in range(4):
        step = run.see(at(300.0 + 12.0 * n), NoAngle("its latch did not come"))
    assert step.state is TrackState.LOCKED
    assert isinstance(step.outline, Found)
    assert (step.sightline, step.set_point, step.angles, step.jacobian) == (None, None, None, None)
    assert step.offset_px is not None
    assert step.why == "its latch did not come"


def test_a_thing_of_another_size_does_not_take_over_the_lock() -> None:
    run = Run()
    run.lock(at(330.0))
    step = run.see(at(332.0, r_px=75.0))
    assert step.state is TrackState.COASTING
    assert isinstance(step.outline, Missed)


def two_balls(seed: int) -> np.ndarray:
    return np.maximum(at(160.0, 240.0, 40.0).noisy(seed), at(480.0, 240.0, 40.0).noisy(seed + 100))


@pytest.mark.parametrize("x_px", [160.0, 480.0])
def test_the_configured_pixel_chooses_the_target(x_px: float) -> None:
    run = Run(TrackingSettings(target_px=(ORIGIN_PX[0] + x_px + 30.0, ORIGIN_PX[1] + 260.0)))
    for n in range(4):
        step = run.see(two_balls(n))
    assert step.state is TrackState.LOCKED
    assert isinstance(step.outline, Found)
    assert step.outline.x_px == pytest.approx(ORIGIN_PX[0] + x_px, abs=0.1)
    assert step.target_selected == "pixel"


def test_another_target_can_be_selected_while_locked() -> None:
    run = Run(TrackingSettings(target_px=(ORIGIN_PX[0] + 160.0, ORIGIN_PX[1] + 240.0)))
    for n in range(3):
        run.see(two_balls(n))
    run.tracker.select((ORIGIN_PX[0] + 470.0, ORIGIN_PX[1] + 250.0))
    assert run.see(two_balls(3)).state is TrackState.SEARCHING
    step = run.see(two_balls(4))
    assert isinstance(step.outline, Found)
    assert step.outline.x_px == pytest.approx(ORIGIN_PX[0] + 480.0, abs=0.1)


def test_a_pixel_with_nothing_near_it_chooses_nothing_and_says_so() -> None:
    run = Run()
    run.tracker.select((ORIGIN_PX[0] + 600.0, ORIGIN_PX[1] + 60.0))
    step = run.see(at(160.0, 240.0, 40.0))
    assert step.state is TrackState.SEARCHING
    assert "no ball at pixel" in step.why
    run.tracker.select(None)
    assert run.lock(at(160.0, 240.0, 40.0)).target_selected == "itself"


def test_a_chosen_target_stays_the_chosen_one_after_a_loss() -> None:
    run = Run(TrackingSettings(target_px=(ORIGIN_PX[0] + 330.0, ORIGIN_PX[1] + 240.0), coast_frames=1))
    assert run.lock(at(330.0)).target_selected == "pixel"
    for _ in range(3):
        run.see(EMPTY)
    assert run.lock(at(330.0)).target_selected == "pixel"


def test_a_steered_target_is_brought_to_the_aim_pixel() -> None:
    """The axes go where the set-point says, one frame later."""
    run, p_mm = Run(), STATION.point_at(np.array((1103.0, 707.0)), 0.01, 0.02, 2066.0)
    az, el, step = 0.01, 0.02, None
    for _ in range(12):
        x, y = STATION.pixel(p_mm, az, el) - np.array(ORIGIN_PX)
        step = run.see(at(float(x), float(y)), turned(az, el))
        if step.set_point is not None:
            az, el = step.set_point.az_rad, step.set_point.el_rad
    assert step is not None
    assert step.offset_px is not None
    assert hypot(*step.offset_px) < 1.0
