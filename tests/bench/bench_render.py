"""Time of one rendered frame, beside a 5x5 GaussianBlur of a 2048x1536 frame on the same machine."""

from statistics import median
from time import perf_counter

import cv2
import numpy as np

from trackerd.formats.settings import CameraSettings
from trackerd.formats.twin import LookSettings
from trackerd.geometry.gimbal import Station
from trackerd.geometry.lens import Lens
from trackerd.geometry.rigid import Rigid
from trackerd.sim.render import Renderer

REPEATS = 300
CAMERA = CameraSettings(driver="synthetic", width_px=640, height_px=480, offset_x_px=704, offset_y_px=528)
LENS = Lens((2048, 1536), 31000.0, 31000.0, 1023.5, 767.5)
POSE = Rigid.identity()


def microseconds(call):
    times = []
    for n in range(REPEATS):
        begin = perf_counter()
        call(n)
        times.append(1e6 * (perf_counter() - begin))
    return median(times), sorted(times)[int(0.95 * REPEATS)]


def main():
    cv2.setNumThreads(1)
    full = np.random.default_rng(1).integers(0, 255, (1536, 2048), dtype=np.uint8)
    yardstick, _ = microseconds(lambda n: cv2.GaussianBlur(full, (5, 5), 0))
    print(f"5x5 GaussianBlur of 2048x1536: {yardstick:.0f} us")
    out = np.empty((480, 640), np.uint8)
    renderer = Renderer(Station("bench", POSE, POSE, LENS), CAMERA, LookSettings(), 4.0, 1)
    for label, motion_mm in (("still", 0.0), ("smeared over 3 px", 0.2), ("smeared over 8 px", 0.5)):
        parts = max(1, round(motion_mm / 0.0645 / 1.5))
        probes = [np.array((way, 3.0, 2000.0)) for way in np.linspace(0.0, motion_mm, parts)]
        middle, most = microseconds(lambda n, p=probes: renderer.render([POSE] * len(p), p, n, out))
        print(f"{label:18s} {middle:6.0f} us median, {most:6.0f} us 95 %: {middle / yardstick:.2f} of the blur")


if __name__ == "__main__":
    main()
