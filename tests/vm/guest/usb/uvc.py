"""The video function of a USB camera: its controls, and frames sent at the camera's rate."""

from __future__ import annotations

import math
import struct
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, field

from guest.usb.descriptors import (
    CAMERA_TERMINAL,
    CLOCK_HZ,
    PAYLOAD_BYTES,
    PROCESSING_UNIT,
    VIDEO_CONTROL,
    VIDEO_ENDPOINT,
    VIDEO_STREAMING,
    Mode,
)
from guest.usb.usbip import Detached, Port, Setup

SET_CUR, GET_CUR, GET_MIN, GET_MAX, GET_RES, GET_LEN, GET_INFO, GET_DEF = (
    1,
    0x81,
    0x82,
    0x83,
    0x84,
    0x85,
    0x86,
    0x87,
)
PROBE, COMMIT = 1, 2
END_OF_HEADER, ERROR, END_OF_FRAME = 0x80, 0x40, 0x02


@dataclass
class Control:
    """A setting of the camera, as the host writes and reads it."""

    layout: str
    value: int
    least: int
    greatest: int
    default: int
    writes: list[int] = field(default_factory=list)

    def answer(self, request: int) -> bytes | None:
        values = {
            GET_CUR: self.value,
            GET_MIN: self.least,
            GET_MAX: self.greatest,
            GET_RES: 1,
            GET_DEF: self.default,
        }
        if request == GET_INFO:
            return b"\x03"
        if request == GET_LEN:
            return struct.pack("<H", struct.calcsize(self.layout))
        return struct.pack(self.layout, values[request]) if request in values else None

    def write(self, data: bytes) -> None:
        self.value = struct.unpack(self.layout, data)[0]
        self.writes.append(self.value)


@dataclass(frozen=True)
class Frame:
    """What the camera sends as one frame: any bytes, with or without the mark that says they are damaged."""

    data: bytes
    error: bool = False


class Video:
    """Answers requests to the video interfaces, and sends `frames` again and again while the host listens."""

    def __init__(self, mode: Mode, frames: Sequence[Frame]) -> None:
        self.mode = mode
        self.frames = frames
        """What is sent; may be replaced at any time."""
        self.flowing = threading.Event()
        """Cleared, the camera sends nothing but stays plugged in."""
        self.flowing.set()
        self.in_step = False
        """Whether the clock decides which frame is next, so that cameras in step show the same moment."""
        self.phase_s = 0.0
        """Delay of this camera's frames behind the clock's ticks."""
        self.sent: list[int] = []
        """Which of `frames` were sent, in their order."""
        # A bitmap: 1 manual, 8 aperture priority. Only manual takes an exposure time.
        self.auto_exposure = Control("<B", 8, 1, 9, 8)
        self.exposure = Control("<I", 80, 1, 10000, 80)
        self.brightness = Control("<H", 128, 0, 255, 128)
        self._controls = {
            (CAMERA_TERMINAL, 2): self.auto_exposure,
            (CAMERA_TERMINAL, 4): self.exposure,
            (PROCESSING_UNIT, 2): self.brightness,
        }
        self._commits = 0

    def control(self, setup: Setup, data: bytes) -> bytes | None:
        """Answers a class request to one of the video interfaces."""
        number, selector = setup.index & 0xFF, setup.value >> 8
        if number == VIDEO_STREAMING and selector in (PROBE, COMMIT):
            return self._negotiate(setup.request, selector)
        control = self._controls.get((setup.index >> 8, selector))
        if number != VIDEO_CONTROL or control is None:
            return None
        if setup.request == SET_CUR:
            control.write(data)
            return b""
        return control.answer(setup.request)

    def _negotiate(self, request: int, selector: int) -> bytes | None:
        if request == SET_CUR:
            # There is one mode, so every proposal ends there; a commit starts a stream.
            self._commits += selector == COMMIT
            return b""
        if request == GET_INFO:
            return b"\x03"
        parameters = struct.pack(
            "<HBBIHHHHHIIIBBBB",
            *(1, 1, 1, self.mode.interval, 0, 0, 0, 0, 0),
            *(self.mode.max_frame_bytes, PAYLOAD_BYTES, CLOCK_HZ, 0, 0, 0, 0),
        )
        return struct.pack("<H", len(parameters)) if request == GET_LEN else parameters

    def send_for_ever(self, port: Port) -> None:
        """Sends frames until the device is unplugged; the thread that calls it ends then."""
        toggle, tick = 0, 0
        try:
            while True:
                # All cameras of one rate share one clock, as by a cable for synchronisation. A late one skips
                # ticks.
                tick = max(tick + 1, math.ceil((time.monotonic() - self.phase_s) * self.mode.rate_hz))
                time.sleep(max(0.0, tick / self.mode.rate_hz + self.phase_s - time.monotonic()))
                if self.flowing.wait(0.1):
                    toggle ^= 1
                    index = (tick if self.in_step else len(self.sent)) % len(self.frames)
                    self._send(port, self.frames[index], toggle)
                    self.sent.append(index)
        except Detached:
            return

    def _send(self, port: Port, frame: Frame, toggle: int) -> None:
        commits, start = self._commits, 0
        while start < len(frame.data):
            request = port.wanted(VIDEO_ENDPOINT)
            if commits != self._commits:
                # The stream was started again: the frame starts again with it.
                commits, start, toggle = self._commits, 0, toggle ^ 1
            end = start + min(request.length, PAYLOAD_BYTES) - 2
            flags = END_OF_HEADER | toggle | (ERROR if frame.error else 0)
            if end >= len(frame.data):
                flags |= END_OF_FRAME
            if port.send(request, bytes([2, flags]) + frame.data[start:end]):
                start = end
