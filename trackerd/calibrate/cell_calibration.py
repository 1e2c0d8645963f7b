"""A cell's adjustment as a calibration file."""

from datetime import UTC, datetime

from trackerd import __version__
from trackerd.calibrate.cell.result import CellResult
from trackerd.calibrate.cell_worth import Worth
from trackerd.formats.calibration import AssumedNoise, Calibration, DataIdentity, Verification, Volume
from trackerd.formats.dataset import Dataset


def calibration_of(
    result: CellResult,
    worth: Worth,
    dataset: Dataset,
    *,
    now: datetime,
    forced_because: str = "",
    parent: Calibration | None = None,
) -> Calibration:
    """`forced_because` counts only where chi-square would have refused it. Stations that had no data keep their zoom."""
    return Calibration(
        id=f"{dataset.folder.resolve().name}-{now.astimezone(UTC):%Y%m%d-%H%M%S}",
        created=now.astimezone(UTC).isoformat(timespec="seconds"),
        software=f"trackerd {__version__}",
        method="bundle",
        stations=dict(result.stations),
        parameters=result.parameters,
        covariance=(result.covariance + result.covariance.T) / 2.0,
        chi2_per_dof=result.chi2_per_dof,
        forced=result.forced,
        forced_because=forced_because if result.forced else "",
        dof=result.dof,
        parent=None if parent is None else parent.id,
        data=DataIdentity(dataset.folder.resolve().name, dataset.identity),
        noise=AssumedNoise(worth.frame.pixel_px, worth.frame.encoder_rad, worth.frame.encoder_fixed_rad),
        volume=_volume(worth),
        verification=verification_of(worth, now),
        zooms={} if parent is None else dict(parent.zooms),
    )


def verification_of(worth: Worth, now: datetime) -> Verification | None:
    """None: there were no check points."""
    if worth.checked is None:
        return None
    found = worth.checked.verification
    return Verification(
        date=now.astimezone(UTC).isoformat(timespec="seconds"),
        points=len(worth.checked.names),
        rms_mm=found.rms_mm,
        max_mm=found.max_mm,
        en_max=float(found.en.max()),
    )


def _volume(worth: Worth) -> Volume:
    (x0, y0, z0), (x1, y1, z1) = worth.box.low_mm.tolist(), worth.box.high_mm.tolist()
    return Volume((x0, y0, z0), (x1, y1, z1))
