"""The controller's map as Modbus registers. A record is read and written whole: its parts would be of different instants."""

from enum import IntEnum

from trackerd.formats import gimbal_map as gm
from trackerd.twin.controller import Controller


class Refusal(IntEnum):
    """Modbus exception codes."""

    ILLEGAL_FUNCTION = 1
    ILLEGAL_ADDRESS = 2
    ILLEGAL_VALUE = 3
    BUSY = 6


class Refused(ValueError):
    """A request that the map does not allow."""

    def __init__(self, code: Refusal) -> None:
        super().__init__(code.name)
        self.code = code


COMMAND = (gm.COMMAND_REGISTER, gm.COMMAND_WORDS)
STATUS = (gm.STATUS_REGISTER, gm.STATUS_WORDS)
STATIC = (gm.STATIC_REGISTER, gm.STATIC_WORDS)
HISTORY = (gm.HISTORY_REGISTER, gm.HISTORY_WORDS)


class GimbalRegisters:
    """One controller's registers; `t_ns` is the scene's time of the request."""

    def __init__(self, controller: Controller) -> None:
        self.controller = controller
        self._command = bytes(2 * gm.COMMAND_WORDS)

    def read(self, address: int, count: int, t_ns: int) -> bytes:
        """Holding registers. Raises Refused."""
        if (address, count) == STATUS:
            return self.controller.status(t_ns)
        if (address, count) == HISTORY:
            return self.controller.history(t_ns)
        if (address, count) == COMMAND:
            return self._command
        first, last = STATIC[0], STATIC[0] + STATIC[1]  # it does not change, so it may be read in parts
        if first <= address < address + count <= last:
            return self.controller.static()[2 * (address - first) : 2 * (address - first + count)]
        raise Refused(Refusal.ILLEGAL_ADDRESS)

    def read_input(self, address: int, count: int, t_ns: int) -> bytes:
        """Input registers: the status record alone. Raises Refused."""
        if (address, count) != STATUS:
            raise Refused(Refusal.ILLEGAL_ADDRESS)
        return self.controller.status(t_ns)

    def write(self, address: int, data: bytes, t_ns: int) -> None:
        """Holding registers. Raises Refused."""
        if (address, len(data) // 2) == COMMAND:
            self._command = data
            self.controller.command(data, t_ns)
        elif (address, len(data) // 2) == STATIC:
            self._write_static(data, t_ns)
        else:
            raise Refused(Refusal.ILLEGAL_ADDRESS)

    def _write_static(self, data: bytes, t_ns: int) -> None:
        """Locked while enabled; otherwise it takes what it holds already, for this controller has nothing to set."""
        self.controller.advance(t_ns)
        if self.controller.enabled:
            raise Refused(Refusal.BUSY)
        if data != self.controller.static():
            raise Refused(Refusal.ILLEGAL_VALUE)
