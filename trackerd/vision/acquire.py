"""Where to look for the ball: predicted gate, then the OpenCV tracker's box, then everywhere; each through the same fit.

An outline is the target's if it has its size and grey levels, and if it cannot be another ball's. A ball far from where the
target is expected is the target after a jump only if it was not there already while the target was elsewhere: that is looked
up in the last image in which the target was seen. Balls that are found to be others are followed for as long as the target is
missed, and at times while it is seen (`Bystanders`).

What cannot be known is refused, with the reason: an outline where the target and another ball are expected within half a
radius; one of two outlines that are equally near; a ball that comes in over the image's edge while the target was hidden in
the middle; and any ball after an equal one was lost sight of as well, or passed so near that the two may have changed places,
unless the target waits where it was expected and the others are seen elsewhere. A target that somebody chose has to be chosen
again then; for one that was found by itself such doubts end after 100 to 300 frames. What is not guaranteed, because no image
shows it: an equal ball that nobody had seen (it was behind something, or nearly all behind the target) and that appears while
the target is hidden.
"""

from dataclasses import dataclass, replace
from math import hypot, inf

from trackerd.contract.model import Found, Image, Missed, Outline
from trackerd.formats.settings import TrackingSettings
from trackerd.geometry.lens import Lens
from trackerd.vision.bystanders import Bystanders
from trackerd.vision.curve import View
from trackerd.vision.everywhere import everywhere, is_something_at
from trackerd.vision.limb import LimbChoice
from trackerd.vision.locate import locate, refine, search
from trackerd.vision.look import Look, same_size
from trackerd.vision.noise import NoiseModel
from trackerd.vision.others import Place
from trackerd.vision.rays import REACH_PX, Circle
from trackerd.vision.tracker import BoxTracker

NEXT_RADIUS, RADIUS_A_FRAME = 0.05, 0.03  # an outline whose radius differs by more from one frame to the next is something
SAME_RADIUS = 0.15  # else, or two things; so much at most while the target is followed,
CHOSEN_RADIUS, LOST_RADIUS = 0.15, 0.6  # and after it was lost: it may come back at another range, less so one that was chosen
GROWTH_PX = 4.0  # of the gate, for each frame missed
GATE_RADII = 0.25  # from where it is expected: what is farther off is looked at together with all the rest
AT_REST, SLOWING = 0.03, 0.9  # of the radius, a frame; of the greatest speed, a frame later
WAITED_FRAMES = 40  # a target that is where it was expected, while the balls like it are seen elsewhere
FRESH_FRAMES = 3  # an expectation that was confirmed so few frames ago tells the target from a ball that may be another
WIDEST_REACH = 0.5  # of the radius: the rays must start inside the outline
SMALL_IMAGE_PX = 1_500_000  # a greater image is searched for an unknown ball in every second frame: 7 ms and more for 3 Mpx
KEPT_FRAMES = 300  # after a loss: then light, range or target may have changed, and whatever is found is it, if nobody chose
CLEARLY_NEARER = 0.5  # of the next one's distance
EDGE_RADII, EDGE_RADII_HIDDEN = 1.0, 1.5  # a ball so near to the image's edge comes in over it
NOTHING = "nothing round in the image passes the verification"
INSIDE_RADII = 2.0  # the target left over the edge if it was expected nearer to it than this


@dataclass(frozen=True, slots=True)
class Expected:
    """Where the ball should be, and how many frames ago that was last known."""

    circle: Circle
    missed: int
    last: Circle | None = None  # where it was when it was last seen: a prediction after a leap may be far off
    px_a_frame: float = inf  # how fast it went when it was last seen

    @property
    def waited(self) -> bool:
        """Whether it was at rest in the image when it was last seen."""
        return self.px_a_frame <= AT_REST * self.circle[2]

    @property
    def reach_px(self) -> float:
        return min(REACH_PX + GROWTH_PX * self.missed, max(REACH_PX, WIDEST_REACH * self.circle[2]))

    def distance_px(self, found: Found) -> float:
        return hypot(found.x_px - self.circle[0], found.y_px - self.circle[1])


class Acquisition:
    """Looks for one ball in the images of one camera; coordinates are the image's own."""

    def __init__(self, noise: NoiseModel, tracking: TrackingSettings, lens: Lens | None = None) -> None:
        """With a lens the outlines are those of spheres behind it, else circles."""
        self._noise = noise
        self._lens = lens
        self._view = None if lens is None else View(lens)
        self._radius_px = tracking.radius_px
        self._box = BoxTracker(tracking.tracker)
        self._bystanders = Bystanders(noise, tracking.radius_px)
        self.forget()

    @property
    def knows_target(self) -> bool:
        """Whether the look of a target is remembered, so that one outline is enough to know it again."""
        return self._look is not None

    def forget(self, chosen: bool = False) -> None:
        """Another target is wanted: nothing of this one is kept. One that somebody chose is it until the next choice."""
        self._chosen = chosen
        self._look: Look | None = None
        self._lost: Expected | None = None  # where it was expected when it was given up
        self._lost_frames = 0
        self._limb = LimbChoice()
        self._px_a_frame = 0.0
        self._before: tuple[float, float, int] | None = None  # where it was, among things at rest, and frames since then
        self._bystanders.forget(for_good=chosen)
        self._box.forget()

    def lose(self) -> None:
        """The target is given up; for `KEPT_FRAMES` only what looks like it, and is no other ball, is taken for it."""
        self._box.forget()

    def next_frame(self, origin_px: tuple[int, int], moved_px: tuple[float, float]) -> None:
        """To be called once for each frame, first: where its image is on the sensor, and how far things at rest have moved in
        the image since the last."""
        if self._lens is not None and self._view is not None and self._view.origin_px != origin_px:
            self._view = View(self._lens, origin_px)
        self._bystanders.go_on(moved_px, self._view)
        if self._before is not None:
            x, y, frames = self._before
            self._before = x + moved_px[0], y + moved_px[1], frames + 1
        if self._lost is not None:
            x, y, r = self._lost.circle
            self._lost = replace(self._lost, circle=(x + moved_px[0], y + moved_px[1], r), missed=self._lost.missed + 1)

    def at(self, image: Image, circle: Circle) -> Outline:
        """The outline at a guess (x, y, r): there, or else the nearest of about that radius."""
        x, y, r = circle
        there = locate(image, circle, self._noise, view=self._view)
        if isinstance(there, Found) and self._admits(there):
            return there
        smallest, largest = max(r / (1.0 + LOST_RADIUS), self._radius_px[0]), min(r * (1.0 + LOST_RADIUS), self._radius_px[1])
        return search(image, self._noise, (smallest, largest), (x, y), self._view, guessed=True)

    def anywhere(self, image: Image, frame_id: int, near_px: tuple[float, float] | None) -> Outline:
        """After a loss the ball that was lost; else the best outline, or the one nearest to a pixel."""
        if self._lost is not None and near_px is None:
            self._lost_frames += 1
            if self._lost_frames > KEPT_FRAMES and not self._chosen:
                self._look = None
            if self._look is not None and self._is_past_telling(self._look, self._lost):
                return Missed("another ball may be the target: it has to be chosen again")
            if self._look is not None or self._bystanders.known:
                growth = CHOSEN_RADIUS if self._chosen else LOST_RADIUS
                return self._elsewhere(image, self._lost, growth) or Missed(NOTHING)
        if image.size > SMALL_IMAGE_PX and frame_id % 2:
            return Missed("a large image is searched in every second frame")
        return search(image, self._noise, self._radius_px, near_px, self._view)

    def _is_past_telling(self, look: Look, lost: Expected) -> bool:
        """Whether nothing that may come into view will be taken for the target: then it is not looked for."""
        return self._chosen and lost.missed > WAITED_FRAMES and self._bystanders.doubts(look)

    def near(self, image: Image, expected: Expected) -> Outline:
        """The ball that is followed, by prediction, tracker or search, whichever is the first to have a plausible outline."""
        expected = replace(expected, px_a_frame=self._px_a_frame)
        self._lost, self._lost_frames = expected, 0
        if expected.missed == 0:  # the prediction of a ball that was seen a frame ago is good to a pixel or so
            at_once = self._judged(refine(image, expected.circle, self._noise, self._view, self._limb), expected)
            if isinstance(at_once, Found):
                return at_once
            self._bystanders.keep_last_image()
        first = self._at(image, expected.circle, expected)
        if isinstance(first, Found):
            return first
        if expected.missed == 0 and expected.last is not None:  # what has not moved much since a frame ago is it, for sure
            expected = Expected(expected.last, 0)
            there = self._at(image, expected.circle, expected)
            if isinstance(there, Found):
                return there
        box = self._box.update(image)
        if box is not None:
            again = self._at(image, (box[0], box[1], expected.circle[2]), expected)
            if isinstance(again, Found):
                return again
        return self._elsewhere(image, expected, SAME_RADIUS) or first

    def learn(self, image: Image, found: Found) -> None:
        """A verified outline of the target, to be remembered. `image` must stay as it is until the next one was looked at."""
        self._look = Look.of(found) if self._look is None else self._look.with_newer(found)
        self._measure_speed(found)
        self._bystanders.watch(image, found, self._limb)
        self._box.start(image, (found.x_px, found.y_px, found.r_px))

    def _measure_speed(self, found: Found) -> None:
        """Against things at rest: the greatest of late, since what turns round stands still for a moment."""
        if self._before is not None:
            x, y, frames = self._before
            self._px_a_frame = max(hypot(found.x_px - x, found.y_px - y) / max(frames, 1), SLOWING * self._px_a_frame)
        self._before = found.x_px, found.y_px, 0

    def _at(self, image: Image, circle: Circle, expected: Expected) -> Outline:
        """The target's outline at a guess; what is found beyond the gate may be a bystander, and is left to the search."""
        found = locate(image, circle, self._noise, expected.reach_px, self._view, self._limb)
        outline = self._judged(found, expected)
        if isinstance(outline, Found) and expected.distance_px(outline) > max(
            expected.reach_px, GATE_RADII * expected.circle[2]
        ):
            return Missed("an outline beyond the gate: to be compared with what else is in view")
        return outline

    def _judged(self, outline: Outline, expected: Expected) -> Outline:
        """An outline near to where the target is expected."""
        if isinstance(outline, Missed):
            return outline
        if not self._admits(outline):
            smallest, largest = self._radius_px
            return Missed(f"an outline of radius {outline.r_px:.1f} px is not admitted ({smallest:g} to {largest:g} px)")
        r = expected.circle[2]
        if not same_size(outline.r_px, r, min(NEXT_RADIUS + RADIUS_A_FRAME * expected.missed, SAME_RADIUS)):
            return Missed(f"an outline of radius {outline.r_px:.1f} px is not the target's ({r:.1f} px)")
        if self._look is not None and not self._look.has_levels(outline):
            return Missed(
                f"an outline with a grey level of {outline.inside_dn:.0f} is not the target's ({self._look.inside_dn:.0f})"
            )
        if expected.missed > FRESH_FRAMES and self._look is not None and self._bystanders.doubts(self._look):
            return Missed("another ball was lost sight of as well: which one is seen cannot be told")
        return self._bystanders.judged(outline, Place(expected.circle, expected.missed))

    def _elsewhere(self, image: Image, expected: Expected, growth: float) -> Outline | None:
        """Whatever looks like the target, anywhere, and is no other ball. None: nothing is round."""
        r = expected.circle[2]
        radius_px = max(self._radius_px[0], r / (1.0 + LOST_RADIUS)), min(self._radius_px[1], r * (1.0 + LOST_RADIUS))
        outlines = everywhere(image, self._noise, radius_px, self._view, limb=self._limb)
        strangers = self._bystanders.strangers(outlines, Place(expected.circle, expected.missed))
        look = self._look
        alike = [s for s in strangers if same_size(s.r_px, r, growth) and (look is None or look.has_levels(s))]
        if not alike:
            return _why_none(len(outlines), len(strangers))
        if any(_comes_in(image, s, expected) for s in alike):
            self._bystanders.came_in([s for s in alike if _comes_in(image, s, expected)])
            return Missed("a ball that came in over the image's edge while the target was hidden is not taken for it")
        alike.sort(key=expected.distance_px)
        nearest_px = expected.distance_px(alike[0])
        if len(alike) > 1 and nearest_px > CLEARLY_NEARER * expected.distance_px(alike[1]):
            return Missed(f"{len(alike)} balls are in view: which one is the target cannot be told")
        doubt = self._doubt(image, alike[0], expected)
        return Missed(doubt) if doubt else alike[0]

    def _doubt(self, image: Image, found: Found, expected: Expected) -> str:
        """Why an outline that looks like the target, and is the only one that is left, need not be it; empty: it is."""
        look, r, away_px = self._look, expected.circle[2], expected.distance_px(found)
        if away_px > r and is_something_at(image, self._noise, expected.circle):
            return "a ball is in view elsewhere, but something round is where the target is expected"
        if away_px > r and self._bystanders.was_there(found):
            return "another ball is in view, not the target"
        cannot_be_told = "another ball is in view: which one is the target cannot be told"
        if self._bystanders.covers(found, expected.circle):
            return cannot_be_told
        if look is None or not self._bystanders.doubts(look) or (away_px <= r and expected.missed <= FRESH_FRAMES):
            return ""
        waits_there = Place(expected.circle, expected.missed).has(found) and expected.missed <= WAITED_FRAMES
        return "" if expected.waited and waits_there and self._bystanders.sees_all(look) else cannot_be_told

    def _admits(self, found: Found) -> bool:
        return self._radius_px[0] <= found.r_px <= self._radius_px[1]


def _why_none(outlines: int, strangers: int) -> Missed | None:
    if outlines == 0:
        return None
    return Missed(
        "another ball is in view, not the target" if strangers == 0 else "what is round in view has not the target's look"
    )


def _comes_in(image: Image, found: Found, expected: Expected) -> bool:
    """Whether a ball is at the image's edge although the target was not expected there."""
    x, y, r = expected.circle
    radii = EDGE_RADII_HIDDEN if expected.missed > 0 else EDGE_RADII
    return _to_edge_px(image, x, y) > INSIDE_RADII * r and _to_edge_px(image, found.x_px, found.y_px) < radii * found.r_px


def _to_edge_px(image: Image, x_px: float, y_px: float) -> float:
    """Distance from the nearest edge, negative outside."""
    height, width = image.shape
    return float(min(x_px, y_px, width - 1 - x_px, height - 1 - y_px))
