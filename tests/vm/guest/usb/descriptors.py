"""Descriptors of a stereo camera: USB Video Class 1.1 with one MJPEG format, and HID interfaces beside it.

Names of fields are those of the specifications: USB 2.0 chapter 9, UVC 1.1 chapter 3, HID 1.11 chapter 6.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

VIDEO_CLASS, HID_CLASS = 0x0E, 0x03
INTERFACE, ENDPOINT, HID, CS_INTERFACE = 0x04, 0x05, 0x21, 0x24
REPORT = 0x22

VIDEO_ENDPOINT = 0x81
CAMERA_TERMINAL, PROCESSING_UNIT = 1, 2
VIDEO_CONTROL, VIDEO_STREAMING = 0, 1
# So many bytes of a frame, with two of header, go into one transfer: one of the driver's buffers, 32 packets
# of 512.
PAYLOAD_BYTES = 16384
CLOCK_HZ = 48_000_000

# The e-con Tara tells its two HID interfaces apart by the length of these: 29 bytes for control, 23 for the
# IMU.
_HEAD = "0600ff 0901 a101 1901 2940 1500 26ff00 7508 9540 8100"
CONTROL_REPORTS = bytes.fromhex(_HEAD + "1901 2940 9100 c0")
IMU_REPORTS = bytes.fromhex(_HEAD + "c0")
HID_CONTROL, HID_IMU = 2, 3


@dataclass(frozen=True)
class Mode:
    """Size and rate of the camera's one video mode."""

    width: int
    height: int
    rate_hz: float

    @property
    def interval(self) -> int:
        """Time from frame to frame, in the 100 ns of the UVC specification."""
        return round(1e7 / self.rate_hz)

    @property
    def max_frame_bytes(self) -> int:
        """Room for a frame in the driver's buffers."""
        return self.width * self.height * 2


def descriptor(kind: int, layout: str, *fields: int) -> bytes:
    """A descriptor: its length, its type and its fields, packed by a struct layout."""
    body = struct.pack("<" + layout, *fields)
    return bytes([len(body) + 2, kind]) + body


def interface(number: int, endpoints: int, class_: int, subclass: int) -> bytes:
    return descriptor(INTERFACE, "7B", number, 0, endpoints, class_, subclass, 0, 0)


def endpoint(address: int, attributes: int, packet_bytes: int, interval: int) -> bytes:
    return descriptor(ENDPOINT, "BBHB", address, attributes, packet_bytes, interval)


def video_control() -> bytes:
    """A sensor with exposure, a processing unit with brightness, an output to USB."""
    auto_exposure_and_exposure_time, brightness = 0x0A, 0x01
    sensor, usb_stream = 0x0201, 0x0101
    fields = (2, CAMERA_TERMINAL, sensor, 0, 0, 0, 0, 0, 3, auto_exposure_and_exposure_time, 0, 0)
    units = descriptor(CS_INTERFACE, "BBHBBHHHBBBB", *fields)
    units += descriptor(CS_INTERFACE, "BBBHBHBB", 5, PROCESSING_UNIT, CAMERA_TERMINAL, 0, 2, brightness, 0, 0)
    units += descriptor(CS_INTERFACE, "BBHBBB", 3, 3, usb_stream, 0, PROCESSING_UNIT, 0)
    header = descriptor(CS_INTERFACE, "BHHIBB", 1, 0x0110, 13 + len(units), CLOCK_HZ, 1, VIDEO_STREAMING)
    return interface(VIDEO_CONTROL, 0, VIDEO_CLASS, 1) + header + units


def video_streaming(mode: Mode) -> bytes:
    """One MJPEG format of one size and rate, over a bulk endpoint, as cameras with a Cypress FX3 have it."""
    bits_per_s = min(mode.max_frame_bytes * 8 * round(mode.rate_hz), 2**32 - 1)
    formats = descriptor(CS_INTERFACE, "9B", 6, 1, 1, 1, 1, 0, 0, 0, 0)
    size = (mode.width, mode.height, bits_per_s, bits_per_s, mode.max_frame_bytes)
    formats += descriptor(CS_INTERFACE, "BBBHHIIIIBI", 7, 1, 0, *size, mode.interval, 1, mode.interval)
    formats += descriptor(CS_INTERFACE, "4B", 0x0D, 1, 1, 4)
    fields = (1, 1, 14 + len(formats), VIDEO_ENDPOINT, 0, 3, 0, 0, 0, 1, 0)
    header = descriptor(CS_INTERFACE, "BBHBBBBBBBB", *fields)
    bulk = endpoint(VIDEO_ENDPOINT, 2, 512, 0)
    return interface(VIDEO_STREAMING, 1, VIDEO_CLASS, 2) + header + formats + bulk


def hid(number: int, reports: bytes, *endpoints: int) -> bytes:
    """An interface of 64-byte reports without numbers."""
    head = interface(number, len(endpoints), HID_CLASS, 0)
    head += descriptor(HID, "HBBBH", 0x0111, 0, 1, REPORT, len(reports))
    return head + b"".join(endpoint(address, 3, 64, 4) for address in endpoints)


def configuration(mode: Mode) -> bytes:
    """All interfaces of the camera."""
    association = descriptor(0x0B, "6B", VIDEO_CONTROL, 2, VIDEO_CLASS, 3, 0, 0)
    body = association + video_control() + video_streaming(mode)
    body += hid(HID_CONTROL, CONTROL_REPORTS, 0x82, 0x02) + hid(HID_IMU, IMU_REPORTS, 0x83)
    return descriptor(2, "HBBBBB", 9 + len(body), 4, 1, 0, 0x80, 250) + body


def device(vendor: int, product: int) -> bytes:
    """A device of several interfaces; its strings are 1 maker, 2 name, 3 serial number."""
    return descriptor(1, "HBBBBHHHBBBB", 0x0200, 0xEF, 2, 1, 64, vendor, product, 0x0100, 1, 2, 3, 1)


def string(text: str | None) -> bytes:
    """A string descriptor; None lists the one language, US English."""
    body = b"\x09\x04" if text is None else text.encode("utf-16-le")
    return bytes([len(body) + 2, 3]) + body
