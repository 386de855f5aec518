"""The example bridge with the world's robot behind it.

usage: python -m whole_task.bridge PORT WORLD_ADDRESS
"""

from __future__ import annotations

import sys
from typing import Any

import robot_bridge

from whole_task.world import World

world = World(sys.argv[2])


class Robot:
    """What a user puts in the place of the example's robot."""

    def advance(self) -> None:
        """The world goes on by itself."""

    def move(self, pose: dict[str, Any], speed_mm_s: float) -> None:
        world.ask("robot_move", **pose, speed_mm_s=speed_mm_s)

    def stop(self) -> None:
        world.ask("robot_stop")

    def status(self) -> dict[str, Any]:
        state = world.ask("robot_status")
        pose = {name: state[name] for name in ("position_mm", "quaternion_xyzw")}
        return {"t_base_gripper": pose, "moving": state["robot_moves"]}


robot_bridge.Robot = Robot
robot_bridge.serve(int(sys.argv[1]))
