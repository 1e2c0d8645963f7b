"""Which balls in view are not the target: seen beside it, then followed.

While the target is seen this costs next to nothing: a look round in a small picture every few frames, and a fit for each other
ball that is close. The frame in which it is first missed brings the rest: the image before, in which it was still seen.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from math import cos, hypot, pi, sin

import numpy as np

from trackerd.contract.model import Found, Image, Missed, Outline
from trackerd.vision.curve import View
from trackerd.vision.everywhere import ITSELF_RADII, everywhere, outlines_at
from trackerd.vision.kernels import first_circle
from trackerd.vision.limb import LimbChoice
from trackerd.vision.locate import locate
from trackerd.vision.look import Look, same_size
from trackerd.vision.noise import NoiseModel
from trackerd.vision.others import DOUBTED_NEW, Other, Others, Place
from trackerd.vision.rays import Circle, edges_on_rays

ALIKE = 0.3  # of the target's radius: other balls that are looked for
MERGED_RADII, MERGED_PX = 0.5, 16.0  # nearer to each other than this, one outline may be either's
CLOSE_RADII = 4.0  # another ball so close is followed in every frame
WATCHED_EVERY, WATCHED_EVERY_LARGE = 40, 120  # frames
WATCHED_EVERY_LOST, LOST_FRAMES = 4, 3  # where one that was close is not where it was expected for so long
EDGE_PX, HALF_SEEN = 2.0, 0.7  # an edge so near to a circle is on it; so much of what the target leaves of a ball shows edges
ABOUT, ABOUT_RADII, MOST_RINGS = 8, 0.7, 3  # seeds of the first ring; from ring to ring
LARGE_IMAGE_PX = 1_000_000
SMALL_RADIUS_PX = 28.0  # up to this, quarter size is too small to find it


class Bystanders:
    def __init__(self, noise: NoiseModel, radius_px: tuple[float, float]) -> None:
        self._noise = noise
        self._radius_px = radius_px
        self._others = Others()
        self._view: View | None = None
        self.forget()

    @property
    def known(self) -> bool:
        return bool(self._others.known)

    def doubts(self, target: Look) -> bool:
        """Whether one that looks like the target may be it: then one that is not followed may be the other."""
        return any(not other.sure for other in self._alike_others(target))

    def sees_all(self, target: Look) -> bool:
        """Whether all that look like the target are in view, as other balls."""
        return all(other.unseen == 0 for other in self._alike_others(target))

    def _alike_others(self, target: Look) -> list[Other]:
        return [
            other
            for other in self._others.known
            if same_size(other.look.r_px, target.r_px, ALIKE) and target.may_be_of(other.look)
        ]

    def forget(self, for_good: bool = False) -> None:
        self._others.forget(for_good)
        self._limb: LimbChoice | None = None
        self._frames = 0
        self._last: tuple[Image, Circle] | None = None  # the last image with the target, not yet looked through
        self._last_is_ours = self._looked_back = False
        self._since_last, self._frames_since_last = (0.0, 0.0), 0

    def go_on(self, moved_px: tuple[float, float], view: View | None) -> None:
        """One frame later; things at rest have moved by this much in the image."""
        self._view = view
        self._others.go_on(moved_px)
        self._since_last = self._since_last[0] + moved_px[0], self._since_last[1] + moved_px[1]
        self._frames_since_last += 1

    def watch(self, image: Image, target: Found, limb: LimbChoice) -> None:
        """The target is seen, with a limb term or without: the others are in the same light.

        The image is kept as it is, not copied: it must not change until the next frame was looked at.
        """
        circle = target.x_px, target.y_px, target.r_px
        self._last, self._last_is_ours, self._limb = (image, circle), False, limb
        self._looked_back = False
        self._since_last, self._frames_since_last = (0.0, 0.0), 0
        self._frames += 1
        every = WATCHED_EVERY_LARGE if image.size > LARGE_IMAGE_PX else WATCHED_EVERY
        if self._frames == 1:
            self._look_round(image, circle, (4, 2))
        elif self._frames % (WATCHED_EVERY_LOST if self._has_lost_a_close_one(circle) else every) == 0:
            scale = 2 if target.r_px < SMALL_RADIUS_PX else 4
            self._look_round(image, circle, (scale,))
        elif self._others.known:
            self._follow_close(image, circle)
            self._others.drop_outside(image.shape[1], image.shape[0])
        self._others.confirm()

    def keep_last_image(self) -> None:
        """The target was missed just now: the image before is needed for longer than it lasts."""
        if self._last is not None and not self._last_is_ours:
            self._last, self._last_is_ours = (self._last[0].copy(), self._last[1]), True

    def judged(self, outline: Found, target: Place) -> Outline:
        """An outline near to where the target is expected: it, unless it may be another ball's."""
        if not self._others.known:
            return outline
        if self.covers(outline, target.circle):
            return Missed("another ball is in the target's place: which one is seen cannot be told")
        if self._others.may_own(outline, target):
            return Missed("another ball is in view: this may be it, and not the target")
        return outline

    def covers(self, outline: Found, target: Circle) -> bool:
        """Whether another ball is expected in the target's place, and this may be it."""
        other = self._others.nearest(target[0], target[1])
        return other is not None and other.distance_px(target[0], target[1]) < _merged_px(target) and other.may_be(outline)

    def strangers(self, outlines: Sequence[Found], target: Place) -> list[Found]:
        """Those of all outlines in an image that are no other ball's; the others' places are known anew."""
        if outlines and self._last is not None and not self._looked_back:
            self._looked_back = True
            self._look_back(self._last, outlines)
        return self._others.claim(outlines, target)

    def was_there(self, found: Found) -> bool:
        """Whether a ball was about there already when the target was last seen, that nobody knew of: then it is another one.

        A guess sees more than the search did.
        """
        if self._last is None:
            return False
        (image, circle), (dx, dy) = self._last, self._since_last
        seeds = _about((found.x_px - dx, found.y_px - dy, found.r_px), min(self._frames_since_last, MOST_RINGS))
        then = outlines_at(image, self._noise, seeds, self._alike(circle), self._view, circle, self._limb)
        known = [(other.x_px - dx, other.y_px - dy, other) for other in self._others.known]
        if all(any(hypot(one.x_px - x, one.y_px - y) <= other.reach_px for x, y, other in known) for one in then):
            return False
        self._others.add([found])
        return True

    def came_in(self, outlines: Sequence[Found]) -> None:
        """Balls that came into view while the target was missed: for some time they are not taken for it."""
        self._others.add(outlines, doubted=DOUBTED_NEW)

    def _look_back(self, last: tuple[Image, Circle], outlines: Sequence[Found]) -> None:
        """Balls that were in view beside the target when it was last seen, brought to where those at rest are now."""
        (image, circle), (dx, dy), n = last, self._since_last, self._frames_since_last
        before = everywhere(image, self._noise, self._alike(circle), self._view, besides=circle, limb=self._limb)
        then = Others(self._others.for_good)
        then.known = [replace(o, x_px=o.x_px - dx, y_px=o.y_px - dy, unseen=o.unseen + n) for o in self._others.known]
        then.add(then.claim(before, Place(circle, 0)))
        moved_back = [replace(found, x_px=found.x_px - dx, y_px=found.y_px - dy) for found in outlines]
        then.add([found for found in moved_back if self._was_half_hidden(image, found, circle)])
        then.confirm()
        for other in then.known:
            other.x_px, other.y_px, other.unseen = other.x_px + dx, other.y_px + dy, max(other.unseen, n)
        self._others = then

    def _was_half_hidden(self, image: Image, found: Found, target: Circle) -> bool:
        """Whether a ball was there, partly behind the target or in front of it, and too much so to be found by a fit."""
        apart_px = hypot(found.x_px - target[0], found.y_px - target[1])
        if not ITSELF_RADII * target[2] < apart_px < found.r_px + target[2]:
            return False
        there = first_circle(image, (found.x_px, found.y_px, found.r_px), self._noise)
        if there is None or hypot(there[0] - target[0], there[1] - target[1]) < ITSELF_RADII * target[2]:
            return False
        edges = edges_on_rays(image, there, self._noise, EDGE_PX)
        angles = 2.0 * np.pi * (np.arange(len(edges.there)) + 0.5) / len(edges.there)
        x, y = there[0] + there[2] * np.cos(angles), there[1] + there[2] * np.sin(angles)
        beside = np.hypot(x - target[0], y - target[1]) > target[2] + EDGE_PX
        off = np.abs(np.hypot(edges.x_px - there[0], edges.y_px - there[1]) - there[2])
        on_it = ((off < EDGE_PX) & edges.there).any(axis=1)
        return bool(on_it[beside].sum() >= HALF_SEEN * max(beside.sum(), 1))

    def _look_round(self, image: Image, target: Circle, scales: tuple[int, ...]) -> None:
        found = everywhere(image, self._noise, self._alike(target), self._view, scales, target, self._limb)
        self._others.add(self._others.claim(found, Place(target, 0)))

    def _follow_close(self, image: Image, target: Circle) -> None:
        x, y, r = target
        chosen = None if self._limb is None else self._limb.kept()
        for other in self._others.known:
            away_px = other.distance_px(x, y)
            if _merged_px(target) < away_px < CLOSE_RADII * r:
                found = locate(image, (other.x_px, other.y_px, other.look.r_px), self._noise, view=self._view, limb=chosen)
                if (
                    isinstance(found, Found)
                    and hypot(found.x_px - x, found.y_px - y) > ITSELF_RADII * r
                    and other.may_be(found)
                ):
                    other.seen(found)

    def _has_lost_a_close_one(self, target: Circle) -> bool:
        """Whether one that may be near to the target is out of sight, though not in front of it or behind it."""
        return any(
            other.unseen >= LOST_FRAMES and other.distance_px(target[0], target[1]) < CLOSE_RADII * target[2] + other.reach_px
            for other in self._others.known
        )

    def _alike(self, target: Circle) -> tuple[float, float]:
        return max(target[2] * (1.0 - ALIKE), self._radius_px[0]), min(target[2] * (1.0 + ALIKE), self._radius_px[1])


def _about(circle: Circle, rings: int) -> Iterator[Circle]:
    """Where a ball may have been some frames ago: there, and in rings round it."""
    x, y, r = circle
    yield circle
    for ring in range(1, rings + 1):
        for n in range(ABOUT * ring):
            turn, away_px = n * 2.0 * pi / (ABOUT * ring), ABOUT_RADII * ring * r
            yield x + away_px * cos(turn), y + away_px * sin(turn), r


def _merged_px(target: Circle) -> float:
    return max(MERGED_RADII * target[2], MERGED_PX)
