"""Several balls in one picture, drawn fast: for sequences of hundreds of frames, where pictures need not be exact."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np
import numpy.typing as npt

from trackerd.contract.clock import HostNs
from trackerd.contract.model import AxisAngles, Found, Frame, NoAngle, TrackState
from trackerd.engine.track import Step, Tracker
from trackerd.formats.settings import CameraSettings, SteeringSettings, TrackingSettings
from trackerd.geometry.gimbal import Station
from trackerd.geometry.lens import Lens
from trackerd.geometry.rigid import Rigid
from trackerd.geometry.sightline import Instants

BACKGROUND_DN = 60.0
FRAME_NS = 18_181_818
NO_ANGLE = NoAngle("no gimbal")
LENS = Lens((2048, 1536), 31000.0, 31000.0, 1023.5, 767.5)
STATION = Station("left", Rigid.identity(), Rigid(np.eye(3), np.array((0.0, -124.5, 0.0))), LENS)

Place = tuple[float, float]


@dataclass(frozen=True)
class Disc:
    x_px: float
    y_px: float
    r_px: float = 30.0
    level_dn: float = 170.0


@dataclass
class Scenes:
    """Frames of one camera; the later a disc is named, the nearer it is to the camera."""

    size_px: tuple[int, int] = (480, 360)
    seed: int = 0
    clutter: bool = True

    def __post_init__(self) -> None:
        self._random = np.random.default_rng(self.seed)
        width, height = self.size_px
        empty = np.full((height, width), BACKGROUND_DN, np.float32)
        for _ in range(10 if self.clutter else 0):
            corner = self._random.integers((0, 0), (width, height))
            cv2.rectangle(
                empty, (*corner.tolist(), *self._random.integers(5, 60, 2).tolist()), float(self._random.integers(30, 110)), -1
            )
        self._empty = cv2.GaussianBlur(empty, (0, 0), 0.9)
        self._noise = self._random.standard_normal(3 * empty.size).astype(np.float32)

    def picture(self, discs: Sequence[Disc]) -> npt.NDArray[np.uint8]:
        picture = self._empty.copy()
        for disc in discs:
            self._draw(picture, disc)
        begin = int(self._random.integers(0, 2 * picture.size))
        noise = self._noise[begin : begin + picture.size].reshape(picture.shape)
        return np.clip(np.rint(picture + noise * np.sqrt(picture / 39.0)), 0, 255).astype(np.uint8)

    def _draw(self, picture: npt.NDArray[np.float32], disc: Disc) -> None:
        height, width = picture.shape
        reach = int(disc.r_px) + 6
        x0, x1 = max(int(disc.x_px) - reach, 0), min(int(disc.x_px) + reach, width)
        y0, y1 = max(int(disc.y_px) - reach, 0), min(int(disc.y_px) + reach, height)
        if x0 >= x1 or y0 >= y1:
            return
        rows, columns = np.mgrid[y0:y1, x0:x1]
        outside = np.hypot(columns - disc.x_px, rows - disc.y_px) - disc.r_px
        share = 1.0 / (1.0 + np.exp(np.clip(1.8 * outside, -30.0, 30.0)))  # a soft edge, nearly that of a blur of 0.95 px
        region = picture[y0:y1, x0:x1]
        region += share.astype(np.float32) * (np.float32(disc.level_dn) - region)


@dataclass
class Watcher:
    """A tracker that sees pictures, and whether it told the truth."""

    size_px: tuple[int, int] = (480, 360)
    tracking: TrackingSettings = field(default_factory=TrackingSettings)

    def __post_init__(self) -> None:
        width, height = self.size_px
        camera = CameraSettings(driver="none", width_px=width, height_px=height)
        self.tracker = Tracker(STATION, 4.0, camera, SteeringSettings(), self.tracking)
        self.frame_id = 0

    def see(self, image: npt.NDArray[np.uint8], angles: AxisAngles | NoAngle = NO_ANGLE) -> Step:
        exposed = HostNs(self.frame_id * FRAME_NS)
        arrived = HostNs(exposed + 10_000_000)
        frame = Frame(image, self.frame_id, None, arrived, 2_000_000)
        self.frame_id += 1
        return self.tracker.step(frame, angles, Instants(exposed, 0.0, arrived))


def locked_off_px(step: Step, place: Place | None) -> float:
    """How far a lock is from the target: 0 without a lock, infinite where the target is hidden."""
    if step.state is not TrackState.LOCKED or not isinstance(step.outline, Found):
        return 0.0
    return np.inf if place is None else float(np.hypot(step.outline.x_px - place[0], step.outline.y_px - place[1]))
