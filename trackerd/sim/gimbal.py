"""One simulated gimbal: two servo axes and their encoders on a stand that is not quite where the calibration says.

The controller counts in its own two channels. Which axis a channel drives, and which way it turns, is only seen in the image.
"""

from dataclasses import replace
from math import pi, sin

import numpy as np

from trackerd.contract.model import Array
from trackerd.formats.settings import Pixel
from trackerd.formats.twin import ErrorSettings, TwinSettings
from trackerd.geometry.gimbal import Station
from trackerd.geometry.rigid import Rigid, rotation_about_x, rotation_about_y
from trackerd.sim.encoder import Encoder
from trackerd.sim.noise import key, normal, uniform
from trackerd.sim.servo import AxisLimits, AxisServo

US = 1e3  # ns


class SimGimbal:
    """`az` and `el` are the servos of the controller's two channels, to be commanded in encoder angles."""

    def __init__(self, name: str, settings: TwinSettings, nominal: Station) -> None:
        self.name = name
        self.error = settings.error_of(name)
        self.station = true_station(nominal, self.error)
        self.az = AxisServo(AxisLimits.of(settings.axes, settings.axes.az_limits_rad), 0.0)
        self.el = AxisServo(AxisLimits.of(settings.axes, settings.axes.el_limits_rad), 0.0)
        self._encoders = settings.encoder
        self._az_encoder = Encoder(settings.encoder, settings.seed, name, "az")
        self._el_encoder = Encoder(settings.encoder, settings.seed, name, "el")
        self._latch_noise = key(settings.seed, name, "latch")
        stream = key(settings.seed, name, "vibration")
        self._rocking_phases = (2.0 * pi * uniform(stream, 0), 2.0 * pi * uniform(stream, 1))

    def place(self, az_rad: float, el_rad: float) -> None:
        """Put the axes somewhere, at rest, at the scene's start."""
        self.az = AxisServo(self.az.limits, az_rad)
        self.el = AxisServo(self.el.limits, el_rad)

    def angles(self, t_ns: int) -> tuple[float, float]:
        """The channels' true angles (az, el), as an encoder without error would read them."""
        return self.az.angle(t_ns), self.el.angle(t_ns)

    def rates(self, t_ns: int) -> tuple[float, float]:
        return self.az.rate(t_ns), self.el.rate(t_ns)

    def encoder(self, t_ns: int, look_ns: int | None = None) -> tuple[float, float]:
        """What the controller reads at an instant, (az, el) in rad. Readings of one look share their noise."""
        look_ns = t_ns if look_ns is None else look_ns
        return self._az_encoder.read(self.az.angle(t_ns), look_ns), self._el_encoder.read(self.el.angle(t_ns), look_ns)

    def latched(self, t_ns: int, exposure_ns: int | None = None) -> tuple[float, float]:
        """What the latch holds for an edge at an instant: it takes the angles a little late.

        Both edges of the exposure that began at `exposure_ns` share the noise: what spoils a reading does not change within
        some ms, so the mean of two edges is no better than one.
        """
        late_us = self._encoders.latch_skew_us + self._encoders.latch_jitter_us * normal(self._latch_noise, t_ns)
        taken_ns = t_ns + round(late_us * US)
        return self.encoder(taken_ns, taken_ns if exposure_ns is None else exposure_ns)

    def pose(self, t_ns: int) -> Rigid:
        """The true world_from_camera."""
        station = self.station
        if self.error.vibration_rad > 0.0:
            station = replace(station, world_from_gimbal=station.world_from_gimbal @ self._rocking(t_ns))
        return station.world_from_camera(*_axis_angles(self.error, *self.angles(t_ns)))

    def aim(self, p_world_mm: Array, q_px: Pixel) -> tuple[float, float]:
        """The channel angles that show a point at a pixel of the sensor. Raises Degenerate where none do."""
        return _channel_angles(self.error, *self.station.aim(p_world_mm, np.array(q_px)))

    def _rocking(self, t_ns: int) -> Rigid:
        turn = 2.0 * pi * self.error.vibration_hz * t_ns * 1e-9
        about_x, about_y = (self.error.vibration_rad * sin(turn + phase) for phase in self._rocking_phases)
        return Rigid(rotation_about_x(about_x) @ rotation_about_y(about_y), np.zeros(3))


def true_station(nominal: Station, error: ErrorSettings) -> Station:
    """The station of the calibration, with its errors built in. Signs and a swap are the channels', not the station's."""
    about_x, about_y = error.stand_tilt_rad
    tilt = Rigid(rotation_about_x(about_x) @ rotation_about_y(about_y), np.zeros(3))
    camera = nominal.rg_from_camera
    return replace(
        nominal,
        world_from_gimbal=nominal.world_from_gimbal @ tilt,
        rg_from_camera=Rigid(camera.rotation, camera.translation_mm + np.array(error.lever_mm)),
        eps_rad=nominal.eps_rad + error.eps_rad,
        d_mm=nominal.d_mm + error.d_mm,
    )


def _axis_angles(error: ErrorSettings, az_rad: float, el_rad: float) -> tuple[float, float]:
    """The station's encoder angles that the channels' angles stand for."""
    if error.swapped:
        az_rad, el_rad = el_rad, az_rad
    return error.az_sign * az_rad, error.el_sign * el_rad


def _channel_angles(error: ErrorSettings, az_rad: float, el_rad: float) -> tuple[float, float]:
    """The way back."""
    az_rad, el_rad = error.az_sign * az_rad, error.el_sign * el_rad
    return (el_rad, az_rad) if error.swapped else (az_rad, el_rad)
