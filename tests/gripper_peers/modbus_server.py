"""Grippers behind pymodbus: framing, checksums, functions and exceptions are pymodbus's own.

Only how position and status follow the commands is written here, from the vendors' register tables. Every
command that is written is printed as a line, so that a test can see what was asked.

usage: modbus_server.py robotiq|dh|onrobot PORT [HELD] PORT is a serial port, or a TCP port number on
loopback. HELD is where something stops the fingers that close, in the gripper's own counts. The environment
variable ACTIVATION_S is how long an activation takes.
"""

from __future__ import annotations

import asyncio
import os
import sys
import time
from typing import Protocol

from pymodbus import FramerType
from pymodbus.server import ModbusSerialServer, ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

ACTIVATION_S = float(os.environ.get("ACTIVATION_S", "0.3"))


class Gripper(Protocol):
    """Registers that are written, registers that are read, and what stands in them now."""

    unit: int
    framer: FramerType
    command_address: int
    status_address: int
    command: list[int]

    def status(self) -> list[int]: ...
    def written(self) -> None: ...


class Finger:
    """A position that goes to its target, and is held up on the way where something is between
    the fingers.
    """

    def __init__(self, position: float, held: float | None, closing: int) -> None:
        self.position, self.target, self.speed = position, position, 0.0
        self.held, self.closing = held, closing
        self.time_s = time.monotonic()

    def go(self, target: float, speed: float) -> None:
        """Sets off from the position of the last update; the position itself as a target stops."""
        self.target, self.speed = target, speed

    def update(self) -> None:
        now = time.monotonic()
        step, self.time_s = self.speed * (now - self.time_s), now
        before, way = self.position, self.target - self.position
        self.position += max(-step, min(step, way))
        if self.held is not None and way * self.closing > 0:
            passed = (self.position - self.held) * self.closing > 0
            if passed and (before - self.held) * self.closing <= 0:
                self.position = self.held

    @property
    def is_held(self) -> bool:
        return self.position == self.held and (self.target - self.position) * self.closing > 0

    @property
    def arrived(self) -> bool:
        return abs(self.target - self.position) < 0.5


class TwoFinger85:
    """Robotiq: three command registers, three status registers."""

    unit, framer = 9, FramerType.RTU
    command_address, status_address = 1000, 2000
    open, closed = 3, 230

    def __init__(self, held: float | None) -> None:
        self.command = [0, 0, 0]
        self.finger = Finger(self.open, held, closing=1)
        self.activated_s: float | None = None

    def written(self) -> None:
        self.finger.update()
        go = self.command[0] >> 11 & 1
        requested = min(max(self.command[1] & 0xFF, self.open), self.closed)
        speed = (20 + 130 * (self.command[2] >> 8) / 255) / 85 * (self.closed - self.open)
        self.finger.go(requested if go else self.finger.position, speed)

    def status(self) -> list[int]:
        self.finger.update()
        action, requested = self.command[0] >> 8, self.command[1] & 0xFF
        position = round(self.finger.position) << 8
        if not action & 1:
            self.activated_s = None
            return [0, requested, position]
        now = time.monotonic()
        if self.activated_s is None:
            self.activated_s = now
        if now - self.activated_s < ACTIVATION_S:
            return [0x1100, requested, position]
        go = action >> 3 & 1
        motion = (2 if self.finger.is_held else 3 if self.finger.arrived else 0) if go else 0
        return [motion << 14 | 3 << 12 | go << 11 | 1 << 8, requested, position]


class DhPge:
    """DH-Robotics: 1000 is open here; a write to the position moves at once."""

    unit, framer = 1, FramerType.RTU
    command_address, status_address = 0x0100, 0x0200

    def __init__(self, held: float | None) -> None:
        self.command = [0, 0, 0, 0, 0]
        self.finger = Finger(1000, held, closing=-1)
        self.activated_s: float | None = None

    def written(self) -> None:
        self.finger.update()
        if self.command[0] and self.activated_s is None:
            self.activated_s = time.monotonic()
            self.command[3] = 1000
        self.finger.go(self.command[3], 20 * self.command[4])

    def status(self) -> list[int]:
        self.finger.update()
        ready = self.activated_s is not None and time.monotonic() - self.activated_s >= ACTIVATION_S
        grip = 2 if self.finger.is_held else 1 if self.finger.arrived else 0
        return [int(ready), grip, round(self.finger.position)]


class OnRobotRg2:
    """OnRobot: widths in tenths of a millimetre; commands are taken while it is not busy."""

    unit, framer = 65, FramerType.SOCKET
    command_address, status_address = 0x0000, 0x010B

    def __init__(self, held: float | None) -> None:
        self.command = [0, 0, 0]
        self.finger = Finger(1100, held, closing=-1)
        self.finger.speed = 1000

    def written(self) -> None:
        self.finger.update()
        control = self.command[2]
        if control == 8:
            self.finger.go(self.finger.position, self.finger.speed)
        elif control and (self.finger.arrived or self.finger.is_held):
            self.finger.go(self.command[1], self.finger.speed)
        self.command[2] = 0

    def status(self) -> list[int]:
        self.finger.update()
        held = self.finger.is_held
        return [round(self.finger.position), int(not held and not self.finger.arrived) | held << 1]


async def serve(port: str, gripper: Gripper) -> None:
    async def action(function_code, start_address, address, count, current_registers, set_values):
        at = address - gripper.command_address
        if set_values is not None and 0 <= at < len(gripper.command):
            gripper.command[at : at + len(set_values)] = set_values
            print("command", *(f"{value:04x}" for value in gripper.command), flush=True)
            gripper.written()
        elif set_values is None and start_address <= gripper.status_address < address + count:
            at = gripper.status_address - start_address
            status = gripper.status()
            current_registers[at : at + len(status)] = status

    registers = [
        SimData(address, count=count, values=0, datatype=DataType.REGISTERS)
        for address, count in (
            (gripper.command_address, len(gripper.command)),
            (gripper.status_address, len(gripper.status())),
        )
    ]
    device = SimDevice(gripper.unit, simdata=registers, action=action)
    if port.isdigit():
        server = ModbusTcpServer(
            device, framer=gripper.framer, address=("127.0.0.1", int(port)), ignore_missing_devices=True
        )
    else:
        server = ModbusSerialServer(
            device, framer=gripper.framer, port=port, baudrate=115200, ignore_missing_devices=True
        )
    print("ready", flush=True)
    await server.serve_forever()


if __name__ == "__main__":
    kind, port = sys.argv[1:3]
    held = float(sys.argv[3]) if len(sys.argv) > 3 else None
    grippers = {"robotiq": TwoFinger85, "dh": DhPge, "onrobot": OnRobotRg2}
    asyncio.run(serve(port, grippers[kind](held)))
