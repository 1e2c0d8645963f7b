"""The task of one station: frame and latched angles into the tracker, its step to the axes and to the fusion."""

from collections.abc import Callable
from dataclasses import dataclass

from trackerd.contract.clock import Clock, ClockKind, HostNs
from trackerd.contract.model import AxisAngles, CameraStatistics, Frame, NoAngle, TrackState
from trackerd.contract.ports import Camera
from trackerd.engine.delay import DelayWatch
from trackerd.engine.latched import RecordingTime
from trackerd.engine.track import Step, Tracker
from trackerd.estimate.clockfit import OneWayFit
from trackerd.geometry.sightline import Instants
from trackerd.service.axes_link import AxesLink
from trackerd.service.stages import Stages
from trackerd.service.worker import Worker

ARRIVAL_SIGMA_NS = 2_000_000.0  # where only the arrival tells when a frame was exposed


@dataclass(slots=True)
class FrameCounts:
    """Every exposure is one of these."""

    processed: int = 0
    no_angle: int = 0  # of the processed ones: no line of sight, and why is in `last_no_angle`
    missed: int = 0  # of the processed ones: no probe in the image
    skipped: int = 0  # complete in the host, but a newer one was there
    dropped: int = 0  # never arrived, or broken
    last_no_angle: str = ""
    last_missed: str = ""


class StationTask:
    """One object for the station's life; `run` serves one opened camera."""

    def __init__(
        self,
        name: str,
        tracker: Tracker,
        link: AxesLink,
        recording: RecordingTime,
        clock: Clock,
        out: Callable[[str, Step], None],
    ) -> None:
        self.name = name
        self.counts = FrameCounts()
        self.stages = Stages()
        self.state = TrackState.SEARCHING
        self.last: Step | None = None
        self._tracker = tracker
        self._link = link
        self._recording = recording
        self._clock = clock
        self._out = out

    def select(self, pixel: tuple[float, float] | None, radius_px: float | None = None) -> None:
        self._tracker.select(pixel, radius_px)

    async def run(self, camera: Camera) -> None:
        """Until cancelled, the stream breaks (DeviceError) or a recording ends. Each pass numbers frames and latches anew."""
        times = CameraTimes(camera, self._recording)
        info = camera.info
        delays = DelayWatch(info.exposure_ns, info.transfer_ns, round(1e9 / info.frame_rate_hz))
        earlier = self.counts.skipped, self.counts.dropped
        with Worker(f"track-{self.name}") as worker:
            while True:
                await camera.stop()
                await self._link.zero_latch()
                epoch = self._link.epoch
                delays.reset()
                await camera.start()
                async for frame in camera.frames():
                    await self._process(frame, times, delays, worker)
                    self._count_missing(camera.statistics(), *earlier)
                    if self._link.epoch != epoch:
                        break

    def lost(self) -> None:
        """No camera: nothing is tracked."""
        self.state = TrackState.SEARCHING
        self._link.unseen()

    async def _process(self, frame: Frame, times: "CameraTimes", delays: DelayWatch, worker: Worker) -> None:
        angles = self._of_this_exposure(frame, await self._link.latched_at(frame), delays)
        known = self._clock.now()
        instants = times.instants(frame, angles)
        step, work_ns = await worker.run(self._timed_step, frame, angles, instants)
        self._link.seen(step)
        self._count(angles, step)
        self._out(self.name, step)
        self.stages.angles.add(known - frame.arrived)
        self.stages.work.add(work_ns)
        self.stages.tracked.add(self._clock.now() - frame.arrived)

    def _of_this_exposure(self, frame: Frame, angles: AxisAngles | NoAngle, delays: DelayWatch) -> AxisAngles | NoAngle:
        if isinstance(angles, NoAngle) or angles.source != "latch" or angles.instant is None:
            return angles
        objection = delays.objection(frame.arrived - angles.instant)
        if not objection:
            return angles
        self._link.out_of_step(objection)
        return NoAngle(objection)

    def _timed_step(self, frame: Frame, angles: AxisAngles | NoAngle, instants: Instants) -> tuple[Step, int]:
        began = self._clock.now()
        step = self._tracker.step(frame, angles, instants)
        return step, self._clock.now() - began

    def _count(self, angles: AxisAngles | NoAngle, step: Step) -> None:
        counts = self.counts
        counts.processed += 1
        if isinstance(angles, NoAngle):
            counts.no_angle += 1
            counts.last_no_angle = angles.reason
        if step.state is not TrackState.LOCKED:
            counts.missed += 1
            counts.last_missed = step.why
        self.state, self.last = step.state, step

    def _count_missing(self, camera: CameraStatistics, skipped: int, dropped: int) -> None:
        """By the camera's own counts, which know of a frame that waited when its stream was begun anew; before it: others'."""
        self.counts.skipped = skipped + camera.skipped
        self.counts.dropped = dropped + camera.dropped


class CameraTimes:
    """When a frame was exposed: by the clock that latched its angles, else by the camera's, else by its arrival."""

    def __init__(self, camera: Camera, recording: RecordingTime) -> None:
        self._info = camera.info
        self._recording = recording
        self._fit = OneWayFit(delay_ns=self._info.transfer_ns + self._info.exposure_ns // 2)

    def instants(self, frame: Frame, angles: AxisAngles | NoAngle) -> Instants:
        if isinstance(angles, AxisAngles) and angles.instant is not None:
            return Instants(angles.instant, angles.instant_sigma_ns, frame.arrived)
        if frame.mid_exposure is None or self._info.clock is ClockKind.NONE:
            return self._by_arrival(frame)
        if self._info.clock is ClockKind.RECORDING:
            return Instants(self._recording.host(frame.mid_exposure, frame.arrived), 0.0, frame.arrived)
        if self._info.clock is ClockKind.HOST:
            return Instants(HostNs(frame.mid_exposure), 0.0, frame.arrived)
        self._fit.add(frame.mid_exposure, frame.arrived)
        fitted = self._fit.host(frame.mid_exposure)
        return Instants(*fitted, frame.arrived) if fitted is not None else self._by_arrival(frame)

    def _by_arrival(self, frame: Frame) -> Instants:
        late_ns = self._info.transfer_ns + frame.exposure_ns // 2
        return Instants(HostNs(frame.arrived - late_ns), ARRIVAL_SIGMA_NS, frame.arrived)
