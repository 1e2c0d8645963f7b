"""How often a right calibration passes its own check points: every sigma is true here, so that each failure is a false alarm.

    python tests/bench/bench_check_points.py --calibrations 100

Simulated: two gimbals 2 m from the volume, 1.1 m apart, f 31000 px, 0.1 px, encoders 2" white, 28 places of 5 looks, of them
8 check points; all are known to 5 um.
"""

import argparse
import sys
import tempfile
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from unit.made_dataset import spread, write_dataset

from trackerd.calibrate.board_views import board_points, find_board
from trackerd.calibrate.cell import calibrate_cell
from trackerd.calibrate.cell_data import cell_data
from trackerd.calibrate.cell_worth import check, measured_of
from trackerd.contract.model import Array
from trackerd.formats.dataset import read_dataset

PLACES, CHECKS = 28, 8


def one(seed: int) -> tuple[Array, Array]:
    """En and the squared Mahalanobis distance of each check point of one calibration, (8,) each."""
    with tempfile.TemporaryDirectory() as folder:
        dataset = read_dataset(write_dataset(Path(folder) / "data", spread(PLACES, seed), check=CHECKS, seed=seed))
    data = cell_data(dataset, find_board, board_points)
    result = calibrate_cell(data.observations, data.targets, data.nominal)
    checked = check(data, result)
    assert checked is not None
    cov = measured_of(data, result).total_mm2 + np.array([point.cov_mm2 for point in data.checks])
    error = checked.verification.error_mm
    return checked.verification.en, np.einsum("mi,mij,mj->m", error, np.linalg.inv(cov), error)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--calibrations", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    found = [one(options.seed + n) for n in range(options.calibrations)]
    en, distance = (np.array(part) for part in zip(*found, strict=True))
    print(f"simulated: {len(en)} calibrations, {CHECKS} check points each")
    print(f"NEES/3 of the check points          {distance.mean() / 3.0:.3f}   (1 where the covariance is true)")
    print(f"points with En > 1                  {(en > 1.0).mean():.1%}")
    print(f"calibrations with every En <= 1     {(en.max(axis=1) <= 1.0).mean():.1%}")
    print(f"points outside their 95 % ellipsoid {(distance > 7.815).mean():.1%}   (5 %)")


if __name__ == "__main__":
    main()
