"""The frozen measurements that travel up the tower and the commands that travel down.

Units are in the names. A measurement carries its sigma and its instant. Arrays are NumPy float64 and read-only by agreement.
"""

from dataclasses import dataclass, field
from enum import Flag, IntEnum, StrEnum
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from trackerd.contract.clock import CameraNs, ClockKind, ControllerUs, HostNs

Array: TypeAlias = npt.NDArray[np.float64]
Image: TypeAlias = npt.NDArray[Any]  # (height, width), uint8 or uint16


# ---- camera ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Frame:
    """One exposure. `image` is valid until the frame after the next is taken; who keeps it longer copies it."""

    image: Image
    frame_id: int  # exposures since the stream was started, from 0; a gap is a frame that never reached the host
    mid_exposure: CameraNs | None  # by the camera's clock (CameraInfo.clock); None without a clock
    arrived: HostNs  # complete in the driver
    exposure_ns: int
    origin_px: tuple[int, int] = (0, 0)  # sensor coordinates (x, y) of the image's first pixel
    skipped: int = 0  # complete frames overwritten in the host's mailbox since the frame before this one
    dropped: int = 0  # exposures since the frame before this one that never arrived, or arrived broken


@dataclass(frozen=True, slots=True)
class CameraInfo:
    name: str
    model: str
    serial: str
    sensor_px: tuple[int, int]  # width, height
    image_px: tuple[int, int]
    frame_rate_hz: float
    exposure_ns: int
    clock: ClockKind
    transfer_ns: int = 0  # nominal end of exposure -> frame complete: readout and transfer


@dataclass(frozen=True, slots=True)
class CameraStatistics:
    delivered: int = 0
    skipped: int = 0
    dropped: int = 0


# ---- gimbal ----------------------------------------------------------------------------------------------------------


class AxisMode(IntEnum):
    """The controller's modes (register 3 of the command record)."""

    HOLD = 0
    POSITION = 1
    VELOCITY = 2
    HOME = 3
    STOW = 4


class GimbalFlag(Flag):
    """Status bits (register 102 of the status record)."""

    READY = 1 << 0
    ENABLED = 1 << 1
    FOLLOWING = 1 << 2
    IN_POSITION = 1 << 3
    FAULT = 1 << 4
    AT_LIMIT = 1 << 5
    COMM_LOST = 1 << 6
    HOMED = 1 << 7
    LATCH_ARMED = 1 << 8
    LATCH_OVERRUN = 1 << 9
    CLOCK_SYNCHRONISED = 1 << 10


@dataclass(frozen=True, slots=True)
class AxisCommand:
    """One command record, in encoder angles (signs belong to the calibration). `sequence` is the heartbeat: only the control
    loop counts it up, so that a hung loop is caught although packets still flow."""

    sequence: int  # 1..65535, skips 0; 0: no command yet, only the status is asked for
    mode: AxisMode = AxisMode.HOLD
    az_rad: float = 0.0
    el_rad: float = 0.0
    az_rad_s: float = 0.0
    el_rad_s: float = 0.0
    at: ControllerUs | None = None  # the instant that the set-point refers to; None: on receipt
    enable: bool = False
    follow: bool = False
    halt: bool = False
    reset_fault: bool = False
    latch: bool = True
    latch_zero: bool = False
    velocity_valid: bool = False
    watchdog_ms: int = 0  # 0: the controller's default


@dataclass(frozen=True, slots=True)
class Latch:
    """The encoders, captured by hardware at one edge of the camera's exposure-active line."""

    index: int  # exposures since the last latch zero, from 0: both edges of one exposure share it
    falling: bool
    az_rad: float
    el_rad: float
    instant: ControllerUs


@dataclass(frozen=True, slots=True)
class GimbalReport:
    """One status record. Angles are the encoders', unwrapped by the whole turns; stamps are raw."""

    sequence: int
    flags: GimbalFlag
    fault: int  # 0 none, 0x01xx protocol, 0x02xx az drive, 0x03xx el drive, 0x04xx limits, 0x05xx safety input
    echo: int  # the last command sequence that was accepted
    command_age_ms: int
    az_rad: float
    el_rad: float
    instant: ControllerUs  # of the live angles
    latch_total: int
    latches: tuple[Latch, ...]  # newest first
    sent: HostNs  # the request left
    received: HostNs  # the reply was complete


@dataclass(frozen=True, slots=True)
class GimbalInfo:
    name: str
    serial: str
    firmware: str
    steerable: bool  # False: angles only (replay, fixed); commands are ignored
    clock: ClockKind
    az_limits_rad: tuple[float, float]
    el_limits_rad: tuple[float, float]
    max_rad_s: float
    max_rad_s2: float
    latch_delay_ns: int = 0
    encoder_delay_ns: int = 0
    snapshot_ns: int = 0  # the greatest age of a status when it is served: one cycle of the controller's; 0: made on request
    latch_sigma_rad: float = 0.0  # what the latch itself adds (jitter); the encoder's own sigma is configured
    edges: int = 2  # latched per exposure: 2 both, mid-exposure is their mean; 1 the entry is mid-exposure; 0 no latches


@dataclass(frozen=True, slots=True)
class AxisAngles:
    """Both axes at one frame's mid-exposure, encoder angles."""

    az_rad: float
    el_rad: float
    sigma_rad: float  # 1 sigma of one axis, independent from frame to frame: repeatability, jitter, latch
    fixed_sigma_rad: float  # 1 sigma of the part that is a function of the angle: no averaging removes it
    instant: HostNs | None  # mid-exposure by the controller's clock, converted; None where the gimbal has no clock
    instant_sigma_ns: float
    source: str  # latch | history | live | recording | fixed


@dataclass(frozen=True, slots=True)
class NoAngle:
    """The frame's angles are not known, and why, in words for an operator."""

    reason: str


# ---- vision ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Found:
    """Outline of the sphere in an image; integer coordinates are pixel centres."""

    x_px: float
    y_px: float
    r_px: float  # sqrt(a b) of the outline's ellipse
    cov_px2: Array  # (3, 3) of x, y, r
    coverage: float  # share of the outline that carries an edge
    chi2: float  # per degree of freedom
    clipped: float  # share of the outline's pixels that are saturated
    blur_px: float = 0.0  # sigma of the edge, where it is widest
    inside_dn: float = 0.0  # grey level of the ball near its outline: median of the sectors that carry an edge
    outside_dn: float = 0.0  # and of what is round it
    inflated: str = ""  # why the covariance is larger than the pixels' noise says; empty: it is that noise alone


@dataclass(frozen=True, slots=True)
class Missed:
    """'Not seen' is a result, not an exception: it says why in words that an operator can read."""

    reason: str


Outline: TypeAlias = Found | Missed


# ---- geometry and fusion ---------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Sightline:
    """A line of sight in W: from the camera's entrance pupil towards the sphere's centre."""

    station: str
    instant: HostNs  # mid-exposure
    instant_sigma_ns: float
    origin_mm: Array  # (3,)
    direction: Array  # (3,), unit
    cov_rad2: Array  # (3, 3): of the direction, across it (rank 2); independent from frame to frame
    fixed_cov_rad2: Array  # (3, 3): the angle-fixed part, common to neighbouring frames
    range_mm: float  # from the apparent radius
    range_sigma_mm: float
    received: HostNs  # the frame was complete in the driver


class TrackState(StrEnum):
    SEARCHING = "searching"
    LOCKED = "locked"
    COASTING = "coasting"


class FixState(StrEnum):
    SEARCHING = "searching"  # no position
    UNCONFIRMED = "unconfirmed"  # the stations have not yet agreed that it is one target
    TRACKING = "tracking"
    COASTING = "coasting"  # extrapolated


class Source(StrEnum):
    """Where the photons came from; every message says it."""

    LIVE = "live"
    TWIN = "twin"
    REPLAY = "replay"


@dataclass(frozen=True, slots=True)
class Fix:
    """The sphere's centre in W at `instant`. Valid where `reasons` is empty."""

    sequence: int
    instant: HostNs
    state: FixState
    position_mm: Array  # (3,)
    velocity_mm_s: Array  # (3,)
    cov_mm2: Array  # (3, 3) of the position: random and systematic part together
    systematic_cov_mm2: Array  # (3, 3) the part that averaging does not reduce
    miss_mm: float  # distance of the skew lines (K = 2), rms distance from the lines (K > 2)
    stations: tuple[str, ...]
    received: HostNs  # the last frame that it stands on was complete in the driver
    reasons: tuple[str, ...] = field(default=())  # why it is not valid

    @property
    def valid(self) -> bool:
        return not self.reasons
