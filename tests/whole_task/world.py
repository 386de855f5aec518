"""A connection to the world server (firmware-host/examples/world_server.rs)."""

from __future__ import annotations

import json
import socket
from typing import Any

Answer = dict[str, Any]


def connect(address: str) -> socket.socket:
    """A connection to ``HOST:PORT``."""
    host, port = address.rsplit(":", 1)
    connection = socket.create_connection((host, int(port)), timeout=20.0)
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return connection


class World:
    """Asks the world server one question after the other."""

    def __init__(self, address: str) -> None:
        with connect(address) as connection:
            # The file keeps the connection open.
            self._lines = connection.makefile("rw", encoding="utf-8")

    def close(self) -> None:
        """Closes the connection."""
        self._lines.close()

    def ask(self, ask: str, **arguments: object) -> Answer:
        """The answer to one request; the server's source lists them."""
        self._lines.write(json.dumps({"ask": ask, **arguments}) + "\n")
        self._lines.flush()
        line = self._lines.readline()
        if not line:
            raise ConnectionError("the world server has gone")
        answer: Answer = json.loads(line)
        if "error" in answer:
            raise ValueError(answer["error"])
        return answer
