"""What one frame costs: a tracker's step on the demo's rendered frames, by both kernels of the circle fit.

Hot is one step after the other. With pauses is as it is in the cell: frame by frame, the caches gone cold meanwhile; with two
threads both stations' frames arrive at once. Wall time is what a frame waits, CPU time what it costs on a shared machine.
Times are also given as a ratio to a 5x5 GaussianBlur of a 2048x1536 frame, which tells a slow machine from slow code.
"""

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Barrier, Thread
from time import perf_counter, sleep, thread_time

import cv2
import numpy as np

from trackerd.contract.clock import HostNs
from trackerd.contract.model import AxisAngles, Frame, TrackState
from trackerd.engine.track import Tracker
from trackerd.formats.calibration import load_calibration
from trackerd.geometry.sightline import Instants
from trackerd.twin.cell import scene_of
from trackerd.vision import by_numpy, fit, kernels
from trackerd.wiring.cell import load

CONFIG = Path(__file__).parents[2] / "config" / "demo.toml"
FRAMES, ROUNDS = 60, 4
PERIOD_NS = 18_181_818
PAUSE_S = 0.012
SETTLING = 10  # frames until it is locked and warm
WARM_UP = "from time import perf_counter as t; a = t(); from trackerd.vision.kernels import warm_up; warm_up(); print(t() - a)"


class Bench:
    """Frames and angles of one station of the demo, played as often as asked, in time that goes on."""

    def __init__(self) -> None:
        self.cell = load(CONFIG)
        self.stations = load_calibration(self.cell.calibration).stations
        scene = scene_of(self.cell, self.stations)
        name, self.camera = "left", self.cell.cameras["left"]
        gimbal, renderer = scene.gimbals[name], scene.renderer(name)
        gimbal.place(*gimbal.aim(scene.truth(0)[0], scene.mounts[name].kept_at_px))
        self.seen = []
        for n in range(FRAMES):
            t = n * PERIOD_NS
            for axis in (gimbal.az, gimbal.el):
                axis.advance(t + 2_000_000)
            view = scene.view(name, t, t + 2_000_000)
            self.seen.append((renderer.render(view.poses, view.probes_mm, n).copy(), gimbal.encoder(t + 1_000_000)))

    def tracker(self) -> Tracker:
        gimbal = self.cell.gimbals["left"]
        return Tracker(self.stations["left"], self.cell.probe.radius_mm, self.camera, gimbal.steering, gimbal.tracking)

    def play(self, before_each: Callable[[], object]) -> np.ndarray:
        """Wall and CPU time of every step in ms, (n, 2)."""
        tracker, times = self.tracker(), []
        for n in range(FRAMES * ROUNDS):
            image, (az_rad, el_rad) = self.seen[n % FRAMES]
            exposed = HostNs(n * PERIOD_NS)
            arrived = HostNs(exposed + 9_000_000)
            origin_px = (self.camera.offset_x_px, self.camera.offset_y_px)
            frame = Frame(image, n, None, arrived, 2_000_000, origin_px)
            angles = AxisAngles(az_rad, el_rad, 1e-5, 0.0, exposed, 1000.0, "latch")
            before_each()
            wall, cpu = perf_counter(), thread_time()
            step = tracker.step(frame, angles, Instants(exposed, 1000.0, arrived))
            times.append((perf_counter() - wall, thread_time() - cpu))
        assert step.state is TrackState.LOCKED, step.why
        return 1e3 * np.array(times[SETTLING:])

    def play_together(self, threads: int) -> np.ndarray:
        """As `play`, with pauses, of all threads: their frames arrive at once."""
        barrier, results = Barrier(threads), []

        def pause() -> None:
            sleep(PAUSE_S)
            barrier.wait()

        workers = [Thread(target=lambda: results.append(self.play(pause))) for _ in range(threads)]
        for worker in workers:
            worker.start()
        for worker in workers:
            worker.join()
        return np.concatenate(results)


def blur_ms() -> float:
    image = np.random.default_rng(1).integers(0, 255, (1536, 2048), dtype=np.uint8)
    times = []
    for _ in range(50):
        begin = thread_time()
        cv2.GaussianBlur(image, (5, 5), 0)
        times.append(1e3 * (thread_time() - begin))
    return float(np.median(times))


def warm_up_s(cache: Path) -> float:
    environment = dict(os.environ, NUMBA_CACHE_DIR=str(cache))
    done = subprocess.run([sys.executable, "-c", WARM_UP], env=environment, capture_output=True, text=True, check=True)
    return float(done.stdout)


def report(kernel: str, how: str, times: np.ndarray, yardstick_ms: float) -> None:
    (wall, cpu), (wall_95, cpu_95) = np.percentile(times, (50, 95), axis=0)
    ratio = cpu / yardstick_ms
    print(f"{kernel:6s} {how:24s} wall {wall:5.2f} {wall_95:6.2f}   CPU {cpu:5.2f} {cpu_95:6.2f}   {ratio:5.2f} of the blur")


def main() -> None:
    cv2.setNumThreads(1)
    sys.setswitchinterval(0.0005)
    yardstick_ms, bench = blur_ms(), Bench()
    print(f"5x5 GaussianBlur of 2048x1536: {yardstick_ms:.2f} ms CPU; steps in ms, median and 95 %")
    used, reference = kernels.converge(), by_numpy.converge
    for kernel in (used,) if used is reference else (used, reference):
        name = "numpy" if kernel is reference else "numba"
        fit.converge = lambda kernel=kernel: kernel
        report(name, "hot", bench.play(lambda: None), yardstick_ms)
        for threads in (1, 2):
            report(name, f"with pauses, {threads} thread(s)", bench.play_together(threads), yardstick_ms)
    with TemporaryDirectory() as folder:
        cold_s, warm_s = warm_up_s(Path(folder)), warm_up_s(Path(folder))
    print(f"warm_up, with its imports: {cold_s:.1f} s with an empty cache, {warm_s:.2f} s with a full one")


if __name__ == "__main__":
    main()
