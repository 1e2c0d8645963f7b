import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from trackerd.formats.twin import EncoderSettings, PathSettings
from trackerd.sim.encoder import EncoderMap
from trackerd.sim.path import ProbePath
from trackerd.sim.ramp import Ramp, Stroke
from trackerd.sim.servo import AxisLimits, AxisServo

MS = 1_000_000
CHECKED = settings(deadline=None, max_examples=60)

angles = st.floats(-1.0, 1.0)
rates = st.floats(-5.0, 5.0)
commands = st.lists(
    st.tuples(st.sampled_from(("hold", "follow", "turn")), angles, rates, st.integers(1, 80_000_000)), min_size=1, max_size=12
)
axes = st.builds(
    AxisLimits,
    rad_s=st.floats(0.05, 3.0),
    rad_s2=st.floats(0.1, 40.0),
    travel_rad=st.tuples(st.floats(-0.6, -0.1), st.floats(0.1, 0.6)),
    bandwidth_rad_s=st.floats(1.0, 370.0),
    damping=st.floats(0.5, 2.0),
)


@given(axes, commands)
@CHECKED
def test_speed_acceleration_and_travel_hold_for_any_commands(limits, commanded):
    servo, t_ns = AxisServo(limits, 0.0), 0
    for kind, angle, rate, pause_ns in commanded:
        if kind == "hold":
            servo.hold(t_ns)
        elif kind == "turn":
            servo.turn(t_ns, rate)
        else:
            servo.follow(t_ns, angle, rate)
        t_ns += pause_ns
        before = servo.rate(-(-(t_ns - pause_ns) // MS) * MS)
        for k in range(-(-(t_ns - pause_ns) // MS) + 1, t_ns // MS + 1):
            rate_now, angle_now = servo.rate(k * MS), servo.angle(k * MS)
            assert abs(rate_now) <= limits.rad_s * (1 + 1e-9)
            assert abs(rate_now - before) <= limits.rad_s2 * 1e-3 * (1 + 1e-9)
            assert limits.travel_rad[0] - 1e-12 <= angle_now <= limits.travel_rad[1] + 1e-12
            before = rate_now


paths = st.builds(
    PathSettings,
    kind=st.sampled_from(("still", "circle", "raster", "random")),
    radius_mm=st.floats(20.0, 300.0),
    speed_mm_s=st.floats(10.0, 1000.0),
    acceleration_mm_s2=st.floats(100.0, 5000.0),
    jerk_mm_s3=st.floats(1000.0, 50_000.0),
    rows=st.integers(2, 6),
    dwell_s=st.just(0.0),
)


@given(paths, st.integers(0, 1000), st.integers(0, 30_000_000_000))
@CHECKED
def test_velocity_and_acceleration_are_the_slopes_of_the_path(path_settings, seed, t_ns):
    path, step_ns = ProbePath(path_settings, seed), 50_000
    before, here, after = (path.at(t) for t in (t_ns, t_ns + step_ns, t_ns + 2 * step_ns))
    seconds = 2 * step_ns * 1e-9
    jerk = 4.0 * path_settings.jerk_mm_s3 + 1e5
    np.testing.assert_allclose((after[0] - before[0]) / seconds, here[1], atol=1e-4 + jerk * seconds**2)
    np.testing.assert_allclose((after[1] - before[1]) / seconds, here[2], atol=1e-3 + jerk * seconds)


@given(paths, st.integers(0, 1000))
@CHECKED
def test_no_path_exceeds_its_speed_reach_and_acceleration(path_settings, seed):
    path = ProbePath(path_settings, seed)
    speed, acceleration = path_settings.speed_mm_s, path_settings.acceleration_mm_s2
    turning = speed**2 / path_settings.radius_mm if path_settings.kind == "circle" else 0.0
    bounded = path_settings.kind in ("circle", "random")
    for t_ns in range(0, 20_000_000_000, 250_000_000):
        p, v, a = path.at(t_ns)
        assert np.linalg.norm(v) <= speed * (1 + 1e-9)
        assert np.linalg.norm(a) <= np.hypot(acceleration, turning) * (1 + 1e-9)
        assert not bounded or np.linalg.norm(p) <= path_settings.radius_mm * (1 + 1e-9)


@given(st.floats(0.1, 1000.0), st.floats(1.0, 2000.0), st.floats(10.0, 5000.0), st.floats(100.0, 1e6))
@CHECKED
def test_a_stroke_ends_at_rest_where_it_should_and_never_turns_back(length, speed, acceleration, jerk):
    stroke = Stroke.over(length, Ramp(speed, acceleration, jerk))
    states = [stroke.at(t) for t in np.linspace(0.0, stroke.duration_s, 101)]
    ways, speeds, accelerations = np.array(states).T
    assert ways[0] == 0.0
    assert abs(ways[-1] - length) < 1e-6 * length
    assert (np.diff(ways) > -1e-9 * length).all()
    assert speeds.min() > -1e-9 * speed
    assert speeds.max() <= speed * (1 + 1e-9)
    assert np.abs(accelerations).max() <= acceleration * (1 + 1e-9)


@given(st.integers(0, 10_000), st.floats(0.0, 20.0))
@CHECKED
def test_the_encoder_map_closes_over_the_turn(seed, fixed_arcsec):
    error = EncoderMap(EncoderSettings(fixed_arcsec=fixed_arcsec), seed)
    assert abs(error(0.3) - error(0.3 + 2.0 * np.pi)) < 1e-12
