"""What a calibration run found, and how far it may be trusted."""

from dataclasses import dataclass, field

import numpy as np

from trackerd.contract.model import Array
from trackerd.formats.file_parts import Vector, instant
from trackerd.geometry.gimbal import Station

FEWEST_CHECK_POINTS = 8  # outside the adjustment: fewer say too little of a volume
MICROSECOND_NS = 1_000


@dataclass(frozen=True, slots=True)
class DataIdentity:
    """What the calibration was made from."""

    name: str
    sha256: str  # of the dataset, 64 hexadecimal digits


@dataclass(frozen=True, slots=True)
class AssumedNoise:
    """1 sigma of one reading, as the adjustment weighed it."""

    pixel_px: float
    encoder_rad: float  # independent from view to view
    encoder_fixed_rad: float = 0.0  # a function of the angle


@dataclass(frozen=True, slots=True)
class Volume:
    """The box of W that the data filled: outside it the calibration is an extrapolation."""

    min_mm: Vector
    max_mm: Vector


@dataclass(frozen=True, slots=True)
class Verification:
    """Check points outside the adjustment: measured against their reference values."""

    date: str  # ISO 8601, as `expires`; without a zone it is UTC
    points: int
    rms_mm: float
    max_mm: float
    en_max: float  # the largest normalised error: |error| over its expanded uncertainty (k = 2)
    rms_limit_mm: float | None = None
    max_limit_mm: float | None = None
    en_limit: float = 1.0
    expires: str | None = None

    def shortcomings(self) -> tuple[str, ...]:
        """Why it verifies nothing, in words; empty where it does."""
        found = []
        if self.points < FEWEST_CHECK_POINTS:
            found.append(f"{self.points} check points, needs {FEWEST_CHECK_POINTS}")
        for name, value, limit, unit in (
            ("rms", self.rms_mm, self.rms_limit_mm, " mm"),
            ("maximum", self.max_mm, self.max_limit_mm, " mm"),
            ("En", self.en_max, self.en_limit, ""),
        ):
            if limit is not None and not value <= limit:
                found.append(f"{name} {value:.3g}{unit} above {limit:.3g}{unit}")
        return tuple(found)

    @property
    def verified(self) -> bool:
        """What the file calls its status; whether it has expired is another question."""
        return not self.shortcomings()

    def expired(self, now_unix_ns: int) -> bool:
        return self.expires is not None and now_unix_ns >= round(instant(self.expires).timestamp() * 1e6) * MICROSECOND_NS


@dataclass(frozen=True, slots=True)
class Standing:
    """What is said of a calibration wherever a position stands on it."""

    id: str
    forced: bool
    verified: bool  # by check points outside the adjustment, and not expired
    expired: bool
    notes: tuple[str, ...]  # the same in words; empty where there is nothing to say


@dataclass(frozen=True, slots=True)
class Calibration:
    """What one calibration run found. `covariance` is that of `parameters`, (n, n); n = 0: not known."""

    id: str
    created: str
    software: str
    method: str  # nominal | twin | bundle | ...
    stations: dict[str, Station]
    parameters: tuple[str, ...] = ()
    covariance: Array = field(default_factory=lambda: np.zeros((0, 0)))
    chi2_per_dof: float | None = None
    forced: bool = False  # accepted by a person although chi-square refused it
    forced_because: str = ""  # in that person's words
    dof: int | None = None
    parent: str | None = None  # id of the calibration that this one began with, where part of it was held
    data: DataIdentity | None = None
    noise: AssumedNoise | None = None
    volume: Volume | None = None
    verification: Verification | None = None
    zooms: dict[str, str] = field(default_factory=dict)  # station -> the name of its zoom setting

    @property
    def verified(self) -> bool:
        return self.verification is not None and self.verification.verified

    def standing(self, now_unix_ns: int) -> Standing:
        """How far it may be trusted at an instant of Unix time."""
        expired = self.verification is not None and self.verification.expired(now_unix_ns)
        verified = self.verified and not expired
        return Standing(self.id, self.forced, verified, expired, tuple(self._notes(expired)))

    def _notes(self, expired: bool) -> list[str]:
        notes = [f"forced: {self.forced_because}"] if self.forced else []
        if self.verification is None:
            notes.append("unverified: no check points outside the adjustment")
        elif not self.verification.verified:
            notes.append(f"unverified: {', '.join(self.verification.shortcomings())}")
        if expired and self.verification is not None:
            notes.append(f"expired: {self.verification.expires}")
        return notes
