"""A TCP line of JSON requests whose answers take their time."""

from __future__ import annotations

import json
import socket
import threading
import time
from contextlib import suppress
from dataclasses import dataclass


@dataclass(frozen=True)
class Request:
    """One line of the client, and when it came, on the clock of ``time.monotonic_ns``."""

    time_ns: int
    name: str


class SlowLine:
    """Listens on `port` and passes all on to ``127.0.0.1:target``; each answer is held back for `delay_s`."""

    def __init__(self, target: int, delay_s: float) -> None:
        self.requests: list[Request] = []
        self._target, self._delay_s = target, delay_s
        self._server = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._server.getsockname()[1]
        threading.Thread(target=self._accept, daemon=True).start()

    def close(self) -> None:
        self._server.close()

    def _accept(self) -> None:
        with suppress(OSError):
            while True:
                client, _ = self._server.accept()
                device = socket.create_connection(("127.0.0.1", self._target))
                for side in (client, device):
                    side.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                threading.Thread(target=self._ask, args=(client, device), daemon=True).start()
                threading.Thread(target=self._answer, args=(client, device), daemon=True).start()

    def _ask(self, client: socket.socket, device: socket.socket) -> None:
        with suppress(OSError, ValueError), client.makefile("r") as lines:
            for line in lines:
                self.requests.append(Request(time.monotonic_ns(), json.loads(line)["request"]))
                device.sendall(line.encode())
        with suppress(OSError):
            device.shutdown(socket.SHUT_RDWR)

    def _answer(self, client: socket.socket, device: socket.socket) -> None:
        with suppress(OSError), device.makefile("r") as lines:
            for line in lines:
                time.sleep(self._delay_s)
                client.sendall(line.encode())
        with suppress(OSError):
            client.shutdown(socket.SHUT_RDWR)
