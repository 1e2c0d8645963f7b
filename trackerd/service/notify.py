"""systemd's notify protocol: one datagram a message (sd_notify(3)). Without NOTIFY_SOCKET it says nothing."""

import logging
import os
import socket
from dataclasses import dataclass

log = logging.getLogger("trackerd.notify")


@dataclass(frozen=True, slots=True)
class Notifier:
    address: str | None

    @classmethod
    def from_environment(cls) -> "Notifier":
        return cls(os.environ.get("NOTIFY_SOCKET") or None)

    def ready(self, status: str) -> None:
        self._send(f"READY=1\nSTATUS={status}")

    def status(self, status: str) -> None:
        self._send(f"STATUS={status}")

    def watchdog(self) -> None:
        self._send("WATCHDOG=1")

    def stopping(self) -> None:
        self._send("STOPPING=1\nSTATUS=holding the axes, closing")

    def _send(self, message: str) -> None:
        if self.address is None:
            return
        address = "\0" + self.address[1:] if self.address.startswith("@") else self.address
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC | socket.SOCK_NONBLOCK) as out:
                out.connect(address)
                out.send(message.encode())
        except OSError as error:  # nobody listens, or not fast enough: no reason to stop measuring
            log.warning("NOTIFY_SOCKET %s: %s", self.address, error)


def watchdog_period_s() -> float | None:
    """How often systemd wants to hear WATCHDOG=1 at least, or None."""
    period_us = os.environ.get("WATCHDOG_USEC")
    mine = os.environ.get("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
    return int(period_us) * 1e-6 if period_us and mine else None
