"""One station's tracker as a state machine: frame and latched angles in, outline, line of sight and set-point out.

searching -> locked after two consistent, verified outlines in a row; locked -> coasting when missed, with the prediction going
on and the gate growing; coasting -> searching when it has missed more than `coast_frames` frames. A target that was locked and
lost is known again by its look: one outline is enough then, and another ball that was seen beside it is not taken for it
(`trackerd.vision.acquire` says what is guaranteed).
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from trackerd.contract.clock import HostNs
from trackerd.contract.errors import Degenerate
from trackerd.contract.model import Array, AxisAngles, Found, Frame, Missed, NoAngle, Outline, Sightline, TrackState
from trackerd.formats.settings import CameraSettings, SteeringSettings, TrackingSettings
from trackerd.geometry.gimbal import Station
from trackerd.geometry.sightline import Instants, seen
from trackerd.steering.follow import Looked, SetPoint, angle_from_offset, follow
from trackerd.steering.motion import Motion
from trackerd.vision.acquire import Acquisition, Expected
from trackerd.vision.drift import Drift
from trackerd.vision.noise import NoiseModel

CONFIRMED = 2  # consistent outlines in a row that make a lock
LONGEST_DELAY_NS = 200_000_000  # a frame that arrived later than this after its exposure is no base for a set-point's instant
BLIND_FRAMES = 3  # the axes are led on without sight: farther out on a tangent, a probe that comes round is not met

Pixel = tuple[float, float]
Selected = Literal["pixel", "guess", "itself"]


@dataclass(frozen=True, slots=True)
class Wanted:
    """A target that somebody chose, in sensor pixels: the ball there, or (with a radius) the one at a guess."""

    pixel: Pixel
    radius_px: float | None = None


@dataclass(frozen=True, slots=True)
class Step:
    """What one frame said."""

    frame_id: int
    instant: HostNs  # mid-exposure
    state: TrackState
    outline: Outline  # in sensor coordinates
    sightline: Sightline | None  # only when locked, with angles
    set_point: SetPoint | None  # to follow; not seen or without angles: the last one, moved on while coasting is allowed
    offset_px: Pixel | None  # of the target from the aim pixel
    angles: AxisAngles | None
    jacobian: Array | None  # (2, 2) d px / d encoder rad at the target
    target_selected: Selected  # how the target was chosen
    why: str  # why there is no lock, no line of sight or no set-point; empty: nothing is missing


@dataclass(frozen=True, slots=True)
class _View:
    """A found target, seen at known angles."""

    line: Sightline
    jacobian: Array
    looked: Looked


class Tracker:
    """Keeps one target of one station. `step` runs in a worker; `select` may be called from elsewhere between two steps."""

    def __init__(
        self,
        station: Station,
        radius_mm: float,
        camera: CameraSettings,
        steering: SteeringSettings,
        tracking: TrackingSettings,
    ) -> None:
        self._station = station
        self._radius_mm = radius_mm
        self._steering = steering
        self._coast_frames = tracking.coast_frames
        self._led_blindly = min(tracking.coast_frames, BLIND_FRAMES)
        self._lead_ns = round(0.5e9 / camera.frame_rate_hz)  # a set-point is in use until the next: it fits best half-way
        noise = NoiseModel(camera.gain_e_per_dn, camera.read_noise_e)
        self._acquisition = Acquisition(noise, tracking, station.lens)
        self._motion = Motion()
        self._drift = Drift()
        self._selection: tuple[Wanted | None] = (None,)  # taken over by the next step
        self._taken: tuple[Wanted | None] | None = None
        self._wanted: Wanted | None = None
        self._selected: Selected = "itself"
        self._state = TrackState.SEARCHING
        self._seen = self._missed = 0  # consistent outlines so far; frames since the last one
        self._last: Found | None = None  # in sensor coordinates
        self._blind = 0  # frames in a row without a direction to the target: not seen, or no angles
        self._jacobian: Array | None = None
        self._set_point: SetPoint | None = None
        self._pose: tuple[AxisAngles | None, Pixel] | None = None  # of the frame before: angles, and the image's first pixel
        self.select(tracking.target_px, tracking.target_radius_px)

    def select(self, pixel: Pixel | None, radius_px: float | None = None) -> None:
        """Choose the ball at a sensor pixel, with a radius the one at that guess, or (None) whichever is found; takes
        effect in the next step."""
        self._selection = (None if pixel is None else Wanted(pixel, radius_px),)

    def step(self, frame: Frame, angles: AxisAngles | NoAngle, instants: Instants) -> Step:
        self._take_selection()
        known = angles if isinstance(angles, AxisAngles) else None
        aim_px = self._aim(frame)
        self._acquisition.next_frame(frame.origin_px, self._moved_px(frame, known))
        outline = self._look(frame, known, instants.exposed, aim_px)
        self._advance(outline)
        offset_px, view, trouble = None, None, angles.reason if isinstance(angles, NoAngle) else ""
        if isinstance(outline, Found):
            self._last = outline
            self._drift.update(instants.exposed, outline.x_px, outline.y_px)
            offset_px = (outline.x_px - aim_px[0], outline.y_px - aim_px[1])
            view, trouble = self._view(outline, angles, offset_px, instants)
            if self._state is TrackState.LOCKED:
                self._acquisition.learn(frame.image, _shifted(outline, frame.origin_px, -1))
        self._set_point = self._follow(view, instants)
        locked = self._state is TrackState.LOCKED
        return Step(
            frame_id=frame.frame_id,
            instant=instants.exposed,
            state=self._state,
            outline=outline,
            sightline=view.line if view is not None and locked else None,
            set_point=self._set_point,
            offset_px=offset_px,
            angles=known,
            jacobian=None if view is None else view.jacobian,
            target_selected=self._selected,
            why=_why(self._state, outline, trouble),
        )

    # ---- state -------------------------------------------------------------------------------------------------------

    def _forget(self) -> None:
        self._state = TrackState.SEARCHING
        self._seen = self._missed = self._blind = 0
        self._last = self._set_point = None
        self._motion.reset()
        self._drift.forget()

    def _take_selection(self) -> None:
        selection = self._selection
        if selection is not self._taken:
            self._forget()
            self._acquisition.forget(chosen=selection[0] is not None)
            self._taken, self._wanted = selection, selection[0]
            self._selected = _selected(self._wanted)

    def _advance(self, outline: Outline) -> None:
        if isinstance(outline, Found):
            self._seen, self._missed = self._seen + 1, 0
            if self._seen >= CONFIRMED or self._acquisition.knows_target:
                self._state, self._wanted = TrackState.LOCKED, None
            return
        self._missed += 1
        if self._state is TrackState.SEARCHING:
            self._forget()
        elif self._missed > self._coast_frames:
            self._forget()
            self._acquisition.lose()
        else:
            self._state = TrackState.COASTING

    # ---- image -------------------------------------------------------------------------------------------------------

    def _look(self, frame: Frame, angles: AxisAngles | None, exposed: HostNs, aim_px: Pixel) -> Outline:
        """Outline in sensor coordinates."""
        x0, y0 = frame.origin_px
        if self._last is None:
            outline = self._look_for_wanted(frame)
        else:
            x, y = self._expected_px(angles, exposed, aim_px, self._last)
            last = self._last.x_px - x0, self._last.y_px - y0, self._last.r_px
            expected = Expected((x - x0, y - y0, self._last.r_px), self._missed, last)
            outline = self._acquisition.near(frame.image, expected)
        return _shifted(outline, frame.origin_px, 1) if isinstance(outline, Found) else outline

    def _look_for_wanted(self, frame: Frame) -> Outline:
        """Outline in image coordinates: at the guess, near the chosen pixel, or anywhere."""
        wanted, (x0, y0) = self._wanted, frame.origin_px
        if wanted is None:
            return self._acquisition.anywhere(frame.image, frame.frame_id, None)
        x, y = wanted.pixel[0] - x0, wanted.pixel[1] - y0
        if wanted.radius_px is not None:
            return self._acquisition.at(frame.image, (x, y, wanted.radius_px))
        return self._acquisition.anywhere(frame.image, frame.frame_id, (x, y))

    def _moved_px(self, frame: Frame, angles: AxisAngles | None) -> Pixel:
        """How far things at rest have moved in the image since the frame before, as far as it is known."""
        before, self._pose = self._pose, (angles, frame.origin_px)
        if before is None:
            return 0.0, 0.0
        (last, origin_px), moved = before, np.zeros(2)
        if last is not None and angles is not None and self._jacobian is not None:
            moved = self._jacobian @ np.array((angles.az_rad - last.az_rad, angles.el_rad - last.el_rad))
        return float(moved[0]) + origin_px[0] - frame.origin_px[0], float(moved[1]) + origin_px[1] - frame.origin_px[1]

    def _expected_px(self, angles: AxisAngles | None, exposed: HostNs, aim_px: Pixel, last: Found) -> Pixel:
        """Sensor pixel: the target's predicted angles against the axes' latched ones, else its drift in the image."""
        target = self._motion.predict(exposed)
        if angles is not None and target is not None and self._jacobian is not None:
            missing = np.array((target.az_rad - angles.az_rad, target.el_rad - angles.el_rad))
            x, y = (self._jacobian @ missing).tolist()
            return aim_px[0] - x, aim_px[1] - y
        return self._drift.predict(exposed) or (last.x_px, last.y_px)

    def _aim(self, frame: Frame) -> Pixel:
        """The configured pixel, or the centre of the region."""
        if self._steering.aim_px is not None:
            return self._steering.aim_px
        height, width = frame.image.shape
        return frame.origin_px[0] + 0.5 * (width - 1), frame.origin_px[1] + 0.5 * (height - 1)

    # ---- geometry and steering ---------------------------------------------------------------------------------------

    def _view(
        self, found: Found, angles: AxisAngles | NoAngle, offset_px: Pixel, instants: Instants
    ) -> tuple[_View | None, str]:
        """Line of sight and what is missing to the aim pixel; None and why, where there are no angles."""
        if isinstance(angles, NoAngle):
            return None, angles.reason
        target = seen(self._station, found, angles, self._radius_mm, instants)
        try:
            pixel_angle = angle_from_offset(target.jacobian, offset_px)
        except Degenerate as error:
            return None, str(error)
        self._jacobian = target.jacobian
        self._motion.update(instants.exposed, angles.az_rad + pixel_angle[0], angles.el_rad + pixel_angle[1])
        return _View(target.line, target.jacobian, Looked(instants.exposed, angles, pixel_angle, offset_px)), ""

    def _follow(self, view: _View | None, instants: Instants) -> SetPoint | None:
        if self._state is TrackState.SEARCHING:
            return None
        delay_ns = min(max(instants.received - instants.exposed, 0), LONGEST_DELAY_NS)
        at = HostNs(instants.exposed + delay_ns + self._lead_ns)
        previous = self._set_point
        if view is None:
            self._blind += 1
            return None if previous is None or self._blind > self._led_blindly else previous.moved_to(at)
        self._blind = 0
        steering = self._steering
        predict = self._motion.predict if steering.feed_forward else None
        return follow(view.looked, steering.gain, steering.deadband_px, at, predict, previous)


def _selected(wanted: Wanted | None) -> Selected:
    if wanted is None:
        return "itself"
    return "pixel" if wanted.radius_px is None else "guess"


def _shifted(found: Found, origin_px: tuple[int, int], sign: int) -> Found:
    """Image to sensor coordinates (sign 1) and back (-1)."""
    return replace(found, x_px=found.x_px + sign * origin_px[0], y_px=found.y_px + sign * origin_px[1])


def _why(state: TrackState, outline: Outline, trouble: str) -> str:
    if isinstance(outline, Missed):
        return outline.reason
    if state is TrackState.SEARCHING:
        return "found once: to be confirmed by the next frame"
    return trouble
