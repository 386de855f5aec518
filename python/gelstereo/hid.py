"""HID devices of a sensor: the control interface of an e-con Tara camera, and blink(1) lights.

Reports are transferred by the library hidapi, on every system that it supports. The same code as in
``gelstereo-host`` encodes and decodes them.

    with gelstereo.hid.TaraControl.open() as camera:
        camera.set_exposure_us(8000)
    with gelstereo.hid.Blink1Light.open() as light:
        light.set((255, 255, 255))
"""

from __future__ import annotations

import importlib
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from gelstereo._native import Blink1Command, HidError, TaraAssembly, TaraRequest, hid_udev_rule

if TYPE_CHECKING:
    from types import ModuleType, TracebackType

    from typing_extensions import Self

__all__ = ["Blink1Light", "HidError", "HidInfo", "TaraControl", "devices"]

_REPORT_BYTES = 64
#: Number of reports that Linux buffers per reader. It bounds the reading, so that a device that sends without
#: end cannot block the caller.
_MAX_WAITING = 64


@dataclass(frozen=True)
class HidInfo:
    """A HID device as listed by the system. A USB device with several HID interfaces has one
    entry for each.
    """

    path: str
    """Path of the device, such as ``/dev/hidraw0``."""
    vendor: int
    """USB vendor."""
    product: int
    """USB product."""
    serial: str
    """Serial number; empty if the device has none."""
    name: str
    """Product name."""
    interface: int
    """Number of the USB interface; -1 on other buses."""

    def __str__(self) -> str:
        serial = f" serial {self.serial}" if self.serial else ""
        return f'{self.vendor:04x}:{self.product:04x} "{self.name}"{serial} at {self.path}'


def devices() -> list[HidInfo]:
    """All HID devices.

    Raises
    ------
    HidError
        If hidapi is not installed.
    """
    return [
        HidInfo(
            path=found["path"].decode(),
            vendor=found["vendor_id"],
            product=found["product_id"],
            serial=found["serial_number"] or "",
            name=found["product_string"] or "",
            interface=found["interface_number"],
        )
        for found in _hidapi().enumerate()
    ]


class _Device:
    """An open device; base class of both kinds."""

    VENDOR: ClassVar[int]
    PRODUCT: ClassVar[int]

    def __init__(self, info: HidInfo) -> None:
        """Open a device of `devices`.

        Raises
        ------
        HidError
            If the system denies access. The message gives the udev rule that would allow it.
        """
        self.info = info
        self._device = _opened(info)

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {self.info}>"

    @classmethod
    def _fitting(cls, serial: str | None) -> list[HidInfo]:
        found = [info for info in devices() if (info.vendor, info.product) == (cls.VENDOR, cls.PRODUCT)]
        return [info for info in found if serial is None or info.serial == serial]

    @classmethod
    def open(cls, serial: str | None = None) -> Self:
        """Open the only connected device of this kind, or the one with this serial number.

        Raises
        ------
        HidError
            If there is none or more than one, or if the system denies access.
        """
        found = cls._fitting(serial)
        wanted = f"{cls.VENDOR:04x}:{cls.PRODUCT:04x}" + (f" with serial number {serial}" if serial else "")
        if not found:
            there = ", ".join(map(str, devices())) or "none"
            raise HidError(f"there is no HID device {wanted}; HID devices found: {there}")
        if len(found) > 1:
            raise HidError(
                f"several HID devices match: {', '.join(map(str, found))}; give the serial number of one"
            )
        return cls(found[0])

    def close(self) -> None:
        """Close the device; it keeps its settings."""
        self._device.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _failed(self, action: str, error: object) -> HidError:
        return HidError(f"cannot {action} {self.info}: {error}; is it still plugged in?")


class TaraControl(_Device):
    """Settings of an e-con Tara camera that are not available through its video interface."""

    VENDOR = TaraRequest.VENDOR
    PRODUCT = TaraRequest.PRODUCT

    @classmethod
    def _fitting(cls, serial: str | None) -> list[HidInfo]:
        """The control interfaces; the camera's other HID interface belongs to its IMU."""
        found = super()._fitting(serial)
        return [info for info in found if _descriptor_bytes(info) == TaraRequest.CONTROL_DESCRIPTOR_BYTES]

    def firmware(self) -> str:
        """Version of the firmware."""
        return str(self._ask(TaraRequest.firmware()))

    def unique_id(self) -> int:
        """Unique number of this camera."""
        return int(self._ask(TaraRequest.unique_id()))

    def exposure_us(self) -> int:
        """Exposure time, microseconds; 1 if the camera controls it."""
        return int(self._ask(TaraRequest.exposure()))

    def set_exposure_us(self, exposure_us: int) -> int:
        """Set the exposure time and return the one that the camera accepted.

        Parameters
        ----------
        exposure_us : int
            10 to 1000000 microseconds, or 1 to let the camera control it.
        """
        return int(self._ask(TaraRequest.set_exposure(exposure_us)))

    def stream_mode(self) -> str:
        """Source of the frame trigger: "master" (the camera's clock) or "trigger"."""
        return str(self._ask(TaraRequest.stream_mode()))

    def set_stream_mode(self, mode: Literal["master", "trigger"]) -> str:
        """Set the source of the frame trigger and return the one that the camera accepted."""
        return str(self._ask(TaraRequest.set_stream_mode(mode)))

    def hdr(self) -> bool:
        """Whether high dynamic range is on."""
        return bool(self._ask(TaraRequest.hdr()))

    def set_hdr(self, on: bool) -> bool:
        """Switch high dynamic range on or off and return the state that the camera accepted."""
        return bool(self._ask(TaraRequest.set_hdr(on)))

    def calibration(self, file: Literal["intrinsic", "extrinsic"]) -> bytes:
        """Read a calibration file that the manufacturer stored in the camera."""
        assembly = TaraAssembly(self._ask(TaraRequest.calibration_length(file)))
        request = TaraRequest.calibration_data(file)
        self._send(request)
        while not assembly.is_complete:
            assembly.push(*self._answer(request))
        return assembly.data

    def _ask(self, request: TaraRequest) -> Any:
        self._send(request)
        return self._answer(request)

    def _send(self, request: TaraRequest) -> None:
        # A late answer to an earlier command would be mistaken for this one's.
        for _ in range(_MAX_WAITING):
            if not self._read(0):
                break
        if self._device.write(b"\0" + request.report) < 0:
            raise self._failed("write to", self._device.error())

    def _answer(self, request: TaraRequest) -> Any:
        end_s = time.monotonic() + request.timeout_s
        while (left_s := end_s - time.monotonic()) > 0:
            answer = request.decode(self._read(int(left_s * 1000) + 1))
            if answer is not None:
                return answer
        raise HidError(f"the camera did not {request.name} within {request.timeout_s:.0f} s")

    def _read(self, timeout_ms: int) -> bytes:
        try:
            if timeout_ms == 0:
                self._device.set_nonblocking(1)
                return bytes(self._device.read(_REPORT_BYTES))
            return bytes(self._device.read(_REPORT_BYTES, timeout_ms))
        except OSError as error:
            raise self._failed("read", error) from error


class Blink1Light(_Device):
    """A blink(1) light. Colours are (red, green, blue), 0 to 255 each."""

    VENDOR = Blink1Command.VENDOR
    PRODUCT = Blink1Command.PRODUCT

    def version(self) -> tuple[int, int]:
        """Major and minor version of the firmware."""
        return Blink1Command.decode_version(self._fetch(Blink1Command.version()))

    def color(self, led: int = 0) -> tuple[int, int, int]:
        """The colour of a light: ``led`` is 1 or 2, or 0 for the colour that the device reports for both."""
        return Blink1Command.decode_color(self._fetch(Blink1Command.read(led)))

    def set(self, color: Sequence[int], led: int = 0) -> None:
        """Change to a colour at once; ``led`` is 0 for all lights, 1 or 2."""
        self._send(Blink1Command.set(color, led))

    def fade(self, color: Sequence[int], fade_ms: int, led: int = 0) -> None:
        """Change to a colour within a time, milliseconds (0 to 655350)."""
        self._send(Blink1Command.fade(color, fade_ms, led))

    def off(self) -> None:
        """Switch all lights off."""
        self.set((0, 0, 0))

    def _send(self, command: Blink1Command) -> None:
        if self._device.send_feature_report(command.report) < 0:
            raise self._failed("send a feature report to", self._device.error())

    def _fetch(self, command: Blink1Command) -> bytes:
        self._send(command)
        try:
            return bytes(self._device.get_feature_report(command.report[0], len(command.report)))
        except OSError as error:
            raise self._failed("fetch a feature report from", error) from error


def _hidapi() -> ModuleType:
    """The library hidapi. On Linux it uses hidraw, so the kernel's drivers stay bound to the device."""
    missing = None
    for name in ("hidraw", "hid"):
        try:
            return importlib.import_module(name)
        except ImportError as error:
            missing = error
    raise HidError("HID devices need hidapi, which is not installed: pip install hidapi") from missing


def _opened(info: HidInfo) -> Any:
    device = _hidapi().device()
    try:
        device.open_path(info.path.encode())
    except OSError as error:
        raise HidError(
            f"{info} cannot be opened ({error}). Where permission is missing, put this line into "
            f"/etc/udev/rules.d/70-gelstereo.rules, add yourself to the group plugdev and plug the device in "
            f"again: {hid_udev_rule(info.vendor, info.product)}"
        ) from error
    return device


def _descriptor_bytes(info: HidInfo) -> int:
    """Length of the report descriptor, which distinguishes the HID interfaces of one device."""
    device = _opened(info)
    try:
        return len(device.get_report_descriptor())
    finally:
        device.close()
