"""A robot for gelstereo-host's bridge: replace the body of ``Robot`` by calls to your own controller.

Run it, then start the host with

    [robot]
    kind = "bridge"
    address = "127.0.0.1:7400"

The robot here moves in a straight line without turning. It stops when nothing comes for the watchdog's time.
"""

import json
import math
import socket
import sys
import time


class Robot:
    def __init__(self):
        self.position_mm, self.target_mm, self.speed_mm_s = [0.0, 0.0, 200.0], [0.0, 0.0, 200.0], 0.0
        self.quaternion_xyzw, self.time_s = [1.0, 0.0, 0.0, 0.0], time.monotonic()

    def advance(self):
        now = time.monotonic()
        step, self.time_s = self.speed_mm_s * (now - self.time_s), now
        way = math.dist(self.position_mm, self.target_mm)
        share = 1.0 if way <= step else step / way
        self.position_mm = [
            p + share * (t - p) for p, t in zip(self.position_mm, self.target_mm, strict=True)
        ]

    def move(self, pose, speed_mm_s):
        self.target_mm, self.quaternion_xyzw = pose["position_mm"], pose["quaternion_xyzw"]
        self.speed_mm_s = speed_mm_s

    def stop(self):
        self.target_mm = self.position_mm

    def status(self):
        pose = {"position_mm": self.position_mm, "quaternion_xyzw": self.quaternion_xyzw}
        return {"t_base_gripper": pose, "moving": self.position_mm != self.target_mm}


def answer(robot, connection, request):
    robot.advance()
    match request["request"]:
        case "hello":
            connection.settimeout(request["watchdog_ms"] / 1000)
            return {"version": 1}
        case "move":
            return robot.move(request["t_base_gripper"], request["speed_mm_s"]) or {}
        case "stop":
            return robot.stop() or {}
        case "status":
            return robot.status()
        case other:
            return {"error": f"there is no request {other!r}"}


def serve(port):
    robot, server = Robot(), socket.create_server(("127.0.0.1", port))
    print(f"listening on 127.0.0.1:{port}", flush=True)
    while True:
        connection, _ = server.accept()
        with connection, connection.makefile("rw") as lines:
            try:
                for line in lines:
                    request = json.loads(line)
                    lines.write(
                        json.dumps({"id": request["id"], **answer(robot, connection, request)}) + "\n"
                    )
                    lines.flush()
            except (OSError, ValueError) as error:
                print(f"stopped: {error}", flush=True)
        robot.advance()
        robot.stop()


if __name__ == "__main__":
    serve(int(sys.argv[1]) if len(sys.argv) > 1 else 7400)
