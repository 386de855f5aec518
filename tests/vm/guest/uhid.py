"""HID devices made in user space by the kernel's ``/dev/uhid``: the kernel's own drivers bind to them."""

from __future__ import annotations

import os
import struct
import threading
from dataclasses import dataclass, field

DESTROY, OUTPUT, GET_REPORT, GET_REPORT_REPLY, CREATE2, SET_REPORT, SET_REPORT_REPLY = 1, 6, 9, 10, 11, 13, 14
CREATE = struct.Struct("<I128s64s64sHHIIII4096s")
EVENT_BYTES = 4380
USB_BUS = 3
BLINK1_VENDOR, BLINK1_PRODUCT = 0x27B8, 0x01ED
# Feature reports: number 1 of 8 bytes, number 2 of 60 bytes, on a page of the maker's own.
BLINK1_REPORTS = bytes.fromhex(
    "0600ff 0901 a101 1500 26ff00 7508 8501 9508 0900 b202 01 8502 953c 0900 b202 01 c0"
)
VERSION = (b"3", b"3")


@dataclass
class Blink1:
    """A blink(1) mk3: keeps every feature report that it is sent."""

    serial: str
    reports: list[bytes] = field(default_factory=list)
    color: tuple[int, int, int] = (0, 0, 0)

    def plug(self) -> None:
        """Makes the device."""
        self._file = os.open("/dev/uhid", os.O_RDWR)
        os.write(
            self._file,
            CREATE.pack(
                *(CREATE2, b"blink(1) mk3", b"", self.serial.encode(), len(BLINK1_REPORTS)),
                *(USB_BUS, BLINK1_VENDOR, BLINK1_PRODUCT, 0x0101, 0, BLINK1_REPORTS),
            ),
        )
        threading.Thread(target=self._serve, daemon=True).start()

    def unplug(self) -> None:
        """Removes the device."""
        os.write(self._file, struct.pack("<I", DESTROY))
        os.close(self._file)

    def _serve(self) -> None:
        try:
            while True:
                event = os.read(self._file, EVENT_BYTES)
                kind = struct.unpack_from("<I", event)[0]
                if kind == SET_REPORT:
                    identity, _, _, size = struct.unpack_from("<IBBH", event, 4)
                    self._received(event[12 : 12 + size])
                    os.write(self._file, struct.pack("<IIH", SET_REPORT_REPLY, identity, 0))
                elif kind == GET_REPORT:
                    (identity,) = struct.unpack_from("<I", event, 4)
                    answer = self._answer()
                    reply = struct.pack("<IIHH4096s", GET_REPORT_REPLY, identity, 0, len(answer), answer)
                    os.write(self._file, reply)
        except OSError:
            return

    def _received(self, report: bytes) -> None:
        self.reports.append(report)
        if report[1:2] in (b"c", b"n"):
            self.color = (report[2], report[3], report[4])

    def _answer(self) -> bytes:
        """The last command with its answer filled in."""
        report = bytearray((self.reports[-1] if self.reports else b"\x01").ljust(9, b"\0"))
        if report[1:2] == b"v":
            report[3:5] = b"".join(VERSION)
        elif report[1:2] == b"r":
            report[2:5] = bytes(self.color)
        return bytes(report)
