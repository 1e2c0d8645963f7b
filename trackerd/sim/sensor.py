"""From the light that a pixel is due to the level that a camera gives: photons, read-out, fixed pattern, rounding, clipping."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from trackerd.contract.model import Array, Image

ROUNDING_DN2 = 1.0 / 12.0


@dataclass(frozen=True, slots=True)
class Sensor:
    """Grey levels (DN) are the camera's own: 0..255 for 8 bits, 0..4095 for 12."""

    gain_e_per_dn: float = 39.2
    read_noise_e: float = 3.0
    bits: int = 8
    flicker: float = 0.0  # rms share by which the light of one frame differs from the mean
    prnu: float = 0.0  # rms share by which the response of one pixel differs from the mean; it stays from frame to frame
    prnu_seed: int = 0

    @property
    def saturation_dn(self) -> float:
        return float((1 << self.bits) - 1)

    def variance_dn2(self, expected_dn: Array) -> Array:
        """Of a pixel's grey level about the level it is due: photon noise, read noise and rounding."""
        return np.asarray(
            np.maximum(expected_dn, 0.0) / self.gain_e_per_dn + (self.read_noise_e / self.gain_e_per_dn) ** 2 + ROUNDING_DN2
        )


def expose(expected_dn: npt.NDArray[np.floating], sensor: Sensor, rng: np.random.Generator) -> Image:
    """One frame (height, width), uint8 or uint16. Photons are normally distributed: at 39 electrons a DN it does not show."""
    light = np.asarray(expected_dn, np.float64)
    if sensor.prnu > 0.0:
        light = light * (1.0 + sensor.prnu * np.random.default_rng(sensor.prnu_seed).standard_normal(light.shape))
    if sensor.flicker > 0.0:
        light = light * (1.0 + sensor.flicker * rng.standard_normal())
    sigma = np.sqrt(sensor.variance_dn2(light) - ROUNDING_DN2)
    noisy = np.rint(light + sigma * rng.standard_normal(light.shape))
    return np.clip(noisy, 0.0, sensor.saturation_dn).astype(np.uint8 if sensor.bits <= 8 else np.uint16)
