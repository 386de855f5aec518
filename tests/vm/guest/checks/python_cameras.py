"""``gelstereo.cameras`` through the kernel's uvcvideo.

The camera is a thread of this very process: that frames come at all shows that waiting for them releases
Python's lock.
"""

from __future__ import annotations

import os
import signal
import threading
import time
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import gelstereo as gs
from guest.checks import Figures, check
from guest.devices import MODES, camera
from guest.usb.camera import Camera, plugged

MODE = MODES["stereo"]
Frame = gs.cameras.CameraFrame


@contextmanager
def opened(device: Camera, **settings: Any) -> Iterator[gs.cameras.Camera]:
    """The camera as a user opens it, by its serial number."""
    size: dict[str, Any] = {"size_px": (MODE.width, MODE.height), "frame_rate_hz": MODE.rate_hz}
    with gs.cameras.open(f"serial:{device.serial}", **size, **settings) as stream:
        yield stream


def read_until(stream: gs.cameras.Camera, wanted: Callable[[Frame], bool], limit_s: float = 40.0) -> Frame:
    """The first frame that fulfils a condition."""
    end = time.monotonic() + limit_s
    for frame in stream:
        if wanted(frame):
            return frame
        assert time.monotonic() < end, f"not within {limit_s:.0f} s, at last {frame}"
    raise AssertionError("the camera was closed")


def is_event(kind: str) -> Callable[[Frame], bool]:
    """Whether a frame is word of this."""
    return lambda frame: frame.event is not None and frame.event["event"] == kind


def is_new(frame: Frame) -> bool:
    return not frame.stale


@check(limit_s=120)
def python_gets_the_cameras_files_and_their_pixels() -> Figures:
    device = camera("GS0001")
    files = {zlib.crc32(frame.data) for frame in device.video.frames}
    with plugged(device), opened(device, mode="every") as stream:
        for _ in range(20):
            frame = read_until(stream, is_new)
            (jpeg,) = frame.encoded
            assert zlib.crc32(jpeg) in files
            assert frame.left.shape == frame.right.shape == (MODE.height, MODE.width // 2)
            assert not frame.left.flags.writeable
            again = gs.cameras.decode(jpeg, format="mjpg", size_px=(MODE.width, MODE.height))
            assert (frame.left == again[0]).all() and (frame.right == again[1]).all()
            assert frame.driver_ns is not None and frame.received_ns is not None
            assert 0 < frame.driver_ns < frame.received_ns <= time.monotonic_ns()
        statistics = stream.statistics
    assert statistics["pairs"] >= 20 and statistics["connects"] == 1, statistics
    return {name: statistics[name] for name in ("rate_hz", "latency_p50_ms", "dropped")}


@check(limit_s=120)
def python_sets_controls_and_finds_them_again_after_unplugging() -> Figures:
    device = camera("GS0001")
    with plugged(device), opened(device, exposure_us=5000, max_retry_ms=400, timeout_s=0.3) as stream:
        read_until(stream, is_new)
        stream.set(exposure_us=700, brightness=33)
        assert {(c.name, c.value) for c in stream.controls} >= {("brightness", 33), ("auto_exposure", 1)}
        refused = ""
        try:
            stream.set(brightness=999)
        except gs.CameraError as error:
            refused = str(error)
        assert refused == "brightness is 999; valid is 0 to 255 in steps of 1", refused
        device.unplug()
        gone = read_until(stream, is_event("disconnected"))
        assert gone.stale and gone.left.any(), "the last images stay"
        longest_s, waited = 0.0, 0
        while waited < 5:
            start = time.monotonic()
            frame = stream.read()
            longest_s, waited = max(longest_s, time.monotonic() - start), waited + (frame.event is None)
            assert frame.stale
        device.video.exposure.value, device.video.brightness.value = 80, 128
        device.plug()
        read_until(stream, is_new)
        assert (device.video.exposure.value, device.video.brightness.value) == (7, 33)
    return {"longest_call_s": longest_s}


@check(limit_s=120)
def python_ends_a_wait_with_ctrl_c_and_closes() -> Figures:
    device = camera("GS0001")
    with plugged(device), opened(device, stall_timeout_ms=60_000) as stream:
        read_until(stream, is_new)
        device.video.flowing.clear()
        read_until(stream, lambda frame: frame.stale and frame.event is None)
        # A check has a handler of its own for its limit; this one is Python's.
        before = signal.signal(signal.SIGINT, signal.default_int_handler)
        threading.Timer(0.5, os.kill, (os.getpid(), signal.SIGINT)).start()
        start = time.monotonic()
        try:
            stream.read(60.0)
            interrupted_s = float("inf")
        except KeyboardInterrupt:
            interrupted_s = time.monotonic() - start
        finally:
            signal.signal(signal.SIGINT, before)
        assert interrupted_s < 20.0, interrupted_s
        stream.close()
        assert stream.closed and list(stream) == []
        refused = ""
        try:
            stream.read()
        except gs.CameraError as error:
            refused = str(error)
        assert "closed" in refused, refused
        device.video.flowing.set()
        # The device is free again.
        with opened(device) as other:
            read_until(other, is_new)
    return {"interrupted_s": interrupted_s}
