"""Controls of a video device by their names, for the faults that the kernel's driver vivid makes
on request.
"""

from __future__ import annotations

import fcntl
import os
import struct
from pathlib import Path

QUERY = struct.Struct("<II32siiiiI8x")
CONTROL = struct.Struct("<Ii")
NEXT_CONTROL = 0x80000000


def request(number: int, size: int) -> int:
    """``_IOWR('V', number, size)`` of the kernel's headers."""
    return (3 << 30) | (size << 16) | (ord("V") << 8) | number


QUERY_CONTROL = request(36, QUERY.size)
SET_CONTROL = request(28, CONTROL.size)


def set_control(node: Path, name: str, value: int) -> None:
    """Sets a control by its name; a button is pressed by any value."""
    file = os.open(node, os.O_RDWR)
    try:
        fcntl.ioctl(file, SET_CONTROL, CONTROL.pack(controls(file)[name], value))
    finally:
        os.close(file)


def controls(file: int) -> dict[str, int]:
    """Names of all controls with their numbers."""
    found: dict[str, int] = {}
    identity = 0
    while True:
        query = QUERY.pack(identity | NEXT_CONTROL, 0, b"", 0, 0, 0, 0, 0)
        try:
            answer = QUERY.unpack(fcntl.ioctl(file, QUERY_CONTROL, query))
        except OSError:
            return found
        identity = answer[0]
        found[answer[2].rstrip(b"\0").decode()] = identity
