"""A port of the kernel's virtual USB host controller, and the requests that come through it.

The kernel's driver ``vhci_hcd`` speaks the USB/IP protocol over any stream socket that is handed to it, so
one end of a socket pair is plugged in and this module answers at the other end. No network and no ``usbip``
program is involved. The protocol is described in the kernel's Documentation/usb/usbip_protocol.rst.
"""

from __future__ import annotations

import queue
import socket
import struct
import threading
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

CONTROLLER = Path("/sys/devices/platform/vhci_hcd.0")
SUBMIT, UNLINK, SUBMITTED, UNLINKED = 1, 2, 3, 4
HEADER = struct.Struct(">IIIII")
SUBMIT_BODY = struct.Struct(">IiIII8s")
SUBMITTED_BODY = struct.Struct(">iiIIIQ")
UNLINK_BODY = struct.Struct(">I24x")
UNLINKED_BODY = struct.Struct(">i24x")
HIGH_SPEED = 3
DEVICE_ID = 0x10001
STALL = -32  # EPIPE: the request is refused
ABORTED = -104  # ECONNRESET: the request was still waiting when it was taken back


@dataclass(frozen=True)
class Setup:
    """The eight bytes that start a control request."""

    request_type: int
    request: int
    value: int
    index: int
    length: int


@dataclass(frozen=True)
class Request:
    """A transfer that the kernel asks for (a URB)."""

    number: int
    endpoint: int
    """Address, with 0x80 for transfers to the host."""
    length: int
    data: bytes


class Device(Protocol):
    """What is plugged into a port."""

    def control(self, setup: Setup, data: bytes) -> bytes | None:
        """Answers a control request; None refuses it."""

    def received(self, endpoint: int, data: bytes) -> None:
        """Takes what the host sent to an endpoint."""


def attach(number: int, kernel_end: socket.socket) -> None:
    """Plugs the other end of a socket into a port of this computer's controller, which keeps the socket."""
    order = f"{number} {kernel_end.fileno()} {DEVICE_ID} {HIGH_SPEED}"
    (CONTROLLER / "attach").write_text(order, encoding="ascii")


class Detached(Exception):
    """The device was unplugged."""


class Port:
    """One port of the controller with a device in it, until `detach`.

    With a `link` the controller is on another computer, which holds the link's other end and attaches it.
    """

    def __init__(self, device: Device, number: int, link: socket.socket | None = None) -> None:
        self.number = number
        self._is_local = link is None
        self._device = device
        self._lock = threading.Lock()
        self._waiting: set[int] = set()
        self._queues: dict[int, queue.Queue[Request | None]] = {}
        self._detached = threading.Event()
        kernel_end = None
        if link is None:
            link, kernel_end = socket.socketpair(socket.AF_UNIX, socket.SOCK_STREAM)
        self._socket = link
        threading.Thread(target=self._serve, name=f"port {number}", daemon=True).start()
        if kernel_end is not None:
            attach(number, kernel_end)
            kernel_end.close()

    @property
    def attached(self) -> bool:
        """Whether the device is plugged in."""
        return not self._detached.is_set()

    def detach(self) -> None:
        """Unplugs the device."""
        if self.attached and not self._is_local:
            self._socket.shutdown(socket.SHUT_RDWR)
            self._detached.wait(10)
        elif self.attached:
            (CONTROLLER / "detach").write_text(str(self.number), encoding="ascii")
            self._detached.wait(10)

    def wanted(self, endpoint: int) -> Request:
        """Waits until the host wants data from an endpoint."""
        waiting = self._queue(endpoint)
        while True:
            request = waiting.get()
            if request is None or self._detached.is_set():
                raise Detached
            with self._lock:
                if request.number in self._waiting:
                    return request

    def send(self, request: Request, data: bytes) -> bool:
        """Answers what `wanted` gave; False if the host has taken the request back."""
        return self._complete(request, 0, data, len(data))

    def _complete(self, request: Request, status: int, data: bytes, length: int) -> bool:
        header = HEADER.pack(SUBMITTED, request.number, 0, 0, 0)
        body = SUBMITTED_BODY.pack(status, length, 0, 0, 0, 0)
        with self._lock:
            # A request that was taken back must never be answered.
            if request.number not in self._waiting:
                return False
            self._waiting.discard(request.number)
            try:
                self._socket.sendall(header + body + data)
            except OSError as error:
                raise Detached from error
        return True

    def _queue(self, endpoint: int) -> queue.Queue[Request | None]:
        with self._lock:
            return self._queues.setdefault(endpoint, queue.Queue())

    def _serve(self) -> None:
        try:
            while True:
                self._next_command()
        except (Detached, OSError):
            self._detached.set()
            self._socket.close()
            with self._lock:
                queues = list(self._queues.values())
            for waiting in queues:
                waiting.put(None)

    def _next_command(self) -> None:
        command, number, _, to_host, endpoint = HEADER.unpack(self._read(HEADER.size))
        if command == UNLINK:
            self._unlink(number, UNLINK_BODY.unpack(self._read(UNLINK_BODY.size))[0])
            return
        _, length, _, _, _, packed = SUBMIT_BODY.unpack(self._read(SUBMIT_BODY.size))
        data = b"" if to_host else self._read(length)
        request = Request(number, endpoint | (0x80 if to_host else 0), length, data)
        with self._lock:
            self._waiting.add(number)
        if endpoint == 0:
            self._control(request, Setup(*struct.unpack("<BBHHH", packed)), bool(to_host))
        elif to_host:
            self._queue(request.endpoint).put(request)
        else:
            self._complete(request, 0, b"", length)
            self._device.received(endpoint, data)

    def _control(self, request: Request, setup: Setup, to_host: bool) -> None:
        answer = self._device.control(setup, request.data)
        if answer is None:
            self._complete(request, STALL, b"", 0)
        elif to_host:
            answer = answer[: setup.length]
            self._complete(request, 0, answer, len(answer))
        else:
            self._complete(request, 0, b"", request.length)

    def _unlink(self, number: int, victim: int) -> None:
        with self._lock:
            status = ABORTED if victim in self._waiting else 0
            self._waiting.discard(victim)
            self._socket.sendall(HEADER.pack(UNLINKED, number, 0, 0, 0) + UNLINKED_BODY.pack(status))

    def _read(self, length: int) -> bytes:
        data = bytearray()
        while len(data) < length:
            part = self._socket.recv(length - len(data))
            if not part:
                raise Detached
            data += part
        return bytes(data)
