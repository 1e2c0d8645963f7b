"""What a person who turns the lens's ring wants to see, frame by frame: time is passed in, nothing is drawn here."""

from collections import deque
from dataclasses import dataclass
from math import hypot, sqrt

import numpy as np

from trackerd.contract.model import Found, Image, Missed, Outline
from trackerd.inspection import advice
from trackerd.inspection.advice import Level, level_at
from trackerd.inspection.numbers import Rows
from trackerd.vision.noise import NoiseModel

RECENT = 30  # frames that the short-term scatter and the rate are taken from
SMOOTHED = 5  # frames whose median is the edge width: a lucky frame is not the best focus


@dataclass(frozen=True, slots=True)
class Glance:
    """One frame's outline."""

    instant_s: float  # on any clock that does not step
    exposure_s: float
    outline: Outline


class LiveView:
    """What is known from the frames so far."""

    def __init__(self) -> None:
        self._level: Level | None = None
        self._recent: deque[Glance] = deque(maxlen=RECENT)
        self._best_px: float | None = None
        self._bright_dn = self._full_dn = 0.0
        self.frames = 0
        self.seen = 0

    def add(self, glance: Glance, image: Image, noise: NoiseModel) -> None:
        self.frames += 1
        self.seen += isinstance(glance.outline, Found)
        self._recent.append(glance)
        self._full_dn = noise.saturation_of(int(np.iinfo(image.dtype).max))
        if isinstance(glance.outline, Missed):
            self._bright_dn = float(np.percentile(image[::8, ::8], 99.0))
            return
        self._level = level_at(image, glance.outline, noise)
        if len(self._found()) >= SMOOTHED and self._smear_px() <= advice.SMEAR_PX:
            blur_px = self._blur_px()
            self._best_px = blur_px if self._best_px is None else min(self._best_px, blur_px)

    def rows(self) -> Rows:
        """Names and words; why it sees no ball is in there too."""
        if not self._recent:
            return [("ball", "no frame yet")]
        last = self._recent[-1].outline
        if isinstance(last, Missed):
            bright = f"{self._bright_dn:.0f} of {self._full_dn:.0f} DN in its brightest parts"
            return [
                ("ball", f"not seen: {last.reason}"),
                ("image", bright),
                ("advice", advice.unseen_advice(self._share())),
                self._rate(),
            ]
        level = self._level
        assert level is not None  # since a ball was seen
        return [
            ("ball", "seen"),
            *self._focus(),
            ("contrast", f"{abs(last.inside_dn - last.outside_dn):.0f} DN: {self._levels(last)}"),
            ("clipped", f"{100 * last.clipped:.1f} % of the outline"),
            ("exposure", advice.exposure_advice(last, level)),
            ("light", advice.light_advice(last, level)),
            ("coverage", f"{100 * last.coverage:.0f} % of the outline"),
            *self._place(),
            self._rate(),
        ]

    def _levels(self, found: Found) -> str:
        return f"{found.inside_dn:.0f} inside, {found.outside_dn:.0f} outside, of {self._full_dn:.0f}"

    def _focus(self) -> Rows:
        blur_px = self._blur_px()
        best_px = blur_px if self._best_px is None else self._best_px
        return [
            ("edge width", f"{blur_px:.2f} px (sigma), best {best_px:.2f} px"),
            ("focus", f"{advice.focus_bar(blur_px, best_px)} {advice.focus_advice(blur_px, best_px, self._smear_px())}"),
        ]

    def _place(self) -> Rows:
        found = self._found()
        places = np.array([(f.x_px, f.y_px, f.r_px) for f in found])
        scatter = places.std(axis=0, ddof=1).tolist() if len(found) > 1 else None
        return [
            (
                name,
                f"{places[-1, k]:.3f} px" + ("" if scatter is None else f", scatter {scatter[k]:.4f} over {len(found)} frames"),
            )
            for k, name in enumerate(("x", "y", "radius"))
        ]

    def _rate(self) -> tuple[str, str]:
        seen = f"ball in {self.seen} of {self.frames} frames"
        if len(self._recent) < 2 or not (span_s := self._recent[-1].instant_s - self._recent[0].instant_s) > 0.0:
            return "rate", seen
        return "rate", f"{(len(self._recent) - 1) / span_s:.1f} Hz, {seen}"

    def _share(self) -> float:
        return self._bright_dn / self._full_dn

    def _found(self) -> list[Found]:
        """The latest frames without a gap: what comes after one may be in another place."""
        found: list[Found] = []
        for glance in reversed(self._recent):
            if isinstance(glance.outline, Missed):
                break
            found.append(glance.outline)
        return found[::-1]

    def _blur_px(self) -> float:
        return float(np.median([found.blur_px for found in self._found()[-SMOOTHED:]]))

    def _smear_px(self) -> float:
        """Rms width of the ball's way within one exposure, from its way between the last two frames."""
        if len(self._found()) < 2:
            return 0.0
        before, now = self._recent[-2], self._recent[-1]
        assert isinstance(before.outline, Found)
        assert isinstance(now.outline, Found)
        between_s = now.instant_s - before.instant_s
        if between_s <= 0.0:
            return 0.0
        way_px = hypot(now.outline.x_px - before.outline.x_px, now.outline.y_px - before.outline.y_px)
        return way_px * now.exposure_s / between_s / sqrt(12.0)
