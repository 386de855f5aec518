"""The HID control function of an e-con Tara: 64-byte reports, as its maker's published SDK exchanges them."""

from __future__ import annotations

import queue
import struct
from dataclasses import dataclass, field

from guest.usb.usbip import Detached, Port

REPORT_BYTES = 64
IN_ENDPOINT, OUT_ENDPOINT = 0x82, 0x02
CAMERA = 0x78
DATA_BYTES = 56


@dataclass
class Tara:
    """State of the camera behind the reports, and faults for tests."""

    exposure_us: int = 8000
    stream_mode: int = 1
    hdr: int = 0
    calibration: tuple[bytes, bytes] = (b"%YAML:1.0\nintrinsic\n", b"%YAML:1.0\nextrinsic\n")
    requests: list[bytes] = field(default_factory=list)
    noise: int = 0
    """So many reports that nobody asked for come before each answer."""
    refuse: bool = False
    """Every answer says that the command failed."""
    silent: bool = False
    """No command is answered."""
    answers: queue.Queue[bytes] = field(default_factory=queue.Queue)

    def received(self, report: bytes) -> None:
        """Takes a command and queues what answers it."""
        self.requests.append(report)
        if self.silent:
            return
        for number in range(self.noise):
            self.answers.put(bytes([CAMERA, 0x06, number]).ljust(REPORT_BYTES, b"\xfe"))
        for answer in self._answers(report):
            self.answers.put(answer.ljust(REPORT_BYTES, b"\0"))

    def _answers(self, report: bytes) -> list[bytes]:
        ok = 0 if self.refuse else 1
        if report[0] == 0x40:
            return [struct.pack(">BBBHH", 0x40, 1, 2, 3, 260)]
        if report[0] == 0x41:
            return [struct.pack(">BI", 0x41, 0xC0FFEE01)]
        if report[0] != CAMERA:
            return []
        command, argument = report[1], report[2]
        if command == 0x02 and ok:
            self.exposure_us = struct.unpack_from(">I", report, 2)[0]
        if command == 0x0B and ok:
            self.stream_mode = argument
        if command == 0x0E and ok:
            self.hdr = argument
        if command in (0x01, 0x02):
            return [struct.pack(">BBI4xB", CAMERA, command, self.exposure_us, ok)]
        if command in (0x0B, 0x0C):
            return [bytes([CAMERA, command, self.stream_mode, 0, ok])]
        if command in (0x0E, 0x0F):
            return [bytes([CAMERA, command, self.hdr, 0, ok])]
        if command == 0x09:
            return [struct.pack(">BB5xH6xB", CAMERA, command, len(self.calibration[argument]), ok)]
        if command == 0x0A:
            return self._file(self.calibration[argument], ok)
        return []

    def _file(self, data: bytes, ok: int) -> list[bytes]:
        packets = range(0, len(data), DATA_BYTES)
        return [
            struct.pack(">BB3xHB", CAMERA, 0x0A, number, ok) + data[start : start + DATA_BYTES]
            for number, start in enumerate(packets, start=1)
        ]

    def send_for_ever(self, port: Port) -> None:
        """Sends answers until the device is unplugged."""
        while port.attached:
            try:
                answer = self.answers.get(timeout=0.2)
                # A reader that closed its file has taken its request back.
                while not port.send(port.wanted(IN_ENDPOINT), answer):
                    pass
            except queue.Empty:
                continue
            except Detached:
                return
