"""What `calibrate lens` is worth, simulated: detectors against the truth, sigmas against the scatter, time against OpenCV.

    python tests/bench/bench_lens.py [--trials 400] [--photographs FOLDER]

All figures are simulated but those of the photographs (default: tests/data/opencv-chessboard).
"""

import argparse
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from scipy.stats import chi2

sys.path.insert(0, str(Path(__file__).parents[1]))

from unit import made_boards
from unit.made_boards import Picture, pose, seen
from unit.made_views import BOARD, WIDE, intrinsics, views

from trackerd.calibrate.board_kinds import Board, Charuco, Chessboard, CircleGrid, Detected, DotArray
from trackerd.calibrate.boards import detect
from trackerd.calibrate.lens import LensOptions, calibrate_lens

PHOTOGRAPHS = Path(__file__).parents[1] / "data" / "opencv-chessboard"
OPENCVS_F_PX, RMS_LIMIT_PX = 535.9, 0.24
POSES = 6


def boards() -> list[tuple[Board, Any]]:
    chess, charuco = Chessboard((9, 6), 25.0), Charuco((8, 6), 30.0, 22.0, "5X5_100")
    grid, asymmetric = CircleGrid((9, 6), 25.0), CircleGrid((4, 11), 18.0, asymmetric=True)
    jitter = np.random.default_rng(4).uniform(-8.0, 8.0, (25, 2))
    array = DotArray(np.array([[45.0 * (n % 5) + jitter[n, 0], 45.0 * (n // 5) + jitter[n, 1], 0.0] for n in range(25)]))
    return [
        (chess, made_boards.chessboard(chess)),
        (charuco, made_boards.charuco(charuco)),
        (grid, made_boards.circles(grid, 11.0)),
        (asymmetric, made_boards.circles(asymmetric, 12.0)),
        (array, made_boards.leds(array, 7.0)),
    ]


def detectors() -> None:
    print("\ndetectors, simulated: 640 x 480, f 540 px, blur 0.7 px, noise 2 DN of 160 DN contrast; limit of the bias 0.02 px")
    print(f"{'board':38} {'points':>6} {'bias x':>8} {'bias y':>8} {'rms':>7} {'worst':>7} {'rms/sigma':>9} {'ms':>6}")
    for board, pattern in boards():
        off, sigmas, spent = [], [], 0.0
        for seed in range(POSES):
            rng = np.random.default_rng(seed)
            where = pose(board.points_mm, rng.uniform(380, 480), tuple(rng.uniform(-0.5, 0.5, 3)), rng.uniform(-20, 20, 2))
            image = replace(Picture(), seed=seed).of(pattern, where)
            begun = time.perf_counter()
            found = detect(board, image)
            spent += time.perf_counter() - begun
            if isinstance(found, Detected):
                off.append(found.q_px - seen(made_boards.LENS, where, board.points_mm)[found.index])
                sigmas.append(found.sigma_px)
        e, s = np.concatenate(off), np.concatenate(sigmas)
        bias, rms, ratio = e.mean(0), np.sqrt(np.square(e).mean()), np.sqrt(np.square(e / s[:, None]).mean())
        figures = f"{bias[0]:8.4f} {bias[1]:8.4f} {rms:7.4f} {np.abs(e).max():7.3f} {ratio:9.2f} {1e3 * spent / POSES:6.0f}"
        print(f"{board.name[:38]:38} {len(e):6d} {figures}")


def sigmas(trials: int) -> None:
    print(f"\nsigmas, simulated: {trials} calibrations of 6 pictures of 30 corners, 0.1 px, 8 intrinsics")
    nees, each, widened = [], [], 0
    for seed in range(trials):
        result = calibrate_lens(views(count=6, seed=seed), BOARD, WIDE.sensor_px, LensOptions(coefficients=4))
        error = (result.estimate.intrinsics - intrinsics(WIDE))[:8]
        nees.append(error @ np.linalg.solve(result.covariance[:8, :8], error) / 8)
        each.append(error**2 / np.diag(result.covariance)[:8])
        widened += result.inflation > 1.0
    low, high = chi2.ppf((0.005, 0.995), 8 * trials) / trials / 8
    print(f"NEES/8 {np.mean(nees):.3f}, 99 % interval {low:.3f} to {high:.3f}; sigmas widened in {widened} of {trials}")
    print("by parameter: " + ", ".join(f"{v:.2f}" for v in np.mean(each, axis=0)) + "  (fx fy cx cy k1 k2 p1 p2)")


def against_opencv() -> None:
    print("\ntime and minimum, simulated: 40 pictures of 54 corners, 0.1 px, five coefficients, one thread")
    cv2.setNumThreads(1)
    board = Chessboard((9, 6), 20.0)
    found = views(board=board, count=40, ranges_mm=(300.0, 500.0))
    points = [board.points_mm.astype(np.float32)] * len(found)
    pixels = [one.q_px.astype(np.float32) for _, one in found]
    begun = time.perf_counter()
    rms, matrix, *_ = cv2.calibrateCamera(points, pixels, WIDE.sensor_px, None, None)
    theirs = time.perf_counter() - begun
    begun = time.perf_counter()
    result = calibrate_lens(found, board, WIDE.sensor_px, LensOptions(coefficients=5))
    ours = time.perf_counter() - begun
    print(f"cv2.calibrateCamera {theirs:.2f} s, rms {rms:.5f} px, fx {matrix[0, 0]:.3f} px")
    fx = f"{result.lens.fx_px:.3f} ± {result.sigmas['fx_px']:.3f} px"
    print(f"calibrate_lens      {ours:.2f} s, rms {result.rms_px:.5f} px, fx {fx}")
    print(f"(with rejection and covariance) ratio {ours / theirs:.2f}; {result.rejected} of {40 * 54} points rejected")


def photographs(folder: Path) -> None:
    board = Chessboard((9, 6), 25.0)
    files = sorted(folder.glob("*.jpg"))
    found = [(file.name, detect(board, cv2.imread(str(file), cv2.IMREAD_GRAYSCALE))) for file in files]
    result = calibrate_lens(found, board, (640, 480))
    print(f"\nphotographs ({len(files)}, real): {len(result.pictures)} used, left out {[one.name for one in result.left_out]}")
    print(f"rms {result.rms_px:.3f} px (limit {RMS_LIMIT_PX}), {result.rejected} points rejected")
    share = result.lens.fx_px / OPENCVS_F_PX - 1.0
    print(f"fx {result.lens.fx_px:.2f} ± {result.sigmas['fx_px']:.2f} px, {share:+.2%} of OpenCV's {OPENCVS_F_PX} (limit 1 %)")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=400)
    parser.add_argument("--photographs", type=Path, default=PHOTOGRAPHS)
    options = parser.parse_args()
    photographs(options.photographs)
    detectors()
    against_opencv()
    sigmas(options.trials)


if __name__ == "__main__":
    main()
