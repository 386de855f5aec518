"""gelstereo-host's task with real peers: a frame stream at 30 Hz, a Modbus gripper on a serial line, a robot
bridge.

Triggers stop the gripper within a frame; a part that falls silent stops the others; signals end a run safely.
"""

from __future__ import annotations

import itertools
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from gripper_peers.wire import Wire
from slow_line import SlowLine
from test_gripper_peers import Server, robotiq, wait_for
from test_recording_readers import host_binary

import gelstereo
from gelstereo.streams import FrameWriter

pytestmark = pytest.mark.realtime

BRIDGE = Path(__file__).parent.parent / "examples" / "robot_bridge.py"
PERIOD_S = 1 / 30
#: Commands of the Robotiq server: closing goes to the closed end, a stop takes the request to move back.
STOP = "0100"
ACTIVATE, RESET = "0100 0000 0000", "0000 0000 0000"


@pytest.fixture(scope="session")
def press() -> list[npt.NDArray[np.uint8]]:
    """A peg pressed 1 mm deep in 20 frames, as in a closing gripper; the first frame is at rest."""
    simulator = gelstereo.simulate(
        {
            "frame_rate_hz": 30,
            "indenter": {"kind": "cylinder", "radius_mm": 4.0, "length_mm": 40.0},
            "effects": {"shoulder": {}, "spread": {}, "defocus": {}, "sensor_noise": {}},
            "trajectory": [
                {"time_s": 0.0, "position_mm": [3.5, 0.0, 34.0], "rotation_rad": [1.5708, 0.0, 0.0]},
                {"time_s": 0.7, "position_mm": [3.5, 0.0, 30.0], "rotation_rad": [1.5708, 0.0, 0.0]},
            ],
        }
    )
    return [
        np.hstack((frame.left, frame.right)) for frame in map(simulator.__getitem__, range(len(simulator)))
    ]


class Camera:
    """Writes frames to a FIFO at 30 Hz: the frame at rest, then the press; each was exposed `age_s` before.

    It can fall silent.
    """

    def __init__(self, fifo: Path, frames: list[npt.NDArray[np.uint8]], age_s: float = 0.0) -> None:
        self._age_ns = int(age_s * 1e9)
        self.pressing, self.silent = threading.Event(), threading.Event()
        self._fifo, self._frames, self._stop = fifo, frames, threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        at = 0
        with open(self._fifo, "wb", buffering=0) as pipe:
            writer = FrameWriter(pipe)
            for moment in itertools.count(time.monotonic() + PERIOD_S, PERIOD_S):
                time.sleep(max(0.0, moment - time.monotonic()))
                if self._stop.is_set():
                    return
                if self.silent.is_set():
                    continue
                at = min(at + 1, len(self._frames) - 1) if self.pressing.is_set() else 0
                try:
                    writer.write(self._frames[at], captured_ns=time.monotonic_ns() - self._age_ns)
                except BrokenPipeError:
                    return

    def close(self) -> None:
        self._stop.set()
        if self._thread.is_alive():
            # Nobody may have opened the other end.
            descriptor = os.open(self._fifo, os.O_RDONLY | os.O_NONBLOCK)
            self._thread.join(timeout=10)
            os.close(descriptor)


class Cell:
    """A running host with its configuration; ``wait`` returns its exit code, standard output and error."""

    def __init__(self, folder: Path, gripper_port: str, bridge_port: int | None, extra: str = "") -> None:
        self.recording = folder / "run.mcap"
        robot = f'[robot]\nkind = "bridge"\naddress = "127.0.0.1:{bridge_port}"\nwatchdog_ms = 600\n'
        (folder / "rig.toml").write_text(gelstereo.Scene().rig.to_toml())
        (folder / "cell.toml").write_text(
            f'rig_file = "rig.toml"\nsource = {{ kind = "stream", path = "camera.fifo" }}\n'
            f'[gripper]\nkind = "robotiq"\nport = "{gripper_port}"\nmodel = "2f85"\n'
            f"{robot if bridge_port else ''}"
            f"[params.contact]\ngrasp_trigger_px = 2.0\n[task]\nmax_late_periods = 30.0\n{extra}"
        )
        command = [host_binary(), "run", "--config", "cell.toml", "--record", str(self.recording), "--json"]
        self.process = subprocess.Popen(
            command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )

    def wait(self) -> tuple[int, str, str]:
        out, err = self.process.communicate(timeout=60)
        return self.process.returncode, out, err

    def replays(self) -> bool:
        """Whether the recording is closed and computes to the same bits."""
        done = subprocess.run(
            [host_binary(), "replay", str(self.recording)], capture_output=True, text=True, check=False
        )
        return done.returncode == 0 and "cut off" not in done.stdout


class Bridge:
    """The example's robot in a process of its own."""

    def __init__(self) -> None:
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            self.port = probe.getsockname()[1]
        self.process = subprocess.Popen(
            [sys.executable, str(BRIDGE), str(self.port)], stdout=subprocess.DEVNULL
        )
        wait_for(self.port)

    def status(self) -> dict:
        """Asked by another client, which the example serves when the host has gone."""
        with socket.create_connection(("127.0.0.1", self.port), timeout=10) as connection:
            lines = connection.makefile("rw")
            for request in ({"request": "hello", "version": 1, "watchdog_ms": 5000}, {"request": "status"}):
                lines.write(json.dumps({"id": 1, **request}) + "\n")
                lines.flush()
                answer = json.loads(lines.readline())
        return answer

    def close(self) -> None:
        self.process.kill()
        self.process.wait()


@contextmanager
def cell(
    folder: Path,
    press: list[npt.NDArray[np.uint8]],
    bridge_port: int | None = None,
    extra: str = "",
    age_s: float = 0.0,
) -> Iterator[tuple[Cell, Camera, Wire, Server]]:
    """A host with a camera, a gripper on a serial line and a robot."""
    os.mkfifo(folder / "camera.fifo")
    with robotiq() as (wire, server):
        camera = Camera(folder / "camera.fifo", press, age_s)
        host = Cell(folder, wire.host_port, bridge_port, extra)
        try:
            yield host, camera, wire, server
        finally:
            host.process.kill()
            host.process.wait()
            camera.close()
            for stream in (host.process.stdout, host.process.stderr):
                assert stream is not None
                stream.close()


@pytest.fixture
def bridge() -> Iterator[Bridge]:
    robot = Bridge()
    yield robot
    robot.close()


def closing_begins(server: Server) -> list[str]:
    """Waits for the command that closes the fingers from 14 mm on; returns the commands up to it."""
    commands: list[str] = []
    deadline = time.monotonic() + 30
    while time.monotonic() < deadline:
        commands += server.commands()
        if any(command.startswith("0900 00e") for command in commands):
            return commands
        time.sleep(0.002)
    raise TimeoutError(f"no closing among {commands}")


def commands_of(server: Server, before: list[str]) -> list[str]:
    """The commands so far; `before` has those that were looked at."""
    before += server.commands()
    return before


def stopped_last(server: Server) -> bool:
    commands = server.commands()
    return bool(commands) and commands[-1].startswith(STOP)


def test_a_trigger_stops_the_gripper_within_a_frame(tmp_path: Path, press, record_property) -> None:
    with cell(tmp_path, press) as (host, camera, _, server):
        closing_begins(server)
        camera.pressing.set()
        _, out, err = host.wait()
        assert out, err
        report = json.loads(out)
        (stop,) = [stop for stop in report["latency"]["stops"] if stop["cause"] == "grasp"]
        assert any(command.startswith(STOP) for command in server.commands())
        record_property("latency", report["latency"])
        parts = ("driver_to_received_ms", "received_to_sensed_ms", "sensed_to_wire_ms")
        assert stop["image_to_wire_ms"] == pytest.approx(sum(stop[part] for part in parts), abs=1e-6)
        # The image that shows the trigger is the first that does: the one before it lay below.
        assert report["stages"][2]["stage"] == "close"
        assert host.replays()


def test_a_silent_camera_stops_closing_fingers(tmp_path: Path, press) -> None:
    with cell(tmp_path, press) as (host, camera, _, server):
        closing_begins(server)
        camera.silent.set()
        code, _, err = host.wait()
        assert code == 2
        assert "close: the camera was silent for" in err and "task.max_blind_travel_mm" in err
        assert stopped_last(server)
        assert host.replays()


def test_a_silent_gripper_stops_the_task(tmp_path: Path, press) -> None:
    with cell(tmp_path, press) as (host, _, wire, server):
        closing_begins(server)
        wire.cut = True
        code, _, err = host.wait()
        assert code == 2
        assert f"the gripper on {wire.host_port} has not answered for" in err
        assert host.replays()


def test_a_silent_robot_stops_the_task_and_the_gripper(tmp_path: Path, press, bridge: Bridge) -> None:
    # On its long way to the part the robot falls silent, while the fingers open.
    with cell(tmp_path, press, bridge.port, "move_speed_mm_s = 60.0\nopening_speed_mm_s = 20.0\n") as (
        host,
        _,
        _,
        server,
    ):
        wait_until(lambda: any(command.startswith("0900") for command in server.commands()))
        time.sleep(0.3)
        bridge.process.send_signal(signal.SIGSTOP)
        code, _, err = host.wait()
        bridge.process.send_signal(signal.SIGCONT)
        assert code == 2
        assert f"the robot at 127.0.0.1:{bridge.port} has not answered for" in err
        assert stopped_last(server), "the gripper is stopped although the robot cannot be"


def wait_until(condition: Callable[[], bool], limit_s: float = 30) -> None:
    deadline = time.monotonic() + limit_s
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.005)


@pytest.mark.parametrize("request_to_stop", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_stops_gripper_and_recording(tmp_path: Path, press, request_to_stop: signal.Signals) -> None:
    with cell(tmp_path, press) as (host, _, _, server):
        closing_begins(server)
        host.process.send_signal(request_to_stop)
        code, out, _ = host.wait()
        assert code == 1
        assert json.loads(out)["why"] == "interrupted during close"
        assert stopped_last(server)
        assert host.replays()


@pytest.mark.parametrize("request_to_stop", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_an_activation(
    tmp_path: Path, press, monkeypatch: pytest.MonkeyPatch, request_to_stop: signal.Signals
) -> None:
    # Longer than any limit of the host: only the signal can end it.
    monkeypatch.setenv("ACTIVATION_S", "600")
    with cell(tmp_path, press) as (host, _, _, server):
        commands: list[str] = []
        wait_until(lambda: ACTIVATE in commands_of(server, commands))
        host.process.send_signal(request_to_stop)
        code, out, _ = host.wait()
        assert code == 1
        assert json.loads(out)["why"] == "interrupted during open"
        assert server.commands() == [RESET]


def test_a_late_result_stops_closing_fingers(tmp_path: Path, press) -> None:
    # 30 periods of 30 Hz are allowed. At rest nothing is late.
    with cell(tmp_path, press, age_s=1.5) as (host, _, _, server):
        code, out, err = host.wait()
        assert code == 2
        assert "close: a result came 15" in err and "task.max_late_periods" in err
        summary = json.loads(out)
        assert summary["outcome"] == {"kind": "error", "cause": "late"}
        assert [stage["stage"] for stage in summary["stages"]] == ["open", "rest"]
        assert stopped_last(server)
        assert host.replays()


def test_a_robot_that_answers_slowly_does_not_delay_the_grippers_stop(
    tmp_path: Path, press, bridge: Bridge
) -> None:
    delay_s = 0.4
    line = SlowLine(bridge.port, delay_s)
    with cell(tmp_path, press, line.port, "device_timeout_s = 2.0\n") as (host, camera, _, server):
        closing_begins(server)
        camera.pressing.set()
        wait_until(lambda: any(command.startswith(STOP) for command in server.commands()))
        host.process.send_signal(signal.SIGTERM)
        code, out, err = host.wait()
        assert code == 1, err
        (stop,) = [stop for stop in json.loads(out)["latency"]["stops"] if stop["cause"] == "grasp"]
        # A status of the robot is always under way, and takes this long.
        assert stop["sensed_to_wire_ms"] < 1e3 * delay_s
        names = [request.name for request in line.requests]
        at = names.index("stop")
        assert names[at - 1] == "status" and "move" not in names[at:], names
        assert host.replays()
    line.close()


@pytest.mark.parametrize("lose_every", [2, pytest.param(3, marks=pytest.mark.long)])
def test_a_stop_comes_through_while_statuses_are_retried(tmp_path: Path, press, lose_every: int) -> None:
    with cell(tmp_path, press) as (host, camera, wire, server):
        closing_begins(server)
        wire.lose_every = lose_every
        camera.pressing.set()
        _, out, err = host.wait()
        assert out, err
        report = json.loads(out)
        assert report["outcome"]["kind"] != "error", err
        assert "grasp" in [stop["cause"] for stop in report["latency"]["stops"]]
        assert stopped_last(server)
        assert host.replays()


def test_a_killed_host_leaves_a_robot_that_stops_by_itself(tmp_path: Path, press, bridge: Bridge) -> None:
    with cell(tmp_path, press, bridge.port, "move_speed_mm_s = 60.0\n") as (host, _, _, server):
        wait_until(lambda: any(command.startswith("0900") for command in server.commands()))
        time.sleep(0.5)
        host.process.send_signal(signal.SIGKILL)
        host.process.wait()
        first = bridge.status()
        time.sleep(0.3)
        second = bridge.status()
        assert not second["moving"] and first["t_base_gripper"] == second["t_base_gripper"]
        x_mm = second["t_base_gripper"]["position_mm"][0]
        assert 1.0 < x_mm < 399.0, "it was on its way to the part"


@pytest.mark.long
def test_triggers_of_many_runs(tmp_path: Path, press) -> None:
    """From image to the stop's last byte over many runs; printed, since it depends on the computer."""
    image_to_wire, sensed_to_wire = [], []
    runs = int(os.environ.get("GELSTEREO_RUNS", "20"))
    for run in range(runs):
        folder = tmp_path / str(run)
        folder.mkdir()
        with cell(folder, press) as (host, camera, _, server):
            closing_begins(server)
            camera.pressing.set()
            wait_until(lambda: any(command.startswith(STOP) for command in server.commands()))
            host.process.send_signal(signal.SIGTERM)
            _, out, err = host.wait()
            assert out, err
            for stop in json.loads(out)["latency"]["stops"]:
                image_to_wire.append(stop["image_to_wire_ms"])
                sensed_to_wire.append(stop["sensed_to_wire_ms"])
        shutil.rmtree(folder)
    assert len(image_to_wire) >= runs
    for name, values in (("image to wire", image_to_wire), ("sensed to wire", sensed_to_wire)):
        print(
            f"{name}: p50 {np.quantile(values, 0.5):.1f} ms, p99 {np.quantile(values, 0.99):.1f} ms of "
            f"{len(values)}"
        )
