"""A simulated camera: exposes on its trigger, is rendered by a worker of its own, and is delivered when a real one would be.

Everything but the rendering runs in the event loop. Instants called `_ns` are scene time unless they are named after the host.
"""

import asyncio
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

from trackerd.formats.framelink import SLOT_HEADER, SLOTS, Doorbell, Offer
from trackerd.formats.settings import CameraSettings
from trackerd.sim.noise import uniform
from trackerd.sim.render import Renderer
from trackerd.sim.scene import View
from trackerd.twin.alarm import Alarm
from trackerd.twin.clock import DeviceClock, SceneTime
from trackerd.twin.exposure import Exposure, ExposureLine
from trackerd.twin.framelink import FrameLink, FrameMemory

BACKLOG = 3  # renders under way; another frame is lost, as in a camera whose buffers are full


@dataclass(slots=True)
class Counts:
    delivered: int = 0
    dropped: int = 0  # lost on purpose, for want of a free buffer, or with the end of their stream
    overruns: int = 0  # rendered later than due
    worst_overrun_ns: int = 0


@dataclass(frozen=True, slots=True)
class CameraModel:
    """What a camera is."""

    name: str
    settings: CameraSettings
    sensor_px: tuple[int, int]
    transfer_ns: int  # end of exposure -> frame complete
    clock: DeviceClock
    drop_probability: float
    drop_stream: int  # key of its draws

    def offer(self) -> Offer:
        s = self.settings
        return Offer(
            camera=self.name,
            serial=f"twin-{self.name}",
            sensor_width=self.sensor_px[0],
            sensor_height=self.sensor_px[1],
            width=s.width_px,
            height=s.height_px,
            bytes_per_pixel=1,
            exposure_ns=round(s.exposure_us * 1000.0),
            frame_rate_hz=s.frame_rate_hz,
            transfer_ns=self.transfer_ns,
            slots=SLOTS,
            slot_bytes=SLOT_HEADER + -(-s.width_px * s.height_px // SLOT_HEADER) * SLOT_HEADER,  # headers stay aligned
        )


class TwinCamera:
    """`look(rising_ns, falling_ns)` gives what an exposure sees; `path` is where its socket will be."""

    def __init__(
        self,
        model: CameraModel,
        *,
        line: ExposureLine,
        look: Callable[[int, int], View],
        renderer: Renderer,
        times: SceneTime,
        alarm: Alarm,
        path: Path,
    ) -> None:
        self.model = model
        self.line = line
        self.socket = path
        self.hidden_until_ns = 0  # the probe is out of its view
        self.counts = Counts()
        self._look = look
        self._renderer = renderer
        self._times = times
        self._alarm = alarm
        self._offer = model.offer()
        self._memory = FrameMemory(self._offer)
        self._link = FrameLink(path, self._offer, self._memory.fd, self._requested)
        self._loop = asyncio.get_running_loop()
        self._worker = ThreadPoolExecutor(1, f"render-{model.name}")
        self._rendering = 0
        self._stream = 0  # frames of an earlier stream are rung no more
        self._awaited_ns: int | None = None
        self._drop = 0

    # ---- on request --------------------------------------------------------------------------------------------------

    def hold_up(self, held_up: bool) -> None:
        """The stream stops, or returns."""
        self.line.hold_up(self._times.now(), held_up)
        self._await_exposure()

    def drop_frames(self, frames: int) -> None:
        """So many of the next frames are lost on their way."""
        self._drop = frames

    def hide_probe(self, duration_s: float) -> None:
        self.hidden_until_ns = self._times.now() + round(duration_s * 1e9)

    def statistics(self) -> dict[str, int]:
        return {"exposed": self.line.exposed, "missed_doorbells": self._link.missed_doorbells, **asdict(self.counts)}

    def close(self) -> None:
        """Waits for the render under way, some milliseconds."""
        self._link.close()
        self._worker.shutdown(wait=True, cancel_futures=True)
        self._memory.close()

    # ---- the stream --------------------------------------------------------------------------------------------------

    def _requested(self, wish: str, answer: Callable[[], None]) -> None:
        """A stop is answered when no exposure is in progress any more: after it there is no latch either."""
        self._stream += 1
        if wish == "start":
            self.line.start(self._times.now())
            self._await_exposure()
            answer()
            return
        self._alarm.at(self._times.host(self.line.stop(self._times.now())), answer)

    def _await_exposure(self) -> None:
        end_ns = self.line.next_end()
        if end_ns is not None and self._awaited_ns != end_ns:
            self._awaited_ns = end_ns
            self._alarm.at(self._times.host(end_ns), self._exposed)

    def _exposed(self) -> None:
        for exposure in self.line.finished(self._times.now()):
            self._take(exposure)
        self._await_exposure()

    def _take(self, exposure: Exposure) -> None:
        if self._is_dropped(exposure):
            self.counts.dropped += 1
            return
        view = self._look(exposure.rising_ns, exposure.falling_ns)
        if exposure.mid_ns < self.hidden_until_ns:
            view = View(view.poses, ())
        self._rendering += 1
        job = self._worker.submit(self._render, exposure, view)
        job.add_done_callback(partial(self._hand_over, exposure, self._stream))

    def _is_dropped(self, exposure: Exposure) -> bool:
        if not self.line.started:  # it was in progress when the stream was stopped: the next stream's frames begin at 0
            return True
        if self._drop:
            self._drop -= 1
            return True
        chance = self.model.drop_probability
        return self._rendering >= BACKLOG or (chance > 0.0 and uniform(self.model.drop_stream, exposure.number) <= chance)

    def _render(self, exposure: Exposure, view: View) -> int:
        """In the worker. The host's time at which the frame was in its slot."""
        slot = exposure.frame_id % self._memory.slots
        self._renderer.render(view.poses, view.probes_mm, exposure.number, self._memory.begin(slot))
        self._memory.finish(slot, exposure.frame_id)
        return time.monotonic_ns()

    def _hand_over(self, exposure: Exposure, stream: int, job: "Future[int]") -> None:
        """In the worker, or where it was cancelled."""
        if not job.cancelled():
            self._loop.call_soon_threadsafe(self._rendered, exposure, stream, job)

    def _rendered(self, exposure: Exposure, stream: int, job: "Future[int]") -> None:
        self._rendering -= 1
        rendered = job.result()
        due = self._times.host(exposure.falling_ns) + self.model.transfer_ns
        self._alarm.at(due, lambda: self._ring(exposure, stream, due, rendered))

    def _ring(self, exposure: Exposure, stream: int, due: int, rendered: int) -> None:
        if stream != self._stream:
            self.counts.dropped += 1
            return
        rung, s = time.monotonic_ns(), self.model.settings
        if rendered > due:
            self.counts.overruns += 1
            self.counts.worst_overrun_ns = max(self.counts.worst_overrun_ns, rung - due)
        doorbell = Doorbell(
            slot=exposure.frame_id % self._memory.slots,
            frame_id=exposure.frame_id,
            mid_exposure_ns=self.model.clock.device_ns(exposure.mid_ns),
            due_ns=due,
            rung_ns=rung,
            exposure_ns=self._offer.exposure_ns,
            width=s.width_px,
            height=s.height_px,
            origin_x=s.offset_x_px,
            origin_y=s.offset_y_px,
        )
        self.counts.delivered += self._link.ring(doorbell)
