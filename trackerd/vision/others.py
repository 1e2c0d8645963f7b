"""The other balls in view, each followed roughly, so that none of them is taken for the target.

What is kept is where each was last seen and how fast it went. One that is out of sight might be anywhere that it could have
reached, and what is found there is not the target's either, unless the target is the nearer one by far.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import hypot

from trackerd.contract.model import Found
from trackerd.vision.everywhere import ITSELF_RADII
from trackerd.vision.look import Look, same_size
from trackerd.vision.rays import Circle

GHOST = 0.06  # of the radius: no ball changes its size so fast that one that differs by more is it, seen again
ALIKE = 0.25  # of the radius: an outline that differs by more is not this ball's
FIRST_RADII, FIRST_PX = 2.0, 40.0  # how far one may have gone in its first frame, when its speed is not known
KNOWN_RADII, KNOWN_PX = 1.0, 16.0  # and how far from its prediction, when it is
STEADY_RADII, STEADY_PX = 0.25, 8.0  # and by how much it strays in a frame
RADII_A_FRAME = 0.5  # more for each frame in which it was not seen
CARRIED_ON = 20  # frames for which its speed is trusted
CLEAR_FRAMES = 3  # out of sight for so few, it is where it is expected
FORGOTTEN = 300  # frames out of sight
DOUBTED, DOUBTED_NEW = 300, 100  # frames for which one that may be the target is refused; one that came in is
NEWEST = 0.5  # share of the newest speed
TARGETS_SHARE = 0.5  # an outline so much nearer to the target's place than to another ball's is the target's, up to
TARGETS_RADII, TARGETS_RADII_DOUBTED = 1.0, 0.3  # so many of its radii, and where that other was out of sight


@dataclass(slots=True)
class Other:
    """A ball that is not the target; image coordinates."""

    look: Look
    x_px: float
    y_px: float
    speed_px: tuple[float, float] | None = None  # a frame
    unseen: int = 0  # frames
    sure: bool = True  # not the target; False: it was out of sight, and what was found then may be the target as well
    doubted: int | None = None  # frames for which it is kept, where it may be the target; None: for as long as it is seen

    @property
    def reach_px(self) -> float:
        """How far from where it is thought to be it may be."""
        fast_px = hypot(*self.speed_px) if self.speed_px is not None else 0.0
        return self._near_px + max(RADII_A_FRAME * self.look.r_px, fast_px) * max(self.unseen - 1, 0)

    @property
    def _near_px(self) -> float:
        radii, px = (FIRST_RADII, FIRST_PX) if self.speed_px is None else (KNOWN_RADII, KNOWN_PX)
        return radii * self.look.r_px + px

    def distance_px(self, x_px: float, y_px: float) -> float:
        return hypot(x_px - self.x_px, y_px - self.y_px)

    def is_expected_at(self, found: Found) -> bool:
        """Whether an outline is where it went on to, and not only where it could be: one in steady motion does not leap."""
        if self.speed_px is None:
            near_px = self._near_px
        else:
            near_px = (STEADY_RADII * self.look.r_px + STEADY_PX) * min(max(self.unseen, 1), CLEAR_FRAMES)
        return self.distance_px(found.x_px, found.y_px) <= near_px

    def may_be(self, found: Found) -> bool:
        alike = same_size(found.r_px, self.look.r_px, ALIKE) and self.look.has_levels(found)
        return alike and self.distance_px(found.x_px, found.y_px) <= self.reach_px

    def may_have_been(self, other: "Other") -> bool:
        """Whether one that is out of sight may be this one, seen again."""
        alike = same_size(self.look.r_px, other.look.r_px, GHOST) and other.look.has_levels_of(self.look)
        return alike and self.distance_px(other.x_px, other.y_px) <= ITSELF_RADII * self.look.r_px

    def go_on(self, moved_px: tuple[float, float]) -> None:
        """One frame later; things at rest have moved by this much in the image."""
        self.unseen += 1
        if self.doubted is not None:
            self.doubted -= 1
        vx, vy = self.speed_px if self.speed_px is not None and self.unseen <= CARRIED_ON else (0.0, 0.0)
        self.x_px += moved_px[0] + vx
        self.y_px += moved_px[1] + vy

    def doubt(self, frames: int | None) -> None:
        if self.sure:
            self.sure, self.doubted = False, frames

    def seen(self, found: Found) -> None:
        """Found again, after `go_on`; where it was expected tells how much faster it is than was thought."""
        frames = max(self.unseen, 1)
        off = (found.x_px - self.x_px) / frames, (found.y_px - self.y_px) / frames
        if self.speed_px is None:
            self.speed_px = off
        elif self.unseen > 0:
            self.speed_px = self.speed_px[0] + NEWEST * off[0], self.speed_px[1] + NEWEST * off[1]
        self.x_px, self.y_px, self.unseen = found.x_px, found.y_px, 0
        self.look = self.look.with_newer(found)


@dataclass(frozen=True, slots=True)
class Place:
    """Where the target is expected, and how long it was not seen."""

    circle: Circle
    missed: int

    @property
    def reach_px(self) -> float:
        return self.circle[2] * (1.0 + RADII_A_FRAME * self.missed)

    def distance_px(self, found: Found) -> float:
        return hypot(found.x_px - self.circle[0], found.y_px - self.circle[1])

    def has(self, found: Found) -> bool:
        """Whether an outline is where the target is expected, so well that it is no chance."""
        return self.distance_px(found) <= TARGETS_RADII_DOUBTED * self.circle[2]


class Others:
    """All of them, in the images of one camera."""

    def __init__(self, for_good: bool = False) -> None:
        """`for_good`: whoever is out of sight is not forgotten, and no doubt ends by itself."""
        self.known: list[Other] = []
        self.for_good = for_good

    def forget(self, for_good: bool = False) -> None:
        self.known, self.for_good = [], for_good

    def go_on(self, moved_px: tuple[float, float]) -> None:
        for other in self.known:
            other.go_on(moved_px)
        self.known = [other for other in self.known if self.for_good or (other.unseen <= FORGOTTEN and other.doubted != 0)]

    def drop_outside(self, width: int, height: int) -> None:
        """Those that have left the image: what comes in is looked at as such."""
        self.known = [
            o
            for o in self.known
            if o.unseen == 0 or (-o.look.r_px < o.x_px < width + o.look.r_px and -o.look.r_px < o.y_px < height + o.look.r_px)
        ]

    def nearest(self, x_px: float, y_px: float) -> Other | None:
        return min(self.known, key=lambda other: other.distance_px(x_px, y_px), default=None)

    def may_own(self, found: Found, target: Place) -> bool:
        """Whether an outline may be one of theirs rather than the target's, which is expected there."""
        return any(_may_claim(other, found, target) for other in self.known)

    def claim(self, outlines: Sequence[Found], target: Place) -> list[Found]:
        """Each that was not yet seen in this frame takes the outline nearest to it; what none could be is given back."""
        pairs = sorted(
            (other.distance_px(found.x_px, found.y_px), o, f)
            for o, other in enumerate(self.known)
            for f, found in enumerate(outlines)
            if other.unseen > 0 and _may_claim(other, found, target)
        )
        owner: dict[int, int] = {}  # of an outline
        for _, o, f in pairs:
            if o not in owner.values() and f not in owner:
                owner[f] = o
        nearest = {o: min(px for px, other, _ in pairs if other == o) for o in owner.values()}
        contested = {o for px, o, f in pairs if f not in owner and px < 2.0 * nearest[o] + self.known[o].look.r_px}
        in_place = any(target.has(found) for f, found in enumerate(outlines) if f not in owner)
        for f, o in owner.items():
            other, outline = self.known[o], outlines[f]
            elsewhere = in_place or target.distance_px(outline) > target.reach_px  # the target is not there
            clear = other.unseen <= CLEAR_FRAMES or (o not in contested and elsewhere)
            if not (clear and other.is_expected_at(outline)) or _is_as_near_to(target, other, outline):
                other.doubt(None if self.for_good else DOUBTED)
            other.seen(outline)
        self._drop_ghosts()
        for other in self.known:
            if target.missed > 0 and other.unseen > CLEAR_FRAMES:  # where it is now, or which one it will be, is not known
                other.doubt(None if self.for_good else DOUBTED)
        return [found for f, found in enumerate(outlines) if f not in owner]

    def confirm(self) -> None:
        """The target is seen, for sure: who is in view beside it is another ball."""
        for other in self.known:
            if other.unseen == 0:
                other.sure, other.doubted = True, None

    def _drop_ghosts(self) -> None:
        """What was kept twice: one of the two is seen, the other is out of sight at the same place."""
        seen = [other for other in self.known if other.unseen == 0]
        self.known = seen + [
            other for other in self.known if other.unseen > 0 and not any(s.may_have_been(other) for s in seen)
        ]

    def add(self, outlines: Sequence[Found], unseen: int = 0, doubted: int | None = None) -> None:
        """Balls that nobody knew of, or that were already seen in this frame."""
        for found in outlines:
            if not any(o.unseen == 0 and o.distance_px(found.x_px, found.y_px) < ITSELF_RADII * found.r_px for o in self.known):
                self.known.append(Other(Look.of(found), found.x_px, found.y_px, unseen=unseen, doubted=doubted))


def _is_as_near_to(target: Place, other: Other, found: Found) -> bool:
    """Whether an outline is hardly farther from the missed target's place than from another ball's, which strays."""
    strays_px = STEADY_RADII * other.look.r_px
    off_px = other.distance_px(found.x_px, found.y_px)
    return target.missed > 0 and off_px > strays_px and target.distance_px(found) < off_px + strays_px + STEADY_PX


def _may_claim(other: Other, found: Found, target: Place) -> bool:
    """Whether an outline may be this one's: it is in its reach, and not in the target's very place."""
    from_target_px = target.distance_px(found)
    radii = TARGETS_RADII if other.unseen <= CLEAR_FRAMES else TARGETS_RADII_DOUBTED
    targets = from_target_px <= radii * target.circle[2] and from_target_px < TARGETS_SHARE * other.distance_px(
        found.x_px, found.y_px
    )
    return not targets and other.may_be(found)
