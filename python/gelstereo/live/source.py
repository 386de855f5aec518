"""Sources of live stereo frames: a camera, a simulated scene, or a folder of images.

All three return `LiveFrame`, so viewers and recorders can be tried without a camera.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from gelstereo import CameraError, Error, Scene, simulate

Image = npt.NDArray[np.uint8]

_NS_PER_S = 1_000_000_000

#: Default rate of a folder of images: that of the simulated sensor and of most USB cameras.
DEFAULT_RATE_HZ = 30.0


@dataclass(frozen=True)
class LiveFrame:
    """A stereo pair with its capture data, or an event in place of a pair.

    Attributes
    ----------
    left, right : (H, W) uint8
        Images; those of an earlier frame if `stale`.
    sequence : int
        The driver's frame number; for a scene or folder, the number of frames before it.
    time_ns : int
        Exposure time on the source's own clock.
    driver_ns : int or None
        Time when the driver had the images, on the system's monotonic clock. None without a driver.
    received_ns : int or None
        Time when both images were decoded, on the same clock. None without a driver.
    dropped : int
        Frames lost or skipped since the previous frame.
    skew_ns : int
        The right image's time minus the left one's; 0 for one stereo device.
    stale : bool
        Whether no new images arrived.
    event : str or None
        Human-readable event of the source.
    encoded : tuple of bytes
        The camera's JPEG files: one with both views, or left and right; empty if there are none.
    layout : str or None
        Arrangement of the views in a file of both, named as in `gelstereo.cameras`.
    event_fields : dict or None
        The event in machine-readable form, as written by the host: ``event`` is its name, the other entries
        are its figures.
    """

    left: Image
    right: Image
    sequence: int
    time_ns: int
    driver_ns: int | None = None
    received_ns: int | None = None
    dropped: int = 0
    skew_ns: int = 0
    stale: bool = False
    event: str | None = None
    event_fields: dict[str, Any] | None = None
    encoded: tuple[bytes, ...] = ()
    layout: str | None = None


class LiveSource(Protocol):
    """A source of frames. Iteration waits for the next frame, for at most a few seconds."""

    name: str
    rate_hz: float | None

    def __iter__(self) -> Iterator[LiveFrame]: ...

    def close(self) -> None:
        """Release the device; the iteration ends."""


class SceneSource:
    """A simulated scene at its own frame rate, played forwards and backwards without end.

    A press played backwards is a release, so the markers never jump as they would at a restart.
    """

    def __init__(self, scene: Scene | str | Path) -> None:
        self.simulator = simulate(scene)
        if len(self.simulator) == 0:
            raise Error("the scene has no frames")
        self.name = f"scene {Path(scene).name}" if isinstance(scene, str | Path) else "scene"
        self.rate_hz: float | None = float(self.simulator.scene.to_dict()["frame_rate_hz"])
        self.rig = self.simulator.scene.rig
        self._closed = False

    def __iter__(self) -> Iterator[LiveFrame]:
        def pair(index: int) -> tuple[Image, Image]:
            frame = self.simulator[index]
            return frame.left, frame.right

        return _played(len(self.simulator), pair, self.rate_hz or DEFAULT_RATE_HZ, lambda: self._closed)

    def close(self) -> None:
        """End the iteration."""
        self._closed = True


class FolderSource:
    """Images ``left/NAME.png`` and ``right/NAME.png`` of a folder, played forwards and backwards
    without end.
    """

    def __init__(self, folder: Path, rate_hz: float = DEFAULT_RATE_HZ) -> None:
        from gelstereo.cli.files import stereo_pairs

        if not rate_hz > 0.0:
            raise Error(f"rate_hz is {rate_hz}; valid is more than 0")
        self._pairs = stereo_pairs(folder)
        self.name = f"folder {folder}"
        self.rate_hz: float | None = rate_hz
        self._closed = False

    def __iter__(self) -> Iterator[LiveFrame]:
        from gelstereo.cli.files import read_image

        def pair(index: int) -> tuple[Image, Image]:
            left, right = self._pairs[index]
            return read_image(left), read_image(right)

        return _played(len(self._pairs), pair, self.rate_hz or DEFAULT_RATE_HZ, lambda: self._closed)

    def close(self) -> None:
        """End the iteration."""
        self._closed = True


class CameraSource:
    """A camera; device and settings as in `gelstereo.cameras.open`."""

    def __init__(self, device: str, **settings: Any) -> None:
        from gelstereo import cameras

        self._camera = cameras.open(device, **settings)
        self.name = f"camera {device}"
        self.rate_hz: float | None = float(self._camera.settings["frame_rate_hz"])
        self._layout = str(self._camera.settings["layout"])
        self._closed = False

    def __iter__(self) -> Iterator[LiveFrame]:
        while not self._closed:
            try:
                frame = self._camera.read()
            except CameraError:
                # The camera may be closed while this waits for a frame.
                if self._closed:
                    return
                raise
            time_ns = frame.driver_ns or frame.received_ns or time.monotonic_ns()
            encoded = tuple(frame.encoded)
            fields = None if frame.event is None else dict(frame.event)
            yield LiveFrame(
                left=frame.left,
                right=frame.right,
                sequence=frame.sequence,
                time_ns=time_ns,
                driver_ns=frame.driver_ns,
                received_ns=frame.received_ns,
                dropped=frame.dropped,
                skew_ns=frame.skew_ns,
                stale=frame.stale,
                event=None if fields is None else str(fields.pop("text")),
                event_fields=fields,
                encoded=encoded,
                layout=self._layout if len(encoded) == 1 else None,
            )

    def close(self) -> None:
        """Release the camera; the iteration ends."""
        self._closed = True
        self._camera.close()


def _there_and_back(count: int) -> Iterator[int]:
    """Indices from 0 to the last and back to 0, without end; neighbours differ by one.

    Examples
    --------
    >>> from itertools import islice
    >>> list(islice(_there_and_back(3), 7))
    [0, 1, 2, 1, 0, 1, 2]
    """
    yield 0
    while True:
        yield from range(1, count)
        yield from range(count - 2, -1, -1)
        if count == 1:
            yield 0


def _played(
    count: int, pair: Callable[[int], tuple[Image, Image]], rate_hz: float, closed: Callable[[], bool]
) -> Iterator[LiveFrame]:
    """Pairs at a constant rate, with times that start at 0; slower if computing them takes longer."""
    period_ns = round(_NS_PER_S / rate_hz)
    due_ns = time.monotonic_ns()
    for sequence, index in enumerate(_there_and_back(count)):
        left, right = pair(index)
        time.sleep(max(0, due_ns - time.monotonic_ns()) / _NS_PER_S)
        if closed():
            return
        yield LiveFrame(
            left=left, right=right, sequence=sequence, time_ns=round(sequence * _NS_PER_S / rate_hz)
        )
        # A source that cannot keep up skips frames instead of sending a burst of late ones.
        due_ns = max(due_ns + period_ns, time.monotonic_ns())
