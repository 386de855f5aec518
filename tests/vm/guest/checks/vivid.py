"""The kernel's virtual camera vivid: plain pixels, and faults that it makes on request."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from guest.checks import Figures, check
from guest.checks.uvc import assert_losses_match_the_numbers, events, wait_for_event, wait_for_frames
from guest.modules import modprobe
from guest.programs import Line, Run, answers, ended, running
from guest.usb.camera import wait_for
from guest.v4l2 import set_control

DRIVER = Path("/sys/bus/platform/drivers/vivid")
SIZE = ["--size", "640x360", "--rate", "30"]
NO_TEXT = 2


def node() -> Path | None:
    """The driver's capture node."""
    for entry in Path("/sys/class/video4linux").glob("video*"):
        if (entry / "name").read_text(encoding="utf-8").startswith("vivid"):
            return Path("/dev", entry.name)
    return None


@contextmanager
def vivid() -> Iterator[Path]:
    """A virtual camera as it is after its driver was loaded."""
    modprobe("vivid n_devs=1 node_types=0x1")
    wait_for(lambda: node() is not None, "vivid's node")
    found = node()
    assert found is not None
    try:
        yield found
    finally:
        rebind()


def rebind() -> None:
    """Takes the driver from its device and gives it back: all settings are the first ones again."""
    if (DRIVER / "vivid.0").exists():
        (DRIVER / "unbind").write_text("vivid.0", encoding="ascii")
    (DRIVER / "bind").write_text("vivid.0", encoding="ascii")
    wait_for(lambda: node() is not None, "vivid's node")


@contextmanager
def watched(device: Path) -> Iterator[Run]:
    """The capture program on the virtual camera."""
    limits = ["--frames", "100000", "--duration-s", "100", "--timeout-ms", "500", "--max-retry-ms", "400"]
    with running(
        "camera_probe", "--device", str(device), "--json", "--format", "grey", *SIZE, *limits
    ) as run:
        wait_for_frames(run, 3)
        yield run


def captured(device: Path, *options: str) -> list[Line]:
    """Frames of a run that must succeed."""
    lines = answers("camera_probe", "--device", str(device), "--json", *SIZE, *options)
    return [line for line in lines if line["line"] == "frame"]


@check()
def plain_pixels_are_read_as_yuyv_and_grey() -> Figures:
    figures = {}
    with vivid() as device:
        set_control(device, "OSD Text Mode", NO_TEXT)
        for name in ("yuyv", "grey"):
            frames = captured(device, "--format", name, "--frames", "10")
            assert all(line["size"] == [320, 360] for line in frames), frames[0]
            # A still picture without text: every frame is the same, and its halves differ.
            pictures = {(line["left"], line["right"]) for line in frames}
            assert len(pictures) == 1, pictures
            assert all(left != right for left, right in pictures)
            figures[name] = pictures.pop()
    return figures


@check()
def a_format_that_the_driver_lacks_is_refused_with_those_it_has() -> None:
    with vivid() as device:
        code, _, error = ended("camera_probe", "--device", str(device), "--format", "mjpg", *SIZE)
    assert code == 2 and "YUYV" in error.upper(), (code, error)


@check()
def a_disconnected_device_is_found_again() -> None:
    with vivid() as device, watched(device) as run:
        set_control(device, "Disconnect", 1)
        gone = wait_for_event(run, "disconnected")
        assert gone["stale"], gone
        # The driver connects the device again as soon as its last user has closed it.
        wait_for_event(run, "connected", 2)
        wait_for_frames(run, 3)


@check()
def a_buffer_marked_as_damaged_is_an_event() -> None:
    with vivid() as device, watched(device) as run:
        set_control(device, "Inject V4L2_BUF_FLAG_ERROR", 1)
        corrupt = wait_for_event(run, "corrupt")
        assert corrupt["stale"] and "damaged" in corrupt["reason"], corrupt
        wait_for_frames(run, 3)
        assert not events(run, "disconnected")


@check()
def a_refused_request_is_named() -> Figures:
    errors = {}
    with vivid() as device:
        for call in ("VIDIOC_REQBUFS", "VIDIOC_QBUF", "VIDIOC_STREAMON"):
            set_control(device, f"Inject {call} Error", 1)
            code, _, error = ended("camera_probe", "--device", str(device), "--format", "grey", *SIZE)
            assert code == 2 and call in error, (code, call, error)
            errors[call] = error
            assert len(captured(device, "--format", "grey", "--frames", "2")) == 2
    return errors


@check()
def a_fatal_error_is_survived_even_if_the_first_attempts_fail() -> None:
    with vivid() as device, watched(device) as run:
        set_control(device, "Inject VIDIOC_STREAMON Error", 1)
        set_control(device, "Inject Fatal Streaming Error", 1)
        wait_for_event(run, "disconnected", 2)
        wait_for_event(run, "connected", 2)
        wait_for_frames(run, 3)


@check()
def dropped_buffers_are_counted() -> Figures:
    with vivid() as device:
        set_control(device, "Percentage of Dropped Buffers", 40)
        frames = captured(device, "--format", "grey", "--frames", "30")
    assert_losses_match_the_numbers(frames)
    dropped = sum(line["dropped"] for line in frames)
    # 40 % of 50 frames are 20; fewer than 5 have a probability below 1e-6.
    assert dropped >= 5, dropped
    return {"dropped": dropped}


@check()
def numbers_that_start_again_go_on_counting() -> Figures:
    with vivid() as device:
        set_control(device, "Wrap Sequence Number", 1)
        lines = answers(
            "camera_probe", "--device", str(device), "--json", *SIZE, "--format", "grey", "--frames", "160"
        )
    frames = [line for line in lines if line["line"] == "frame"]
    assert frames[0]["sequence"] < 2**32 < frames[-1]["sequence"], (frames[0], frames[-1])
    assert_losses_match_the_numbers(frames)
    assert not [line for line in lines if line["line"] == "event" and line["event"] == "sequence"]
    return {"first": frames[0]["sequence"], "last": frames[-1]["sequence"]}


@check()
def timestamps_that_start_again_are_an_event() -> Figures:
    with vivid() as device:
        set_control(device, "Wrap Timestamp", 1)
        lines = answers(
            "camera_probe", "--device", str(device), "--json", *SIZE, "--format", "grey", "--frames", "20"
        )
    frames = [line for line in lines if line["line"] == "frame"]
    times = [line["driver_ns"] for line in frames]
    assert times == sorted(times), times
    found = [line for line in lines if line["line"] == "event" and line["event"] == "timestamp"]
    assert found, lines
    return {"events": len(found), "first": found[0]["text"]}
