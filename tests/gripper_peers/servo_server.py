"""A bus servo on a serial port: a control table whose position follows its goal.

Dynamixel packets are framed, stuffed and checked by ROBOTIS's own SDK (``dynamixel_sdk``). rustypot, a
published driver of both kinds, drives the same server in the tests as a check on it.

usage: servo_server.py dynamixel|feetech PORT [HELD_POSITION]
"""

from __future__ import annotations

import struct
import sys
import time
from dataclasses import dataclass

import serial
from dynamixel_sdk import Protocol2PacketHandler

ID = 1
READ, WRITE, PING = 2, 3, 1


@dataclass(frozen=True)
class Layout:
    """Where a series keeps what this server moves by; formats are little-endian."""

    goal: int
    present: int
    moving: int
    torque: int
    speed: int
    number: str
    speed_number: str
    counts_per_s: float


LAYOUTS = {
    "dynamixel": Layout(116, 132, 122, 64, 112, "<i", "<I", 0.229 / 60 * 4096),
    "feetech": Layout(42, 56, 66, 40, 46, "<H", "<H", 1.0),
}


class Servo:
    """The control table, and motion over time."""

    def __init__(self, layout: Layout, held: float | None) -> None:
        self.layout, self.held = layout, held
        self.table = bytearray(256)
        self.position, self.time_s = 2048.0, time.monotonic()
        struct.pack_into(layout.number, self.table, layout.goal, 2048)

    def update(self) -> None:
        layout, now = self.layout, time.monotonic()
        elapsed_s, self.time_s = now - self.time_s, now
        (goal,) = struct.unpack_from(layout.number, self.table, layout.goal)
        (speed,) = struct.unpack_from(layout.speed_number, self.table, layout.speed)
        step = speed * layout.counts_per_s * elapsed_s if speed else 1e9
        before = self.position
        if self.table[layout.torque]:
            self.position += max(-step, min(step, goal - self.position))
            if self.held is not None and goal < self.held < before:
                self.position = max(self.position, self.held)
            elif self.held is not None and goal < self.held and before == self.held:
                self.position = self.held
        stands = abs(self.position - goal) < 1 or (self.position == before == self.held)
        self.table[layout.moving] = 0 if stands else 1
        struct.pack_into(layout.number, self.table, layout.present, round(self.position))

    def read(self, address: int, count: int) -> bytes:
        self.update()
        return bytes(self.table[address : address + count])

    def write(self, address: int, data: bytes) -> None:
        self.update()
        self.table[address : address + len(data)] = data
        print("command", address, data.hex(), flush=True)


def serve_dynamixel(port: serial.Serial, servo: Servo) -> None:
    handler = Protocol2PacketHandler()
    while True:
        if port.read(1) != b"\xff" or port.read(3) != b"\xff\xfd\x00":
            continue
        identifier, length = struct.unpack("<BH", port.read(3))
        body = port.read(length)
        packet = [0xFF, 0xFF, 0xFD, 0, identifier, length & 0xFF, length >> 8, *body]
        crc = handler.updateCRC(0, packet, len(packet) - 2)
        if identifier != ID or packet[-2:] != [crc & 0xFF, crc >> 8]:
            continue
        packet = handler.removeStuffing(packet)
        instruction, parameters = packet[7], bytes(packet[8 : 7 + (packet[5] | packet[6] << 8) - 2])
        answer = b""
        if instruction == READ:
            answer = servo.read(*struct.unpack("<HH", parameters[:4]))
        elif instruction == WRITE:
            servo.write(struct.unpack("<H", parameters[:2])[0], parameters[2:])
        elif instruction == PING:
            answer = struct.pack("<HB", 1200, 50)
        size = len(answer) + 4
        status = [0xFF, 0xFF, 0xFD, 0, ID, size & 0xFF, size >> 8, 0x55, 0, *answer, 0, 0]
        status = handler.addStuffing(status)
        status[-2:] = [0, 0]
        crc = handler.updateCRC(0, status, len(status) - 2)
        status[-2:] = [crc & 0xFF, crc >> 8]
        port.write(bytes(status))


def serve_feetech(port: serial.Serial, servo: Servo) -> None:
    while True:
        if port.read(1) != b"\xff" or port.read(1) != b"\xff":
            continue
        identifier, length = port.read(2)
        body = port.read(length)
        if identifier != ID or (identifier + length + sum(body)) & 0xFF != 0xFF:
            continue
        instruction, parameters = body[0], body[1:-1]
        answer = b""
        if instruction == READ:
            answer = servo.read(parameters[0], parameters[1])
        elif instruction == WRITE:
            servo.write(parameters[0], bytes(parameters[1:]))
        status = bytes([ID, len(answer) + 2, 0]) + answer
        port.write(b"\xff\xff" + status + bytes([~sum(status) & 0xFF]))


if __name__ == "__main__":
    kind, path = sys.argv[1:3]
    servo = Servo(LAYOUTS[kind], float(sys.argv[3]) if len(sys.argv) > 3 else None)
    with serial.Serial(path, 1_000_000) as port:
        print("ready", flush=True)
        {"dynamixel": serve_dynamixel, "feetech": serve_feetech}[kind](port, servo)
