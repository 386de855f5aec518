"""Frames for ``gelstereo-host sense --stream -``, to feed the host through a pipe from any camera readable in
Python.

The format is that of ``docs/frame-stream.md``; a frame is a header of 44 bytes and its pixels.
"""

from __future__ import annotations

import struct
import time
import zlib
from typing import BinaryIO, Literal

import numpy as np
import numpy.typing as npt

from gelstereo._native import Error

__all__ = ["HEADER_BYTES", "MAGIC", "VERSION", "FrameWriter", "Layout", "header"]

MAGIC = b"\x89GSF"
"""First bytes of a frame."""
VERSION = 1
"""Version of the format."""
_HEADER = struct.Struct("<4sBBBBQQIIIII")
HEADER_BYTES = _HEADER.size
"""Size of a header."""

Layout = Literal["side_by_side", "side_by_side_swapped", "interleaved", "interleaved_swapped"]
"""Arrangement of both views in one frame."""
_LAYOUTS: dict[str, int] = {
    "side_by_side": 0,
    "side_by_side_swapped": 1,
    "interleaved": 2,
    "interleaved_swapped": 3,
}
_GREY8, _JPEG = 0, 1
_HAS_PAYLOAD_CRC = 1
_MAX_SIDE_PX = 16_384
_MAX_PAYLOAD_BYTES = 1 << 26


def header(
    payload: bytes,
    *,
    sequence: int,
    captured_ns: int | None,
    size_px: tuple[int, int],
    jpeg: bool = False,
    layout: Layout = "side_by_side",
) -> bytes:
    """The header of one frame.

    Parameters
    ----------
    payload
        The pixels, or one JPEG file with both views.
    sequence
        Number of the frame; it increases by 1, and gaps count as lost frames.
    captured_ns
        Time of exposure, ``time.monotonic_ns()`` of the host's computer; None if unknown.
    size_px
        Width and height of the frame, both views together.
    jpeg
        Whether the payload is a JPEG file instead of grey bytes.
    layout
        Arrangement of both views in the frame.

    Raises
    ------
    Error
        The host would reject the frame.
    """
    width_px, height_px = size_px
    if not (0 < width_px <= _MAX_SIDE_PX and 0 < height_px <= _MAX_SIDE_PX) or width_px % 2:
        raise Error(
            f"size_px is {size_px}; valid is an even width and 1 to {_MAX_SIDE_PX} pixels each, "
            "both views together"
        )
    if not jpeg and len(payload) != width_px * height_px:
        raise Error(
            f"payload has {len(payload)} bytes; "
            f"{width_px} x {height_px} grey pixels have {width_px * height_px}"
        )
    if not 0 < len(payload) <= _MAX_PAYLOAD_BYTES:
        raise Error(f"payload has {len(payload)} bytes; valid is 1 to {_MAX_PAYLOAD_BYTES}")
    if layout not in _LAYOUTS:
        raise Error(f"layout is {layout!r}; valid is one of {', '.join(_LAYOUTS)}")
    if not 0 <= sequence < 1 << 64:
        raise Error(f"sequence is {sequence}; valid is 0 to 2^64 - 1")
    if captured_ns is not None and not 0 < captured_ns < 1 << 64:
        raise Error(f"captured_ns is {captured_ns}; valid is 1 to 2^64 - 1, or None")
    head = _HEADER.pack(
        MAGIC,
        VERSION,
        _JPEG if jpeg else _GREY8,
        _LAYOUTS[layout],
        _HAS_PAYLOAD_CRC,
        sequence,
        captured_ns or 0,
        width_px,
        height_px,
        len(payload),
        zlib.crc32(payload),
        0,
    )
    return head[:-4] + struct.pack("<I", zlib.crc32(head[:-4]))


class FrameWriter:
    """Writes frames to a pipe or a file and numbers them.

    >>> import io
    >>> pipe = io.BytesIO()
    >>> writer = FrameWriter(pipe)
    >>> writer.write_pair(np.zeros((480, 640), np.uint8), np.zeros((480, 640), np.uint8))
    >>> len(pipe.getvalue()) - HEADER_BYTES == 2 * 480 * 640
    True
    """

    def __init__(self, pipe: BinaryIO) -> None:
        """Writes to ``pipe``, for example ``sys.stdout.buffer`` or the ``stdin`` of a process."""
        self._pipe = pipe
        self._sequence = 0

    def __repr__(self) -> str:
        return f"<FrameWriter: {self._sequence} frames written>"

    def write_pair(
        self,
        left: npt.NDArray[np.uint8],
        right: npt.NDArray[np.uint8],
        captured_ns: int | None = None,
    ) -> None:
        """Writes two grey images of equal size, ``(rows, columns)``.

        Parameters
        ----------
        left
            The left view.
        right
            The right view.
        captured_ns
            Moment of exposure by ``time.monotonic_ns()``; by default now.

        Raises
        ------
        Error
            The images are not grey images of equal size.
        """
        for name, view in (("left", left), ("right", right)):
            if view.dtype != np.uint8 or view.ndim != 2:
                raise Error(
                    f"{name} is {view.dtype} of shape {view.shape}; valid is uint8 of (rows, columns)"
                )
        if left.shape != right.shape:
            raise Error(f"left is {left.shape} and right {right.shape}; both views must have one size")
        self.write(np.hstack((left, right)), captured_ns=captured_ns)

    def write(
        self,
        frame: npt.NDArray[np.uint8],
        *,
        layout: Layout = "side_by_side",
        captured_ns: int | None = None,
    ) -> None:
        """Writes the grey frame of a stereo device, ``(rows, columns)``, with both views in it.

        Parameters
        ----------
        frame
            Both views.
        layout
            Arrangement of the views. captured_ns: Moment of exposure by ``time.monotonic_ns()``; by default
            now.

        Raises
        ------
        Error
            The frame is not a grey image, or has an odd width.
        """
        if frame.dtype != np.uint8 or frame.ndim != 2:
            raise Error(f"frame is {frame.dtype} of shape {frame.shape}; valid is uint8 of (rows, columns)")
        height_px, width_px = frame.shape
        self._send(np.ascontiguousarray(frame).tobytes(), (width_px, height_px), False, layout, captured_ns)

    def write_jpeg(
        self,
        jpeg: bytes,
        size_px: tuple[int, int],
        *,
        layout: Layout = "side_by_side",
        captured_ns: int | None = None,
    ) -> None:
        """Writes one JPEG file with both views, as the camera sent it.

        Parameters
        ----------
        jpeg
            The file's bytes.
        size_px
            Its width and height.
        layout
            Arrangement of the views. captured_ns: Moment of exposure by ``time.monotonic_ns()``; by default
            now.

        Raises
        ------
        Error
            The size is not valid.
        """
        self._send(jpeg, size_px, True, layout, captured_ns)

    def _send(
        self, payload: bytes, size_px: tuple[int, int], jpeg: bool, layout: Layout, captured_ns: int | None
    ) -> None:
        moment = time.monotonic_ns() if captured_ns is None else captured_ns
        head = header(
            payload,
            sequence=self._sequence,
            captured_ns=moment,
            size_px=size_px,
            jpeg=jpeg,
            layout=layout,
        )
        # A single write, so that frames of several writers to one pipe do not interleave.
        self._pipe.write(head + payload)
        self._pipe.flush()
        self._sequence += 1
