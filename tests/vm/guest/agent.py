"""Does in the VM what the test outside asks for, one line of JSON each.

usage: agent.py HOST PORT
"""

from __future__ import annotations

import json
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from guest.modules import modprobe
from guest.usb.usbip import attach

Answer = dict[str, Any]
processes: list[subprocess.Popen[str]] = []


def plug_camera(host: str, port: int) -> Answer:
    """Plugs a camera in that is made outside; its device nodes."""
    modprobe("vhci-hcd", "uvcvideo", "usbhid", "hid-generic")
    with socket.create_connection((host, port)) as link:
        link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        attach(0, link)
    return {"nodes": nodes("video4linux", 2)}


def serial_ports() -> Answer:
    """Serial adapters, their drivers and the time that they keep bytes back."""
    modprobe("xhci-pci", "ftdi_sio")
    found = nodes("tty", 1, "ttyUSB")
    device = Path("/sys/class/tty", found[0], "device")
    # The driver adds it after the node.
    timer = device / "latency_timer"
    until(timer.exists, f"no {timer}")
    latency_ms = timer.read_text(encoding="ascii").strip()
    return {"nodes": found, "driver": (device / "driver").resolve().name, "latency_ms": int(latency_ms)}


def nodes(class_: str, count: int, prefix: str = "") -> list[str]:
    """Names of a class's devices, once there are so many."""
    found: list[str] = []

    def are_there() -> bool:
        found[:] = sorted(entry.name for entry in Path("/sys/class", class_).glob(f"{prefix}*"))
        return len(found) >= count

    until(are_there, f"no {count} devices of {class_}")
    return found


def until(is_so: Callable[[], bool], fault: str) -> None:
    """Waits for half a minute."""
    for _ in range(600):
        if is_so():
            return
        time.sleep(0.05)
    raise TimeoutError(f"{fault} in 30 s")


def run(arguments: list[str]) -> Answer:
    """Runs a program to its end."""
    process = subprocess.Popen(arguments, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    processes.append(process)
    said, errors = process.communicate()
    processes.remove(process)
    return {"code": process.returncode, "said": said, "errors": errors}


def kill() -> Answer:
    """Kills the programs that run."""
    for process in list(processes):
        process.kill()
    return {}


ASKS: dict[str, Callable[..., Answer]] = {
    function.__name__: function for function in (plug_camera, serial_ports, run, kill)
}


def serve(connection: socket.socket) -> None:
    """Each request has a thread of its own, so that a program can be killed while it runs."""
    lock = threading.Lock()
    lines = connection.makefile("rw", encoding="utf-8")

    def answer(line: str) -> None:
        request = json.loads(line)
        try:
            done = ASKS[request["ask"]](**request["arguments"])
        except Exception as error:
            done = {"failure": repr(error)}
        with lock:
            lines.write(json.dumps({"id": request["id"], **done}) + "\n")
            lines.flush()

    for line in lines:
        threading.Thread(target=answer, args=(line,), daemon=True).start()


if __name__ == "__main__":
    with socket.create_connection((sys.argv[1], int(sys.argv[2]))) as outside:
        serve(outside)
