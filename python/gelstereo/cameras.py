"""Stereo cameras by Video4Linux2: the capture code of ``gelstereo-host``, from Python.

Linux only; elsewhere `open` and `list` raise `CameraError`. No hardware was used to test it: see
``docs/cameras.md``.

Examples
--------
>>> import gelstereo as gs
>>> with gs.cameras.open("serial:GS0001", size_px=(1280, 480), exposure_us=8000) as camera:  # doctest: +SKIP
...     for frame in camera:
...         if frame.event is not None:
...             print(frame.event["text"])
...         if not frame.stale:
...             print(frame.sequence, frame.left.mean())
"""

from __future__ import annotations

import builtins
from collections.abc import Mapping
from typing import Literal, TypeAlias

import numpy as np
import numpy.typing as npt

from gelstereo._native import (
    Camera,
    CameraControl,
    CameraFrame,
    CameraInfo,
    decode_camera_frame,
    list_cameras,
)

__all__ = ["Camera", "CameraControl", "CameraFrame", "CameraInfo", "decode", "list", "open"]

Layout: TypeAlias = Literal["side_by_side", "side_by_side_swapped", "interleaved", "interleaved_swapped"]
Format: TypeAlias = Literal["mjpg", "yuyv", "grey", "y16"]


def list() -> builtins.list[CameraInfo]:
    """List the video nodes of this computer.

    Returns
    -------
    list of CameraInfo
        Ordered by number. A USB camera has two nodes; frames can be read from the one whose kind is
        ``"capture"``.

    Raises
    ------
    CameraError
        If this system has no Video4Linux2.
    """
    return list_cameras()


def open(
    device: str,
    *,
    right_device: str | None = None,
    layout: Layout | None = None,
    format: Format | None = None,
    size_px: tuple[int, int] | None = None,
    frame_rate_hz: float | None = None,
    mode: Literal["latest", "every"] | None = None,
    max_skew_ms: float | None = None,
    buffers: int | None = None,
    queue_frames: int | None = None,
    stall_timeout_ms: int | None = None,
    min_retry_ms: int | None = None,
    max_retry_ms: int | None = None,
    keep_encoded: bool | None = None,
    exposure_us: float | None = None,
    auto_exposure: bool | None = None,
    gain: int | None = None,
    white_balance_k: int | None = None,
    auto_white_balance: bool | None = None,
    controls: Mapping[str, int] | None = None,
    timeout_s: float = 1.0,
) -> Camera:
    """Open a stereo camera and start its stream.

    Defaults are those of ``gelstereo-host``.

    Parameters
    ----------
    device
        ``"serial:"`` and the USB serial number, or a path such as ``"/dev/video0"``.
    right_device
        The right camera, where each view has its own device.
    layout
        Arrangement of both views in the frames of one stereo device. Default: ``"side_by_side"``.
    format
        Pixel format of the camera. Default: ``"mjpg"``.
    size_px
        Width and height of the device's frames as reported by its driver; side by side, this includes both
        views. Default: (1280, 480).
    frame_rate_hz
        Default: 30.
    mode
        ``"latest"`` returns the newest pair and counts older ones as dropped. ``"every"`` returns all in
        order. Default: ``"latest"``.
    max_skew_ms
        Largest time difference between the images of two devices that form a pair. Default: 5.
    buffers, queue_frames
        Number of buffers that the driver fills ahead, and of frames queued for reading. Default: 4 and 8.
    stall_timeout_ms
        A device that sends nothing for this time is restarted. Default: 2000.
    min_retry_ms, max_retry_ms
        Shortest and longest pause before reopening a lost device. Default: 100 and 5000.
    keep_encoded
        Whether frames include the camera's JPEG files (``frame.encoded``). Default: True.
    exposure_us
        Exposure time, a multiple of 100 µs; turns automatic exposure off.
    auto_exposure
        Whether the camera chooses the exposure time.
    gain
        In the camera's own unit; turns automatic gain off.
    white_balance_k
        Kelvin; turns automatic white balance off.
    auto_white_balance
        Whether the camera chooses the white balance.
    controls
        Any other control by its name: ``{"sharpness": 2}``.
    timeout_s
        Longest wait for a frame, seconds. If none arrives, a stale frame is returned.

    Returns
    -------
    Camera
        Iterable, and a context manager.

    Raises
    ------
    CameraError
        If there is no such camera, or it does not support the request. The message lists what is available.
    """
    wanted_controls = {
        "exposure_us": exposure_us,
        "auto_exposure": auto_exposure,
        "gain": gain,
        "white_balance_k": white_balance_k,
        "auto_white_balance": auto_white_balance,
        "other": None if controls is None else dict(controls),
    }
    settings = {
        "device": device,
        "right_device": right_device,
        "layout": layout,
        "format": format,
        "size_px": None if size_px is None else tuple(size_px),
        "frame_rate_hz": frame_rate_hz,
        "mode": mode,
        "max_skew_ms": max_skew_ms,
        "buffers": buffers,
        "queue_frames": queue_frames,
        "stall_timeout_ms": stall_timeout_ms,
        "min_retry_ms": min_retry_ms,
        "max_retry_ms": max_retry_ms,
        "keep_encoded": keep_encoded,
        "controls": {name: value for name, value in wanted_controls.items() if value is not None},
    }
    return Camera({name: value for name, value in settings.items() if value is not None}, timeout_s)


def decode(
    data: bytes,
    *,
    format: Format,
    size_px: tuple[int, int],
    layout: Layout = "side_by_side",
    stride: int | None = None,
) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.uint8]]:
    """Decode a frame of a stereo device, in its driver's format, to both views.

    Parameters
    ----------
    data
        The frame's bytes.
    format, size_px, layout
        As in `open`.
    stride
        Bytes from row to row, if rows are padded. Not used for ``"mjpg"``.

    Returns
    -------
    left, right
        Read-only (H, W) uint8 luma.

    Raises
    ------
    CameraError
        If the format cannot hold two views in this layout.
    ImageError
        If the frame is too short, damaged, or a JPEG file of another size.
    """
    return decode_camera_frame(data, format, size_px, layout, stride)
