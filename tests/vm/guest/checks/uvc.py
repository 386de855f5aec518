"""The host's capture through the kernel's uvcvideo, from one USB stereo camera."""

from __future__ import annotations

import itertools
import time
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from guest.checks import Figures, check
from guest.devices import camera
from guest.programs import Line, Run, answers, ended, running
from guest.usb.camera import Camera, plugged
from guest.usb.uvc import Frame

# Frames may be late on a busy computer; a call that has no end is what this must find.
MAX_SILENCE_S = 20.0
SIZE = "640x240"


def checksum(data: bytes) -> str:
    """As the program under test prints it."""
    return f"{zlib.crc32(data):08x}"


@contextmanager
def watched(device: Camera, *more: str, name: str | None = None, size: str = SIZE) -> Iterator[Run]:
    """The capture program on a camera, by its serial number or by `name`."""
    name = name or f"serial:{device.serial}"
    limits = ["--frames", "100000", "--duration-s", "100", "--timeout-ms", "500", "--max-retry-ms", "400"]
    with running("camera_probe", "--device", name, "--size", size, "--json", *limits, *more) as run:
        yield run
        times = run.times_s
        silences = [after - before for before, after in itertools.pairwise(times)]
        assert max(silences, default=0.0) < MAX_SILENCE_S, f"no line for {max(silences):.1f} s"


def captured(*options: str, size: str = SIZE) -> list[Line]:
    """What the capture program says of the one camera until it ends."""
    return answers("camera_probe", "--device", "serial:GS0001", "--size", size, "--json", *options)


def events(run: Run, kind: str) -> list[Line]:
    """Events of one kind."""
    return [line for line in run.of("event") if line["event"] == kind]


def wait_for_frames(run: Run, count: int) -> None:
    """Waits until so many frames more have come."""
    wanted = len(run.of("frame")) + count
    run.wait_for(lambda run: len(run.of("frame")) >= wanted, f"{count} frames")


def wait_for_event(run: Run, kind: str, count: int = 1) -> Line:
    """Waits for the event of so high a number."""
    run.wait_for(lambda run: len(events(run, kind)) >= count, f"event {kind}")
    return events(run, kind)[count - 1]


def assert_losses_match_the_numbers(frames: Sequence[Line]) -> None:
    """Between frames of one stream, the frames counted as lost are the driver's numbers that are missing."""
    for before, after in itertools.pairwise(frames):
        assert after["sequence"] - before["sequence"] == after["dropped"] + 1, (before, after)


def assert_order(received: Sequence[str], sent: Sequence[str]) -> None:
    """What was received is what was sent, in that order, but for what was lost."""
    rest = iter(sent)
    for position, one in enumerate(received):
        assert one in rest, f"frame {position} of {len(received)} was not sent, or not in this order"


@check()
def cameras_are_listed_with_their_serial_number() -> None:
    device = camera("GS0001")
    with plugged(device):
        found = answers("camera_probe", "--list", "--json")
    mine = [line for line in found if line["serial"] == "GS0001"]
    assert {line["kind"] for line in mine} == {"capture", "metadata"}, found
    assert all((line["vendor_id"], line["product_id"]) == ("2560", "c114") for line in mine), found


@check()
def frames_are_the_jpeg_files_byte_by_byte() -> Figures:
    device = camera("GS0001")
    with plugged(device):
        lines = captured("--frames", "60")
    statistics, frames = lines[-1], [line for line in lines if line["line"] == "frame"]
    assert len(frames) == 60, lines[:3]
    assert not [line for line in lines if line["line"] == "event" and line["event"] != "connected"], lines
    assert_files(device, frames, [320, 240])
    assert_losses_match_the_numbers(frames)
    wanted = ["rate_hz", "latency_p50_ms", "latency_p99_ms", "dropped", "longest_call_ms"]
    return {name: statistics[name] for name in wanted}


@check()
def large_frames_are_the_jpeg_files_byte_by_byte() -> Figures:
    device = camera("GS0001", kind="large")
    with plugged(device):
        lines = captured("--frames", "10", size="2560x720")
    assert_files(device, [line for line in lines if line["line"] == "frame"], [1280, 720])
    return {"rate_hz": lines[-1]["rate_hz"], "bytes": len(device.video.frames[0].data)}


def assert_files(device: Camera, frames: Sequence[Line], size: list[int]) -> None:
    """Frames are the files that the camera sent, in that order, and a file always gives the same pixels.

    Not every file arrives: an emulated computer loses frames, and may lose the same one of three each time.
    """
    files = [checksum(frame.data) for frame in device.video.frames]
    assert_order([line["jpeg"] for line in frames], [files[index] for index in device.video.sent])
    pictures = {(line["jpeg"], line["left"], line["right"]) for line in frames}
    assert len(pictures) == len({line["jpeg"] for line in frames}) > 1, (pictures, files)
    assert all(line["left"] != line["right"] and line["size"] == size for line in frames), frames


@check()
def exposure_and_brightness_reach_the_camera() -> None:
    device = camera("GS0001")
    settings = ["--auto-exposure", "false", "--exposure-us", "5000", "--control", "brightness=77"]
    with plugged(device):
        captured("--frames", "2", *settings)
    video = device.video
    assert (video.auto_exposure.value, video.exposure.value, video.brightness.value) == (1, 50, 77), video
    assert 50 in video.exposure.writes and 77 in video.brightness.writes


@check()
def a_setting_outside_the_cameras_range_is_refused() -> None:
    device = camera("GS0001")
    with plugged(device):
        code, _, error = ended(
            "camera_probe", "--device", "serial:GS0001", "--size", SIZE, "--control", "brightness=1000"
        )
    assert code == 2 and "brightness" in error and "255" in error, (code, error)


@check(limit_s=120)
def an_unplugged_camera_is_found_again() -> Figures:
    device = camera("GS0001")
    with plugged(device), watched(device, "--auto-exposure", "false", "--exposure-us", "5000") as run:
        wait_for_frames(run, 5)
        device.unplug()
        gone = wait_for_event(run, "disconnected")
        assert gone["stale"] and "GS0001" in gone["device"], gone
        run.wait_for(lambda run: bool(run.of("timeout")) or len(events(run, "disconnected")) > 2, "waiting")
        device.video.exposure.value = 80
        plugged_s = time.monotonic()
        device.plug()
        again = wait_for_event(run, "connected", 2)
        wait_for_frames(run, 5)
        back_s = time.monotonic() - plugged_s
        assert "GS0001" in again["device"], again
        assert device.video.exposure.value == 50, "the exposure was not set again"
        assert all(line["stale"] for line in run.of("timeout")), run.of("timeout")
        assert not any(line["stale"] for line in run.of("frame"))
    return {"back_after_s": back_s, "attempts": len(events(run, "disconnected"))}


@check(limit_s=120)
def a_usb_reset_is_survived() -> Figures:
    device = camera("GS0001")
    with plugged(device), watched(device) as run:
        wait_for_frames(run, 5)
        reset_s = time.monotonic()
        device.reset()
        wait_for_frames(run, 5)
        back_s = time.monotonic() - reset_s
        assert not any(line["stale"] for line in run.of("frame"))
    return {"back_after_s": back_s, "events": [line["event"] for line in run.of("event")]}


@check(limit_s=120)
def another_camera_does_not_take_its_place() -> None:
    device, other = camera("GS0001"), camera("GS0002")
    with plugged(device):
        path = str(device.video_node)
        with watched(device, name=path) as run:
            wait_for_frames(run, 3)
            device.unplug()
            # Only when the old device is closed is its number free again; the second attempt comes after
            # that.
            wait_for_event(run, "disconnected", 2)
            frames = len(run.of("frame"))
            with plugged(other):
                assert str(other.video_node) == path, "the kernel gave it another number"
                run.wait_for(
                    lambda run: any("GS0002" in line["reason"] for line in events(run, "disconnected")),
                    "refusal of the other camera",
                )
                assert len(run.of("frame")) == frames
            device.plug()
            wait_for_frames(run, 3)


@check()
def damaged_jpegs_are_events_and_the_stream_goes_on() -> Figures:
    device = camera("GS0001")
    good = [frame.data for frame in device.video.frames[:3]]
    # Cut in its pixels, without its start, a sound start with nothing in it, no JPEG at all, one byte.
    damaged = [good[0][:5000], good[1][40:], good[2][:300] + bytes(3000), bytes(range(256)) * 40, b"\xff"]
    sent = [good[0], damaged[0], good[1], damaged[1], damaged[2], good[2], damaged[3], damaged[4]]
    device.video.frames = [Frame(data) for data in sent]
    with plugged(device):
        lines = captured("--frames", "18")
    received = {line["jpeg"] for line in lines if line["line"] == "frame"}
    assert received == {checksum(data) for data in good}, (received, [checksum(data) for data in sent])
    corrupt = [line for line in lines if line["line"] == "event" and line["event"] == "corrupt"]
    assert len(corrupt) >= 20, corrupt
    assert all(line["stale"] for line in corrupt), corrupt
    reasons = {line["reason"] for line in corrupt}
    # The frame without its start and both that are no JPEG have one reason; each that was cut states its
    # length.
    assert len(reasons) == 3, reasons
    return {"reasons": sorted(reasons)}


@check()
def frames_that_the_driver_throws_away_are_counted() -> Figures:
    device = camera("GS0001")
    files = [frame.data for frame in device.video.frames]
    device.video.frames = [Frame(data, error=index % 4 == 3) for index, data in enumerate(files)]
    with plugged(device):
        lines = captured("--frames", "30")
    frames = [line for line in lines if line["line"] == "frame"]
    assert {line["jpeg"] for line in frames} <= {
        checksum(data) for index, data in enumerate(files) if index % 4 != 3
    }
    assert_losses_match_the_numbers(frames)
    dropped = sum(line["dropped"] for line in frames)
    assert dropped >= 8, dropped
    return {"dropped": dropped}


@check(limit_s=120)
def a_silent_camera_is_an_event_and_is_started_again() -> None:
    device = camera("GS0001")
    with plugged(device), watched(device, "--stall-ms", "1500") as run:
        wait_for_frames(run, 5)
        device.video.flowing.clear()
        stalled = wait_for_event(run, "stalled")
        assert stalled["stale"] and stalled["silent_ms"] >= 1500, stalled
        device.video.flowing.set()
        wait_for_frames(run, 5)
        assert len(events(run, "connected")) >= 2


@check()
def the_newest_frame_is_given_to_a_slow_reader() -> Figures:
    device = camera("GS0001")
    with plugged(device):
        slow = ["--mode", "latest", "--work-ms", "300", "--frames", "10"]
        lines = captured(*slow)
    frames = [line for line in lines if line["line"] == "frame"]
    assert_losses_match_the_numbers(frames)
    dropped = sum(line["dropped"] for line in frames)
    assert dropped >= 9, dropped
    ages_ms = [(line["received_ns"] - line["driver_ns"]) * 1e-6 for line in frames]
    return {"dropped": dropped, "oldest_ms": max(ages_ms)}
