"""A controller of the twin on simulated axes in virtual time, spoken to in records."""

from typing import Any

from unit.sim_cell import scene

from trackerd.contract.model import AxisMode, GimbalFlag
from trackerd.formats import gimbal_map as gm
from trackerd.formats.gimbal_map import ByteOrder, CommandRecord, StatusRecord
from trackerd.twin.axes import GimbalAxes
from trackerd.twin.clock import DeviceClock
from trackerd.twin.controller import Controller
from trackerd.twin.exposure import ExposureLine

MS = 1_000_000


class Rig:
    def __init__(self, clock: DeviceClock | None = None, **twin: Any) -> None:
        self.scene = scene(**twin)
        self.axes = GimbalAxes(self.scene.gimbals["left"], self.scene.settings.encoder)
        self.line = ExposureLine(self.scene.trigger("left"))
        self.clock = clock or DeviceClock()
        self.controller = Controller(7, self.axes, self.clock, self.line)
        self.start_rad = self.axes.motion(0)[0]
        self.seq = 0

    def send(self, t_ms: float, control: int = 0, mode: AxisMode = AxisMode.HOLD, **fields: Any) -> None:
        """A fresh record, unless `cmd_seq` says otherwise. az, el: rad from the start; az_rate, el_rate: rad/s."""
        self.seq += 1
        az, el = fields.pop("az", 0.0), fields.pop("el", 0.0)
        rates = fields.pop("az_rate", 0.0), fields.pop("el_rate", 0.0)
        record = CommandRecord(
            cmd_seq=fields.pop("cmd_seq", self.seq),
            control=control,
            mode=mode,
            az_cmd=gm.counts(self.start_rad[0] + az)[0],
            el_cmd=gm.counts(self.start_rad[1] + el)[0],
            az_vel=gm.counts_per_ms(rates[0]),
            el_vel=gm.counts_per_ms(rates[1]),
            cmd_time_us=fields.pop("cmd_time_us", 0),
            watchdog_ms=fields.pop("watchdog_ms", 0),
            **fields,
        )
        self.controller.command(gm.encode_command(record, ByteOrder.MODBUS), round(t_ms * MS))

    def enable(self, t_ms: float = 1.0, watchdog_ms: int = 0) -> None:
        self.send(t_ms)
        self.send(t_ms, gm.ENABLE, watchdog_ms=watchdog_ms)

    def status(self, t_ms: float) -> StatusRecord:
        return gm.decode_status(self.controller.status(round(t_ms * MS)), ByteOrder.MODBUS)

    def flags(self, t_ms: float) -> GimbalFlag:
        return GimbalFlag(self.status(t_ms).status)

    def offset(self, t_ms: float) -> tuple[float, float]:
        """True angles against the start's."""
        t_ns = round(t_ms * MS)
        self.controller.advance(t_ns)
        az, el = self.axes.motion(t_ns)[0]
        return az - self.start_rad[0], el - self.start_rad[1]

    def rates(self, t_ms: float) -> tuple[float, float]:
        t_ns = round(t_ms * MS)
        self.controller.advance(t_ns)
        return self.axes.motion(t_ns)[1]

    def follow(self, t_ms: float, **fields: Any) -> None:
        self.send(t_ms, gm.ENABLE | gm.FOLLOW | fields.pop("bits", 0), fields.pop("mode", AxisMode.POSITION), **fields)
