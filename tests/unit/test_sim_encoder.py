import numpy as np
import pytest

from trackerd.formats.settings import ARCSEC
from trackerd.formats.twin import EncoderSettings
from trackerd.sim.encoder import Encoder, EncoderMap
from trackerd.sim.noise import key, normal, uniform

TURN = np.linspace(0.0, 2.0 * np.pi, 7200, endpoint=False)


@pytest.mark.parametrize("weights", [(1.0, 1.0, 1.0, 1.0), (3.0, 2.0, 0.5, 0.1)])
def test_the_map_has_the_rms_of_the_settings_over_the_turn(weights):
    settings = EncoderSettings(fixed_arcsec=2.0, fixed_weights=weights)
    errors = [EncoderMap(settings, 7)(angle) for angle in TURN]
    assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(2.0 * ARCSEC)
    assert np.mean(errors) == pytest.approx(0.0, abs=1e-12)


def test_the_map_holds_the_cycles_of_the_settings_only():
    errors = [EncoderMap(EncoderSettings(fixed_arcsec=2.0), 7)(angle) for angle in TURN]
    amplitudes = np.abs(np.fft.rfft(errors)) / len(TURN) * 2.0
    assert set(np.flatnonzero(amplitudes > 1e-9)) == {1, 2, 36, 360}


def test_every_axis_has_a_map_of_its_own():
    settings = EncoderSettings(fixed_arcsec=2.0)
    readings = {Encoder(settings, 1, gimbal, axis).read(0.3, 0) for gimbal in ("left", "right") for axis in ("az", "el")}
    assert len(readings) == 4


def test_the_white_part_is_normal_and_new_at_every_instant():
    encoder = Encoder(EncoderSettings(white_arcsec=2.0), 1, "left", "az")
    noise = np.array([encoder.read(0.1, t_ns) - 0.1 for t_ns in range(0, 20_000_000, 1000)]) / ARCSEC
    assert noise.std() == pytest.approx(2.0, rel=0.03)
    assert noise.mean() == pytest.approx(0.0, abs=0.06)
    assert abs(np.corrcoef(noise[1:], noise[:-1])[0, 1]) < 0.03
    assert np.mean((noise / 2.0) ** 4) == pytest.approx(3.0, abs=0.25)


def test_the_same_instant_reads_the_same():
    encoder = Encoder(EncoderSettings(white_arcsec=2.0, fixed_arcsec=1.0), 1, "left", "az")
    assert encoder.read(0.1, 123) == encoder.read(0.1, 123)


def test_without_errors_the_angle_is_read():
    assert Encoder(EncoderSettings(), 1, "left", "az").read(0.123, 5) == 0.123


def test_streams_of_draws_are_apart_and_uniform():
    draws = np.array([uniform(key(3, "left"), n) for n in range(20_000)])
    others = np.array([uniform(key(3, "right"), n) for n in range(20_000)])
    assert np.histogram(draws, 10, (0.0, 1.0))[0] == pytest.approx(np.full(10, 2000), abs=200)
    assert abs(np.corrcoef(draws, others)[0, 1]) < 0.03
    assert normal(key(3, "left"), -1) == normal(key(3, "left"), -1)
