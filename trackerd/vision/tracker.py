"""OpenCV's trackers as a second hypothesis: where to look when prediction fails. Precision comes from the fit alone.

A tracker learns from a verified outline, but lazily: `start` only keeps a small copy of every fourth image (0.1 ms), and the
work (5 ms for KCF, then 0.6 ms a frame) is spent when `update` is called: in the frames in which the gated fit missed. So its
memory is hardly older than the last verified outline, and it costs next to nothing while all is well.

KCF: grey descriptors only (its default throws on grey images), and one update on the frame it was started on, without which
it carries a constant offset of the motion up to the first update. It was the only one whose "lost" was always true; MOSSE
often does not recognise a ball without a stem from one look at it, CSRT takes more than a frame period on its first call.
"""

from math import sqrt
from typing import Any, Literal

import cv2

from trackerd.contract.model import Image
from trackerd.vision.rays import Circle
from trackerd.vision.search import eight_bits

_cv2: Any = cv2  # its stubs lack the trackers

Kind = Literal["kcf", "mosse", "csrt", "none"]
SCALE: dict[Kind, int] = {"kcf": 4, "mosse": 1, "csrt": 4, "none": 1}  # MOSSE loses the target at once at quarter size
BOX_RADII: dict[Kind, float] = {"kcf": 2.4, "mosse": 3.0, "csrt": 2.4, "none": 2.4}  # side of the box; MOSSE needs surroundings
SMALLEST_SIDE_PX = 8
KEPT_EVERY = 4  # a ball that crosses the image moves by less than its radius meanwhile


class BoxTracker:
    """Follows a ball by its look. Coordinates are those of the full-size image, an integer is a pixel's centre."""

    def __init__(self, kind: Kind) -> None:
        self._kind = kind
        self._scale = SCALE[kind]
        self._seen: tuple[Image, Circle] | None = None  # small image and circle in it, not yet learnt
        self._since = 0  # outlines since that one
        self._tracker: Any = None
        self._side_px = 0.0
        self._r_px = 0.0

    def start(self, image: Image, circle: Circle) -> None:
        """A ball (x, y, r) as seen in this image, to be learnt; the image may be reused afterwards."""
        if self._kind == "none":
            return
        self._since += 1
        if self._seen is not None and self._since < KEPT_EVERY:
            return
        self._since = 0
        x, y, r = circle
        k = self._scale
        small = _shrink(image, k)
        self._seen = (small if k > 1 else small.copy(), ((x + 0.5) / k - 0.5, (y + 0.5) / k - 0.5, r / k))
        self._tracker = None

    def update(self, image: Image) -> Circle | None:
        """Where the ball is in this image, to some pixels. None: lost, or never started."""
        if self._kind == "none" or (self._tracker is None and not self._learn()):
            return None
        found, box = self._tracker.update(_shrink(image, self._scale))
        if not found:
            return None
        left, top, width, height = box
        k = self._scale
        grown = sqrt(max(width * height, 1)) / self._side_px
        x, y = left + 0.5 * (width - 1), top + 0.5 * (height - 1)  # the box covers whole pixels
        return (x + 0.5) * k - 0.5, (y + 0.5) * k - 0.5, self._r_px * grown * k

    def forget(self) -> None:
        self._seen = self._tracker = None

    def _learn(self) -> bool:
        """False: nothing to learn from, or the ball is cut by the image's edge."""
        if self._seen is None:
            return False
        image, (x, y, r) = self._seen
        side = max(round(BOX_RADII[self._kind] * r), SMALLEST_SIDE_PX)
        left, top = round(x - 0.5 * (side - 1)), round(y - 0.5 * (side - 1))
        if left < 0 or top < 0 or left + side > image.shape[1] or top + side > image.shape[0]:
            return False
        tracker = _create(self._kind)
        tracker.init(image, (left, top, side, side))
        tracker.update(image)
        self._tracker, self._side_px, self._r_px, self._seen = tracker, float(side), r, None
        return True


def _create(kind: Kind) -> Any:
    if kind == "kcf":
        settings = _cv2.TrackerKCF_Params()
        settings.desc_pca = settings.desc_npca = _cv2.TrackerKCF_GRAY
        settings.compressed_size = 1
        return _cv2.TrackerKCF_create(settings)
    if kind == "csrt":
        return _cv2.TrackerCSRT_create()
    return _cv2.legacy.TrackerMOSSE_create()


def _shrink(image: Image, scale: int) -> Image:
    """An 8-bit image, smaller by a whole number. A resize to a fraction's own size keeps X = (x + 0.5) scale - 0.5 exact
    only where the sides are multiples of the scale: the rest is cut off."""
    if scale == 1:
        return eight_bits(image)
    height, width = image.shape[0] // scale, image.shape[1] // scale
    return eight_bits(cv2.resize(image[: height * scale, : width * scale], (width, height), interpolation=cv2.INTER_LINEAR))
