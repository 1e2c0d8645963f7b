"""Triangulation by its three methods: rms over the Cramér-Rao bound, truth of the stated covariance, time of one call.

Simulated: white angular noise of about 2 arcsec whose shape differs from line to line, one target, many looks.

    python tests/bench/bench_triangulate.py [--draws 4000] [--seed 1]
"""

import argparse
import sys
from pathlib import Path
from time import perf_counter

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "unit"))

from looking_cells import CELLS, Cell, cell
from made_lines import nees

from trackerd.contract.model import Sightline
from trackerd.geometry.triangulate import Method, triangulate

NEES_LIMITS = 0.95, 1.05
RATIO_LIMITS = 0.9, 1.1  # of maximum likelihood


def row(made: Cell, draws: list[list[Sightline]], method: Method) -> tuple[float, float, float, float]:
    """Rms over the bound, NEES / 3, chi-square per degree of freedom, us a call."""
    began = perf_counter()
    points = [triangulate(lines, method) for lines in draws]
    each_us = (perf_counter() - began) / len(draws) * 1e6
    errors = np.array([point.p_mm - made.target_mm for point in points])
    ratio = float(np.sqrt((errors**2).sum(axis=1).mean() / made.bound.trace()))
    chi2 = float(np.mean([point.chi2 for point in points])) / points[0].dof
    return ratio, nees(errors, np.array([point.cov_mm2 for point in points])), chi2, each_us


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draws", type=int, default=4000)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    print(f"simulated, {options.draws} looks a row, seed {options.seed}")
    print("cell      K  bound mm  method               rms/bound  NEES/3  chi2/dof  us/call")
    met = True
    for kind, cells in CELLS.items():
        for stations in cells:
            made = cell(kind, stations)
            draws = made.draws(np.random.default_rng((options.seed, stations)), options.draws)
            for method in Method:
                ratio, truth, chi2, each_us = row(made, draws, method)
                best = method is not Method.MAXIMUM_LIKELIHOOD or RATIO_LIMITS[0] <= ratio <= RATIO_LIMITS[1]
                met &= best and NEES_LIMITS[0] <= truth <= NEES_LIMITS[1]
                head = f"{kind:9s} {stations}  {np.sqrt(made.bound.trace()):8.4f}  {method:19s}"
                print(f"{head}  {ratio:9.3f}  {truth:6.3f}  {chi2:8.3f}  {each_us:7.0f}")
    limits = f"NEES/3 {NEES_LIMITS} in every row, rms/bound of maximum likelihood {RATIO_LIMITS}"
    print(f"limits: {limits}: {'met' if met else 'MISSED'}")


if __name__ == "__main__":
    main()
