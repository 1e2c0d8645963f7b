"""The settings of a cell, as models: every key with its unit, range and default. What they mean is told in config/cell.toml.

Angles and speeds are in degrees here because people write them; code reads the radians from the properties.
"""

from math import pi, radians
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from trackerd.contract.model import Source

ARCSEC = pi / 648_000.0

Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Lateness = Annotated[float, Field(ge=-5000, le=5000)]
Pixel = tuple[float, float]
DegreeRange = tuple[float, float]


class KeyRuleError(ValueError):
    """A rule between the keys of one table, told of the key that a person would change."""

    def __init__(self, key: str, rule: str) -> None:
        super().__init__(rule)
        self.key = key


class Settings(BaseModel):
    """Frozen, and an unknown key is an error."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class CameraSettings(Settings):
    """Common to every camera driver; a driver's own Settings add to it."""

    driver: str
    exposure_us: Annotated[float, Field(gt=0, le=1e6)] = 2000.0
    frame_rate_hz: Annotated[float, Field(gt=0, le=2000)] = 55.0
    width_px: Annotated[int, Field(ge=32, le=16384)] = 2048
    height_px: Annotated[int, Field(ge=32, le=16384)] = 1536
    offset_x_px: Annotated[int, Field(ge=0)] = 0  # origin of the region on the sensor
    offset_y_px: Annotated[int, Field(ge=0)] = 0
    gain_e_per_dn: Positive = 39.0  # sensor gain, for the noise model
    read_noise_e: NotNegative = 3.0
    transfer_us: NotNegative = 0.0  # end of exposure -> frame complete, where no other clock tells the instant
    timeout_s: Positive = 0.5  # no frame for this long: the stream is lost

    @property
    def source(self) -> Source:
        """Where its images come from; a driver that plays or simulates says otherwise."""
        return Source.LIVE

    @model_validator(mode="after")
    def _exposure_fits_the_period(self) -> Self:
        if self.exposure_us > 1e6 / self.frame_rate_hz:
            period = f"{1e6 / self.frame_rate_hz:.0f} us at frame_rate_hz = {self.frame_rate_hz:g}"
            raise KeyRuleError("exposure_us", f"must not be longer than the frame period, {period}")
        return self


class TravelSettings(Settings):
    """How far both axes may go, as the encoders count."""

    az_limits_deg: DegreeRange
    el_limits_deg: DegreeRange

    @field_validator("az_limits_deg", "el_limits_deg")
    @classmethod
    def _ordered(cls, value: DegreeRange) -> DegreeRange:
        if not value[0] < value[1]:
            raise ValueError("the lower limit must be below the upper one")
        if max(map(abs, value)) > 360.0:
            raise ValueError("must lie within -360 and 360 degrees")
        return value

    @property
    def az_limits_rad(self) -> tuple[float, float]:
        return radians(self.az_limits_deg[0]), radians(self.az_limits_deg[1])

    @property
    def el_limits_rad(self) -> tuple[float, float]:
        return radians(self.el_limits_deg[0]), radians(self.el_limits_deg[1])


class SteeringSettings(TravelSettings):
    """The loop from pixel offset to axis command, and its limits."""

    gain: Annotated[float, Field(gt=0, le=1)] = 0.7
    feed_forward: bool = True
    deadband_px: Annotated[float, Field(ge=0, le=50)] = 0.5
    aim_px: Pixel | None = None  # sensor pixel that the probe is kept at; default: the centre of the region
    max_deg_s: Annotated[float, Field(gt=0, le=360)] = 30.0
    max_deg_s2: Annotated[float, Field(gt=0, le=10_000)] = 300.0
    max_deg_s3: Annotated[float, Field(gt=0, le=1_000_000)] = 20_000.0
    az_limits_deg: DegreeRange = (-60.0, 60.0)
    el_limits_deg: DegreeRange = (-60.0, 60.0)
    rearm: Literal["automatic", "operator"] | None = None  # default: automatic on a twin, operator on a real bus
    test_deg: Annotated[float, Field(gt=0, le=2)] = 0.2
    test_deg_s: Annotated[float, Field(gt=0, le=1)] = 1.0
    diverge_frames: Annotated[int, Field(ge=3, le=1000)] = 10
    watchdog_ms: Annotated[int, Field(ge=5, le=1000)] = 50

    @model_validator(mode="after")
    def _room_for_the_test(self) -> Self:
        for key in ("az_limits_deg", "el_limits_deg"):
            low, high = getattr(self, key)
            if high - low < 2 * self.test_deg:
                raise KeyRuleError(
                    key, f"leaves no room for the test of the axes by test_deg = {self.test_deg:g} to both sides"
                )
        return self


class TrackingSettings(Settings):
    """How a station finds the probe and holds on to it."""

    tracker: Literal["kcf", "mosse", "csrt", "none"] = "kcf"  # second hypothesis; precision comes from the fit
    target_px: Pixel | None = None  # sensor pixel of the initial target; default: found by itself
    target_radius_px: Positive | None = None  # with it target_px is a guess: the target is looked for there first
    radius_px: tuple[float, float] = (12.0, 250.0)  # admitted radius of the outline
    coast_frames: Annotated[int, Field(ge=0, le=1000)] = 10

    @field_validator("radius_px")
    @classmethod
    def _radii(cls, value: tuple[float, float]) -> tuple[float, float]:
        if not 3.0 <= value[0] < value[1]:
            raise ValueError("needs 3 <= smallest < largest")
        return value

    @model_validator(mode="after")
    def _guess_has_a_place(self) -> Self:
        if self.target_radius_px is None:
            return self
        if self.target_px is None:
            raise KeyRuleError("target_radius_px", "needs target_px: the two are one guess of where the target is")
        if not self.radius_px[0] <= self.target_radius_px <= self.radius_px[1]:
            raise KeyRuleError(
                "target_radius_px", f"must lie within radius_px = [{self.radius_px[0]:g}, {self.radius_px[1]:g}]"
            )
        return self


class GimbalSettings(Settings):
    """Common to every gimbal driver; a driver's own Settings add to it."""

    driver: str
    camera: str  # the name of the camera it carries
    cycle_ms: Annotated[float, Field(ge=1, le=100)] = 5.0
    stale_ms: Annotated[float, Field(ge=5, le=1000)] = 20.0  # a status older than this: no angles, no fix
    encoder_sigma_arcsec: NotNegative = 2.0  # 1 sigma of one frame's angle, independent from frame to frame
    encoder_fixed_arcsec: NotNegative = 0.0  # 1 sigma of the part that is a function of the angle
    latch_offset_us: tuple[Lateness, Lateness] = (0.0, 0.0)  # az, el: the latched angles are those of this much later
    latch_offset_sigma_us: tuple[NotNegative, NotNegative] = (0.0, 0.0)
    steering: SteeringSettings = SteeringSettings()
    tracking: TrackingSettings = TrackingSettings()

    @model_validator(mode="after")
    def _slower_than_the_bus(self) -> Self:
        if self.steering.watchdog_ms < 2 * self.cycle_ms:
            raise KeyRuleError("cycle_ms", f"must be at most half of steering.watchdog_ms = {self.steering.watchdog_ms}")
        if self.stale_ms < 2 * self.cycle_ms:
            raise KeyRuleError("stale_ms", f"must be at least two cycles of cycle_ms = {self.cycle_ms:g}")
        return self

    @property
    def source(self) -> Source:
        """Where its angles come from; a driver that plays or simulates says otherwise."""
        return Source.LIVE

    @property
    def latch_offset_s(self) -> tuple[float, float]:
        return self.latch_offset_us[0] * 1e-6, self.latch_offset_us[1] * 1e-6

    @property
    def latch_offset_sigma_s(self) -> tuple[float, float]:
        return self.latch_offset_sigma_us[0] * 1e-6, self.latch_offset_sigma_us[1] * 1e-6

    @property
    def encoder_sigma_rad(self) -> float:
        return self.encoder_sigma_arcsec * ARCSEC

    @property
    def encoder_fixed_rad(self) -> float:
        return self.encoder_fixed_arcsec * ARCSEC


class ProbeSettings(Settings):
    radius_mm: Annotated[float, Field(gt=0, le=500)]
    radius_tolerance: Annotated[float, Field(gt=0, le=0.5)] = 0.05  # apparent against triangulated range, relative


class FusionSettings(Settings):
    """From lines of sight to a fix."""

    model: Literal["constant_velocity", "constant_acceleration"] = "constant_acceleration"
    process_noise: Positive = 3e4  # white jerk, mm^2/s^5 (constant velocity: white acceleration, mm^2/s^3); raised by itself
    simultaneous_us: Positive = 1000.0  # lines closer than this are brought together by their own rate, others interpolated
    wait_ms: Positive = 100.0  # for the slowest station's line
    confirm_pairs: Annotated[int, Field(ge=1, le=1000)] = 5
    max_miss_mm: Positive = 1.0
    max_speed_mm_s: Positive = 3000.0  # a faster jump is another target
    gate_chi2: Positive = 30.0  # innovation, 3 degrees of freedom
    coast_ms: NotNegative = 100.0
    valid_periods: Positive = 3.0  # valid_until = instant + this many frame periods
    max_age_ms: Positive = 100.0  # an older exposure is not valid when it is published


class ZenohSettings(Settings):
    mode: Literal["peer", "client", "router"] = "peer"
    listen: tuple[str, ...] = ("tcp/127.0.0.1:7447",)
    connect: tuple[str, ...] = ()
    key: str = "probe/position"
    twin_prefix: str = "twin"
    replay_prefix: str = "replay"
    allow_live_key: bool = False  # a twin or a replay may use the key as it stands
    lease_ms: Annotated[int, Field(ge=500, le=60_000)] = 2000
    overlay: Path | None = None  # a Zenoh json5 file for what has no key here; the keys above rule

    @field_validator("key", "twin_prefix", "replay_prefix")
    @classmethod
    def _key(cls, value: str) -> str:
        key = value.removeprefix("/")
        if not key or any(not chunk for chunk in key.split("/")) or any(c in key for c in "*$?# "):
            raise ValueError("not a Zenoh key: chunks parted by single '/', without * $ ? # or blanks")
        return key


class ServiceSettings(Settings):
    status_hz: Annotated[float, Field(ge=1, le=100)] = 10.0
    restart_s: tuple[float, float] = (0.2, 5.0)  # first and longest pause before a device is opened again
    log_level: Literal["debug", "info", "warning", "error"] = "info"
    log_format: Literal["text", "json"] = "text"

    @field_validator("restart_s")
    @classmethod
    def _pauses(cls, value: tuple[float, float]) -> tuple[float, float]:
        if not 0.0 < value[0] <= value[1]:
            raise ValueError("needs 0 < first pause <= longest pause")
        return value
