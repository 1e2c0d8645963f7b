"""What a plan will be worth before anything has moved: the Cramér-Rao bound of its looks, carried over to targets."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import hypot, sqrt

import numpy as np

from trackerd.calibrate.cell.observations import Observations, observations
from trackerd.calibrate.cell.predict import Prediction, predict
from trackerd.calibrate.cell.solve import bound
from trackerd.calibrate.cell.targets import Targets, known_points
from trackerd.calibrate.plan.looks import Eye
from trackerd.calibrate.plan.volume import Box
from trackerd.calibrate.uncertainty import Spread, spread
from trackerd.contract.model import Array
from trackerd.formats.looks import Errand
from trackerd.geometry.gimbal import Station

STEPS = 9  # of the map along each side of the box
FLOOR_PX = 0.01  # of a place in the raster of pixels, which averaging does not reduce


@dataclass(frozen=True, slots=True)
class Noise:
    """1 sigma of what is to be measured."""

    point_mm: float  # of a coordinate of the mover
    pixel_px: float  # of one frame
    encoder_rad: float  # of one frame
    encoder_fixed_rad: float  # a function of the angle
    frames: int  # that a look averages


@dataclass(frozen=True, slots=True)
class Predicted:
    stations: dict[str, Station]
    box: Box
    p_mm: Array  # (STEPS^3, 3)
    prediction: Prediction
    total: Spread  # of one frame's target
    calibration: Spread  # the calibration's part of it

    @property
    def words(self) -> str:
        across, depth = self.total.worst()
        return (
            f"{self.total.typical_mm():.3f} mm rms (3D, 1 sigma) for a target in one frame,"
            f" of it {self.calibration.typical_mm():.3f} mm from the calibration; at worst U (k = 2)"
            f" {across:.3f} mm across and {depth:.3f} mm in depth"
        )


def predicted(planned: Sequence[Errand], eyes: Sequence[Eye], box: Box, noise: Noise) -> Predicted:
    """Check points do not count. Raises Degenerate where the lines of sight do not determine a target."""
    stations = {eye.name: eye.station for eye in eyes}
    seen, targets = design(planned, noise)
    names, covariance = bound(seen, targets, stations)
    p_mm = box.grid(STEPS)
    prediction = predict(
        stations,
        names,
        covariance,
        p_mm,
        sigma_px=noise.pixel_px,
        encoder_sigma_rad=noise.encoder_rad,
        encoder_fixed_rad=noise.encoder_fixed_rad,
    )
    total, calibration = (spread(cov, p_mm, stations) for cov in (prediction.total_mm2, prediction.calibration_mm2))
    return Predicted(stations, box, p_mm, prediction, total, calibration)


def design(planned: Sequence[Errand], noise: Noise) -> tuple[Observations, Targets]:
    """The looks of a plan as observations that are still to be made."""
    stops = [errand.stop for errand in planned if not errand.stop.is_check]
    targets = known_points(np.array([stop.p_mm for stop in stops]), [stop.name for stop in stops], noise.point_mm**2)
    rows = [
        (gimbal, errand.view(look), look.az_rad, look.el_rad, look.q_px[0], look.q_px[1], errand.stop.name)
        for errand in planned
        if not errand.stop.is_check
        for gimbal, looks in errand.looks.items()
        for look in looks
    ]
    gimbal, view, az, el, u, v, point = map(list, zip(*rows, strict=True))
    averaged = sqrt(noise.frames)
    seen = observations(
        gimbal,
        view,
        az,
        el,
        u,
        v,
        point,
        targets,
        sigma_px=hypot(noise.pixel_px / averaged, FLOOR_PX),
        encoder_sigma_rad=noise.encoder_rad / averaged,
        encoder_fixed_rad=noise.encoder_fixed_rad,
    )
    return seen, targets
