"""Where to look for the ball: predicted gate, then the OpenCV tracker's box, then everywhere; each through the same fit."""

from dataclasses import dataclass
from math import hypot

from trackerd.contract.model import Found, Image, Missed, Outline
from trackerd.formats.settings import TrackingSettings
from trackerd.vision.locate import locate, refine, search
from trackerd.vision.noise import NoiseModel
from trackerd.vision.rays import REACH_PX, Circle
from trackerd.vision.tracker import BoxTracker

SAME_RADIUS = 0.15  # an outline whose radius differs by more is another thing
JUMP_RADII = 3.0  # farther from where it was expected, and the more frames ago the farther, it is another thing
GROWTH_PX = 4.0  # of the gate, for each frame missed
WIDEST_REACH = 0.5  # of the radius: the rays must start inside the outline
SMALL_IMAGE_PX = 1_000_000  # a greater image is searched in every second frame: 7 ms and more for 3 Mpx


@dataclass(frozen=True, slots=True)
class Expected:
    """Where the ball should be, and how many frames ago that was last known."""

    circle: Circle
    missed: int

    @property
    def reach_px(self) -> float:
        return min(REACH_PX + GROWTH_PX * self.missed, max(REACH_PX, WIDEST_REACH * self.circle[2]))

    def admits(self, found: Found) -> bool:
        x, y, r = self.circle
        far = hypot(found.x_px - x, found.y_px - y)
        return abs(found.r_px / r - 1.0) <= SAME_RADIUS and far <= JUMP_RADII * r * (1 + self.missed)


class Acquisition:
    """Looks for one ball in the images of one camera; coordinates are the image's own."""

    def __init__(self, noise: NoiseModel, tracking: TrackingSettings) -> None:
        self._noise = noise
        self._radius_px = tracking.radius_px
        self._box = BoxTracker(tracking.tracker)

    def anywhere(self, image: Image, frame_id: int, near_px: tuple[float, float] | None) -> Outline:
        """The best outline, or the one nearest to a pixel."""
        if image.size > SMALL_IMAGE_PX and frame_id % 2:
            return Missed("a large image is searched in every second frame")
        return search(image, self._noise, self._radius_px, near_px)

    def near(self, image: Image, frame_id: int, expected: Expected) -> Outline:
        """The ball that is followed, by prediction, tracker or search, whichever is the first to have a plausible outline."""
        if expected.missed == 0:  # the prediction of a ball that was seen a frame ago is good to a pixel or so
            at_once = self._plausible(refine(image, expected.circle, self._noise), expected)
            if isinstance(at_once, Found):
                return at_once
        first = self._at(image, expected.circle, expected)
        if isinstance(first, Found):
            return first
        box = self._box.update(image)
        if box is not None:
            again = self._at(image, (box[0], box[1], expected.circle[2]), expected)
            if isinstance(again, Found):
                return again
        anywhere = self.anywhere(image, frame_id, None)
        return anywhere if isinstance(anywhere, Found) and expected.admits(anywhere) else first

    def learn(self, image: Image, found: Found) -> None:
        """A verified outline, for the tracker to remember."""
        self._box.start(image, (found.x_px, found.y_px, found.r_px))

    def forget(self) -> None:
        self._box.forget()

    def _at(self, image: Image, circle: Circle, expected: Expected) -> Outline:
        return self._plausible(locate(image, circle, self._noise, expected.reach_px), expected)

    def _plausible(self, outline: Outline, expected: Expected) -> Outline:
        if isinstance(outline, Missed):
            return outline
        smallest, largest = self._radius_px
        if not smallest <= outline.r_px <= largest:
            return Missed(f"an outline of radius {outline.r_px:.1f} px is not admitted ({smallest:g} to {largest:g} px)")
        if not expected.admits(outline):
            return Missed(f"an outline of radius {outline.r_px:.1f} px is not the target's ({expected.circle[2]:.1f} px)")
        return outline
