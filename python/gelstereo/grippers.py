"""Grippers from Python, for bench work: ``gelstereo-host``'s drivers over pyserial.

>>> import gelstereo
>>> with gelstereo.grippers.open("robotiq", "/dev/ttyUSB0", model="2f85") as gripper:  # doctest: +SKIP
...     gripper.activate()
...     gripper.move(20.0, speed_mm_s=50.0, force=0.2)
GripperStatus(width_mm=20.115, moving=False, object_detected=True)
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from gelstereo._native import GripperDriver, GripperError, GripperStatus

if TYPE_CHECKING:
    from types import TracebackType

    from typing_extensions import Self

__all__ = ["Gripper", "GripperError", "GripperStatus", "open"]

#: Interval of status requests during a move. A Robotiq gripper reports a fault after a second without a
#: request.
_POLL_S = 0.02
_DEFAULT_BAUD_RATES: Mapping[str, int] = {"dynamixel": 1_000_000, "feetech": 1_000_000}


class Gripper:
    """A gripper on an open port, and a context manager that closes the port and leaves the fingers as they
    are.
    """

    def __init__(self, driver: GripperDriver, port: Any) -> None:
        self._driver, self._port = driver, port

    def __repr__(self) -> str:
        return f"<Gripper on {getattr(self._port, 'name', None) or 'a port'}>"

    def activate(self) -> None:
        """Activate the gripper and wait until it is ready. Some grippers sweep their fingers unless they are
        active already.

        Ctrl-C stops the fingers.

        Raises
        ------
        GripperError
            If the gripper holds an object that activation would drop, reports a fault, does not answer, or is
            not ready after 15 s.
        """
        self._driver.activate()
        try:
            while self._driver.status().moving:
                time.sleep(_POLL_S)
        except BaseException:
            self._driver.stop()
            raise

    def move(
        self, width_mm: float, *, speed_mm_s: float = 50.0, force: float = 0.2, timeout_s: float = 30.0
    ) -> GripperStatus:
        """Move to an opening width and wait until the fingers stop; Ctrl-C stops them.

        Parameters
        ----------
        width_mm
            Opening width between the pads.
        speed_mm_s
            Rate of change of the opening width.
        force
            Fraction of the gripper's range of force, 0 to 1.
        timeout_s
            Time limit of the move, after which the fingers are stopped.

        Raises
        ------
        GripperError
            If a value is outside the gripper's range, the gripper reports a fault or does not answer, or the
            move exceeds `timeout_s`.
        """
        self._driver.move_to(width_mm, speed_mm_s, force)
        deadline_s = time.monotonic() + timeout_s
        try:
            while (status := self._driver.status()).moving:
                if time.monotonic() > deadline_s:
                    raise GripperError(
                        f"the fingers still move after {timeout_s} s, at {status.width_mm:.1f} mm; they were "
                        "stopped"
                    )
                time.sleep(_POLL_S)
        except BaseException:
            self._driver.stop()
            raise
        return status

    def start(self, width_mm: float, *, speed_mm_s: float = 50.0, force: float = 0.2) -> None:
        """Start a move without waiting; arguments and errors as for `move`."""
        self._driver.move_to(width_mm, speed_mm_s, force)

    def stop(self) -> None:
        """Stop the fingers in place."""
        self._driver.stop()

    def status(self) -> GripperStatus:
        """Present width and state."""
        return self._driver.status()

    def close(self) -> None:
        """Close the port. The fingers stay in place."""
        self._port.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


def open(kind: str, port: str, **settings: Any) -> Gripper:
    """Open a gripper's port; nothing moves.

    Parameters
    ----------
    kind
        ``"robotiq"``, ``"robotiq_urcap"``, ``"dh"``, ``"on_robot"``, ``"dynamixel"`` or ``"feetech"``.
    port
        A serial port, or a URL of pyserial's ``serial_for_url``: ``socket://192.168.1.11:63352`` is a TCP
        connection.
    settings
        The other settings of the configuration's table ``[gripper]``, such as ``model="2f85"``, ``unit=9``,
        ``baud_rate=115200`` or ``widths={"points": [(3, 85.0), (230, 0.0)], "max_error_mm": 0.5}``.

    Raises
    ------
    GripperError
        If a setting is not valid, pyserial is missing or the port cannot be opened.
    """
    try:
        import serial
    except ImportError as error:
        raise GripperError("grippers need pyserial, which is not installed: pip install pyserial") from error
    baud_rate = settings.get("baud_rate", _DEFAULT_BAUD_RATES.get(kind, 115_200))
    try:
        line = serial.serial_for_url(port, baudrate=baud_rate)
    except (OSError, ValueError) as error:
        raise GripperError(f"gripper port {port}: {error}") from error
    try:
        return Gripper(GripperDriver({"kind": kind, "port": port, **settings}, line, port), line)
    except BaseException:
        line.close()
        raise
