"""USB3 Vision cameras as the bus sees them, without claiming them: port, negotiated speed, permission.

A camera is an interface of class EFh, subclass 05h, protocol 00h (USB3 Vision 1.1, 'control'). The camera library owns the
device; nothing here opens an interface.
"""

from dataclasses import dataclass
from typing import Any

import usb.core
import usb.util

MISCELLANEOUS, USB3_VISION, CONTROL = 0xEF, 0x05, 0x00
SUPER_SPEED = 4  # libusb's number; super-speed-plus is above it


@dataclass(frozen=True, slots=True)
class UsbCamera:
    vendor_id: int
    product_id: int
    port: str  # bus-port.port..., as in /sys/bus/usb/devices
    speed: int | None  # libusb's number
    serial: str | None  # None: no permission to read it

    @property
    def fell_back(self) -> bool:
        """It negotiated less than USB 3: a cable, a hub or a port that cannot."""
        return self.speed is not None and self.speed < SUPER_SPEED


class NoUsb(Exception):
    """libusb is not installed."""


def cameras(backend: Any = None) -> list[UsbCamera]:
    """Every USB3 Vision camera that is connected. Raises NoUsb without libusb."""
    try:
        found = usb.core.find(find_all=True, custom_match=_is_camera, backend=backend)
        return [_camera(device) for device in found]
    except usb.core.NoBackendError as error:
        raise NoUsb("libusb-1.0 is not installed") from error


def _is_camera(device: Any) -> bool:
    return any(
        (i.bInterfaceClass, i.bInterfaceSubClass, i.bInterfaceProtocol) == (MISCELLANEOUS, USB3_VISION, CONTROL)
        for configuration in device
        for i in configuration
    )


def _camera(device: Any) -> UsbCamera:
    ports = ".".join(str(port) for port in device.port_numbers or ())
    return UsbCamera(device.idVendor, device.idProduct, f"{device.bus}-{ports}", device.speed, _serial(device))


def _serial(device: Any) -> str | None:
    try:
        serial: str | None = usb.util.get_string(device, device.iSerialNumber)
    except (usb.core.USBError, ValueError, NotImplementedError):
        return None
    return serial
