"""Two USB cameras, one for each view, paired by the drivers' timestamps."""

from __future__ import annotations

from guest.checks import Figures, check
from guest.checks.uvc import checksum, events, wait_for_event, wait_for_frames, watched
from guest.devices import MONO, camera
from guest.programs import Line
from guest.usb.camera import Camera, plugged

PERIOD_MS = 1000.0 / MONO.rate_hz


def pair() -> tuple[Camera, Camera]:
    """A left and a right camera, in step."""
    return camera("LEFT01", port=0, kind="left"), camera("RIGHT1", port=1, kind="right")


def options(right: Camera, max_skew_ms: float) -> list[str]:
    """How the capture program takes both."""
    size = f"{MONO.width}x{MONO.height}"
    return [
        *("--right-device", f"serial:{right.serial}", "--size", size, "--rate", str(MONO.rate_hz)),
        *("--max-skew-ms", str(max_skew_ms)),
    ]


def numbers(line: Line, left: Camera, right: Camera) -> tuple[int, int]:
    """Which of the files both images are."""
    files = [[checksum(frame.data) for frame in device.video.frames] for device in (left, right)]
    return files[0].index(line["left_jpeg"]), files[1].index(line["right_jpeg"])


@check(limit_s=120)
def two_cameras_are_paired_by_time() -> Figures:
    left, right = pair()
    with plugged(left, right), watched(left, *options(right, 0.5 * PERIOD_MS)) as run:
        wait_for_frames(run, 40)
        frames = run.of("frame")
    skews_ms = [line["skew_ns"] * 1e-6 for line in frames]
    assert max(map(abs, skews_ms)) <= 0.5 * PERIOD_MS, skews_ms
    same = sum(one == other for one, other in (numbers(line, left, right) for line in frames))
    # On a busy computer an emulated camera may be late by more than half a period.
    assert same >= 0.8 * len(frames), (same, len(frames))
    return {"pairs": len(frames), "same_moment": same, "max_skew_ms": max(map(abs, skews_ms))}


@check(limit_s=120)
def images_too_far_apart_are_no_pair() -> Figures:
    left, right = pair()
    right.video.phase_s = 0.5e-3 * PERIOD_MS
    with plugged(left, right), watched(left, *options(right, 5.0)) as run:
        wait_for_event(run, "skewed", 20)
        skewed, frames = events(run, "skewed"), run.of("frame")
    assert all(abs(line["skew_ns"]) > line["max_skew_ns"] == 5_000_000 for line in skewed), skewed
    assert all(abs(line["skew_ns"]) <= 5_000_000 for line in frames), frames
    assert len(frames) < len(skewed), (len(frames), len(skewed))
    return {"refused": len(skewed), "paired": len(frames)}


@check(limit_s=120)
def one_of_two_cameras_is_unplugged_and_comes_back() -> None:
    left, right = pair()
    with plugged(left, right), watched(left, *options(right, 0.5 * PERIOD_MS)) as run:
        wait_for_frames(run, 5)
        right.unplug()
        gone = wait_for_event(run, "disconnected")
        assert gone["stale"] and "RIGHT1" in gone["device"], gone
        right.plug()
        run.wait_for(
            lambda run: sum("RIGHT1" in line["device"] for line in events(run, "connected")) >= 2,
            "the right camera",
        )
        wait_for_frames(run, 5)
