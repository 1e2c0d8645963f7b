"""Numbers and words of `trackerd inspect`; the pages are drawn, and looked into where a test can tell right from wrong."""

import csv
import signal
from dataclasses import replace
from math import sqrt
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2
from vision_pictures import NOISE, Ball

from trackerd.cli import main
from trackerd.contract.errors import ConfigError, TrackerdError
from trackerd.contract.model import Found, Missed
from trackerd.geometry.lens import Lens
from trackerd.inspection.advice import (
    Level,
    exposure_advice,
    focus_advice,
    focus_bar,
    level_at,
    light_advice,
    unseen_advice,
)
from trackerd.inspection.allan import degrees_of_freedom, interval, overlapping
from trackerd.inspection.camera import Camera
from trackerd.inspection.detector import detector_for
from trackerd.inspection.examine import edges, examine, profile
from trackerd.inspection.image_page import image_page
from trackerd.inspection.live import Glance, LiveView
from trackerd.inspection.numbers import ellipse_95, examination_rows, scatter_rows, series_rows
from trackerd.inspection.repeatability import repeatability
from trackerd.inspection.series import Sample, samples, shape, write_csv
from trackerd.inspection.series_page import series_page
from trackerd.pictures import look

FOUND = Found(100.0, 80.0, 50.0, np.diag((4e-6, 9e-6, 1e-6)), 0.95, 1.0, 0.0, 0.9, 180.0, 60.0)
EIGHT_BITS = Level(full_dn=255.0, bright_dn=0.0, sigma_dn=1.8)
SMALL = Ball(x_px=80.3, y_px=60.6, r_px=30.0, size_px=(160, 120))
EMPTY = Missed("nothing round in the image passes the verification")


def series_of(values):
    return [replace(FOUND, x_px=float(x), y_px=float(y), r_px=float(r)) for x, y, r in values]


# ---- Allan deviation -------------------------------------------------------------------------------------------------


def slope(allan):
    return float(np.polyfit(np.log(allan.frames), np.log(allan.deviation), 1)[0])


def test_the_allan_deviation_of_white_noise_falls_with_the_root_of_the_frames_averaged():
    allan = overlapping(np.random.default_rng(1).standard_normal(4000))
    assert allan.deviation[0] == pytest.approx(1.0, abs=0.05)
    assert slope(allan) == pytest.approx(-0.5, abs=0.05)
    assert allan.white_until == allan.frames[-1] == 768


def test_the_allan_deviation_of_a_random_walk_rises_with_the_root_of_the_frames_averaged():
    allan = overlapping(np.cumsum(np.random.default_rng(2).standard_normal(4000)))
    assert slope(allan) == pytest.approx(0.5, abs=0.1)
    assert allan.white_until == 1


def test_the_allan_deviation_of_a_steady_drift_rises_with_the_frames_averaged():
    allan = overlapping(0.25 * np.arange(400.0))
    np.testing.assert_allclose(allan.deviation, 0.25 * allan.frames / sqrt(2.0))


def test_the_allan_deviation_agrees_with_its_definition_written_out():
    values = np.random.default_rng(3).standard_normal(40)
    allan = overlapping(values)
    for length, deviation in zip(allan.frames.astype(int), allan.deviation, strict=True):
        pairs = [values[k : k + length].mean() - values[k + length : k + 2 * length].mean() for k in range(41 - 2 * length)]
        assert deviation == pytest.approx(sqrt(0.5 * np.mean(np.square(pairs))))


@pytest.mark.parametrize("length", [1, 4, 16])
def test_the_interval_of_the_allan_deviation_holds_the_truth_in_95_of_100_series_of_white_noise(length):
    random, inside = np.random.default_rng(4), 0
    for _ in range(600):
        allan = overlapping(random.standard_normal(128))
        k = int(np.flatnonzero(allan.frames == length)[0])
        inside += bool(allan.low[k] <= 1.0 / sqrt(length) <= allan.high[k])
    assert inside / 600 == pytest.approx(0.95, abs=0.03)


def test_frames_without_a_ball_leave_the_allan_deviation_as_it_is():
    random = np.random.default_rng(5)
    values = random.standard_normal(4000)
    values[random.random(4000) < 0.1] = np.nan
    allan = overlapping(values)
    assert allan.deviation[0] == pytest.approx(1.0, abs=0.05)
    assert slope(allan) == pytest.approx(-0.5, abs=0.06)


def test_two_frames_give_one_allan_deviation_and_no_two_neighbours_give_none():
    assert overlapping(np.array((1.0, 3.0))).deviation.tolist() == [sqrt(2.0)]
    assert len(overlapping(np.array((1.0, np.nan, 3.0))).frames) == 0
    assert overlapping(np.array((1.0, np.nan, 3.0))).white_until == 0


def test_the_interval_of_a_standard_deviation_is_that_of_chi_square():
    low, high = interval(2.0, 10.0)
    assert (low, high) == pytest.approx((2.0 * sqrt(10.0 / chi2.ppf(0.975, 10)), 2.0 * sqrt(10.0 / chi2.ppf(0.025, 10))))
    assert degrees_of_freedom(500, 1) == pytest.approx(2.0 / 3.0 * 500, rel=0.01)  # neighbouring differences share a value


# ---- repeatability ---------------------------------------------------------------------------------------------------


def test_the_scatter_of_a_still_series_is_told_beside_the_stated_sigma():
    random = np.random.default_rng(6)
    values = (100.0, 80.0, 50.0) + random.standard_normal((800, 3)) * (0.002, 0.003, 0.001)
    result = repeatability(series_of(values))
    for name, stated in (("x", 0.002), ("y", 0.003), ("r", 0.001), ("d", 0.002)):
        scatter = result.scatter[name]
        assert scatter.stated == pytest.approx(stated)
        assert scatter.ratio == pytest.approx(1.0, abs=0.08)
        assert scatter.interval[0] < stated < scatter.interval[1]
        assert scatter.neighbours == pytest.approx(stated, rel=0.08)
        assert abs(scatter.drift) < 4.0 * scatter.drift_sigma
    assert result.scatter["x"].mean == pytest.approx(values[:, 0].mean())
    assert result.scatter["d"].peak_to_peak == pytest.approx(2.0 * np.ptp(values[:, 2]))
    assert (result.found, result.missed, result.reasons) == (800, 0, {})


def test_a_drift_is_told_with_its_sigma_and_does_not_pass_for_noise():
    random = np.random.default_rng(7)
    values = np.full((200, 3), 50.0) + 0.002 * random.standard_normal((200, 3))
    values[:, 0] += np.linspace(0.0, 0.1, 200)
    result = repeatability(series_of(values))
    x = result.scatter["x"]
    assert x.drift == pytest.approx(0.1, abs=4.0 * x.drift_sigma)
    assert x.drift_sigma < 0.001
    assert x.neighbours == pytest.approx(0.002, rel=0.2)
    assert x.deviation > 0.02
    assert ("note", "it moved or drifted: the noise is what neighbouring frames differ by, not the deviation") in series_rows(
        result
    )


def test_missed_frames_are_counted_by_reason_and_left_out_of_the_scatter():
    outlines = series_of(np.full((6, 3), 50.0) + np.arange(6)[:, None])
    result = repeatability([outlines[0], EMPTY, *outlines[1:], Missed("too dark"), EMPTY])
    assert (result.found, result.missed) == (6, 3)
    assert list(result.reasons.items()) == [(EMPTY.reason, 2), ("too dark", 1)]
    assert result.scatter["x"].mean == 52.5
    assert ("missed", "2 x nothing round in the image passes the verification") in series_rows(result)


def test_two_frames_have_a_scatter_and_one_has_none():
    result = repeatability(series_of([(50.0, 40.0, 30.0), (50.2, 40.0, 30.0)]))
    assert result.scatter["x"].deviation == pytest.approx(0.2 / sqrt(2.0))
    assert result.scatter["x"].interval[1] > 4.0
    assert [len(row) for row in scatter_rows(result)] == [9] * 4
    assert repeatability([FOUND, EMPTY]) is None


# ---- advice ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("inside", "outside", "clipped", "advice"),
    [
        (180.0, 60.0, 0.0, "good"),
        (60.0, 180.0, 0.0, "good"),
        (40.0, 20.0, 0.0, "dark: 40 of 255: exposure x 4.4 possible"),
        (245.0, 60.0, 0.03, "too bright: 3 % of the outline is clipped: lower exposure or gain by about 27 %"),
        (255.0, 60.0, 0.4, "too bright: 40 % of the outline is clipped: lower exposure or gain by about 50 %"),
        (150.0, 60.0, 0.02, "too bright: 2 % of the outline is clipped: lower exposure or gain by about 10 %"),
        (180.0, 60.0, 0.004, "good"),
        (364.0, 60.0, 0.3, "too bright: 30 % of the outline is clipped: lower exposure or gain by about 51 %"),
    ],
)  # fmt: skip
def test_exposure_advice_says_how_far_to_turn(inside, outside, clipped, advice):
    assert exposure_advice(replace(FOUND, inside_dn=inside, outside_dn=outside, clipped=clipped), EIGHT_BITS) == advice


def test_the_rim_of_a_shaded_ball_is_no_measure_of_its_exposure():
    shaded = np.full((120, 160), 20, np.uint8)
    column, row = np.meshgrid(np.arange(160), np.arange(120))
    depth = 1.0 - ((column - 80.0) ** 2 + (row - 60.0) ** 2) / 900.0
    shaded[depth > 0.0] = (60.0 + 150.0 * np.sqrt(depth[depth > 0.0])).astype(np.uint8)
    found = replace(FOUND, x_px=80.0, y_px=60.0, r_px=30.0, inside_dn=60.0, outside_dn=20.0)
    level = level_at(shaded, found, NOISE)
    assert level.bright_dn == pytest.approx(205.0, abs=5.0)
    assert exposure_advice(found, level) == "good"
    clipped = np.minimum(shaded.astype(np.uint16) * 2, 255).astype(np.uint8)
    advice = exposure_advice(found, level_at(clipped, found, NOISE))
    assert advice == "too bright: the ball or what is round it is clipped: lower exposure or gain by about 50 %"


def test_exposure_advice_holds_for_deep_pixels_and_for_black_ones():
    deep = Level(full_dn=4095.0, bright_dn=0.0, sigma_dn=30.0)
    assert exposure_advice(replace(FOUND, inside_dn=2900.0), deep) == "good"
    assert exposure_advice(replace(FOUND, inside_dn=0.0, outside_dn=0.0), deep) == "dark: 0 of 4095: exposure x 99 possible"


def test_light_advice_names_what_makes_the_outline_weak():
    assert light_advice(FOUND, EIGHT_BITS) == "good"
    weak = light_advice(replace(FOUND, inside_dn=70.0, outside_dn=60.0), EIGHT_BITS)
    assert weak == "weak: a contrast of 10 is 6 x a pixel's noise: other background or light"
    assert light_advice(replace(FOUND, coverage=0.6), EIGHT_BITS).startswith("only 60 % of the outline carry an edge")


def test_focus_advice_is_silent_about_an_edge_that_moves():
    assert focus_advice(0.95, 0.94, 0.0) == "the best so far"
    assert focus_advice(1.88, 0.94, 0.0) == "2.00 x as wide as the best so far: turn back"
    assert focus_advice(1.88, 0.94, 0.8) == "moving: 0.8 px of smear in the exposure: hold it still to focus"
    assert focus_bar(0.94, 0.94).count("█") == 24
    assert focus_bar(1.88, 0.94).count("█") == 12


def test_without_a_ball_the_brightness_tells_what_to_try():
    assert unseen_advice(0.02) == "the image is dark: lens cap, light, exposure"
    assert unseen_advice(1.0).startswith("parts of the image are clipped")
    assert "roughly into focus" in unseen_advice(0.5)


# ---- one picture -----------------------------------------------------------------------------------------------------


def test_an_examination_has_the_outline_its_edge_points_and_their_weights():
    ball = replace(SMALL, stem=True)
    examination = examine(ball.noisy(1))
    found, seen = examination.found, edges(examination.fit, examination.noise)
    assert (found.x_px, found.y_px, found.r_px) == pytest.approx((80.3, 60.6, 30.0), abs=0.02)
    distance = np.hypot(*(seen.edge_px - (80.3, 60.6)).T)
    assert np.abs(distance[seen.kept] - 30.0).max() < 0.35
    np.testing.assert_allclose(np.hypot(*(seen.outline_px - (found.x_px, found.y_px)).T), found.r_px, atol=0.01)
    below = np.abs(seen.angle_rad - np.pi / 2) < 1.0  # away from the stem
    assert seen.kept[below].all()
    assert seen.weight[below].mean() > 0.75
    assert (~seen.kept).any()
    assert seen.weight[~seen.kept].mean() < 0.5


def test_the_profile_is_that_of_the_picture_round_the_outline():
    examination = examine(SMALL.noisy(2))
    seen = profile(examination)
    far_in, far_out = seen.distance_px < -4.0, seen.distance_px > 4.0
    assert seen.level_dn[far_in].mean() == pytest.approx(160.0, abs=0.5)
    assert seen.level_dn[far_out].mean() == pytest.approx(60.0, abs=0.5)
    model = np.interp(seen.distance_px, seen.edge_distance_px, seen.edge_dn)
    assert np.std(seen.level_dn - model) < 3.0  # 2.1 DN is the noise inside


def test_the_95_percent_ellipse_holds_95_of_100_centres():
    cov = np.array(((4e-6, 3e-6, 0.0), (3e-6, 9e-6, 0.0), (0.0, 0.0, 1e-6)))
    long, short, angle = ellipse_95(replace(FOUND, cov_px2=cov))
    points = np.random.default_rng(8).multivariate_normal((0.0, 0.0), cov[:2, :2], 20_000)
    along = points @ (np.cos(angle), np.sin(angle)) / long
    across = points @ (-np.sin(angle), np.cos(angle)) / short
    assert np.mean(along**2 + across**2 <= 1.0) == pytest.approx(0.95, abs=0.005)


def test_a_picture_without_a_ball_says_where_it_looked_and_why_that_is_none():
    empty = np.random.default_rng(9).integers(58, 63, (120, 160)).astype(np.uint8)
    examination = examine(empty, (80.0, 60.0, 30.0))
    assert examination.found is None
    assert [look.circle for look in examination.looks] == [(80.0, 60.0, 30.0)]
    rows = examination_rows(examination)
    assert ("ball", "none found") in rows
    assert dict(rows)["reason"] == examination.outline.reason == examination.looks[0].reason


def test_a_round_thing_that_is_no_ball_is_shown_with_its_own_reason():
    picture = SMALL.clean.copy()
    picture[66:, :], picture[:, 92:] = 60.0, 60.0  # a third of the outline is left
    noisy = picture + np.random.default_rng(10).standard_normal(picture.shape)
    examination = examine(np.clip(np.rint(noisy), 0, 255).astype(np.uint8))
    assert examination.found is None
    assert examination.looks
    assert all(look.reason for look in examination.looks)


def test_the_depth_of_the_pixels_is_told_by_the_brightest_one():
    image = np.full((40, 40), 700, np.uint16)
    assert detector_for(image).noise.saturation_dn == 1023.0
    image[3, 3] = 4000
    noise = detector_for(image).noise
    assert (noise.saturation_dn, noise.gain_e_per_dn) == (4095.0, pytest.approx(10_000 / 4095))
    assert detector_for(np.zeros((40, 40), np.uint8)).noise.saturation_dn == 255.0


def test_what_is_no_picture_is_refused():
    with pytest.raises(TypeError, match="uint8 or uint16"):
        examine(np.zeros((20, 20)))
    with pytest.raises(ValueError, match="height, width"):
        examine(np.zeros((20, 20, 3), np.uint8))


CAMERA = Camera("left", 39.0, 3.0, (160, 120), (944, 708), Lens((2048, 1536), 31000.0, 31000.0, 1023.5, 767.5), 4.0)


def test_the_camera_of_a_cell_gives_noise_place_on_the_sensor_and_range():
    examination = examine(SMALL.noisy(3), None, detector_for(SMALL.noisy(3), CAMERA))
    rows = dict(examination_rows(examination))
    assert rows["noise model"] == "39 e-/DN, read noise 3 e- (as configured)"
    assert float(rows["range"].split()[0]) == pytest.approx(31000.0 * 4.0 / 30.0, rel=1e-3)
    assert "assumed" in dict(examination_rows(examine(SMALL.noisy(3))))["noise model"]


def test_a_picture_of_another_size_than_the_cameras_is_refused():
    assert CAMERA.origin_of(np.zeros((120, 160), np.uint8)) == (944, 708)
    assert CAMERA.origin_of(np.zeros((1536, 2048), np.uint8)) == (0, 0)
    with pytest.raises(
        ConfigError, match=r"\[camera.left\]: its pictures have 160 x 120 or 2048 x 1536 px, this one has 64 x 48"
    ):
        detector_for(np.zeros((48, 64), np.uint8), CAMERA)


# ---- a series --------------------------------------------------------------------------------------------------------


def looked_at(images, guess=None):
    return list(samples(((f"{n}.png", 1000 * n, image) for n, image in enumerate(images)), guess))


@pytest.fixture(scope="module")
def still():
    return looked_at([replace(SMALL, stem=True).noisy(seed) for seed in range(24)])


def test_a_still_series_scatters_as_stated(still):
    result = repeatability([sample.outline for sample in still])
    assert result.found == 24
    for name in "xyr":
        assert 0.5 < result.scatter[name].ratio < 1.6
        assert result.scatter[name].deviation < 0.012


def test_a_ball_that_jumps_or_is_gone_for_a_frame_is_found_again():
    far = replace(SMALL, x_px=110.0)
    gone = np.full((120, 160), 60, np.uint8)
    there = [isinstance(s.outline, Found) for s in looked_at([SMALL.noisy(1), far.noisy(2), gone, SMALL.noisy(3)])]
    assert there == [True, True, False, True]


def test_what_is_left_over_by_sector_is_averaged_over_the_series(still):
    left = shape(still)
    assert len(left.angle_rad) == len(left.offset_px) == 96
    below = np.abs(left.angle_rad - np.pi / 2) < 1.0
    assert np.abs(left.offset_px[below]).max() < 5.0 * np.nanmax(left.sigma_px[below])
    assert shape([Sample("a", None, EMPTY, None)]) is None


def test_the_csv_has_one_row_a_frame_with_sigma_or_the_reason(tmp_path, still):
    write_csv(tmp_path / "a.csv", [*still[:2], Sample("gone.png", None, EMPTY, None)])
    with (tmp_path / "a.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["name"] for row in rows] == ["0.png", "1.png", "gone.png"]
    assert [row["found"] for row in rows] == ["1", "1", "0"]
    assert float(rows[1]["x_px"]) == pytest.approx(still[1].outline.x_px, abs=1e-6)
    assert float(rows[1]["sigma_y_px"]) == pytest.approx(sqrt(still[1].outline.cov_px2[1, 1]), abs=1e-6)
    assert (rows[1]["t_ns"], rows[1]["reason"]) == ("1000", "")
    assert (rows[2]["x_px"], rows[2]["reason"]) == ("", EMPTY.reason)


# ---- the pages -------------------------------------------------------------------------------------------------------


def titles(figure):
    return {axes.get_title(loc="left") for axes in figure.axes}


def words(figure):
    return {text.get_text() for axes in figure.axes for text in axes.texts}


def test_the_page_of_a_picture_shows_every_aspect_and_is_written_as_png_and_svg(tmp_path):
    figure = image_page(examine(replace(SMALL, stem=True).noisy(1), name="ball.png"))
    for ending in (".png", ".svg"):
        look.save(figure, tmp_path / f"page{ending}")
    assert (tmp_path / "page.png").read_bytes().startswith(b"\x89PNG")
    assert "</svg>" in (tmp_path / "page.svg").read_text()
    assert titles(figure) >= {
        "Radial profile",
        "Centre on the pixel grid, 100×",
        "Residuals by sector: edge minus outline, ±1σ",
        "How well each sector looks like an edge",
        "Levels and contrast",
        "Whole image, 160 × 120 px",
    }
    assert "pixel (80, 61)" in words(figure)


def test_the_centre_is_drawn_100_times_as_large_as_a_pixel():
    figure = image_page(examine(SMALL.noisy(1)))
    (axes,) = [axes for axes in figure.axes if "100×" in axes.get_title(loc="left")]
    figure.draw_without_rendering()
    left, right = axes.transData.transform([(80.0, 60.0), (81.0, 60.0)])
    assert right[0] - left[0] == pytest.approx(100.0, abs=0.5)


def test_the_page_of_a_picture_without_a_ball_says_why(tmp_path):
    figure = image_page(examine(np.full((120, 160), 60, np.uint8), name="dark.png"))
    look.save(figure, tmp_path / "page.png")
    assert figure.get_suptitle() == "dark.png: no ball found"
    assert "none found" in words(figure)


def test_the_page_of_a_series_marks_missed_frames_and_tells_the_allan_deviation(tmp_path, still):
    series = [*still, Sample("gone.png", 24_000, EMPTY, None)]
    figure = series_page("still", series, repeatability([sample.outline for sample in series]))
    look.save(figure, tmp_path / "page.png")
    assert "Allan deviation, 95 % interval" in titles(figure)
    assert any("found in 24, missed in 1" in word for word in words(figure))
    over_time = figure.axes[0]
    assert "missed" in [text.get_text() for text in over_time.get_legend().get_texts()]


def test_a_series_of_two_frames_apart_has_a_page_too(tmp_path, still):
    series = [still[0], Sample("gone.png", None, EMPTY, None), still[1]]
    figure = series_page("two", series, repeatability([sample.outline for sample in series]))
    look.save(figure, tmp_path / "page.png")
    assert "no two neighbouring frames with a ball" in words(figure)


def test_a_page_that_cannot_be_written_is_an_error_with_its_path(tmp_path):
    figure = image_page(examine(np.full((120, 160), 60, np.uint8)))
    with pytest.raises(TrackerdError, match=r"nowhere/page\.png: cannot be written: No such file"):
        look.save(figure, tmp_path / "nowhere" / "page.png")


# ---- live ------------------------------------------------------------------------------------------------------------

GREY = np.full((120, 160), 60, np.uint8)


def seen_by(*outlines, exposure_s=0.002):
    view = LiveView()
    for n, outline in enumerate(outlines):
        view.add(Glance(0.02 * n, exposure_s, outline), GREY, NOISE)
    return dict(view.rows())


def blurred(blur_px, count=6):
    return [replace(FOUND, blur_px=blur_px)] * count


def test_the_best_edge_of_the_run_stays_while_the_ring_is_turned_on():
    rows = seen_by(*blurred(2.0), *blurred(0.9), *blurred(1.8))
    assert rows["edge width"] == "1.80 px (sigma), best 0.90 px"
    assert rows["focus"] == "█" * 12 + "·" * 12 + " 2.00 x as wide as the best so far: turn back"


def test_one_lucky_frame_is_not_the_best_focus():
    rows = seen_by(*blurred(1.8), *blurred(0.5, 1), *blurred(1.8))
    assert rows["edge width"] == "1.80 px (sigma), best 1.80 px"


def test_a_ball_that_moves_in_the_exposure_is_no_measure_of_focus():
    moving = [replace(FOUND, x_px=100.0 + 20.0 * n, blur_px=0.5) for n in range(8)]
    rows = seen_by(*blurred(0.9), *moving)
    assert rows["edge width"].endswith("best 0.90 px")
    assert "moving: 0.6 px of smear" in rows["focus"]
    assert "moving" not in seen_by(*blurred(0.9), *moving, exposure_s=1e-5)["focus"]


def test_without_a_ball_the_view_says_why_and_what_to_try():
    rows = seen_by(*blurred(0.9), EMPTY)
    assert rows["ball"] == f"not seen: {EMPTY.reason}"
    assert rows["image"] == "60 of 255 DN in its brightest parts"
    assert "roughly into focus" in rows["advice"]
    assert rows["rate"] == "50.0 Hz, ball in 6 of 7 frames"


def test_the_scatter_is_of_the_frames_since_the_ball_came_back():
    rows = seen_by(replace(FOUND, x_px=500.0), EMPTY, FOUND, replace(FOUND, x_px=100.002))
    assert rows["x"] == "100.002 px, scatter 0.0014 over 2 frames"
    assert seen_by(FOUND)["x"] == "100.000 px"
    assert dict(LiveView().rows()) == {"ball": "no frame yet"}


def test_the_view_tells_exposure_contrast_clipping_and_rate():
    rows = seen_by(*[replace(FOUND, inside_dn=250.0, clipped=0.03)] * 30)
    assert rows["contrast"] == "190 DN: 250 inside, 60 outside, of 255"
    assert rows["clipped"] == "3.0 % of the outline"
    assert rows["exposure"].startswith("too bright: 3 % of the outline is clipped")
    assert rows["rate"] == "50.0 Hz, ball in 30 of 30 frames"


# ---- what a person has to change -------------------------------------------------------------------------------------

DEMO = str(Path(__file__).parents[2] / "config" / "demo.toml")


@pytest.fixture
def here(tmp_path, monkeypatch):
    """A working folder with a file that is no picture; the process as it was afterwards."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "1")
    (tmp_path / "here.png").write_text("no picture")
    handler = signal.getsignal(signal.SIGTERM)
    yield tmp_path
    signal.signal(signal.SIGTERM, handler)


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ("", "inspect: needs either PATH, what to look at, or --live"),
        ("here.png --live", "inspect: needs either PATH, what to look at, or --live"),
        ("nowhere.png", "nowhere.png: there is no such file or folder"),
        ("here.png", "here.png: cannot be decoded"),
        ("here.png --out page.jpg", "--out page.jpg: must end in .png, .svg, .pdf"),
        ("here.png --camera left", "--camera left: needs --config FILE, the cell that has this camera"),
        ("here.png --station up", "here.png: --station up: there is no such station (there are: none: it is no recording)"),
        ("--live", "inspect --live: needs --config FILE, the cell that has the camera"),
        (f"--live --config {DEMO}", "demo.toml: which camera? --camera NAME, one of left, right"),
        (f"--live --config {DEMO} --camera up", "demo.toml: --camera up: no such camera (there are: left, right)"),
    ],
)
def test_what_a_person_has_to_change_ends_with_status_2_and_one_line(words, says, here, capsys):
    assert main(["inspect", *words.split()]) == 2
    told = capsys.readouterr()
    assert told.err.startswith("trackerd: ")
    assert says in told.err
    assert told.err.count("\n") == 1
    assert told.out == ""
    assert [path.name for path in here.iterdir()] == ["here.png"]


def test_a_guess_is_three_numbers(here, capsys):
    with pytest.raises(SystemExit):
        main(["inspect", "here.png", "--guess", "1,2"])
    assert "'1,2': needs X,Y,R, as in 1020,760,60" in capsys.readouterr().err
