"""What encoders whose error is a function of the angle cost: position error over many encoders, without any other error.

Each seed is another set of encoders in the demo's cell. Nothing is averaged or filtered, and nothing of it is absorbed by a
calibration: a still target has one error for ever, whose size is a matter of luck; the circle's is the mean over its places.

    python tests/bench/bench_encoder.py [--seeds 40]
"""

import argparse
from pathlib import Path

import numpy as np

from trackerd.contract.clock import HostNs
from trackerd.contract.model import Array, Sightline
from trackerd.formats.calibration import load_calibration
from trackerd.formats.twin import EncoderSettings
from trackerd.geometry.gimbal import Station
from trackerd.geometry.triangulate import triangulate
from trackerd.sim.encoder import EncoderMap
from trackerd.sim.noise import key

ARCSEC = np.pi / 648_000.0
CALIBRATION = Path(__file__).parents[2] / "config" / "demo-calibration.toml"
PLACES = [np.array((150.0 * np.cos(a), 150.0 * np.sin(a), 0.0)) for a in np.linspace(0.0, 2.0 * np.pi, 60, endpoint=False)]


def error_mm(stations: dict[str, Station], maps: dict[tuple[str, str], EncoderMap], p_mm: Array) -> float:
    lines = []
    for name, station in stations.items():
        az, el = station.aim(p_mm)
        pose = station.world_from_camera(az + maps[name, "az"](az), el + maps[name, "el"](el))
        d = pose.rotate(station.lens.unproject(np.array((station.lens.cx_px, station.lens.cy_px))))
        cov = ARCSEC**2 * (np.eye(3) - np.outer(d, d))
        lines.append(Sightline(name, HostNs(0), 0.0, pose.translation_mm, d, cov, 0.0 * cov, 2000.0, 1.0, HostNs(0)))
    return float(np.linalg.norm(triangulate(lines).p_mm - p_mm))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=40)
    seeds = parser.parse_args().seeds
    stations = load_calibration(CALIBRATION).stations
    settings = EncoderSettings(fixed_arcsec=2.0)
    rows = []
    for seed in range(1, seeds + 1):
        maps = {(n, a): EncoderMap(settings, key(seed, n, a, "map")) for n in stations for a in ("az", "el")}
        rows.append([error_mm(stations, maps, p_mm) for p_mm in PLACES])
    errors = np.array(rows)
    still, circle = errors[:, 0], np.sqrt((errors**2).mean(axis=1))
    head = f"2 arcsec rms, {seeds} sets of encoders, 3D error in mm"
    print(f"{head:56s}rms over seeds smallest   median  largest   seed 1")
    for what, of_seeds in (("still, where the circle begins", still), ("circle, rms over its places", circle)):
        spread = (of_seeds.min(), np.median(of_seeds), of_seeds.max(), of_seeds[0])
        print(f"  {what:54s}{np.sqrt((of_seeds**2).mean()):14.3f}", *(f"{value:9.3f}" for value in spread))


if __name__ == "__main__":
    main()
