"""The devices of the checks, with settings that suit them."""

from __future__ import annotations

from pathlib import Path

from guest.usb.camera import Camera
from guest.usb.descriptors import Mode

OUT = Path("/out")
# A mode for each kind of frames. Decoding under emulation takes some 0.4 us a pixel, so that only one is of
# usual size.
MODES = {
    "large": Mode(width=2560, height=720, rate_hz=30.0),
    "gel": Mode(width=1280, height=480, rate_hz=4.0),
    "stereo": Mode(width=640, height=240, rate_hz=30.0),
    "left": Mode(width=320, height=240, rate_hz=15.0),
    "right": Mode(width=320, height=240, rate_hz=15.0),
}


def frames(kind: str) -> list[bytes]:
    """The JPEG files of a kind that the host made."""
    return [path.read_bytes() for path in sorted((OUT / "frames").glob(f"{kind}_*.jpg"))]


def camera(serial: str, port: int = 0, kind: str = "stereo") -> Camera:
    """A camera that sends those files, not yet plugged in."""
    return Camera(port, serial, MODES[kind], frames(kind))
