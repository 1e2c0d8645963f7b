"""USB3 Vision cameras on a bus in memory: a pyusb backend that hands out descriptors."""

from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import pytest
import usb.backend
import usb.core

from drivers.usb import vision
from drivers.usb.vision import NoUsb, UsbCamera, cameras

SERIAL = 3  # index of the string descriptor
VISION, MOUSE = (0xEF, 0x05, 0x00), (0x03, 0x01, 0x02)


class Bus(usb.backend.IBackend):
    """Devices as (vendor, product, speed, interface class, may be opened)."""

    def __init__(self, *devices: tuple[int, int, int, tuple[int, int, int], bool]) -> None:
        super().__init__()
        self.devices = devices
        self.claimed = 0

    def enumerate_devices(self) -> Iterator[int]:
        return iter(range(len(self.devices)))

    def get_device_descriptor(self, dev: int) -> Any:
        vendor, product, speed, _, _ = self.devices[dev]
        return SimpleNamespace(
            bLength=18, bDescriptorType=1, bcdUSB=0x300, bDeviceClass=0xEF, bDeviceSubClass=2, bDeviceProtocol=1,
            bMaxPacketSize0=9, idVendor=vendor, idProduct=product, bcdDevice=0, iManufacturer=1, iProduct=2,
            iSerialNumber=SERIAL, bNumConfigurations=1, address=dev, bus=2, port_number=dev + 1,
            port_numbers=(1, dev + 1), speed=speed,
        )  # fmt: skip

    def get_configuration_descriptor(self, dev: int, config: int) -> Any:
        return SimpleNamespace(
            bLength=9, bDescriptorType=2, wTotalLength=18, bNumInterfaces=1, bConfigurationValue=1, iConfiguration=0,
            bmAttributes=0x80, bMaxPower=100, extra_descriptors=[],
        )  # fmt: skip

    def get_interface_descriptor(self, dev: int, intf: int, alt: int, config: int) -> Any:
        if alt:
            raise IndexError
        kind, sub, protocol = self.devices[dev][3]
        return SimpleNamespace(
            bLength=9, bDescriptorType=4, bInterfaceNumber=0, bAlternateSetting=0, bNumEndpoints=0, bInterfaceClass=kind,
            bInterfaceSubClass=sub, bInterfaceProtocol=protocol, iInterface=0, extra_descriptors=[],
        )  # fmt: skip

    def open_device(self, dev: int) -> int:
        if not self.devices[dev][4]:
            raise usb.core.USBError("Access denied (insufficient permissions)", -3, 13)
        return dev

    def close_device(self, dev_handle: int) -> None:
        pass

    def claim_interface(self, dev_handle: int, intf: int) -> None:
        self.claimed += 1

    def ctrl_transfer(self, dev_handle: int, *request: Any) -> int:
        """String descriptors: the languages, then the serial number."""
        index, data = request[2], request[4]
        text = b"\x09\x04" if index & 0xFF == 0 else "24587345".encode("utf-16-le")
        answer = bytes([len(text) + 2, 3]) + text
        data[: len(answer)] = type(data)("B", answer)
        return len(answer)


def test_a_camera_at_full_speed_tells_its_port_and_serial() -> None:
    bus = Bus((0x2676, 0xBA02, 4, VISION, True))
    assert cameras(bus) == [UsbCamera(0x2676, 0xBA02, "2-1.1", 4, "24587345")]
    assert not cameras(bus)[0].fell_back


def test_any_makers_camera_is_found_by_its_class_and_nothing_else_is() -> None:
    found = cameras(Bus((0x046D, 0xC077, 2, MOUSE, True), (0x1E10, 0x4000, 5, VISION, True)))
    assert [(camera.vendor_id, camera.port, camera.fell_back) for camera in found] == [(0x1E10, "2-1.2", False)]


def test_a_camera_behind_a_usb_2_cable_fell_back() -> None:
    [found] = cameras(Bus((0x2676, 0xBA02, 3, VISION, True)))
    assert found.fell_back


def test_a_camera_that_may_not_be_opened_has_no_serial() -> None:
    [found] = cameras(Bus((0x2676, 0xBA02, 4, VISION, False)))
    assert (found.serial, found.speed) == (None, 4)


def test_looking_claims_nothing() -> None:
    bus = Bus((0x2676, 0xBA02, 4, VISION, True))
    cameras(bus)
    assert bus.claimed == 0


def test_an_empty_bus_has_no_cameras() -> None:
    assert cameras(Bus()) == []


def test_without_libusb_it_is_told_in_words(monkeypatch: pytest.MonkeyPatch) -> None:
    def find(**_: Any) -> None:
        raise usb.core.NoBackendError("No backend available")

    monkeypatch.setattr(vision.usb.core, "find", find)
    with pytest.raises(NoUsb, match=r"libusb-1\.0 is not installed"):
        cameras()
