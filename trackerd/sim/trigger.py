"""When the cameras expose: all at the same instants, or each by its own oscillator."""

from dataclasses import dataclass

from trackerd.formats.settings import CameraSettings
from trackerd.formats.twin import TwinSettings
from trackerd.sim.noise import key, uniform


@dataclass(frozen=True, slots=True)
class Trigger:
    """Exposure k begins at phase + k period, in ns of the scene's time."""

    phase_ns: int
    period_ns: float
    exposure_ns: int

    def begin_ns(self, k: int) -> int:
        return self.phase_ns + round(k * self.period_ns)

    def first_from(self, t_ns: int) -> int:
        """The number of the first exposure that begins at t_ns or later."""
        k = max(0, int((t_ns - self.phase_ns) / self.period_ns) - 1)
        while self.begin_ns(k) < t_ns:
            k += 1
        return k


def trigger_of(settings: TwinSettings, name: str, camera: CameraSettings) -> Trigger:
    """Free: a seeded phase within the period, and a seeded rate within the tolerance."""
    period_ns, exposure_ns = 1e9 / camera.frame_rate_hz, round(camera.exposure_us * 1000.0)
    if settings.trigger == "shared":
        return Trigger(0, period_ns, exposure_ns)
    stream = key(settings.seed, name, "trigger")
    off_ppm = settings.free_ppm * (2.0 * uniform(stream, 1) - 1.0)
    return Trigger(int(period_ns * uniform(stream, 0)), period_ns * (1.0 + off_ppm * 1e-6), exposure_ns)
