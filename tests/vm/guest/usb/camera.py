"""A stereo camera on USB: video by UVC, and e-con Tara's HID interfaces beside it."""

from __future__ import annotations

import fcntl
import socket
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from guest.modules import modprobe
from guest.usb import descriptors as d
from guest.usb.tara import OUT_ENDPOINT, Tara
from guest.usb.usbip import CONTROLLER, Port, Setup
from guest.usb.uvc import Frame, Video

TARA_VENDOR, TARA_PRODUCT = 0x2560, 0xC114
# _IO('U', 20) of linux/usbdevice_fs.h.
USBDEVFS_RESET = 0x5514
GET_STATUS, CLEAR_FEATURE, GET_DESCRIPTOR, SET_CONFIGURATION, SET_INTERFACE = 0, 1, 6, 9, 11


class Camera:
    """A camera that is plugged in by `plug` and unplugged by `unplug`, as often as one likes."""

    def __init__(self, port: int, serial: str, mode: d.Mode, frames: Sequence[bytes]) -> None:
        self.serial = serial
        self.video = Video(mode, [Frame(data) for data in frames])
        self.tara = Tara()
        self._number = port
        self._port: Port | None = None
        self._configuration = d.configuration(mode)

    def plug(self) -> None:
        """Plugs the camera in and waits until the kernel's drivers have made its device nodes."""
        modprobe("vhci-hcd", "uvcvideo", "usbhid", "hid-generic")
        self._start(Port(self, self._number))
        wait_for(
            lambda: len(self.nodes("video4linux")) >= 2 and len(self.nodes("hidraw")) == 2, "its device nodes"
        )

    def serve(self, link: socket.socket) -> None:
        """Answers another computer, which plugs the other end of this connection in."""
        self._start(Port(self, self._number, link))

    def unplug_link(self) -> None:
        """Unplugs a camera that another computer has plugged in."""
        if self._port is not None:
            self._port.detach()
            self._port = None

    def _start(self, port: Port) -> None:
        self._port = port
        for send_for_ever in (self.video.send_for_ever, self.tara.send_for_ever):
            threading.Thread(target=send_for_ever, args=(port,), daemon=True).start()

    def unplug(self) -> None:
        """Unplugs the camera."""
        if self._port is not None:
            self._port.detach()
            self._port = None
            wait_for(lambda: not self.nodes("video4linux"), "its device nodes to vanish")

    def reset(self) -> None:
        """Resets the device on its port, as a hub or ``usbreset`` does: the kernel binds its drivers anew."""
        interface = Path("/sys/class/video4linux", self.video_node.name, "device").resolve()
        number = {name: int((interface.parent / name).read_text()) for name in ("busnum", "devnum")}
        node = Path("/dev/bus/usb", f"{number['busnum']:03}", f"{number['devnum']:03}")
        with node.open("wb") as file:
            fcntl.ioctl(file, USBDEVFS_RESET)

    def nodes(self, class_: str) -> list[Path]:
        """Device nodes of a class (``video4linux``, ``hidraw``) that belong to this camera, by its serial
        number.
        """
        entries = sorted(Path("/sys/class", class_).glob("*"))
        return [Path("/dev", entry.name) for entry in entries if self.serial in serials(entry)]

    @property
    def video_node(self) -> Path:
        """The node that captures (the other one carries the camera's metadata)."""
        names = {
            Path("/sys/class/video4linux", n.name, "index").read_text().strip(): n
            for n in self.nodes("video4linux")
        }
        return names["0"]

    @property
    def control_node(self) -> Path:
        """The HID node that takes commands (the other one is the IMU's)."""
        reports = {
            n: Path("/sys/class/hidraw", n.name, "device/report_descriptor").read_bytes()
            for n in self.nodes("hidraw")
        }
        return next(node for node, found in reports.items() if found == d.CONTROL_REPORTS)

    def control(self, setup: Setup, data: bytes) -> bytes | None:
        """Answers a control request to the device or one of its interfaces."""
        if setup.request_type & 0x60 == 0x20:
            number = setup.index & 0xFF
            # HID requests (SET_IDLE, SET_PROTOCOL) change nothing here.
            return b"" if number in (d.HID_CONTROL, d.HID_IMU) else self.video.control(setup, data)
        if setup.request == GET_DESCRIPTOR:
            return self._descriptor(setup)
        if setup.request in (CLEAR_FEATURE, SET_CONFIGURATION, SET_INTERFACE):
            return b""
        return b"\0\0" if setup.request == GET_STATUS else None

    def _descriptor(self, setup: Setup) -> bytes | None:
        kind, index = setup.value >> 8, setup.value & 0xFF
        if setup.request_type == 0x81:
            reports = {d.HID_CONTROL: d.CONTROL_REPORTS, d.HID_IMU: d.IMU_REPORTS}
            return reports.get(setup.index) if kind == d.REPORT else None
        strings = [None, "gelstereo tests", f"Stereo Camera {self.serial}", self.serial]
        if kind == 1:
            return d.device(TARA_VENDOR, TARA_PRODUCT)
        if kind == 2:
            return self._configuration
        return d.string(strings[index]) if kind == 3 and index < len(strings) else None

    def received(self, endpoint: int, data: bytes) -> None:
        """Takes a HID report."""
        if endpoint == OUT_ENDPOINT:
            self.tara.received(data)


def serials(entry: Path) -> list[str]:
    """Serial numbers of the device of a node and of its parents; none if it vanishes meanwhile."""
    try:
        device = (entry / "device").resolve()
        files = [parent / "serial" for parent in [device, *device.parents]]
        return [file.read_text(encoding="utf-8").strip() for file in files if file.exists()]
    except OSError:
        return []


@contextmanager
def plugged(*cameras: Camera) -> Iterator[None]:
    """Cameras that are unplugged at the end, however it comes."""
    try:
        for camera in cameras:
            camera.plug()
        yield
    finally:
        for camera in cameras:
            camera.unplug()


def wait_for(condition: object, what: str, limit_s: float = 30.0) -> None:
    """Waits until a condition holds."""
    assert callable(condition)
    end = time.monotonic() + limit_s
    while not condition():
        if time.monotonic() > end:
            raise TimeoutError(
                f"waited {limit_s:.0f} s for {what}; ports: {(CONTROLLER / 'status').read_text()}"
            )
        time.sleep(0.05)
