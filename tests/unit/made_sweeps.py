"""A made-up gimbal that sweeps over a still target, with encoders that are late: what the calibration of the latency is judged
with. White noise of the pixels and of every encoder reading, and the encoders' error as a function of the angle."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import pi
from typing import Literal

import numpy as np
from unit.sim_cell import station

from trackerd.calibrate.sweep import Sightings, Sweep, sweep_of_history, sweep_of_latches
from trackerd.contract.model import Array
from trackerd.geometry.gimbal import Station

ARCSEC = pi / 648_000.0
STATIONS = {"left": station("left", -550.0), "right": station("right", 550.0)}
TARGET = np.array((20.0, 10.0, 30.0))
CYCLES = np.array((1, 2, 36, 360))  # a turn, of the encoders' fixed error
RATE_HZ, HISTORY_HZ = 55.0, 1000.0


def still(t_s: Array) -> Array:
    return np.zeros((len(t_s), 3))


@dataclass(frozen=True)
class Made:
    """What is swept, and what is wrong."""

    seed: int = 1
    station: Station = STATIONS["left"]
    late_us: tuple[float, float] = (250.0, -80.0)
    kind: Literal["sine", "triangle", "one way"] = "sine"
    swing_deg: tuple[float, float] = (1.2, 0.9)
    pace_hz: tuple[float, float] = (2.3, 3.1)
    seconds: float = 3.0
    pixel_px: float = 0.1
    white_arcsec: float = 2.0
    fixed_arcsec: float = 0.0  # rms over the turn
    hysteresis_arcsec: float = 0.0  # to either side
    smear_arcsec: float = 0.0  # at the highest speed, with its square
    moves_mm: Callable[[Array], Array] = still
    exposure_s: float = 0.0

    def rng(self, stream: int) -> np.random.Generator:
        """Of its own for each gimbal: two of one seed share nothing."""
        return np.random.default_rng((self.seed, stream, *self.station.name.encode()))

    def angles(self, t_s: Array) -> Array:
        """True (n, 2)."""
        rng = self.rng(1)
        az_el = np.array(self.station.aim(TARGET, np.array((1023.5, 767.5))))
        turns = np.array(self.pace_hz) * t_s[:, None] + rng.uniform(0.0, 1.0, 2)
        wave = np.sin(2.0 * pi * turns)
        if self.kind == "triangle":
            wave = np.arcsin(0.995 * wave) * 2.0 / pi  # an axis does not turn round at once
        if self.kind == "one way":
            wave = (t_s / self.seconds - 0.5)[:, None] * 2.0 + 0.0 * wave
        return np.asarray(az_el + np.radians(self.swing_deg) * wave)

    def readings(self, t_s: Array, rng: np.random.Generator) -> Array:
        """Encoders (n, 2) as they are stamped at t_s: each axis' angle of a little later, and its errors."""
        late = [self._true_readings(t_s + us * 1e-6)[:, axis] for axis, us in enumerate(self.late_us)]
        return np.stack(late, axis=1) + rng.normal(0.0, self.white_arcsec * ARCSEC, (len(t_s), 2))

    def sightings(self) -> Sightings:
        rng = self.rng(2)
        t_s = np.arange(round(RATE_HZ * self.seconds)) / RATE_HZ + rng.uniform(0.0, 1.0 / RATE_HZ)
        seen = zip(TARGET + self.moves_mm(t_s), self.angles(t_s), strict=True)
        q_px = np.array([self.station.pixel(p, *angles.tolist()) for p, angles in seen])
        cov = np.broadcast_to(self.pixel_px**2 * np.eye(2), (len(t_s), 2, 2))
        return Sightings(t_s, q_px + rng.normal(0.0, self.pixel_px, q_px.shape), cov, self.exposure_s)

    def latched(self) -> Sweep:
        """One reading a frame."""
        seen = self.sightings()
        angles = self.readings(seen.t_s, self.rng(3))
        return sweep_of_latches(seen, angles, max(self.white_arcsec, 0.01) * ARCSEC)

    def history(self) -> tuple[Array, Array]:
        """1 kHz, from before the first frame to after the last one."""
        t_s = np.arange(-0.02, self.seconds + 0.05, 1.0 / HISTORY_HZ)
        return t_s, self.readings(t_s, self.rng(4))

    def historied(self) -> Sweep:
        return sweep_of_history(self.sightings(), *self.history())

    @property
    def believed(self) -> Station:
        """What the calibration has for the station: a little off, as they are."""
        camera = self.station.rg_from_camera
        lens = replace(self.station.lens, fx_px=0.995 * self.station.lens.fx_px, fy_px=0.995 * self.station.lens.fy_px)
        off = replace(camera, translation_mm=camera.translation_mm + np.array((0.5, -1.0, 20.0)))
        return replace(self.station, eps_rad=self.station.eps_rad + 3e-4, rg_from_camera=off, lens=lens)

    def _true_readings(self, t_s: Array) -> Array:
        angles, h = self.angles(t_s), 1e-5
        speed = (self.angles(t_s + h) - self.angles(t_s - h)) / (2.0 * h)
        share = speed / (2.0 * pi * np.array(self.pace_hz) * np.radians(self.swing_deg) + 1e-12)
        phases = self.rng(5).uniform(0.0, 2.0 * pi, (2, len(CYCLES)))
        fixed = self.fixed_arcsec / np.sqrt(2.0) * np.cos(CYCLES * angles[:, :, None] + phases).sum(axis=2)
        odd = self.hysteresis_arcsec * np.tanh(share / 0.05) + self.smear_arcsec * share * np.abs(share)
        return np.asarray(angles + (fixed + odd) * ARCSEC)
