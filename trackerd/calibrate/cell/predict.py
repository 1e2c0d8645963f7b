"""What a calibration is worth where it is used: the covariance of a triangulated target, with the calibration's part."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from trackerd.calibrate.cell.aiming import aim
from trackerd.calibrate.cell.known import names_of
from trackerd.calibrate.cell.model import Linear, linearise
from trackerd.calibrate.cell.state import STATION_COLUMNS, state_of
from trackerd.calibrate.cell.targets import known_points
from trackerd.contract.errors import ConfigError, Degenerate
from trackerd.contract.model import Array
from trackerd.geometry.gimbal import Station


@dataclass(frozen=True, slots=True)
class Prediction:
    """Of m targets that K stations triangulate, in W."""

    random_mm2: Array  # (m, 3, 3) pixels and white encoders of the moment: averaging reduces it
    fixed_mm2: Array  # (m, 3, 3) the angle-fixed part of the encoders
    calibration_mm2: Array  # (m, 3, 3) J_theta C_theta J_theta^T
    sensitivity: Array  # (m, 3, p) d target / d parameter: correlations between targets are S_i C S_j^T

    @property
    def systematic_mm2(self) -> Array:
        """What averaging does not reduce."""
        return self.fixed_mm2 + self.calibration_mm2

    @property
    def total_mm2(self) -> Array:
        return self.random_mm2 + self.systematic_mm2


@dataclass(frozen=True, slots=True)
class Fixes:
    """m targets seen by K stations, linearised: an image offset (2 K) moves the target by -gain @ offset."""

    linear: Linear  # of m K image points, station by station within a target
    by_target: Array  # (m, 2 K, 3) d pixels / d target
    by_encoder: Array  # (m, 2 K, 2 K) d pixels / d encoders, block diagonal
    weight: Array  # (m, 2 K, 2 K) inverse covariance of the pixels, encoders included
    gain: Array  # (m, 3, 2 K) d target / d pixels


def predict(
    stations: Mapping[str, Station],
    parameters: Sequence[str],
    covariance: Array,
    p_mm: npt.ArrayLike,
    *,
    sigma_px: float,
    encoder_sigma_rad: float,
    encoder_fixed_rad: float = 0.0,
    angles_rad: npt.ArrayLike | None = None,
) -> Prediction:
    """Covariances of targets p_mm (m, 3) that every station sees at `angles_rad` (m, K, 2), default: at its principal point.

    The weights are those of trackerd.geometry.triangulate; derivatives are analytic. Raises Degenerate where a station cannot
    be aimed at a target, or where the lines do not determine it, and ConfigError for a parameter that no station has.
    """
    cell = list(stations.values())
    found = fixes(cell, p_mm, sigma_px, float(np.hypot(encoder_sigma_rad, encoder_fixed_rad)), angles_rad)
    moves = found.gain @ found.by_encoder
    sensitivity = sensitivity_of(cell, parameters, found)
    swing = moves @ moves.transpose(0, 2, 1)
    gained = found.gain @ found.gain.transpose(0, 2, 1)
    return Prediction(
        random_mm2=sigma_px**2 * gained + encoder_sigma_rad**2 * swing,
        fixed_mm2=encoder_fixed_rad**2 * swing,
        calibration_mm2=sensitivity @ covariance @ sensitivity.transpose(0, 2, 1),
        sensitivity=sensitivity,
    )


def fixes(
    cell: Sequence[Station], p_mm: npt.ArrayLike, sigma_px: float, encoder_rad: float, angles_rad: npt.ArrayLike | None = None
) -> Fixes:
    """The geometry of m fixes; `encoder_rad` is 1 sigma of one axis, both parts."""
    p = np.asarray(p_mm, float).reshape(-1, 3)
    m, k = len(p), len(cell)
    if k < 2:
        raise Degenerate(f"a point needs two lines of sight, here {k}")
    station_of, point = np.tile(np.arange(k), m), np.repeat(np.arange(m), k)
    angles = aim(cell, station_of, p[point]) if angles_rad is None else np.asarray(angles_rad, float).reshape(m * k, 2)
    targets = known_points(p)
    linear = linearise(state_of(cell, targets), targets, station_of, angles, np.arange(m * k), point)
    by_target = linear.world.reshape(m, 2 * k, 3)
    by_encoder = np.zeros((m, 2 * k, 2 * k))
    weight = np.zeros((m, 2 * k, 2 * k))
    encoder = linear.encoder.reshape(m, k, 2, 2)
    for i in range(k):
        at = slice(2 * i, 2 * i + 2)
        by_encoder[:, at, at] = encoder[:, i]
        spread = sigma_px**2 * np.eye(2) + encoder_rad**2 * encoder[:, i] @ encoder[:, i].transpose(0, 2, 1)
        weight[:, at, at] = np.linalg.inv(spread)
    weighted = by_target.transpose(0, 2, 1) @ weight
    try:
        gain: Array = np.linalg.solve(weighted @ by_target, weighted).astype(np.float64)
    except np.linalg.LinAlgError as err:
        raise Degenerate("the lines of sight do not determine a point") from err
    if not np.isfinite(gain).all():
        raise Degenerate("a target is behind a camera, or the lines of sight do not determine it")
    return Fixes(linear, by_target, by_encoder, weight, gain)


def sensitivity_of(cell: Sequence[Station], parameters: Sequence[str], found: Fixes) -> Array:
    """d target / d parameter, (m, 3, p): a station whose parameter grows sees the target where it is not."""
    m, k = found.gain.shape[0], len(cell)
    by_station = found.linear.station.reshape(m, k, 2, STATION_COLUMNS)
    by_all = np.zeros((m, 3, k * STATION_COLUMNS))
    for i in range(k):
        at = slice(i * STATION_COLUMNS, (i + 1) * STATION_COLUMNS)
        by_all[:, :, at] = -found.gain[:, :, 2 * i : 2 * i + 2] @ by_station[:, i]
    return chosen_columns(cell, parameters, by_all)


def chosen_columns(cell: Sequence[Station], parameters: Sequence[str], by_all: Array) -> Array:
    """Of derivatives by all columns (m, 3, 23 K), those by some parameters; 0 for those of stations that are not in `cell`."""
    index = {name: i for i, name in enumerate(names_of(cell))}
    stations = {station.name for station in cell}
    unknown = [name for name in parameters if name not in index and name.split(".")[0] in stations]
    if unknown:
        raise ConfigError(f"covariance: no station has a parameter {', '.join(unknown)}")
    chosen = np.zeros((*by_all.shape[:2], len(parameters)))
    for column, name in enumerate(parameters):
        if name in index:
            chosen[:, :, column] = by_all[:, :, index[name]]
    return chosen
