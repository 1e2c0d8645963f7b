"""The records of the gimbal's map as the contract's commands, reports and infos: the same on every bus, and without one."""

from trackerd.contract.clock import ClockKind, ControllerUs, HostNs
from trackerd.contract.model import AxisCommand, GimbalFlag, GimbalInfo, GimbalReport, Latch
from trackerd.formats import gimbal_map as m

ALL_FLAGS = sum(flag.value for flag in GimbalFlag)


def encode_command(command: AxisCommand, order: m.ByteOrder) -> bytes:
    """The command record on the wire. Angles wrap, speeds are clamped to their range."""
    bits = (
        (command.enable, m.ENABLE),
        (command.follow, m.FOLLOW),
        (command.halt, m.HALT),
        (command.reset_fault, m.FAULT_RESET),
        (command.latch, m.LATCH_ENABLE),
        (command.latch_zero, m.LATCH_ZERO),
        (command.velocity_valid, m.VELOCITY_VALID),
        (command.at is not None, m.TIME_VALID),
    )
    record = m.CommandRecord(
        cmd_seq=command.sequence,
        control=sum(bit for is_set, bit in bits if is_set),
        mode=int(command.mode),
        az_cmd=m.counts(command.az_rad)[0],
        el_cmd=m.counts(command.el_rad)[0],
        az_vel=m.counts_per_ms(command.az_rad_s),
        el_vel=m.counts_per_ms(command.el_rad_s),
        cmd_time_us=(command.at or 0) & m.LOW_WORD,
        watchdog_ms=command.watchdog_ms,
    )
    return m.encode_command(record, order)


def report(status: m.StatusRecord, sent: HostNs, received: HostNs) -> GimbalReport:
    """Fractions and low words unwrapped: live angles by the whole turns, latches near the live sample."""
    az_rad, el_rad = m.angle(status.az_live, status.az_turns), m.angle(status.el_live, status.el_turns)
    latches = tuple(
        Latch(
            index=(latch.index - 1) & m.INDEX_MASK,  # the controller counts from 1
            falling=bool(latch.index & m.FALLING_EDGE),
            az_rad=m.nearest_angle(latch.az, az_rad),
            el_rad=m.nearest_angle(latch.el, el_rad),
            instant=ControllerUs(m.unwrap(latch.t_us, status.clock_us)),
        )
        for latch in status.latches
    )
    return GimbalReport(
        sequence=status.status_seq,
        flags=GimbalFlag(status.status & ALL_FLAGS),
        fault=status.fault,
        echo=status.cmd_seq_echo,
        command_age_ms=status.cmd_age_ms,
        az_rad=az_rad,
        el_rad=el_rad,
        instant=ControllerUs(status.clock_us),
        latch_total=status.latch_total,
        latches=latches,
        sent=sent,
        received=received,
    )


def info(name: str, static: m.StaticRecord) -> GimbalInfo:
    return GimbalInfo(
        name=name,
        serial=str(static.serial),
        firmware="{}.{}".format(*static.firmware),
        steerable=True,
        clock=ClockKind.DEVICE,
        az_limits_rad=(m.angle(*static.az_min), m.angle(*static.az_max)),
        el_limits_rad=(m.angle(*static.el_min), m.angle(*static.el_max)),
        max_rad_s=m.rad_per_s(static.max_speed),
        max_rad_s2=m.rad_per_s(static.max_acceleration) * 1e3,
        latch_delay_ns=static.latch_delay_ns,
        encoder_delay_ns=static.encoder_delay_ns,
        snapshot_ns=static.cycle_us * 1000,
    )
