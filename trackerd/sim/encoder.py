"""What an encoder reads: the angle, a fixed function of the angle, and the noise of the one reading."""

from math import cos, pi, sqrt

from trackerd.formats.settings import ARCSEC
from trackerd.formats.twin import EncoderSettings
from trackerd.sim.noise import key, normal, uniform


class EncoderMap:
    """The fixed part: a sum of cosines over the turn with seeded phases; no averaging removes it."""

    def __init__(self, settings: EncoderSettings, stream: int) -> None:
        norm = sqrt(sum(weight * weight for weight in settings.fixed_weights) / 2.0)
        scale = settings.fixed_arcsec * ARCSEC / norm
        self._waves = tuple(
            (cycles, scale * weight, 2.0 * pi * uniform(stream, cycles))
            for cycles, weight in zip(settings.fixed_cycles, settings.fixed_weights, strict=True)
            if scale > 0.0
        )

    def __call__(self, angle_rad: float) -> float:
        """The error in rad at a true angle; its rms over the turn is the setting."""
        return sum(size * cos(cycles * angle_rad + phase) for cycles, size, phase in self._waves)


class Encoder:
    """One axis' encoder. A reading depends on the angle and the instant alone: the same question has the same answer."""

    def __init__(self, settings: EncoderSettings, seed: int, gimbal: str, axis: str) -> None:
        self._map = EncoderMap(settings, key(seed, gimbal, axis, "map"))
        self._white_rad = settings.white_arcsec * ARCSEC
        self._noise = key(seed, gimbal, axis, "white")

    def read(self, angle_rad: float, t_ns: int) -> float:
        """The reading at an instant whose true angle is given."""
        white = self._white_rad * normal(self._noise, t_ns) if self._white_rad > 0.0 else 0.0
        return angle_rad + self._map(angle_rad) + white
