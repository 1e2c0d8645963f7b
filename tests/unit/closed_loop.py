"""One station of the demo cell, closed over bytes in virtual time: no sockets, no threads, no wall clock.

The simulated scene moves the probe, renders what the camera sees and turns the axes; the twin's controller takes commands and
gives status records; the driver's conversion, the latched angles, the tracker and the axes are the daemon's own. What the
daemon's tasks do between them is done here, at instants of the scene.
"""

import heapq
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import count
from math import degrees, hypot
from pathlib import Path

import cv2
import numpy as np

from drivers.gimbal.records import encode_command, info, report
from trackerd.contract.clock import CameraNs, HostNs
from trackerd.contract.model import AxisAngles, AxisCommand, Frame, GimbalFlag, NoAngle
from trackerd.engine.axes import Axes, AxesSnapshot, AxesState
from trackerd.engine.latched import LatchedAngles, RecordingTime
from trackerd.engine.track import Step, Tracker
from trackerd.estimate.latching import Waiting
from trackerd.formats import gimbal_map as gm
from trackerd.formats.calibration import load_calibration
from trackerd.formats.twin import DeviceClockSettings, PathSettings
from trackerd.geometry.gimbal import Station
from trackerd.geometry.rigid import Rigid
from trackerd.geometry.sightline import Instants
from trackerd.sim.path import ProbePath
from trackerd.sim.scene import View
from trackerd.twin.axes import GimbalAxes
from trackerd.twin.cell import scene_of
from trackerd.twin.clock import DeviceClock
from trackerd.twin.controller import Controller
from trackerd.twin.exposure import Exposure, ExposureLine
from trackerd.wiring.cell import load

DEMO = Path(__file__).parents[2] / "config" / "demo.toml"
NAME, CAMERA = "left", "left"
MS = 1_000_000
HOST_START_NS = 77_000_000_000_000  # the host's clock is not the scene's
REQUEST_NS = 200_000  # on the wire, one way
WORK_NS = 3 * MS  # of the tracker
LATCH_CYCLES = 2
BIG = gm.ByteOrder.MODBUS
SMALL = {"width_px": 320, "height_px": 240, "offset_x_px": 864, "offset_y_px": 648}

Pair = tuple[float, float]

cv2.setNumThreads(1)  # as in the daemon: its own threads only fight for the cores


@dataclass(frozen=True, slots=True)
class Cycle:
    """What was true at one bus cycle, before its exchange."""

    t_ns: int
    turned_deg: Pair  # of the controller's channels, true, from the start
    fastest_deg_s: float  # of both channels, true, since the cycle before
    state: AxesState
    enabled: bool
    off_px: float  # the probe, true, from where it is to be kept


class ClosedLoop:
    """`run` it, or `until` something is so; break things in between; read `cycles`, `commands`, `steps` afterwards."""

    def __init__(
        self, *overrides: str, automatic: bool = True, believed: Callable[[Station], Station] = lambda station: station
    ) -> None:
        cell = load(DEMO, overrides)
        stations = load_calibration(cell.calibration).stations
        self.settings = cell.gimbals[NAME]
        self.camera = cell.cameras[CAMERA]
        self.scene = scene_of(cell, stations)
        self.gimbal = self.scene.gimbals[NAME]
        self.line = ExposureLine(self.scene.trigger(NAME))
        self.controller = Controller(
            1001,
            GimbalAxes(self.gimbal, self.scene.settings.encoder),
            _clock(self.scene.settings.gimbal_clock(NAME)),
            self.line,
        )
        self.axes = Axes(self.settings.steering, automatic)
        self.tracker = Tracker(
            believed(stations[NAME]), cell.probe.radius_mm, self.camera, self.settings.steering, self.settings.tracking
        )
        self.now_ns = 0
        self.hidden = False  # the probe is out of the camera's view
        self.stopped = False  # no frame arrives
        self.hung = False  # the daemon does nothing
        self.angles_fail = ""  # why no frame gets angles
        self.cycles: list[Cycle] = []
        self.commands: list[tuple[int, AxisCommand]] = []
        self.steps: list[Step] = []
        self.flags = GimbalFlag(0)  # as reported last
        self._start_rad = self.gimbal.angles(0)
        self._renderer = self.scene.renderer(NAME)
        self._camera_clock = _clock(self.scene.settings.camera_clock(CAMERA))
        self._transfer_ns = round(self.scene.settings.camera.transfer_us * 1000.0)
        self._order = count()
        self._due: list[tuple[int, int, Callable[[], None]]] = []
        self._waiting: list[tuple[Frame, int]] = []
        self._stream = 0
        self._zero_from_ns: int | None = 0
        self.connect()
        self._at(0, self._cycle)

    # ---- what a test does --------------------------------------------------------------------------------------------

    def run(self, duration_s: float) -> "ClosedLoop":
        end_ns = self.now_ns + round(duration_s * 1e9)
        while self._due[0][0] <= end_ns:
            self.now_ns, _, work = heapq.heappop(self._due)
            work()
        self.now_ns = end_ns
        return self

    def until(self, so: Callable[["ClosedLoop"], bool], within_s: float) -> float:
        """Seconds that it took; fails where it did not come."""
        begin_ns = self.now_ns
        while not so(self.run(0.005)):
            assert self.now_ns - begin_ns < within_s * 1e9, f"not within {within_s} s: {self.snapshot()}"
        return (self.now_ns - begin_ns) * 1e-9

    def until_state(self, state: AxesState, within_s: float = 12.0) -> float:
        return self.until(lambda loop: loop.state is state, within_s)

    def connect(self) -> None:
        static = gm.decode_static(self.controller.static(), BIG)
        self._latched = LatchedAngles(info(NAME, static), self.settings, RecordingTime(), round(self.settings.stale_ms * MS))
        self.axes.connected(info(NAME, static))
        self._number_anew()

    def reconnect(self, reason: str = "the connection is lost") -> None:
        """The link breaks, and is there again."""
        self.axes.link_lost(reason)
        self.controller.link_lost(self.now_ns)
        self.connect()

    def restart_controller(self) -> None:
        self.controller.restart(self.now_ns)

    def miswire(self, az_sign: int = 1, el_sign: int = 1, swapped: bool = False) -> None:
        """From now on the channels turn the other way, or the other axis; the camera goes on from where it looks."""
        since_ns, looked = self.now_ns, self.gimbal.pose
        az0, el0 = self.gimbal.angles(since_ns)

        def pose(t_ns: int) -> Rigid:
            if t_ns <= since_ns:
                return looked(t_ns)
            az, el = self.gimbal.angles(t_ns)
            turned = (el - el0, az - az0) if swapped else (az - az0, el - el0)
            return self.gimbal.station.world_from_camera(az0 + az_sign * turned[0], el0 + el_sign * turned[1])

        self.gimbal.pose = pose  # type: ignore[method-assign]

    def stand_still(self) -> None:
        """The probe stops where it is."""
        self._put(self.scene.truth(self.now_ns)[0])

    def show_probe(self) -> None:
        """The probe is brought into the middle of the view, and stands still there."""
        pose = self.scene.true_pose(NAME, self.now_ns)
        range_mm = np.linalg.norm(self.scene.truth(self.now_ns)[0] - pose.translation_mm)
        self._put(pose.move(np.array((0.0, 0.0, range_mm))))

    def _put(self, p_mm: np.ndarray) -> None:
        self.scene.path = ProbePath(PathSettings(kind="still", centre_mm=tuple(p_mm.tolist())))

    # ---- what a test reads -------------------------------------------------------------------------------------------

    @property
    def state(self) -> AxesState:
        return self.axes.snapshot().state

    def snapshot(self) -> AxesSnapshot:
        return self.axes.snapshot()

    def since(self, t_ns: int) -> Iterator[Cycle]:
        return (cycle for cycle in self.cycles if cycle.t_ns >= t_ns)

    def excursion_deg(self, since_ns: int = 0) -> float:
        """The farthest that either channel got from where it was at an instant."""
        cycles = list(self.since(since_ns))
        first = cycles[0].turned_deg
        return max(abs(a - b) for cycle in cycles for a, b in zip(cycle.turned_deg, first, strict=True))

    # ---- what the daemon's tasks do ----------------------------------------------------------------------------------

    def _at(self, t_ns: int, work: Callable[[], None]) -> None:
        heapq.heappush(self._due, (t_ns, next(self._order), work))

    def _host(self, t_ns: int) -> HostNs:
        return HostNs(HOST_START_NS + t_ns)

    def _cycle(self) -> None:
        self._at(self.now_ns + round(self.settings.cycle_ms * MS), self._cycle)
        self.controller.advance(self.now_ns)
        self._note()
        if not self.hung:
            self._exchange()
            waiting, self._waiting = self._waiting, []
            for frame, cycles in waiting:
                self._match(frame, cycles + 1)
        for exposure in self.line.finished(self.now_ns):
            complete_ns = exposure.falling_ns + self._transfer_ns
            self._at(max(self.now_ns, complete_ns), partial(self._deliver, exposure, self._stream))

    def _exchange(self) -> None:
        now = self._host(self.now_ns)
        command = self.axes.command(now, self._latched.controller_time(now))
        zeroing = self._zero_from_ns is not None and self.now_ns >= self._zero_from_ns
        command = replace(command, latch_zero=True) if zeroing else command
        self.commands.append((self.now_ns, command))
        asked_ns = self.now_ns + REQUEST_NS
        if command.sequence:
            self.controller.command(encode_command(command, BIG), asked_ns)
        status = gm.decode_status(self.controller.status(asked_ns), BIG)
        got = report(status, now, HostNs(now + 2 * REQUEST_NS))
        self.flags = got.flags
        if zeroing and got.latch_total == 0 and got.echo == command.sequence:
            self._zero_from_ns = None
            self._latched.renumbered()
            self.line.start(asked_ns)
        if self._latched.reported(got):
            self.axes.restarted("the controller has restarted")
            self._number_anew()
        self.axes.reported(got)

    def _number_anew(self) -> None:
        self._stream += 1
        self._waiting.clear()
        self._zero_from_ns = self.line.stop(self.now_ns)

    def _deliver(self, exposure: Exposure, stream: int) -> None:
        if stream != self._stream or self.hung or self.stopped:
            return
        view = self.scene.view(NAME, exposure.rising_ns, exposure.falling_ns)
        if self.hidden:
            view = View(view.poses, ())
        image = self._renderer.render(view.poses, view.probes_mm, exposure.number)
        stamp = CameraNs(self._camera_clock.device_ns(exposure.mid_ns))
        origin_px = self.camera.offset_x_px, self.camera.offset_y_px
        arrived = self._host(self.now_ns)
        self._match(Frame(image, exposure.frame_id, stamp, arrived, self.line.trigger.exposure_ns, origin_px), 0)

    def _match(self, frame: Frame, cycles: int) -> None:
        angles = NoAngle(self.angles_fail) if self.angles_fail else self._latched.match(frame, self._host(self.now_ns))
        if not isinstance(angles, Waiting):
            self._track(frame, angles)
        elif cycles < LATCH_CYCLES:
            self._waiting.append((frame, cycles))
        else:
            self._track(frame, NoAngle("its latch did not come"))

    def _track(self, frame: Frame, angles: AxisAngles | NoAngle) -> None:
        exposed = HostNs(frame.arrived - self._transfer_ns - frame.exposure_ns // 2)
        if isinstance(angles, AxisAngles) and angles.instant is not None:
            exposed = angles.instant
        step = self.tracker.step(frame, angles, Instants(exposed, 0.0, frame.arrived))
        self.steps.append(step)
        self._at(self.now_ns + WORK_NS, lambda: self.axes.seen(step))

    # ---- the truth ---------------------------------------------------------------------------------------------------

    def _note(self) -> None:
        t_ns = self.now_ns
        az, el = self.gimbal.angles(t_ns)
        turned = degrees(az - self._start_rad[0]), degrees(el - self._start_rad[1])
        past = (max(0, t_ns - n * MS) for n in range(round(self.settings.cycle_ms)))
        fastest = max(abs(rate) for t in past for rate in self.gimbal.rates(t))
        kept_at = self.scene.mounts[NAME].kept_at_px
        off_px = hypot(*(self._pixel(t_ns) - np.array(kept_at)))
        self.cycles.append(Cycle(t_ns, turned, degrees(fastest), self.state, self.controller.enabled, off_px))

    def _pixel(self, t_ns: int) -> np.ndarray:
        p_camera = self.scene.true_pose(NAME, t_ns).inverse().move(self.scene.truth(t_ns)[0])
        return self.gimbal.station.lens.project(p_camera)


def _clock(settings: DeviceClockSettings) -> DeviceClock:
    return DeviceClock(round(settings.offset_s * 1e9), settings.drift_ppm)


QUICK = ("twin.path.kind=still", "gimbal.left.steering.test_deg=0.03", "gimbal.left.tracking.tracker=none")


def quick(*overrides: str, automatic: bool = True) -> ClosedLoop:
    """A probe that stands still in a small region, and a short test: for what happens after it."""
    small = (f"camera.left.{key}={value}" for key, value in SMALL.items())
    return ClosedLoop(*QUICK, "twin.start_offset_px=[20,-10]", *small, *overrides, automatic=automatic)


def circling(*overrides: str, automatic: bool = True) -> ClosedLoop:
    """Followed while the probe stands still; from 2.4 s on it circles, from 3 s on at 250 mm/s."""
    path = ("twin.path.kind=circle", "twin.path.dwell_s=2.4")
    return ClosedLoop(*QUICK, "twin.start_offset_px=[20,-10]", *path, *overrides, automatic=automatic)
