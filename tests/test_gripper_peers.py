"""gelstereo-host's gripper drivers against servers by other authors, over pseudo-terminals and loopback.

pymodbus frames and checks every message of the Robotiq server. pyRobotiqGripper, a published driver, drives
the same server as a check on the server itself.
"""

from __future__ import annotations

import os
import select
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from gripper_peers.wire import Faults, Wire
from test_recording_readers import host_binary

import gelstereo

pytest.importorskip("pymodbus")
PEERS = Path(__file__).parent / "gripper_peers"


class Server:
    """A server process, which prints each command before it answers it."""

    def __init__(self, script: str, *arguments: str) -> None:
        command = [sys.executable, str(PEERS / script), *arguments]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, bufsize=0)
        assert self.process.stdout is not None
        self._out = self.process.stdout.fileno()
        self._printed = ""
        assert self.next_command() == "ready"

    def commands(self) -> list[str]:
        """Every command that was answered since the last call."""
        while select.select([self._out], [], [], 0)[0]:
            self._read()
        lines = []
        while "\n" in self._printed:
            lines.append(self._line())
        return lines

    def next_command(self) -> str:
        """The next command, waited for."""
        while "\n" not in self._printed:
            assert select.select([self._out], [], [], 30)[0], "nothing came within 30 s"
            self._read()
        return self._line()

    def _read(self) -> None:
        printed = os.read(self._out, 1 << 16)
        assert printed, "the server ended"
        self._printed += printed.decode()

    def _line(self) -> str:
        line, _, self._printed = self._printed.partition("\n")
        return line.removeprefix("command ")

    def close(self) -> None:
        self.process.kill()
        self.process.wait()
        assert self.process.stdout is not None
        self.process.stdout.close()


@contextmanager
def on_a_wire(
    script: str, kind: str, faults: Faults | None = None, held: float | None = None
) -> Iterator[tuple[Wire, Server]]:
    """A server of this kind at the other end of a serial line."""
    wire = Wire(faults)
    server = Server(script, kind, wire.device_port, *([] if held is None else [str(held)]))
    try:
        yield wire, server
    finally:
        server.close()
        wire.close()


@contextmanager
def on_tcp(script: str, *arguments: str, kind: str | None = None) -> Iterator[tuple[str, Server]]:
    """A server, of this kind where there are several, on a loopback port."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    server = Server(script, *([] if kind is None else [kind]), str(port), *arguments)
    try:
        wait_for(port)
        yield f"tcp://127.0.0.1:{port}", server
    finally:
        server.close()


def robotiq(faults: Faults | None = None, held: float | None = None):
    return on_a_wire("modbus_server.py", "robotiq", faults, held)


def wait_for(port: int) -> None:
    """Until somebody listens on the loopback port."""
    for _ in range(300):
        with socket.socket() as probe:
            if probe.connect_ex(("127.0.0.1", port)) == 0:
                return
        time.sleep(0.1)
    raise TimeoutError(f"nobody listens on port {port}")


TABLES = {
    "robotiq": 'model = "2f85"',
    "robotiq_urcap": 'model = "2f85"',
    "dh": "widths = { points = [[0, 0.0], [1000, 50.0]], max_error_mm = 0.5 }\nspeed_mm_s = [5, 100]",
    "on_robot": 'model = "rg2"',
    "dynamixel": "widths = { points = [[1000, 0.0], [3000, 60.0]], max_error_mm = 1 }\nmax_current = 900",
    "feetech": "widths = { points = [[1000, 0.0], [3000, 60.0]], max_error_mm = 1 }",
}


def gripper(
    tmp_path: Path, port: str, *action: str, kind: str = "robotiq"
) -> subprocess.CompletedProcess[str]:
    cell = tmp_path / "cell.toml"
    cell.write_text(f'[gripper]\nkind = "{kind}"\nport = "{port}"\n{TABLES[kind]}\n')
    command = [host_binary(), "gripper", "--config", str(cell), *action]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)


def state(done: subprocess.CompletedProcess[str]) -> dict[str, str]:
    assert done.returncode == 0, done.stdout + done.stderr
    words = done.stdout.split()
    return dict(zip(words[::2], words[1::2], strict=True))


def test_a_robotiq_gripper_is_activated_moved_and_never_activated_again(tmp_path: Path) -> None:
    with robotiq(held=180.0) as (wire, server):
        assert state(gripper(tmp_path, wire.host_port, "activate"))["moving"] == "false"
        assert server.commands() == ["0000 0000 0000", "0100 0000 0000"]
        moved = state(gripper(tmp_path, wire.host_port, "move", "0", "--speed-mm-s", "150"))
        # Held at count 180 of 3 to 230 over 85 mm.
        assert abs(float(moved["width_mm"]) - 85 * 50 / 227) < 0.2
        assert moved["object_detected"] == "true"
        assert server.commands() == ["0900 00e6 ff33"], "no second activation: it would drop what is held"
        stopped = state(gripper(tmp_path, wire.host_port, "stop"))
        assert stopped["moving"] == "false"
        assert server.commands()[-1].startswith("0100"), "stopped by taking back the request, still activated"


@pytest.mark.parametrize(
    ("kind", "begun", "ended"),
    [
        ("robotiq", "0100 0000 0000", "0000 0000 0000"),
        ("robotiq_urcap", "0100 0000 0000", "0000 0000 0000"),
        # Sent to where it is, fully open.
        ("dh", "00a5 0000 0000 0000 0000", "00a5 0000 0000 03e8 0000"),
    ],
)
def test_ctrl_c_ends_an_activation(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str, begun: str, ended: str
) -> None:
    monkeypatch.setenv("ACTIVATION_S", "600")
    # A command is printed before it is answered: the signal arrives while the host reads.
    monkeypatch.setenv("ANSWER_S", "0.1")
    opened = on_tcp("urcap_server.py") if kind == "robotiq_urcap" else on_a_wire("modbus_server.py", kind)
    with opened as (line, server):
        cell = tmp_path / "cell.toml"
        port = line if isinstance(line, str) else line.host_port
        cell.write_text(f'[gripper]\nkind = "{kind}"\nport = "{port}"\n{TABLES[kind]}\n')
        command = [host_binary(), "gripper", "--config", str(cell), "activate"]
        host = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        while server.next_command() != begun:
            pass
        host.send_signal(signal.SIGINT)
        out, err = host.communicate(timeout=10)
        assert host.returncode == 1, out + err
        # The answer to the last command may be lost with the host.
        while server.next_command() != ended:
            pass


def test_a_robotiq_gripper_is_reached_by_rtu_over_tcp(tmp_path: Path) -> None:
    with on_tcp("modbus_server.py", kind="robotiq") as (port, _):
        moved = state(gripper(tmp_path, port, "move", "40", "--speed-mm-s", "150"))
        assert abs(float(moved["width_mm"]) - 40) < 0.2


def test_a_dh_gripper_is_initialised_once_and_holds(tmp_path: Path) -> None:
    with on_a_wire("modbus_server.py", "dh", held=400.0) as (wire, server):
        moved = state(gripper(tmp_path, wire.host_port, "move", "10", kind="dh"))
        assert (moved["width_mm"], moved["object_detected"]) == ("20.00", "true")
        assert server.commands()[0].startswith("00a5")
        state(gripper(tmp_path, wire.host_port, "activate", kind="dh"))
        assert server.commands() == []


def test_an_onrobot_gripper_moves_and_holds(tmp_path: Path) -> None:
    with on_tcp("modbus_server.py", "300", kind="onrobot") as (port, server):
        moved = state(gripper(tmp_path, port, "move", "80", "--force", "0.5", kind="on_robot"))
        assert (moved["width_mm"], moved["object_detected"]) == ("80.00", "false")
        assert server.commands() == ["00c8 0320 0001"], "20 N of 40, 80 mm, grip"
        moved = state(gripper(tmp_path, port, "move", "10", kind="on_robot"))
        assert (moved["width_mm"], moved["object_detected"]) == ("30.00", "true")


@pytest.mark.parametrize("kind", ["dynamixel", "feetech"])
def test_a_servo_gripper_moves_and_holds(tmp_path: Path, kind: str) -> None:
    """rustypot, a published driver, reads from the same servo what ours wrote."""
    rustypot = pytest.importorskip("rustypot")
    with on_a_wire("servo_server.py", kind, held=1500.0) as (wire, _):
        moved = state(gripper(tmp_path, wire.host_port, "move", "45", kind=kind))
        assert abs(float(moved["width_mm"]) - 45) < 0.1 and moved["object_detected"] == "false"
        controller = rustypot.Xl330PyController if kind == "dynamixel" else rustypot.Sts3215PyController
        other = controller(wire.host_port, 1_000_000, 0.5)
        assert other.read_raw_goal_position(1) == [2500]
        assert abs(other.read_raw_present_position(1)[0] - 2500) <= 2
        del other
        moved = state(gripper(tmp_path, wire.host_port, "move", "0", kind=kind))
        assert abs(float(moved["width_mm"]) - 15) < 0.1 and moved["object_detected"] == "true"
        stopped = state(gripper(tmp_path, wire.host_port, "stop", kind=kind))
        assert abs(float(stopped["width_mm"]) - 15) < 0.1
        other = controller(wire.host_port, 1_000_000, 0.5)
        assert other.read_raw_goal_position(1) == [1000], "a goal at the present position would let go"


@pytest.mark.parametrize(
    "faults",
    [
        Faults(drop=0.2, seed=3),
        Faults(double=0.3, seed=4),
        Faults(change=0.2, seed=5),
        Faults(late=0.2, late_s=0.15, seed=6),
        Faults(split=1.0, seed=7),
    ],
    ids=["dropped", "doubled", "changed", "late", "split"],
)
def test_faults_on_the_line_do_not_change_what_the_gripper_does(tmp_path: Path, faults: Faults) -> None:
    with robotiq(faults) as (wire, server):
        moved = state(gripper(tmp_path, wire.host_port, "move", "60", "--speed-mm-s", "150"))
        assert abs(float(moved["width_mm"]) - 60) < 0.2
        assert server.commands()[-1] == "0900 0046 ff33"


def test_a_gripper_that_vanishes_is_an_error_in_words(tmp_path: Path) -> None:
    with robotiq() as (wire, _):
        state(gripper(tmp_path, wire.host_port, "activate"))
        wire.cut = True
        silent = gripper(tmp_path, wire.host_port, "status")
        assert silent.returncode == 2
        assert f"the gripper on {wire.host_port} has not answered for" in silent.stderr


def test_another_driver_agrees_with_the_server(tmp_path: Path) -> None:
    """pyRobotiqGripper moves the same server as we do: the server is no echo of our own reading of the
    manual.
    """
    driver = pytest.importorskip("pyrobotiqgripper")
    with robotiq() as (wire, server):
        other = driver.RobotiqGripper(com_port=wire.host_port, device_id=9)
        other.connect()
        other.activate()
        other.move(100)
        other.disconnect()
        ours = state(gripper(tmp_path, wire.host_port, "status"))
        assert abs(float(ours["width_mm"]) - 85 * 130 / 227) < 0.4
        assert server.commands()[-1].split()[1] == "0064"


def test_a_urcap_moves_and_holds(tmp_path: Path) -> None:
    """pyrobotiqur, a published client of the URCap, moves the same server as we do."""
    client = pytest.importorskip("pyrobotiqur")
    with on_tcp("urcap_server.py", "180") as (port, server):
        ours = state(gripper(tmp_path, port, "activate", kind="robotiq_urcap"))
        assert ours["object_detected"] == "false"
        with client.RobotiqGripper("127.0.0.1", int(port.rsplit(":", 1)[1])) as other:
            other.activate()
            assert other.move(100, speed=255) == (100, 3)
        server.commands()
        moved = state(gripper(tmp_path, port, "move", "40", "--speed-mm-s", "150", kind="robotiq_urcap"))
        assert abs(float(moved["width_mm"]) - 40) < 0.2 and moved["object_detected"] == "false"
        assert server.commands() == ["0900 007b ff33"], "one line sets it all, and nothing is activated again"
        held = state(gripper(tmp_path, port, "move", "0", "--speed-mm-s", "150", kind="robotiq_urcap"))
        assert abs(float(held["width_mm"]) - 85 * 50 / 227) < 0.2 and held["object_detected"] == "true"


def test_python_drives_the_same_gripper_by_pyserial() -> None:
    with (
        robotiq(held=180.0) as (wire, server),
        gelstereo.grippers.open("robotiq", wire.host_port, model="2f85") as hand,
    ):
        hand.activate()
        held = hand.move(0.0, speed_mm_s=150.0)
        assert held.object_detected and abs(held.width_mm - 85 * 50 / 227) < 0.2
        assert repr(held) == "GripperStatus(width_mm=18.722, moving=False, object_detected=True)"
        commands = server.commands()
        hand.activate()
        assert server.commands() == [], f"no second activation after {commands}"
        with pytest.raises(
            gelstereo.GripperError, match=r"asked for 120.000 mm; it can have 0.000 to 85.000 mm"
        ):
            hand.move(120.0)
        with pytest.raises(gelstereo.GripperError, match="can move at 20 to 150 mm/s"):
            hand.start(20.0, speed_mm_s=500.0)
        wire.cut = True
        with pytest.raises(gelstereo.GripperError, match="has not answered"):
            hand.status()


def test_ctrl_c_ends_an_activation_from_python(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ACTIVATION_S", "600")
    with (
        robotiq() as (wire, server),
        gelstereo.grippers.open("robotiq", wire.host_port, model="2f85") as hand,
    ):
        threading.Timer(1.0, os.kill, (os.getpid(), signal.SIGINT)).start()
        with pytest.raises(KeyboardInterrupt):
            hand.activate()
        commands = [server.next_command() for _ in range(3)]
        assert commands == ["0000 0000 0000", "0100 0000 0000", "0000 0000 0000"]


def test_settings_of_grippers_are_checked_in_python() -> None:
    with pytest.raises(gelstereo.GripperError, match="gripper port /dev/nothing"):
        gelstereo.grippers.open("robotiq", "/dev/nothing", model="2f85")
    with robotiq() as (wire, _):
        with pytest.raises(gelstereo.GripperError, match="unknown field `modle`"):
            gelstereo.grippers.open("robotiq", wire.host_port, modle="2f85")
        with pytest.raises(gelstereo.GripperError, match="unknown variant `robotic`"):
            gelstereo.grippers.open("robotic", wire.host_port)
        with pytest.raises(gelstereo.GripperError, match="counts must rise"):
            table = {"points": [(230, 0.0), (3, 85.0)], "max_error_mm": 0.5}
            gelstereo.grippers.open("dh", wire.host_port, widths=table)
