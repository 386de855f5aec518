"""The pymodbus grippers of ``gripper_peers`` with fingers in the world.

usage: python -m whole_task.gripper robotiq|dh PORT WORLD_ADDRESS
"""

from __future__ import annotations

import asyncio
import sys

from gripper_peers.modbus_server import DhPge, Finger, TwoFinger85, serve

from whole_task.world import World

# Counts and millimetres of both ends, as in the tables that the host is given.
SCALES = {"robotiq": ((3, 85.0), (230, 0.0)), "dh": ((1000, 50.0), (0, 0.0))}
# The fingers of the simulated 2F-85 stop here.
WIDTH_RANGE_MM = (0.95, 85.0)


class WorldFinger(Finger):
    """Fingers that the world moves; positions are the gripper's own counts."""

    def __init__(self, kind: str, world: World) -> None:
        self._world = world
        (open_count, open_mm), (closed_count, closed_mm) = SCALES[kind]
        self._mm_per_count = (open_mm - closed_mm) / (open_count - closed_count)
        self._closed_count = closed_count
        self._state = world.ask("gripper_status")
        super().__init__(self._count(), None, closing=0)

    def _count(self) -> float:
        return self._closed_count + float(self._state["width_mm"]) / self._mm_per_count

    def update(self) -> None:
        self._state = self._world.ask("gripper_status")
        self.position = self._count()

    def go(self, target: float, speed: float) -> None:
        if speed == 0:
            # A gripper whose speed nobody has set yet.
            return
        if target == self.position:
            self._state = self._world.ask("gripper_stop")
            return
        width_mm = (target - self._closed_count) * self._mm_per_count
        width_mm = min(max(width_mm, WIDTH_RANGE_MM[0]), WIDTH_RANGE_MM[1])
        speed_mm_s = abs(speed * self._mm_per_count)
        self._state = self._world.ask("gripper_move", width_mm=width_mm, speed_mm_s=speed_mm_s)

    @property
    def is_held(self) -> bool:
        return bool(self._state["object_detected"])

    @property
    def arrived(self) -> bool:
        return not self._state["fingers_move"] and not self.is_held


if __name__ == "__main__":
    kind, port, address = sys.argv[1:]
    gripper = {"robotiq": TwoFinger85, "dh": DhPge}[kind](None)
    gripper.finger = WorldFinger(kind, World(address))
    asyncio.run(serve(port, gripper))
