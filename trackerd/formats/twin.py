"""The settings of the simulated cell: table [twin]. Imperfections are off by default.

Names of gimbals and cameras are those of the cell; who is not named has the defaults.
"""

from math import hypot
from typing import Annotated, Literal, Self

from pydantic import Field, field_validator, model_validator

from trackerd.formats.settings import ARCSEC, DegreeRange, NotNegative, Pixel, Positive, Settings, TravelSettings

Vector = tuple[float, float, float]
Sign = Literal[-1, 1]


class PathSettings(Settings):
    """Where the probe goes. It stands still for `dwell_s`, then starts without a jump of its acceleration.

    `external`: it stands at the centre until a request on the control socket moves it, as a machine's program would.
    """

    kind: Literal["still", "circle", "raster", "random", "external"] = "circle"
    centre_mm: Vector = (0.0, 0.0, 0.0)
    normal: Vector = (0.0, 0.0, 1.0)  # of the plane of circle and raster
    radius_mm: Annotated[float, Field(gt=0, le=2000)] = 150.0  # raster: half the length of a row; random: bound of the reach
    speed_mm_s: Annotated[float, Field(gt=0, le=3000)] = 250.0  # of the cruise; random: its bound
    acceleration_mm_s2: Annotated[float, Field(gt=0, le=50_000)] = 800.0  # along the path; random: its bound
    jerk_mm_s3: Annotated[float, Field(gt=0, le=1e7)] = 8000.0  # along the path
    rows: Annotated[int, Field(ge=2, le=1000)] = 7
    row_mm: Positive = 20.0  # from row to row
    dwell_s: NotNegative = 6.0  # so that the cell can lock and prove its axes

    @field_validator("normal")
    @classmethod
    def _not_null(cls, value: Vector) -> Vector:
        if hypot(*value) < 1e-6:
            raise ValueError("needs a direction: at least one component other than 0")
        return value


class AxesSettings(TravelSettings):
    """Both servo axes of every gimbal; angles as the controller counts them."""

    max_deg_s: Annotated[float, Field(gt=0, le=720)] = 60.0
    max_deg_s2: Annotated[float, Field(gt=0, le=20_000)] = 800.0
    bandwidth_hz: Annotated[float, Field(gt=0, le=60)] = 20.0  # of the position loop; it steps at 1 kHz
    damping: Annotated[float, Field(ge=0.5, le=2)] = 1.0
    az_limits_deg: DegreeRange = (-75.0, 75.0)
    el_limits_deg: DegreeRange = (-75.0, 75.0)


class SweepSettings(Settings):
    """A recording's axes swing about their aim at the probe: what `calibrate latency` looks at. An axis of 0 does not."""

    kind: Literal["sine", "triangle"] = "sine"
    az_deg: Annotated[float, Field(ge=0, le=30)] = 0.0  # to either side, as the encoder counts
    el_deg: Annotated[float, Field(ge=0, le=30)] = 0.0
    az_hz: Annotated[float, Field(gt=0, le=20)] = 2.3  # of two paces that share no beat the axes tell apart best
    el_hz: Annotated[float, Field(gt=0, le=20)] = 3.1


class EncoderSettings(Settings):
    """Reading = angle + a fixed function of the angle + noise of each reading."""

    white_arcsec: NotNegative = 0.0  # 1 sigma of one look (both edges of an exposure share it): repeatability
    fixed_arcsec: NotNegative = 0.0  # rms over the turn of the map, its phases seeded for each axis
    fixed_cycles: tuple[Annotated[int, Field(ge=1, le=100_000)], ...] = (1, 2, 36, 360)  # a turn
    fixed_weights: tuple[Positive, ...] = (1.0, 1.0, 1.0, 1.0)  # relative amplitudes of these
    latch_skew_us: float = 0.0  # the latch takes the angles this much after the edge that it stamps
    latch_jitter_us: NotNegative = 0.0  # 1 sigma of the same

    @model_validator(mode="after")
    def _one_weight_a_cycle(self) -> Self:
        if len(self.fixed_cycles) != len(self.fixed_weights) or not self.fixed_cycles:
            raise ValueError("fixed_cycles and fixed_weights need the same number of entries, at least one")
        return self


class ErrorSettings(Settings):
    """What one gimbal really is, against the calibration that the cell believes in."""

    az_sign: Sign = 1  # -1: the axis turns against the sign of the calibration
    el_sign: Sign = 1
    swapped: bool = False  # the controller's az channel is the EL axis, and the other way round
    eps_arcsec: float = 0.0  # more non-orthogonality of the axes
    d_mm: float = 0.0  # more distance between the axes
    lever_mm: Vector = (0.0, 0.0, 0.0)  # more lever arm, in RG
    stand_tilt_arcsec: tuple[float, float] = (0.0, 0.0)  # of the base, about x_G and y_G
    vibration_arcsec: NotNegative = 0.0  # amplitude of the base's rocking about x_G and y_G; no encoder sees it
    vibration_hz: Annotated[float, Field(gt=0, le=500)] = 25.0

    @property
    def eps_rad(self) -> float:
        return self.eps_arcsec * ARCSEC

    @property
    def stand_tilt_rad(self) -> tuple[float, float]:
        return self.stand_tilt_arcsec[0] * ARCSEC, self.stand_tilt_arcsec[1] * ARCSEC

    @property
    def vibration_rad(self) -> float:
        return self.vibration_arcsec * ARCSEC


class LookSettings(Settings):
    """What the cameras see and how they see it: table [twin.camera]."""

    background_dn: Annotated[float, Field(ge=0, le=255)] = 60.0
    probe_dn: Annotated[float, Field(ge=0, le=255)] = 180.0  # the middle of the ball
    limb: Annotated[float, Field(ge=0, le=1)] = 0.0  # darkening towards the rim: 1 is black there
    stem_dn: Annotated[float, Field(ge=0, le=255)] = 140.0
    stem_width: Annotated[float, Field(ge=0, le=0.95)] = 0.35  # of the ball's diameter; 0: no stem
    stem_deg: float = -90.0  # from the ball outwards, in the image: 0 right, 90 down
    texture_dn: Annotated[float, Field(ge=0, le=60)] = 2.0  # rms of a background that stands still in the world
    texture_px: Annotated[float, Field(ge=1, le=100)] = 6.0  # its correlation length (sigma of the blur)
    psf_px: Annotated[float, Field(ge=0.3, le=10)] = 0.9  # sigma of the lens' blur
    gain_e_per_dn: Positive = 39.0
    read_noise_e: NotNegative = 3.0
    drop_probability: Annotated[float, Field(ge=0, le=1)] = 0.0  # of a frame on its way to the host
    transfer_us: NotNegative = 8000.0  # end of exposure -> frame complete: readout and transfer of 480 rows


class DeviceClockSettings(Settings):
    """One device's clock against the scene's: it reads offset + t (1 + drift)."""

    offset_s: float = 0.0
    drift_ppm: Annotated[float, Field(ge=-500, le=500)] = 0.0


class ClockSettings(Settings):
    camera: dict[str, DeviceClockSettings] = Field(default_factory=dict)
    gimbal: dict[str, DeviceClockSettings] = Field(default_factory=dict)


class TwinSettings(Settings):
    seed: Annotated[int, Field(ge=0, lt=1 << 63)] = 1
    trigger: Literal["shared", "free"] = "shared"  # free: each camera with a phase of its own
    free_ppm: Annotated[float, Field(ge=0, le=500)] = 50.0  # and a rate that is off by up to this
    start_offset_px: Pixel = (60.0, -40.0)  # where the probe first is in the image, from the pixel that it is kept at
    path: PathSettings = PathSettings()
    axes: AxesSettings = AxesSettings()
    sweep: SweepSettings = SweepSettings()
    encoder: EncoderSettings = EncoderSettings()
    error: dict[str, ErrorSettings] = Field(default_factory=dict)  # by gimbal
    camera: LookSettings = LookSettings()
    clock: ClockSettings = ClockSettings()

    def error_of(self, gimbal: str) -> ErrorSettings:
        return self.error.get(gimbal, ErrorSettings())

    def camera_clock(self, camera: str) -> DeviceClockSettings:
        return self.clock.camera.get(camera, DeviceClockSettings())

    def gimbal_clock(self, gimbal: str) -> DeviceClockSettings:
        return self.clock.gimbal.get(gimbal, DeviceClockSettings())
