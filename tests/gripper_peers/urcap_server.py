"""A Robotiq gripper behind the text protocol of the Robotiq Gripper URCap.

It has the registers of `modbus_server`'s 2F-85. No server of this protocol by others was found. pyrobotiqur,
a published client, drives this one in the tests as a check on it.

usage: urcap_server.py PORT [HELD]
The environment variable ANSWER_S is how long every answer takes.
"""

from __future__ import annotations

import os
import socketserver
import sys
import time

from modbus_server import TwoFinger85

ANSWER_S = float(os.environ.get("ANSWER_S", "0"))

# Register, lowest bit and mask of each variable of the command.
COMMAND = {
    "ACT": (0, 8, 1),
    "GTO": (0, 11, 1),
    "ATR": (0, 12, 1),
    "POS": (1, 0, 0xFF),
    "SPE": (2, 8, 0xFF),
    "FOR": (2, 0, 0xFF),
}
# The same of the status.
STATUS = {
    "STA": (0, 12, 3),
    "OBJ": (0, 14, 3),
    "PRE": (1, 0, 0xFF),
    "FLT": (1, 8, 0x0F),
    "POS": (2, 8, 0xFF),
}


class Urcap:
    """Answers lines."""

    def __init__(self, held: float | None) -> None:
        self.gripper = TwoFinger85(held)

    def answer(self, line: str) -> str:
        match line.split():
            case ["SET", *pairs] if pairs and len(pairs) % 2 == 0 and set(pairs[::2]) <= set(COMMAND):
                for name, value in zip(pairs[::2], pairs[1::2], strict=True):
                    register, shift, mask = COMMAND[name]
                    self.gripper.command[register] &= ~(mask << shift)
                    self.gripper.command[register] |= (int(value) & mask) << shift
                self.gripper.written()
                print("command", *(f"{value:04x}" for value in self.gripper.command), flush=True)
                # Without a line feed, as some versions answer.
                return "ack"
            case ["GET", name] if name in STATUS:
                register, shift, mask = STATUS[name]
                return f"{name} {self.gripper.status()[register] >> shift & mask}\n"
            case ["GET", name] if name in COMMAND:
                register, shift, mask = COMMAND[name]
                return f"{name} {self.gripper.command[register] >> shift & mask}\n"
            case _:
                return "?\n"


class Handler(socketserver.StreamRequestHandler):
    """One client; the URCap takes one at a time."""

    def handle(self) -> None:
        for line in self.rfile:
            answer = urcap.answer(line.decode())
            time.sleep(ANSWER_S)
            self.wfile.write(answer.encode())


class Server(socketserver.TCPServer):
    allow_reuse_address = True


if __name__ == "__main__":
    urcap = Urcap(float(sys.argv[2]) if len(sys.argv) > 2 else None)
    with Server(("127.0.0.1", int(sys.argv[1])), Handler) as server:
        print("ready", flush=True)
        server.serve_forever()
