"""Scene time (ns since the twin's start), the host's and each device's own."""

import time
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class SceneTime:
    """The scene runs on CLOCK_MONOTONIC, from an instant on."""

    start_host_ns: int

    def now(self) -> int:
        return time.monotonic_ns() - self.start_host_ns

    def host(self, scene_ns: int) -> int:
        return scene_ns + self.start_host_ns

    def scene(self, host_ns: int) -> int:
        return host_ns - self.start_host_ns


@dataclass(frozen=True, slots=True)
class DeviceClock:
    """A free-running clock: it counts from its device's start, at its own rate."""

    offset_ns: int = 0  # what it reads at its start
    drift_ppm: float = 0.0
    started_ns: int = 0  # scene time

    def device_ns(self, scene_ns: int) -> int:
        elapsed = scene_ns - self.started_ns
        return self.offset_ns + elapsed + round(elapsed * self.drift_ppm * 1e-6)

    def device_us(self, scene_ns: int) -> int:
        return self.device_ns(scene_ns) // 1000

    def scene_ns(self, device_us: int) -> int:
        elapsed = device_us * 1000 - self.offset_ns
        return self.started_ns + elapsed - round(elapsed * self.drift_ppm * 1e-6 / (1.0 + self.drift_ppm * 1e-6))

    def restarted(self, scene_ns: int) -> "DeviceClock":
        return DeviceClock(self.offset_ns, self.drift_ppm, scene_ns)
