"""A gimbal controller as a state machine: command records in, status records out, time passed in. No I/O.

Nothing happens between calls; whoever asks at an instant finds everything worked off that was due before it, each thing at its
own instant: the watchdog, the brake, the edges at the latch input. Times are scene ns.
"""

from math import copysign

from trackerd.contract.model import AxisMode, GimbalFlag
from trackerd.formats import gimbal_map as gm
from trackerd.formats.gimbal_map import ByteOrder, CommandRecord
from trackerd.twin.axes import Axes, Pair, SetPoints, fractions, outside
from trackerd.twin.clock import DeviceClock
from trackerd.twin.exposure import ExposureLine
from trackerd.twin.latch import LatchRing
from trackerd.twin.records import WATCHDOG_DEFAULT_MS, WATCHDOG_MAX_MS, WATCHDOG_MIN_MS, static_record, torn

MS = 1_000_000
BRAKE_NS = 2000 * MS  # from 'comm lost' to disabled
CARRY_NS = 100 * MS  # a set-point is carried on no longer than this without a fresh record
SLICE_NS = 100 * MS  # the servo's history is half a second deep: edges are read while it still holds them
IN_POSITION_RAD = 1e-4  # 20 arcsec
AT_LIMIT_RAD = 2e-6
HISTORY_PERIOD_NS = 1 * MS
FAULT_EMERGENCY_STOP = gm.FAULT_SAFETY | 1
NEVER_AGE_MS = 0xFFFF


class Controller:
    """Enabling takes an enable of 0 and then of 1: after power-up, after 'comm lost' and after the safety input."""

    def __init__(self, serial: int, axes: Axes, clock: DeviceClock, line: ExposureLine | None = None) -> None:
        self.serial = serial
        self.axes = axes
        self.line = line  # the exposure-active line of the camera that it carries
        self.trips: list[int] = []  # when the watchdog tripped, since the twin's start
        self.torn_commands = 0
        self.tear = 0  # so many of the next status records are torn: a fault on request
        self.now_ns = clock.started_ns
        self._stow_rad = axes.reading(self.now_ns)
        self.status_seq = 0
        self._power_up(clock)

    # ---- the way in --------------------------------------------------------------------------------------------------

    def command(self, data: bytes, t_ns: int) -> None:
        """Take one command record (32 bytes). One that is torn or not fresh changes nothing."""
        self.advance(t_ns)
        try:
            record = gm.decode_command(data, ByteOrder.MODBUS)
        except gm.TornRecord:
            self.torn_commands += 1
            return
        if record.map_id != gm.MAP_ID:
            self._raise_fault(gm.FAULT_MAP_ID)
        elif record.cmd_seq not in (0, self.echo):
            self._accept(record)

    def link_lost(self, t_ns: int) -> None:
        """The connection that carried the commands is gone."""
        self.advance(t_ns)
        if self.heard_ns is not None:
            self._lose()

    def advance(self, t_ns: int) -> None:
        """Work off what is due up to t_ns. An earlier instant than before changes nothing."""
        while self.now_ns < t_ns:
            due = [t for t in (self._watchdog_due(), self._brake_due()) if t is not None]
            self.now_ns = max(self.now_ns, min(t_ns, self.now_ns + SLICE_NS, *due))
            self.axes.advance(self.now_ns)
            self._latch()
            self._check_travel()
            self._timers()

    # ---- the way out -------------------------------------------------------------------------------------------------

    def status(self, t_ns: int) -> bytes:
        """One consistent snapshot (100 bytes): everything in it is of t_ns."""
        self.advance(t_ns)
        self._latch()
        self.status_seq = (self.status_seq + 1) & 0xFFFF
        (az, az_turns), (el, el_turns) = map(gm.counts, self.axes.reading(self.now_ns))
        record = gm.StatusRecord(
            self.status_seq, self.flags().value, self.fault, self.echo, self._command_age_ms(), az, el,
            self.clock.device_us(self.now_ns), self.latch.total, self.latch.read(), az_turns, el_turns,
        )  # fmt: skip
        data = gm.encode_status(record, ByteOrder.MODBUS)
        if not self.tear:
            return data
        self.tear -= 1
        return torn(data)

    def static(self) -> bytes:
        return static_record(self.serial, self.axes)

    def history(self, t_ns: int) -> bytes:
        """The encoders at 1 kHz, the newest sample at t_ns (250 bytes)."""
        self.advance(t_ns)
        since_start = (self.now_ns - self.clock.started_ns) // HISTORY_PERIOD_NS
        instants = [self.now_ns - n * HISTORY_PERIOD_NS for n in range(min(gm.HISTORY_DEPTH, 1 + since_start))]
        samples = [(self.clock.device_us(t) & gm.LOW_WORD, *fractions(self.axes.reading(t))) for t in instants]
        return gm.encode_history(self.status_seq, HISTORY_PERIOD_NS // 1000, samples, ByteOrder.MODBUS)

    def flags(self) -> GimbalFlag:
        """As of the last instant that was advanced to."""
        facts = {
            GimbalFlag.READY: not self.fault,
            GimbalFlag.ENABLED: self.enabled,
            GimbalFlag.FOLLOWING: self.following,
            GimbalFlag.IN_POSITION: self._in_position(),
            GimbalFlag.FAULT: self.fault != 0,
            GimbalFlag.AT_LIMIT: self._at_limit(),
            GimbalFlag.COMM_LOST: self.comm_lost,
            GimbalFlag.HOMED: True,  # absolute encoders
            GimbalFlag.LATCH_ARMED: self.latch.armed,
            GimbalFlag.LATCH_OVERRUN: self.latch.overrun,
        }
        return GimbalFlag(sum(flag.value for flag, true in facts.items() if true))

    @property
    def following(self) -> bool:
        return self._target is not None

    @property
    def comm_lost(self) -> bool:
        return self.lost_ns is not None

    # ---- faults on request -------------------------------------------------------------------------------------------

    def restart(self, t_ns: int) -> None:
        """Power off and on: every count begins again, the axes stay where they ramp down to."""
        self.advance(t_ns)
        self._power_up(self.clock.restarted(self.now_ns))

    def emergency_stop(self, t_ns: int) -> None:
        """The safety input: torque off at once. It stays until a fault reset."""
        self.advance(t_ns)
        self._raise_fault(FAULT_EMERGENCY_STOP)
        self.enabled, self._released = False, False

    # ---- inside ------------------------------------------------------------------------------------------------------

    def _power_up(self, clock: DeviceClock) -> None:
        self.clock = clock
        self.latch = LatchRing()
        self._latch_zero_ns = clock.started_ns  # older edges are none of its count
        self.enabled = False
        self.fault = 0
        self.echo = 0
        self.status_seq = 0
        self.heard_ns: int | None = None  # the last fresh record
        self.watchdog_ns = WATCHDOG_DEFAULT_MS * MS
        self._control = 0
        self._released = False  # an enable of 0 was seen since the last reason to want one
        self.lost_ns: int | None = None  # since when nobody commands
        self._target: SetPoints | None = None  # what is followed
        self._turning = False  # velocity mode
        self.axes.hold(self.now_ns)

    def _accept(self, record: CommandRecord) -> None:
        self.echo, self.heard_ns = record.cmd_seq, self.now_ns
        watchdog_ms = record.watchdog_ms or WATCHDOG_DEFAULT_MS
        self.watchdog_ns = max(WATCHDOG_MIN_MS, min(WATCHDOG_MAX_MS, watchdog_ms)) * MS
        rising = record.control & ~self._control
        self._control = record.control
        if rising & gm.FAULT_RESET:
            self.fault = 0
        if rising & gm.LATCH_ZERO:
            self._latch()
            self.latch.zero()
            self._latch_zero_ns = self.now_ns
        self.latch.arm(bool(record.control & gm.LATCH_ENABLE))
        self._enable(bool(record.control & gm.ENABLE))
        target = self._set_points(record) if self._may_follow(record.control) else None
        if target is None:
            self._hold()
        else:
            self._follow(target, record.mode == AxisMode.VELOCITY)

    def _enable(self, wanted: bool) -> None:
        if not wanted:
            self.enabled, self._released = False, True
        elif self._released and not self.fault:
            self.enabled, self.lost_ns = True, None

    def _may_follow(self, control: int) -> bool:
        asked = bool(control & gm.FOLLOW) and not control & gm.HALT
        return asked and self.enabled and not self.comm_lost and not self.fault

    def _set_points(self, record: CommandRecord) -> SetPoints | None:
        """What a record asks for; None: to hold."""
        velocity = (gm.rad_per_s(record.az_vel), gm.rad_per_s(record.el_vel))
        live = self.axes.motion(self.now_ns)[0]
        until_ns = self.now_ns + min(self.watchdog_ns, CARRY_NS)
        if record.mode == AxisMode.STOW:
            return SetPoints(self._stow_rad, (0.0, 0.0), self.now_ns, until_ns)
        if record.mode == AxisMode.VELOCITY:
            return SetPoints(live, velocity, self.now_ns, until_ns)
        if record.mode != AxisMode.POSITION:
            return None
        rad = gm.nearest_angle(record.az_cmd, live[0]), gm.nearest_angle(record.el_cmd, live[1])
        moving = velocity if record.control & gm.VELOCITY_VALID else (0.0, 0.0)
        return SetPoints(rad, moving, self._referred(record), until_ns)

    def _referred(self, record: CommandRecord) -> int:
        """The instant that a set-point refers to, kept within what is carried on: a wild stamp moves no axis far."""
        if not record.control & gm.TIME_VALID:
            return self.now_ns
        stamp_us = gm.unwrap(record.cmd_time_us, self.clock.device_us(self.now_ns))
        return max(self.now_ns - CARRY_NS, min(self.now_ns + CARRY_NS, self.clock.scene_ns(stamp_us)))

    def _follow(self, target: SetPoints, turning: bool) -> None:
        self._target, self._turning = target, turning
        self._check_travel()
        if self._target is None:
            return
        if turning:
            self.axes.turn(self.now_ns, target.rad_s)
        else:
            self.axes.go(self.now_ns, target)

    def _hold(self) -> None:
        if self._target is not None:
            self.axes.hold(self.now_ns)
        self._target = None

    def _lose(self) -> None:
        if not self.comm_lost:
            self.lost_ns, self._released = self.now_ns, False
        self._hold()

    def _raise_fault(self, fault: int) -> None:
        self.fault = fault
        self._hold()

    def _watchdog_due(self) -> int | None:
        return None if self.heard_ns is None or self.comm_lost else self.heard_ns + self.watchdog_ns

    def _brake_due(self) -> int | None:
        return self.lost_ns + BRAKE_NS if self.lost_ns is not None and self.enabled else None

    def _timers(self) -> None:
        due = self._watchdog_due()
        if due is not None and self.now_ns >= due:
            self.trips.append(self.now_ns)
            self._lose()
        due = self._brake_due()
        if due is not None and self.now_ns >= due:
            self.enabled = False

    def _latch(self) -> None:
        """Take the edges whose angles are captured by now."""
        if self.line is None:
            return
        for edge in self.line.edges(self.now_ns - self.axes.latch_settles_ns):
            if edge.t_ns > self._latch_zero_ns and self.latch.armed:
                az, el = fractions(self.axes.latched(edge.t_ns, edge.exposure_ns))
                self.latch.edge(edge.falling, az, el, self.clock.device_us(edge.t_ns) & gm.LOW_WORD)

    def _check_travel(self) -> None:
        """A set-point beyond the travel is a fault; the axes themselves never leave it."""
        if self._target is None:
            return
        beyond = outside(self._now_asked(self._target), self.axes.limits_rad)
        if beyond is not None:
            self._raise_fault(gm.FAULT_LIMITS | (1 + beyond))

    def _now_asked(self, target: SetPoints) -> Pair:
        if not self._turning:
            return target.at(self.now_ns)
        live = self.axes.motion(self.now_ns)[0]  # at the stop and turning outwards counts as beyond
        return live[0] + copysign(AT_LIMIT_RAD, target.rad_s[0]), live[1] + copysign(AT_LIMIT_RAD, target.rad_s[1])

    def _at_limit(self) -> bool:
        near = outside(self.axes.motion(self.now_ns)[0], self.axes.limits_rad, -AT_LIMIT_RAD) is not None
        return near or self.fault & gm.FAULT_CLASS == gm.FAULT_LIMITS

    def _in_position(self) -> bool:
        if self._target is None or self._turning:
            return False
        asked, live = self._target.at(self.now_ns), self.axes.motion(self.now_ns)[0]
        return max(abs(asked[0] - live[0]), abs(asked[1] - live[1])) < IN_POSITION_RAD

    def _command_age_ms(self) -> int:
        return NEVER_AGE_MS if self.heard_ns is None else min(NEVER_AGE_MS, (self.now_ns - self.heard_ns) // MS)
