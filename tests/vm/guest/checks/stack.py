"""The devices themselves: the kernel's drivers accept them. What fails here is the tests' fault and not the
host's.
"""

from __future__ import annotations

import os
from pathlib import Path

from guest.checks import Figures, check
from guest.devices import camera
from guest.usb.camera import plugged


@check(limit_s=120)
def uvcvideo_and_usbhid_bind_to_the_camera() -> Figures:
    device = camera(serial="GS0001")
    with plugged(device):
        name = (
            Path("/sys/class/video4linux", device.video_node.name, "name").read_text(encoding="utf-8").strip()
        )
        assert name == "Stereo Camera GS0001", name
        driver = Path("/sys/class/video4linux", device.video_node.name, "device/driver").resolve().name
        assert driver == "uvcvideo", driver
        lengths = {
            len(Path("/sys/class/hidraw", node.name, "device/report_descriptor").read_bytes())
            for node in device.nodes("hidraw")
        }
        assert lengths == {29, 23}, lengths
        control = device.control_node
        file = os.open(control, os.O_RDWR)
        os.write(file, bytes([0, 0x78, 0x01]).ljust(65, b"\0"))
        answer = os.read(file, 64)
        os.close(file)
        assert answer[:6] == bytes([0x78, 0x01]) + (8000).to_bytes(4, "big"), answer.hex()
    return {"name": name}
