"""What the outline is worth: rms error, NEES and time, on pictures of the twin's renderer; and the time of a tracker's step.

Times are also given as a ratio to a 5x5 GaussianBlur of a 2048x1536 frame, which tells a slow machine from slow code.
"""

from statistics import median
from time import perf_counter

import cv2
import numpy as np

from trackerd.contract.clock import HostNs
from trackerd.contract.model import AxisAngles, Found, Frame, TrackState
from trackerd.engine.track import Tracker
from trackerd.formats.settings import CameraSettings, SteeringSettings, TrackingSettings
from trackerd.formats.twin import LookSettings
from trackerd.geometry.gimbal import Station
from trackerd.geometry.lens import Lens
from trackerd.geometry.rigid import Rigid
from trackerd.geometry.sightline import Instants
from trackerd.geometry.sphere import outline
from trackerd.sim.render import Renderer
from trackerd.vision.locate import locate
from trackerd.vision.noise import NoiseModel

PICTURES = 150
ORIGIN_PX = (704, 528)
CAMERA = CameraSettings(driver="synthetic", width_px=640, height_px=480, offset_x_px=ORIGIN_PX[0], offset_y_px=ORIGIN_PX[1])
NOISE = NoiseModel(CAMERA.gain_e_per_dn, CAMERA.read_noise_e)
LENS = Lens((2048, 1536), 31000.0, 31000.0, 1023.5, 767.5)
POSE = Rigid.identity()
STATION = Station("bench", POSE, POSE, LENS)

PLAIN = {"texture_dn": 0.0, "stem_width": 0.0}
SCENES = {  # look, range in mm, smear in mm
    "r 60, nothing but the ball": (PLAIN, 2066.0, 0.0),
    "r 60, stem": ({"texture_dn": 0.0}, 2066.0, 0.0),
    "r 60, stem and texture": ({}, 2066.0, 0.0),
    "r 60, limb darkened by 0.3": (PLAIN | {"limb": 0.3}, 2066.0, 0.0),
    "r 60, contrast 15": (PLAIN | {"probe_dn": 75.0}, 2066.0, 0.0),
    "r 60, blur 2.5 px": (PLAIN | {"psf_px": 2.5}, 2066.0, 0.0),
    "r 60, smeared over 8 px": (PLAIN, 2066.0, 0.53),
    "r 15": (PLAIN, 8266.0, 0.0),
    "r 120": (PLAIN, 1033.0, 0.0),
}


def microseconds(call, repeats):
    times = []
    for n in range(repeats):
        begin = perf_counter()
        call(n)
        times.append(1e6 * (perf_counter() - begin))
    return median(times), sorted(times)[int(0.95 * repeats)]


def pictures(look, range_mm, smear_mm):
    """Image, and the truth (x, y, r) in image coordinates."""
    random = np.random.default_rng(3)
    renderer = Renderer(STATION, CAMERA, LookSettings(**look), 4.0, 1)
    parts = np.linspace(-0.5, 0.5, 9) if smear_mm else (0.0,)
    for n in range(PICTURES):
        p_mm = np.array((*(random.uniform(-30.0, 30.0, 2) * range_mm / LENS.fx_px), range_mm))
        probes = [p_mm + np.array((smear_mm * part, 0.0, 0.0)) for part in parts]
        truth = outline(p_mm, 4.0, LENS)
        image = renderer.render([POSE] * len(probes), probes, n)
        yield image, np.array((truth.x_px - ORIGIN_PX[0], truth.y_px - ORIGIN_PX[1], truth.r_px))


def judge(look, range_mm, smear_mm):
    random = np.random.default_rng(4)
    errors, nees, missed, times = [], [], 0, []
    for image, truth in pictures(look, range_mm, smear_mm):
        guess = (*(truth[:2] + random.uniform(-6.0, 6.0, 2)).tolist(), float(truth[2] * random.uniform(0.95, 1.05)))
        locate(image, guess, NOISE)  # warms the caches that a running tracker finds warm
        begin = perf_counter()
        found = locate(image, guess, NOISE)
        times.append(1e6 * (perf_counter() - begin))
        if not isinstance(found, Found):
            missed += 1
            continue
        error = np.array((found.x_px, found.y_px, found.r_px)) - truth
        errors.append(error)
        nees.append(float(error @ np.linalg.solve(found.cov_px2, error)) / 3.0)
    return np.array(errors), np.mean(nees), missed, median(times)


def tracker_step():
    """Median and 95 % of a whole step in microseconds: locked, and searching without a ball."""
    angles = AxisAngles(0.0, 0.0, 1e-5, 0.0, None, 0.0, "latch")
    tracker = Tracker(STATION, 4.0, CAMERA, SteeringSettings(), TrackingSettings())
    images = [image for image, _ in pictures({}, 2066.0, 0.0)][:1]
    renderer = Renderer(STATION, CAMERA, LookSettings(), 4.0, 1)
    empty = renderer.render([POSE], [], 0)

    def step(n, image):
        exposed = HostNs(n * 18_181_818)
        frame = Frame(image, n, None, HostNs(exposed + 10_000_000), 2_000_000, ORIGIN_PX)
        return tracker.step(frame, angles, Instants(exposed, 0.0, frame.arrived))

    for n in range(30):
        state = step(n, images[0]).state
    assert state is TrackState.LOCKED
    locked = microseconds(lambda n: step(30 + n, images[0]), 300)
    for n in range(20):
        step(400 + n, empty)
    return locked, microseconds(lambda n: step(500 + n, empty), 100)


def main():
    cv2.setNumThreads(1)
    full = np.random.default_rng(1).integers(0, 255, (1536, 2048), dtype=np.uint8)
    yardstick, _ = microseconds(lambda n: cv2.GaussianBlur(full, (5, 5), 0), 100)
    print(f"5x5 GaussianBlur of 2048x1536: {yardstick:.0f} us; {PICTURES} pictures a scene\n")
    print(f"{'scene':28s} {'rms x, y, r (px)':24s} {'bias x, y, r (px)':27s} {'NEES/3':>6s} {'missed':>6s} {'us':>6s} of blur")
    for name, scene in SCENES.items():
        errors, nees, missed, took = judge(*scene)
        rms = " ".join(f"{v:.4f}" for v in np.sqrt((errors**2).mean(axis=0)))
        bias = " ".join(f"{v:+.4f}" for v in errors.mean(axis=0))
        print(f"{name:28s} {rms:24s} {bias:27s} {nees:6.2f} {missed:6d} {took:6.0f} {took / yardstick:.2f}")
    for name, (middle, most) in zip(("locked", "searching, nothing there"), tracker_step(), strict=True):
        print(f"tracker step, {name}: {middle:.0f} us median, {most:.0f} us 95 %: {middle / yardstick:.2f} of the blur")


if __name__ == "__main__":
    main()
