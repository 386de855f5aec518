"""The devices of the checks, with settings that suit them, and loading of kernel modules."""

from __future__ import annotations

import subprocess
from pathlib import Path

from guest.usb.camera import Camera
from guest.usb.descriptors import Mode

OUT = Path("/out")
# As one lens pair of an ELP camera: two views of 640 x 480 side by side.
STEREO = Mode(width=1280, height=480, rate_hz=30.0)
MONO = Mode(width=640, height=480, rate_hz=15.0)


def modprobe(*modules: str) -> None:
    """Loads kernel modules."""
    for module in modules:
        subprocess.run(["/bin/busybox", "modprobe", *module.split()], check=True)


def frames(kind: str) -> list[bytes]:
    """The JPEG files that the host made: ``stereo``, ``left`` or ``right``."""
    return [path.read_bytes() for path in sorted((OUT / "frames").glob(f"{kind}_*.jpg"))]


def camera(serial: str, port: int = 0, kind: str = "stereo") -> Camera:
    """A camera that sends those files, not yet plugged in."""
    return Camera(port, serial, STEREO if kind == "stereo" else MONO, frames(kind))
