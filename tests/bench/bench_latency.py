"""Latency between camera and encoders from a sweep of 3 s at 55 fps: error, and whether the stated sigma is true.

Simulated: two gimbals, 2 m range, f 31000 px, 0.1 px, encoders of 2 arcsec, white alone and with 2 arcsec rms more as a
function of the angle; the calibration is a little off. Angles come from a history of 1 kHz, or from one latch a frame.

    python tests/bench/bench_latency.py [--seeds 25]
"""

import argparse
import sys
from math import sqrt
from pathlib import Path

import numpy as np
from scipy.stats import chi2 as chi2_distribution

sys.path.insert(0, str(Path(__file__).parents[1]))

from unit.made_sweeps import STATIONS, Made

from trackerd.calibrate.latency import latency_of
from trackerd.contract.model import Array

LIMIT_US = 5.0
HEAD = "angles   encoder's error     axis    bias us  rms us  95 % us  largest us  stated us  NEES   (99 % if true)   chi2/dof"


def sweeps(seeds: int, fixed_arcsec: float) -> list[Made]:
    late = np.random.default_rng(7).uniform(-400.0, 400.0, (seeds, 2))
    return [
        Made(seed, station, (late[seed, 0], late[seed, 1]), fixed_arcsec=fixed_arcsec)
        for seed in range(seeds)
        for station in STATIONS.values()
    ]


def tell(head: str, errors_us: Array, sigma_us: Array, chi2: float) -> float:
    """One row; returns the rms in us."""
    size, count = np.abs(errors_us), len(errors_us)
    low, high = (float(chi2_distribution.ppf(p, count)) / count for p in (0.005, 0.995))
    rms = sqrt(float(np.mean(size**2)))
    row = (
        f"{np.mean(errors_us):+8.2f}  {rms:6.2f}  {np.quantile(size, 0.95):7.2f}  {size.max():10.2f}  {np.mean(sigma_us):9.2f}"
    )
    print(f"{head}{row}  {np.mean((errors_us / sigma_us) ** 2):4.2f}   ({low:.2f} to {high:.2f}) {chi2:8.2f}")
    return rms


def rows(read: str, fixed_arcsec: float, seeds: int) -> float:
    """The three rows of one kind of angles; returns the larger rms of an axis."""
    made = sweeps(seeds, fixed_arcsec)
    found = [latency_of(one.believed, one.historied() if read == "1 kHz" else one.latched()) for one in made]
    errors = np.array([latency.offset_s * 1e6 - one.late_us for one, latency in zip(made, found, strict=True)])
    sigmas = np.array([latency.sigma_s * 1e6 for latency in found])
    chi2 = float(np.mean([latency.chi2 / latency.freedom for latency in found]))
    kind = "2 white + 2 fixed" if fixed_arcsec else "2 white"
    return max(tell(f"{read:9s}{kind:20s}{axis:7s}", errors[:, i], sigmas[:, i], chi2) for i, axis in enumerate(("AZ", "EL")))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=25)
    seeds = parser.parse_args().seeds
    print(f"simulated, {seeds} seeds x 2 gimbals, 3 s at 55 fps, latencies between -400 and 400 us")
    print(HEAD)
    worst = {read: max(rows(read, fixed, seeds) for fixed in (0.0, 2.0)) for read in ("1 kHz", "latches")}
    for read, rms in worst.items():
        print(f"{read}: {rms:.2f} us rms of an axis at most, limit {LIMIT_US:g}: {'met' if rms <= LIMIT_US else 'MISSED'}")


if __name__ == "__main__":
    main()
