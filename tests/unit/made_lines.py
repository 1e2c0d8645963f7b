"""Lines of sight of a made-up cell with white angular noise, for the tests of what fuses them."""

from collections.abc import Callable
from math import cos, pi, sin

import numpy as np

from trackerd.contract.clock import HostNs
from trackerd.contract.model import Array, Sightline

ARCSEC = pi / 648_000.0
SIGMA_RAD = 2 * ARCSEC
PERIOD_NS = 18_181_818
LATENCY_NS = 8_000_000
CENTRE = np.array((0.0, 0.0, 1900.0))
STATIONS = {
    "left": np.array((-550.0, 0.0, 0.0)),
    "right": np.array((550.0, 0.0, 0.0)),
    "top": np.array((0.0, -900.0, 200.0)),
}

Path = Callable[[float], Array]


def still(_: float) -> Array:
    return CENTRE


def circle(t_s: float) -> Array:
    """150 mm radius, 250 mm/s."""
    a = t_s * 250.0 / 150.0
    return CENTRE + 150.0 * np.array((cos(a), sin(a), 0.0))


def line(
    path: Path,
    station: str,
    instant_ns: int,
    rng: np.random.Generator | None = None,
    sigma_rad: float = SIGMA_RAD,
    fixed_rad: float = 0.0,
    instant_sigma_ns: float = 0.0,
) -> Sightline:
    """Towards where the target is at the instant; noise only with a generator."""
    offset = path(instant_ns * 1e-9) - STATIONS[station]
    range_mm = float(np.linalg.norm(offset))
    seen = offset / range_mm
    if rng is not None:
        noise = rng.normal(0.0, sigma_rad, 3)
        seen = seen + noise - seen * (seen @ noise)
        seen /= np.linalg.norm(seen)
    across = np.eye(3) - np.outer(seen, seen)
    return Sightline(
        station=station,
        instant=HostNs(instant_ns),
        instant_sigma_ns=instant_sigma_ns,
        origin_mm=STATIONS[station],
        direction=seen,
        cov_rad2=sigma_rad**2 * across,
        fixed_cov_rad2=fixed_rad**2 * across,
        range_mm=range_mm,
        range_sigma_mm=2.0,
        received=HostNs(instant_ns + LATENCY_NS),
    )


def nees(errors: Array, covs: Array) -> float:
    """Mean of e' C^-1 e over (n, 3) errors, per degree of freedom."""
    return float(np.einsum("ni,nij,nj->n", errors, np.linalg.inv(covs), errors).mean()) / 3.0
