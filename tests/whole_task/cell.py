"""Starts a cell of processes for one task: the world, and camera, gripper and robot between it
and the host.
"""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from gripper_peers.wire import Faults, Wire
from test_recording_readers import ROOT, host_binary

import gelstereo
from whole_task.lateness import Lateness
from whole_task.world import World

Line = dict[str, Any]

# Width tables of the host, as `whole_task.gripper` has them.
GRIPPERS = {
    "robotiq": 'model = "2f85"',
    "dh": "widths = { points = [[0, 0.0], [1000, 50.0]], max_error_mm = 0.05 }\nspeed_mm_s = [1, 100]",
}
# A 2F-85 reports its width in steps of 0.37 mm, which alone puts the part off by up to 0.09 mm: the default
# hole, 0.1 mm wider to each side, would be a test of luck.
HOLE_DIAMETER_MM = 8.6
TASK = """
[task]
opening_speed_mm_s = 100.0
# Late results and silent devices have tests of their own; here many processes share the cores.
max_late_periods = 30.0
device_timeout_s = 1.5
[part]
spacing_mm = 0.4
[part.shape]
kind = "cylinder"
radius_mm = 4.0
length_mm = 40.0
"""


@dataclass(frozen=True)
class Outcome:
    """What came of a run, as the host says and as the world has it."""

    code: int
    """The host's exit code; negative is the signal that killed it."""
    report: Line | None
    """The host's report, if it wrote one."""
    errors: str
    """What the host said on stderr."""
    truth: Line
    events: list[Line]
    """The world's log."""

    @property
    def kind(self) -> str:
        """The outcome's name, or how the host ended without one."""
        return self.report["outcome"]["kind"] if self.report else f"ended with {self.code}"


def world_binary() -> str:
    """The world server beside the host that is under test, or built by cargo."""
    if given := os.environ.get("GELSTEREO_HOST"):
        beside = Path(given).parent / "examples" / "world_server"
        if beside.exists():
            return str(beside)
    build = ["cargo", "build", "--quiet", "--package", "gelstereo-host", "--example", "world_server"]
    subprocess.run(build, cwd=ROOT, check=True)
    return str(Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target")) / "debug/examples/world_server")


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


def wait_until(condition: Callable[[], object], what: str, limit_s: float = 120.0) -> None:
    """Returns once the condition holds."""
    end = time.monotonic() + limit_s
    while not condition():
        if time.monotonic() > end:
            raise TimeoutError(f"waited {limit_s:.0f} s for {what}")
        time.sleep(0.005)


@dataclass(frozen=True)
class Setting:
    """What a cell is made of."""

    seed: int
    kind: str = "robotiq"
    task: str = TASK
    """Tables ``[task]`` and ``[part]`` of host and world."""
    simulated: str = f"hole_diameter_mm = {HOLE_DIAMETER_MM}"
    """More of the world's table ``[simulated]``."""
    rig: str = field(default_factory=lambda: gelstereo.Scene().rig.to_toml())


class Cell:
    """The processes of one task. `parts` has those that a test may kill: camera, gripper, robot and, in a
    run, host.
    """

    def __init__(self, folder: Path, setting: Setting, wire: Wire) -> None:
        self.lateness = Lateness()
        self.folder, self.setting, self.wire = folder, setting, wire
        self.parts: dict[str, subprocess.Popen[str]] = {}
        self.recording, self.config = folder / "run.mcap", folder / "cell.toml"
        self.robot_port = free_port()
        self._log = folder / "world.jsonl"
        (folder / "rig.toml").write_text(setting.rig, encoding="utf-8")
        self._world = self._start_world()
        assert self._world.stdout is not None
        self.address = self._world.stdout.readline().split()[1]
        self.parts["robot"] = self._python("bridge", str(self.robot_port), self.address)
        self.parts["gripper"] = self._python("gripper", setting.kind, wire.device_port, self.address)
        for name, word in (("robot", "listening"), ("gripper", "ready")):
            output = self.parts[name].stdout
            assert output is not None and output.readline().startswith(word)

    def _start_world(self) -> subprocess.Popen[str]:
        config = self.folder / "world.toml"
        world = f"[simulated]\nseed = {self.setting.seed}\n{self.setting.simulated}\n"
        config.write_text('rig_file = "rig.toml"\n' + self.setting.task + world, encoding="utf-8")
        command = [world_binary(), "--config", str(config), "--log", str(self._log)]
        return subprocess.Popen(command, stdout=subprocess.PIPE, text=True)

    def _python(self, module: str, *arguments: str) -> subprocess.Popen[str]:
        paths = os.pathsep.join([str(ROOT / "tests"), str(ROOT / "examples")])
        command = [sys.executable, "-m", f"whole_task.{module}", *arguments]
        return subprocess.Popen(
            command, stdout=subprocess.PIPE, text=True, env={**os.environ, "PYTHONPATH": paths}
        )

    def configure(self, source: str, serial_port: str, robot: str, recording: Path) -> None:
        """Writes the host's configuration."""
        devices = (
            f"[source]\n{source}\n"
            f'[gripper]\nkind = "{self.setting.kind}"\nport = "{serial_port}"\n'
            f"{GRIPPERS[self.setting.kind]}\n"
            f'[robot]\nkind = "bridge"\naddress = "{robot}:{self.robot_port}"\n'
            # As for `device_timeout_s`: a host that shares its cores was silent for over the default of 1 s.
            "timeout_ms = 1500\nwatchdog_ms = 2000\n"
            f'[recording]\npath = "{recording}"\n'
        )
        self.config.write_text('rig_file = "rig.toml"\n' + self.setting.task + devices, encoding="utf-8")

    def feed_by_fifo(self) -> None:
        """Starts a camera that feeds the host on this computer through a FIFO."""
        fifo = self.folder / "camera.fifo"
        os.mkfifo(fifo)
        self.parts["camera"] = self._python("feeder", str(fifo), self.address)
        source = f'kind = "stream"\npath = "{fifo}"'
        self.configure(source, self.wire.host_port, "127.0.0.1", self.recording)

    def start_host(self) -> None:
        """Starts the task."""
        command = [host_binary(), "run", "--config", str(self.config), "--json"]
        self.parts["host"] = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )

    def end(self, limit_s: float = 60.0) -> Outcome:
        """Waits until the host has ended."""
        host = self.parts["host"]
        said, errors = host.communicate(timeout=limit_s)
        return self.outcome(host.returncode, said, errors)

    def outcome(self, code: int, said: str, errors: str) -> Outcome:
        """What came of a run by what the host said, beside what the world has."""
        report = json.loads(said) if said.startswith("{") else None
        with closing(World(self.address)) as world:
            return Outcome(code, report, errors, world.ask("truth"), self.events())

    def events(self) -> list[Line]:
        """What has happened in the world until now."""
        *lines, _unfinished = self._log.read_text(encoding="utf-8").split("\n")
        return [json.loads(line) for line in lines]

    def wait_for(self, event: str, count: int, ended: Callable[[], bool] | None = None) -> None:
        """Waits until so many events of this name have happened in the world, or the host has ended.

        `ended` asks a host that is not a part of the cell, such as one in a VM.
        """
        ended = ended or (lambda: self.parts["host"].poll() is not None)

        def happened() -> bool:
            return ended() or sum(line["event"] == event for line in self.events()) >= count

        wait_until(happened, f"{event} number {count} in the world")

    def kill(self, part: str) -> int:
        """Kills a part without warning; the moment, on the world's clock."""
        process = self.parts[part]
        process.send_signal(signal.SIGKILL)
        process.wait()
        return time.monotonic_ns()

    def close(self) -> None:
        """Ends everything."""
        for process in [*self.parts.values(), self._world]:
            process.kill()
            process.wait()
            for stream in (process.stdout, process.stderr):
                if stream is not None:
                    stream.close()


@contextmanager
def cell(folder: Path, setting: Setting, faults: Faults | None = None) -> Iterator[Cell]:
    """A cell on this computer, which is ended with the block."""
    wire = Wire(faults)
    opened = Cell(folder, setting, wire)
    try:
        opened.feed_by_fifo()
        with opened.lateness:
            yield opened
    finally:
        opened.close()
        wire.close()
