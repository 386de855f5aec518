"""A camera whose frames come from elsewhere, each sent once and at once."""

from __future__ import annotations

import queue
from collections.abc import Sequence
from contextlib import suppress

from guest.usb.descriptors import Mode
from guest.usb.usbip import Detached, Port
from guest.usb.uvc import Frame, Video


class LiveVideo(Video):
    """Sends what was given to `show` last; a frame that nobody has fetched yet is replaced by the next."""

    def __init__(self, mode: Mode, frames: Sequence[Frame] = ()) -> None:
        super().__init__(mode, frames)
        self._next: queue.Queue[Frame] = queue.Queue(maxsize=1)

    def show(self, frame: Frame) -> None:
        with suppress(queue.Empty):
            self._next.get_nowait()
        self._next.put(frame)

    def send_for_ever(self, port: Port) -> None:
        toggle = 0
        with suppress(Detached):
            while port.attached:
                with suppress(queue.Empty):
                    frame = self._next.get(timeout=0.2)
                    toggle ^= 1
                    self._send(port, frame, toggle)
