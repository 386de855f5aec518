"""The whole task with the kernel's own drivers: uvcvideo for the camera and ftdi_sio for the gripper, in a
VM.

Inside run the kernel and gelstereo-host. Outside run the world, the USB camera (by USB/IP over TCP), the
gripper (pymodbus behind QEMU's FTDI adapter) and the robot's bridge.
"""

from __future__ import annotations

import json
import os
import shutil
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import image
import machine
import pytest
from gripper_peers.wire import Wire
from guest.usb.descriptors import Mode
from peers import Agent, WorldCamera, listen
from test_recording_readers import host_binary
from whole_task.cell import Cell, Outcome, Setting
from whole_task.judge import Delay, assert_at_rest, assert_triggers, assert_true, frames, lost_frames

import gelstereo

pytestmark = [pytest.mark.long, pytest.mark.realtime]

REPOSITORY = Path(__file__).resolve().parents[2]
OUTSIDE = "10.0.2.2"
SERIAL = "GS2024"
# Under software emulation the host needs 0.2 s for a frame of this size. Frames were lost at 6 Hz, and beside
# one busy process at 4 Hz in a third of the tasks, and with them the markers. All speeds follow from the
# rate: the drag of the part at the bottom of the hole must stay below half a marker's distance from frame to
# frame.
MODE = Mode(width=640, height=240, rate_hz=3.0)
TASK = """
[task]
open_width_mm = 11.5
opening_speed_mm_s = 100.0
closing_speed_mm_s = 1.5
insertion_speed_mm_s = 0.5
move_speed_mm_s = 150.0
insertion_depth_mm = 4.0
approach_mm = 1.0
overtravel_mm = 3.0
frame_timeout_s = 4.0
# An emulated computer on a busy one took 0.52 s for a frame, over the default of three periods.
max_late_periods = 12.0
device_timeout_s = 2.0
[part]
spacing_mm = 0.6
[part.shape]
kind = "cylinder"
radius_mm = 4.5
length_mm = 40.0
"""
SIMULATED = """
frame_rate_hz = 3.0
hole_diameter_mm = 9.6
[simulated.gel]
rows = 13
cols = 13
"""
#: `GELSTEREO_VM_SEEDS=20` for the documented ones.
SEEDS = range(1, 1 + int(os.environ.get("GELSTEREO_VM_SEEDS", "4")))
UNTRIED = "untried: the emulated computer was late"
#: The host's words for a gripper whose answer did not arrive in time.
SILENT = "has not answered"
# The camera's time limit of the task, and what an emulated computer adds.
MAX_MOTION_S = 8.0


def rig() -> str:
    """The default rig cut down to 320 x 240 pixels of each view, around the middle of the gel."""
    text = gelstereo.Scene().rig.to_toml()
    for old, new in (("640", "320"), ("480", "240"), ("239.5", "119.5")):
        text = text.replace(old, new)
    return text.replace("319.5", "81.5", 1).replace("319.5", "237.5", 1)


class Vm:
    """A VM that runs, with the camera and the serial adapter plugged in."""

    def __init__(self, booted: image.Image, out: Path) -> None:
        self.out, self.wire, self._monitor = out, Wire(), out / "monitor"
        self.outcome: machine.Outcome | None = None
        shutil.copy(host_binary(), out / "gelstereo-host")
        with listen() as agent, listen() as camera:
            self._machine = threading.Thread(
                target=self._run, args=(booted, agent.getsockname()[1]), daemon=True
            )
            self._machine.start()
            agent.settimeout(machine.LIMIT_S)
            self.agent = Agent(agent.accept()[0])
            plugging: list[Any] = []
            camera_port = camera.getsockname()[1]
            thread = threading.Thread(
                target=lambda: plugging.append(self.agent.ask("plug_camera", host=OUTSIDE, port=camera_port))
            )
            thread.start()
            camera.settimeout(60)
            self.camera = WorldCamera(MODE, SERIAL, camera.accept()[0])
            thread.join()
        assert plugging, "the camera's device nodes did not appear"
        self.serial = self.agent.ask("serial_ports")
        self.agent.ask("run", arguments=["/bin/cp", "/out/gelstereo-host", "/dev/shm/"])

    def _run(self, booted: image.Image, agent_port: int) -> None:
        agent = Path(__file__).parent / "guest" / "agent.py"
        script = (
            "/bin/busybox modprobe virtio_net\n"
            "/bin/busybox ip link set eth0 up\n"
            "/bin/busybox ip addr add 10.0.2.15/24 dev eth0\n"
            f"exec '{sys.executable}' '{agent}' {OUTSIDE} {agent_port}\n"
        )
        devices = ["-netdev", "user,id=net", "-device", "virtio-net-pci,netdev=net", "-device", "qemu-xhci"]
        devices += ["-chardev", f"serial,id=line,path={self.wire.host_port}"]
        devices += ["-device", "usb-serial,chardev=line,id=adapter"]
        devices += ["-qmp", f"unix:{self._monitor},server=on,wait=off"]
        self.outcome = machine.run(booted, script, self.out, limit_s=1500.0, devices=devices)

    def start(self, seed: int) -> Cell:
        """A world, a gripper and a robot for one task."""
        folder = self.out / str(seed)
        folder.mkdir()
        cell = Cell(folder, Setting(seed, "dh", TASK, SIMULATED, rig()), self.wire)
        source = f'kind = "camera"\ndevice = "serial:{SERIAL}"\nsize_px = [{MODE.width}, {MODE.height}]\n'
        source += f"frame_rate_hz = {MODE.rate_hz}"
        inside = Path("/out") / str(seed)
        cell.configure(source, f"/dev/{self.serial['nodes'][0]}", OUTSIDE, inside / "run.mcap")
        self.camera.film(cell.address)
        return cell

    def vanish(self, seed: int, event: str, count: int, unplug: Callable[[], object]) -> Outcome:
        """Unplugs something after so many of these events of a task, which must end with nothing moving."""
        with task(self, seed) as cell, ThreadPoolExecutor(1) as pool:
            running = pool.submit(self.run_task, cell)
            cell.wait_for(event, count, running.done)
            unplug()
            unplugged_ns = time.monotonic_ns()
            outcome = running.result()
            assert_at_rest(cell, unplugged_ns, MAX_MOTION_S)
        return outcome

    def run_task(self, cell: Cell) -> Outcome:
        """Runs the host inside to its end."""
        arguments = [
            "/dev/shm/gelstereo-host",
            "run",
            "--config",
            f"/out/{cell.folder.name}/cell.toml",
            "--json",
        ]
        done = self.agent.ask("run", limit_s=90.0, arguments=arguments)
        return cell.outcome(done["code"], done["said"], done["errors"])

    def unplug_adapter(self) -> None:
        # QEMU 7.2 crashes in usb_wakeup() if a byte arrives for an adapter that was removed.
        self.wire.cut = True
        time.sleep(0.2)
        self.monitor("device_del", id="adapter")

    def plug_adapter(self) -> None:
        self.monitor("device_add", driver="usb-serial", chardev="line", id="adapter")
        self.wire.cut = False
        self.serial = self.agent.ask("serial_ports")

    def monitor(self, command: str, **arguments: str) -> None:
        """Has QEMU's monitor do something."""
        with socket.socket(socket.AF_UNIX) as connection:
            connection.connect(str(self._monitor))
            with connection.makefile("rw", encoding="utf-8") as lines:
                lines.readline()
                for execute, given in (("qmp_capabilities", {}), (command, arguments)):
                    lines.write(json.dumps({"execute": execute, "arguments": given}) + "\n")
                    lines.flush()
                    while "return" not in (answer := json.loads(lines.readline())):
                        assert "error" not in answer, answer

    def close(self) -> None:
        self.agent.close()
        self._machine.join(60)
        self.wire.close()


@pytest.fixture(scope="module")
def vm(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Vm]:
    try:
        booted = image.build(REPOSITORY / "target" / "vm")
    except image.Unavailable as reason:
        if os.environ.get("CI") == "true":
            pytest.fail(f"CI must run the device tests: {reason}")
        pytest.skip(f"no VM for the device tests: {reason}")
    opened = Vm(booted, tmp_path_factory.mktemp("task"))
    yield opened
    opened.close()
    if opened.outcome is not None:
        # Shown with a failure of the last test.
        print(opened.outcome.console[-4000:])


@contextmanager
def task(vm: Vm, seed: int) -> Iterator[Cell]:
    cell = vm.start(seed)
    try:
        with cell.lateness:
            yield cell
    finally:
        cell.close()


def delay(cell: Cell, outcome: Outcome) -> Delay:
    """The outer computer's lateness, and the time that the emulated one took from an image to a stop.

    That time is not judged here, because it is mostly that of the software emulation.
    """
    assert outcome.report is not None
    stops = outcome.report["latency"]["stops"]
    emulated_s = max((stop["image_to_wire_ms"] / 1e3 for stop in stops), default=0.0)
    return Delay(cell.lateness.longest_s + emulated_s, 1.0 / MODE.rate_hz)


def test_the_drivers_are_the_kernels(vm: Vm) -> None:
    assert vm.serial["driver"] == "ftdi_sio", vm.serial


def test_seeds_are_inserted_or_refused_with_a_reason(vm: Vm) -> None:
    begun, lines = time.monotonic(), []
    for seed in SEEDS:
        with task(vm, seed) as cell:
            outcome = vm.run_task(cell)
            lost = lost_frames(cell.recording, vm.camera.sent)
            if outcome.kind == "error" and (lost or SILENT in outcome.errors):
                # The emulated computer was too slow: markers that move too far between frames are lost, a
                # peer gives up a silent host, and bytes of the gripper arrive late.
                lines.append({"seed": seed, "outcome": UNTRIED, "lost_frames": lost})
                continue
            assert_true(outcome)
            recorded = frames(cell.recording, vm.camera.sent)
            exposed = assert_triggers(outcome, recorded, delay(cell, outcome))
            latency = outcome.report["latency"] if outcome.report else None
            lines.append({"seed": seed, "outcome": outcome.kind, "exposed": exposed, "latency": latency})
    summary = {"total_s": time.monotonic() - begun, "serial": vm.serial, "runs": lines}
    (REPOSITORY / "target" / "vm" / "task.json").write_text(json.dumps(summary, indent=1), encoding="utf-8")
    kinds = [line["outcome"] for line in lines]
    assert kinds.count(UNTRIED) <= len(kinds) // 2, f"the computer was too slow too often: {lines}"
    kinds = [kind for kind in kinds if kind != UNTRIED]
    assert kinds.count("inserted") >= 0.75 * len(kinds), kinds


def test_an_adapter_that_is_unplugged_in_mid_grasp_stops_the_task(vm: Vm) -> None:
    """ftdi_sio goes away with the port; the gripper behind it finishes its move."""
    try:
        outcome = vm.vanish(21, "gripper_move", 2, vm.unplug_adapter)
    finally:
        vm.plug_adapter()
    assert outcome.code == 2 and "gripper" in outcome.errors, (outcome.kind, outcome.errors)


def test_a_host_that_is_killed_while_inserting_leaves_the_robot_at_rest(vm: Vm) -> None:
    outcome = vm.vanish(22, "robot_move", 4, lambda: vm.agent.ask("kill"))
    assert outcome.code == -9, (outcome.kind, outcome.errors)


def test_a_camera_that_is_unplugged_while_inserting_stops_the_task(vm: Vm) -> None:
    outcome = vm.vanish(23, "robot_move", 4, vm.camera.unplug)
    named = "pair" in outcome.errors or "camera" in outcome.errors
    assert outcome.code == 2 and named, (outcome.kind, outcome.errors)
