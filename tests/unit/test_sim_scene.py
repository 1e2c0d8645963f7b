import numpy as np
import pytest
from sim_cell import scene

from trackerd.formats.settings import ARCSEC

MS = 1_000_000


def seen_px(made, gimbal, t_ns):
    pose = made.true_pose(gimbal, t_ns)
    return made.gimbals[gimbal].station.lens.project(pose.inverse().move(made.truth(t_ns)[0]))


def test_at_the_start_the_probe_is_off_the_aim_by_the_settings():
    made = scene(start_offset_px=(60.0, -40.0), error={"left": {"swapped": True, "el_sign": -1, "lever_mm": (1.0, 2.0, 3.0)}})
    for gimbal, mount in made.mounts.items():
        np.testing.assert_allclose(seen_px(made, gimbal, 0) - mount.kept_at_px, (60.0, -40.0), atol=1e-4)


@pytest.mark.parametrize("sign", [1, -1])
def test_a_flipped_axis_moves_the_image_the_other_way_and_its_encoder_does_not_show_it(sign):
    made = scene(error={"left": {"az_sign": sign}})
    az, el = made.encoder("left", 0)
    before = seen_px(made, "left", 0)
    made.gimbals["left"].az.follow(0, az + 0.002)
    after = seen_px(made, "left", 900 * MS)
    assert made.encoder("left", 900 * MS) == pytest.approx((az + 0.002, el), abs=1e-9)
    expected = made.gimbals["left"].station.pixel_jacobian(made.truth(0)[0], sign * az, el)[:, 0] * sign * 0.002
    np.testing.assert_allclose(after - before, expected, rtol=0.02, atol=0.2)


def test_swapped_axes_answer_to_each_other_s_channel():
    made = scene(error={"left": {"swapped": True}})
    gimbal = made.gimbals["left"]
    before = seen_px(made, "left", 0)
    gimbal.az.follow(0, gimbal.az.angle(0) + 0.002)
    moved = seen_px(made, "left", 900 * MS) - before
    assert abs(moved[0]) > 5 * abs(moved[1])  # EL turns the camera sideways


def test_stand_tilt_and_vibration_move_the_camera_but_no_encoder():
    still, tilted, rocking = (
        scene(error={"left": error})
        for error in ({}, {"stand_tilt_arcsec": (20.0, 0.0)}, {"vibration_arcsec": 5.0, "vibration_hz": 10.0})
    )
    for other in (tilted, rocking):
        other.gimbals["left"].place(*still.start_angles("left"))
        assert other.encoder("left", 13 * MS) == still.encoder("left", 13 * MS)
    shift = seen_px(tilted, "left", 13 * MS) - seen_px(still, "left", 13 * MS)
    assert np.linalg.norm(shift) == pytest.approx(20.0 * ARCSEC * 31000, rel=0.1)
    swings = [seen_px(rocking, "left", t * MS) - seen_px(still, "left", t * MS) for t in range(0, 100, 2)]
    assert 0.5 < np.abs(swings).max() / (5.0 * ARCSEC * 31000) < 1.5
    np.testing.assert_allclose(np.mean(swings, axis=0), 0.0, atol=0.02)


def test_a_late_latch_holds_the_angles_of_a_later_instant():
    made = scene(encoder={"latch_skew_us": 250.0})
    gimbal = made.gimbals["left"]
    gimbal.az.turn(0, 0.1)
    assert gimbal.latched(500 * MS) == gimbal.encoder(500 * MS + 250_000)
    assert gimbal.latched(500 * MS)[0] - gimbal.encoder(500 * MS)[0] == pytest.approx(25e-6, rel=1e-6)


def test_a_jittering_latch_scatters_by_the_axis_speed():
    made = scene(encoder={"latch_jitter_us": 100.0})
    gimbal = made.gimbals["left"]
    gimbal.az.turn(0, 0.1)
    late = [gimbal.latched(t * MS)[0] - gimbal.encoder(t * MS)[0] for t in range(400, 900)]
    assert np.std(late) == pytest.approx(10e-6, rel=0.15)


def test_cameras_on_one_trigger_expose_together():
    made = scene(trigger="shared")
    assert made.trigger("left") == made.trigger("right")
    assert made.trigger("left").begin_ns(55) == 1_000_000_000


def test_free_cameras_have_a_phase_and_a_rate_of_their_own():
    made = scene(trigger="free", free_ppm=50.0)
    left, right = made.trigger("left"), made.trigger("right")
    assert abs(left.phase_ns - right.phase_ns) > 100_000
    assert left.period_ns != right.period_ns
    for trigger in (left, right):
        assert trigger.period_ns == pytest.approx(1e9 / 55, rel=51e-6)
        assert 0 <= trigger.phase_ns <= 1e9 / 55
        k = trigger.first_from(123 * MS)
        assert trigger.begin_ns(k - 1) < 123 * MS <= trigger.begin_ns(k)


def test_an_exposure_is_parted_only_where_the_image_moves():
    made = scene(path={"dwell_s": 1.0})
    assert len(made.view("left", 0, 2 * MS).poses) == 1
    moving = made.view("left", 2000 * MS, 2002 * MS)  # the axes stand: 250 mm/s is 7.8 px in 2 ms
    assert len(moving.poses) == 7
    assert len(moving.probes_mm) == len(moving.poses)


def test_aiming_ahead_keeps_the_probe_where_it_belongs():
    made = scene(path={"dwell_s": 1.0}, start_offset_px=(0.0, 0.0))
    worst = 0.0
    for t_ns in range(0, 3000 * MS, 10 * MS):
        made.follow(t_ns, t_ns + 10 * MS)
        off = seen_px(made, "left", t_ns + 5 * MS) - np.array(made.mounts["left"].kept_at_px)
        worst = max(worst, float(np.abs(off).max()))
    assert worst < 2.0


def test_two_scenes_of_one_seed_are_the_same_and_another_seed_s_is_not():
    errors = {"white_arcsec": 2.0, "fixed_arcsec": 2.0}
    first, same, other = (scene(seed=seed, path={"kind": "random", "dwell_s": 0.0}, encoder=errors) for seed in (1, 1, 2))
    for made in (first, same, other):
        made.follow(0, 500 * MS)
    assert first.encoder("left", 700 * MS) == same.encoder("left", 700 * MS)
    assert first.encoder("left", 700 * MS) != other.encoder("left", 700 * MS)
    view = first.view("right", 700 * MS, 702 * MS)
    images = [made.renderer("right").render(view.poses, view.probes_mm, 3) for made in (first, same, other)]
    np.testing.assert_array_equal(images[0], images[1])
    assert (images[0] != images[2]).any()
