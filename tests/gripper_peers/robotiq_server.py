"""A Robotiq 2F-85 behind pymodbus: framing, checksums, functions and exceptions are pymodbus's own.

Only how position and status follow the command is written here, from the vendor's register tables. Every command that
is written is printed as a line, so that a test can see what was asked.

usage: robotiq_server.py PORT [OBJECT_POSITION]     PORT is a serial port, or a TCP port number for RTU over TCP
"""

from __future__ import annotations

import asyncio
import sys
import time

from pymodbus import FramerType
from pymodbus.server import ModbusSerialServer, ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

COMMAND, STATUS, COUNT = 1000, 2000, 3
OPEN, CLOSED = 3, 230
ACTIVATION_S = 0.3


class TwoFinger85:
    """Position, activation and contact over time."""

    def __init__(self, object_position: float | None) -> None:
        self.object_position = object_position
        self.position = float(OPEN)
        self.command = [0] * COUNT
        self.time_s = time.monotonic()
        self.activated_s: float | None = None

    def write(self, at: int, values: list[int]) -> None:
        self.status()
        self.command[at : at + len(values)] = values
        print("command", *(f"{value:04x}" for value in self.command), flush=True)

    def status(self) -> list[int]:
        now = time.monotonic()
        elapsed_s, self.time_s = now - self.time_s, now
        action, requested = self.command[0] >> 8, self.command[1] & 0xFF
        activate, go = action & 1, action >> 3 & 1
        if not activate:
            self.activated_s = None
            return [0, requested, round(self.position) << 8]
        if self.activated_s is None:
            self.activated_s = now
        if now - self.activated_s < ACTIVATION_S:
            return [0x1100, requested, round(self.position) << 8]
        motion = self._move(requested, elapsed_s) if go else 0
        return [motion << 14 | 3 << 12 | go << 11 | 1 << 8, requested, round(self.position) << 8]

    def _move(self, requested: int, elapsed_s: float) -> int:
        target = min(max(requested, OPEN), CLOSED)
        speed_mm_s = 20 + 130 * (self.command[2] >> 8) / 255
        step = speed_mm_s / 85 * (CLOSED - OPEN) * elapsed_s
        way = target - self.position
        position = self.position + max(-step, min(step, way))
        held = self.object_position
        if held is not None and way > 0 and self.position <= held < position:
            position = held
        self.position = position
        if held is not None and way > 0 and abs(position - held) < 1e-6:
            return 2
        return 3 if abs(target - position) < 0.5 else 0


async def serve(port: str, gripper: TwoFinger85) -> None:
    async def action(function_code, start_address, address, count, current_registers, set_values):
        if set_values is not None and COMMAND <= address < COMMAND + COUNT:
            gripper.write(address - COMMAND, list(set_values))
        elif set_values is None and start_address <= STATUS < address + count:
            at = STATUS - start_address
            current_registers[at : at + COUNT] = gripper.status()

    registers = [
        SimData(address, count=COUNT, values=0, datatype=DataType.REGISTERS) for address in (COMMAND, STATUS)
    ]
    device = SimDevice(9, simdata=registers, action=action)
    if port.isdigit():
        address = ("127.0.0.1", int(port))
        server = ModbusTcpServer(device, framer=FramerType.RTU, address=address, ignore_missing_devices=True)
    else:
        server = ModbusSerialServer(
            device, framer=FramerType.RTU, port=port, baudrate=115200, ignore_missing_devices=True
        )
    print("ready", flush=True)
    await server.serve_forever()


if __name__ == "__main__":
    held = float(sys.argv[2]) if len(sys.argv) > 2 else None
    asyncio.run(serve(sys.argv[1], TwoFinger85(held)))
