"""What fusion adds to or takes from the lines of sight: 3D error of a fix at its own stamp, no alignment, no time shift.

Two stations 2 m from the work, baseline 1.1 m, 55 fps, 2 arcsec white in each of two directions. Still, on a circle of 150 mm
radius at 250 mm/s and on others; common trigger and free-running; both motion models over their process noise.

    python tests/bench/bench_fuse.py [--sweep]
"""

import argparse
import time
from collections.abc import Callable, Iterator
from math import cos, pi, sin, sqrt

import numpy as np

from trackerd.contract.clock import HostNs
from trackerd.contract.model import Array, Fix, Sightline
from trackerd.engine.fuse import Fuser
from trackerd.formats.settings import FusionSettings

ARCSEC = pi / 648_000.0
PERIOD_NS = 18_181_818
STATIONS = {"left": np.array((-550.0, 0.0, 0.0)), "right": np.array((550.0, 0.0, 0.0))}
CENTRE = np.array((0.0, 0.0, sqrt(2000.0**2 - 550.0**2)))
RADIUS_MM = 150.0
LATENCY_NS = 8_000_000

Path = Callable[[float], Array]


def still(t_s: float) -> Array:
    return CENTRE


def circle(speed_mm_s: float) -> Path:
    """In a plane tilted by 45 deg, so that depth takes part."""

    def path(t_s: float) -> Array:
        a = speed_mm_s / RADIUS_MM * t_s
        return CENTRE + RADIUS_MM * np.array((cos(a), sin(a) * sqrt(0.5), sin(a) * sqrt(0.5)))

    return path


def raster(t_s: float) -> Array:
    """Rows of 200 mm there and back at up to 250 mm/s and 1 m/s^2: acceleration that switches."""
    ramp_s = 0.25
    half_s = 2 * ramp_s + (200.0 - 250.0 * ramp_s) / 250.0
    row, t = divmod(t_s, half_s)
    if t < ramp_s:
        x = 500.0 * t * t
    elif t < half_s - ramp_s:
        x = 31.25 + 250.0 * (t - ramp_s)
    else:
        x = 200.0 - 500.0 * (half_s - t) ** 2
    return CENTRE + np.array(((x if row % 2 == 0 else 200.0 - x) - 100.0, 0.0, 0.0))


def lines(path: Path, duration_s: float, skew_ns: int, seed: int, sigma_rad: float = 2 * ARCSEC) -> Iterator[Sightline]:
    """Of both stations in the order of their instants; the second is `skew_ns` late."""
    rng = np.random.default_rng(seed)
    for n in range(round(duration_s * 1e9) // PERIOD_NS):
        for station, late_ns in (("left", 0), ("right", skew_ns)):
            instant = HostNs(n * PERIOD_NS + late_ns)
            offset = path(instant * 1e-9) - STATIONS[station]
            range_mm = float(np.linalg.norm(offset))
            direction = offset / range_mm
            across = np.eye(3) - np.outer(direction, direction)
            seen = direction + across @ rng.normal(0.0, sigma_rad, 3)
            seen /= np.linalg.norm(seen)
            yield Sightline(
                station=station,
                instant=instant,
                instant_sigma_ns=0.0,
                origin_mm=STATIONS[station],
                direction=seen,
                cov_rad2=sigma_rad**2 * (np.eye(3) - np.outer(seen, seen)),
                fixed_cov_rad2=np.zeros((3, 3)),
                range_mm=range_mm,
                range_sigma_mm=2.0,
                received=HostNs(instant + LATENCY_NS),
            )


def run(path: Path, settings: FusionSettings, skew_ns: int, duration_s: float = 20.0, seed: int = 1) -> list[Fix]:
    fuser = Fuser(tuple(STATIONS), settings, 12.7, 0.05, PERIOD_NS)
    fixes = []
    for line in lines(path, duration_s, skew_ns, seed):
        fixes += fuser.add(line, line.received)
    return fixes


def judge(path: Path, fixes: list[Fix], settle_s: float = 1.0) -> tuple[float, float, float, float]:
    """RMS, 95 % and maximum of the 3D error in mm, and NEES / 3."""
    judged = [fix for fix in fixes if fix.valid and fix.instant * 1e-9 > settle_s]
    errors = np.array([fix.position_mm - path(fix.instant * 1e-9) for fix in judged])
    nees = np.array([e @ np.linalg.solve(f.cov_mm2, e) for e, f in zip(errors, judged, strict=True)])
    length = np.linalg.norm(errors, axis=1)
    return sqrt(float((length**2).mean())), float(np.quantile(length, 0.95)), float(length.max()), float(nees.mean()) / 3


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sweep", action="store_true", help="process noise over six decades")
    sweep = parser.parse_args().sweep
    paths = {"still": still, "circle 250": circle(250.0), "raster 250": raster, "circle 1000": circle(1000.0)}
    decades = {"constant_velocity": range(2, 8), "constant_acceleration": range(3, 9)}
    default = FusionSettings()
    choices = [(m, 10.0**e) for m, d in decades.items() for e in d] if sweep else [(default.model, default.process_noise)]
    print(f"{'model':22} {'noise':>8} {'path':12} {'skew ms':>7} {'rms':>7} {'95 %':>7} {'max':>7} {'NEES/3':>7}")
    for model, noise in choices:
        settings = FusionSettings(model=model, process_noise=noise, gate_chi2=1e4 if sweep else default.gate_chi2)
        for name, path in paths.items():
            for skew_ns in (0, PERIOD_NS // 2):
                rms, q95, worst, nees = judge(path, run(path, settings, skew_ns))
                print(f"{model:22} {noise:8.0e} {name:12} {skew_ns / 1e6:7.1f} {rms:7.4f} {q95:7.4f} {worst:7.4f} {nees:7.2f}")
    started = time.perf_counter()
    n = len(run(circle(250.0), default, 0))
    print(f"cost of a fix from two lines: {(time.perf_counter() - started) / n * 1e6:.0f} us, line generation included")


if __name__ == "__main__":
    main()
