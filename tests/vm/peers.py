"""What stands outside the VM in the test of the whole task: a camera, and a connection to the
agent inside.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import queue
import socket
import struct
import threading
import zlib
from typing import Any

import cv2
import numpy as np
from guest.usb.camera import Camera
from guest.usb.descriptors import Mode
from guest.usb.live import LiveVideo
from guest.usb.uvc import Frame
from whole_task.world import connect

Answer = dict[str, Any]

# Magic to layout, number, time, width and height, payload's length, both checksums: docs/frame-stream.md.
STREAM_HEADER = struct.Struct("<8sQQIIIII")
# High enough that the host's results differ little from those of the raw pixels.
JPEG_QUALITY = 92
ENDED = "the VM has ended"


def listen() -> socket.socket:
    """A listening socket; QEMU's user network shows this computer's loopback to the guest as 10.0.2.2."""
    return socket.create_server(("127.0.0.1", 0))


class Agent:
    """Asks the agent in the VM (guest/agent.py)."""

    def __init__(self, connection: socket.socket) -> None:
        self._connection = connection
        self._lines = connection.makefile("rw", encoding="utf-8")
        self._numbers = itertools.count()
        self._waiting: dict[int, queue.Queue[Answer]] = {}
        self._has_ended = False
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        with contextlib.suppress(OSError):
            for line in self._lines:
                answer = json.loads(line)
                self._waiting.pop(answer["id"]).put(answer)
        # Whoever waits learns at once that the VM is gone.
        self._has_ended = True
        for answers in list(self._waiting.values()):
            answers.put({"failure": ENDED})

    def ask(self, ask: str, limit_s: float = 60.0, **arguments: object) -> Answer:
        """The answer to one request."""
        number, answers = next(self._numbers), queue.Queue[Answer]()
        self._waiting[number] = answers
        if self._has_ended:
            raise RuntimeError(ENDED)
        self._lines.write(json.dumps({"id": number, "ask": ask, "arguments": arguments}) + "\n")
        self._lines.flush()
        answer = answers.get(timeout=limit_s)
        if "failure" in answer:
            raise RuntimeError(answer["failure"])
        return answer

    def close(self) -> None:
        """Ends the agent, and with it the VM, which may have ended before."""
        with contextlib.suppress(OSError):
            self._connection.shutdown(socket.SHUT_RDWR)
        self._reader.join()
        with contextlib.suppress(OSError):
            self._lines.close()
        self._connection.close()


class WorldCamera:
    """A USB camera that sends what the world shows, as JPEG."""

    def __init__(self, mode: Mode, serial: str, link: socket.socket) -> None:
        self.sent: dict[int, int] = {}
        """Number of the world's frame by the CRC-32 of the JPEG file."""
        self._camera = Camera(0, serial, mode, [])
        self._video = LiveVideo(mode)
        self._camera.video = self._video
        self._camera.serve(link)

    def unplug(self) -> None:
        """Pulls the camera's plug, as the VM sees it."""
        self._camera.unplug_link()

    def film(self, address: str) -> None:
        """Sends the frames of this world from now on, until it ends."""
        threading.Thread(target=self._film, args=(address,), daemon=True).start()

    def _film(self, address: str) -> None:
        with connect(address) as world, world.makefile("rb") as stream:
            world.settimeout(None)
            world.sendall(b'{"ask":"frames"}\n')
            while len(header := stream.read(STREAM_HEADER.size)) == STREAM_HEADER.size:
                _, number, _, width, height, length, _, _ = STREAM_HEADER.unpack(header)
                pixels = stream.read(length)
                if len(pixels) < length:
                    break
                image = np.frombuffer(pixels, np.uint8).reshape(height, width)
                # A camera's JPEG is in colour.
                colour = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
                _, encoded = cv2.imencode(".jpg", colour, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
                jpeg = encoded.tobytes()
                self.sent[zlib.crc32(jpeg)] = number
                self._video.show(Frame(jpeg))
