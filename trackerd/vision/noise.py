"""What a pixel's grey value is worth: shot, read and rounding noise of one sensor."""

from dataclasses import dataclass
from math import sqrt

ROUNDING_DN2 = 1.0 / 12.0  # variance of rounding to whole grey levels


@dataclass(frozen=True, slots=True)
class NoiseModel:
    """Gain and read noise of the sensor in the grey levels (DN) of the image at hand."""

    gain_e_per_dn: float = 39.0
    read_noise_e: float = 3.0
    saturation_dn: float | None = None  # default: the greatest value of the image's type

    @property
    def floor_dn2(self) -> float:
        """Variance of a dark pixel."""
        return (self.read_noise_e / self.gain_e_per_dn) ** 2 + ROUNDING_DN2

    def sigma_dn(self, level_dn: float) -> float:
        return sqrt(max(level_dn, 0.0) / self.gain_e_per_dn + self.floor_dn2)

    def saturation_of(self, greatest_dn: int) -> float:
        return float(greatest_dn) if self.saturation_dn is None else self.saturation_dn
