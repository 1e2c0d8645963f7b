"""The share of each cause in a layout that is calibrated as the bundle adjustment does it, over the box of its points."""

from collections.abc import Iterator
from dataclasses import dataclass

from trackerd.budget.adjustment import NO_NOISE, calibration_bound
from trackerd.budget.contributions import CellNoise, Part, contributions, grid
from trackerd.budget.settings import BudgetSettings, Volume
from trackerd.budget.stage import make_stage
from trackerd.contract.errors import ConfigError, Degenerate

STEPS = 5  # places along each axis of the box
LEAST_SHARE = 1e-6


@dataclass(frozen=True, slots=True)
class Share:
    """One cause in one case of one layout; lengths in mm, root mean squares over the box, of single looks."""

    layout: str
    case: str
    part: str
    sigma_x_mm: float
    sigma_y_mm: float
    sigma_z_mm: float
    rms_mm: float  # 3D
    u_across_mm: float  # k = 2, in the worst direction across the view, and
    u_depth_mm: float  # along it
    share: float  # of the whole variance


def layout_shares(settings: BudgetSettings) -> list[Share]:
    """Of all layouts and all cases that have noise; causes that are not there are left out.

    Raises ConfigError where a layout cannot see its points, or a corner of their box.
    """
    return [
        _share(layout, case, part)
        for layout in settings.layout
        for case, noise in settings.case.items()
        if noise.pixel_sigma_px > 0.0 or noise.encoders_rad > 0.0
        for part in _parts(settings, layout, case)
    ]


def _parts(settings: BudgetSettings, layout: str, case: str) -> Iterator[Part]:
    stage, noise = make_stage(settings, layout, settings.points.draw), settings.case[case]
    names, covariance = calibration_bound(stage, noise)
    box = Volume(centre_mm=settings.points.centre_mm, half_size_mm=settings.points.half_size_mm, steps=STEPS)
    told = CellNoise(max(noise.pixel_sigma_px, NO_NOISE), noise.encoder_sigma_rad, noise.encoder_fixed_rad)
    try:
        found = contributions(stage.stations, names, covariance, grid(box), told)
    except Degenerate as error:
        raise ConfigError(f"budget [layout.{layout}]: {error}") from error
    yield from (part for part in found.parts if part.share > LEAST_SHARE)


def _share(layout: str, case: str, part: Part) -> Share:
    return Share(layout, case, part.name, *part.sigma_mm, part.rms_mm, part.u_across_mm, part.u_depth_mm, part.share)
