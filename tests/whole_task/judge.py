"""Holds what the host said and recorded against what happened in the world."""

from __future__ import annotations

import itertools
import json
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from whole_task.cell import Cell, Outcome, wait_until

# Outcomes that say nothing of the insertion; all others but "inserted" name the reason against it.
NO_ANSWERS = {"interrupted", "source_ended", "error"}
# After a part vanished the world may move on for so long: the longest watchdog of the defaults,
# task.frame_timeout_s, and what a busy computer adds.
MAX_MOTION_S = 3.0

# Of the world's camera.
PERIOD_S = 1 / 30

Frame = dict[str, Any]


def assert_true(outcome: Outcome) -> None:
    """The host's outcome is what happened in the world."""
    inserted = outcome.truth["inserted_mm"] >= outcome.truth["hole_depth_mm"]
    assert outcome.report is not None and outcome.kind not in NO_ANSWERS, (outcome.kind, outcome.errors)
    assert (outcome.kind == "inserted") == inserted, (outcome.report, outcome.truth)
    assert outcome.code == (0 if inserted else 1), outcome.errors


def frames(recording: Path, sent: Mapping[int, int] | None = None) -> list[Frame]:
    """Frames of a recording in their order: ``stage``, ``motion_px`` and ``world_frame``, the world's number
    of it.

    Without `sent` the camera's numbers are the world's. Else `sent` has the number by the CRC-32 of the JPEG
    file.
    """
    numbers = world_frames(recording, sent)
    stage, found = "", []
    for topic, time_ns, data in messages(recording):
        if topic in ("/gelstereo/stage", "/gelstereo/frame"):
            said = note(data)
            if topic == "/gelstereo/stage":
                stage = said.get("stage", stage)
            elif "motion_px" in said:
                found.append({"stage": stage, "time_ns": time_ns, **said})
    return [{**frame, "world_frame": numbers[frame["time_ns"]]} for frame in found]


def world_frames(recording: Path, sent: Mapping[int, int] | None = None) -> dict[int, int]:
    """The world's number of each recorded image pair, by its time in ns."""
    numbers = {}
    for topic, time_ns, data in messages(recording):
        if topic == "/gelstereo/stereo/image/compressed" and sent is not None:
            numbers[time_ns] = sent[zlib.crc32(data[data.index(b"\xff\xd8\xff") :])]
        elif topic == "/gelstereo/capture" and sent is None and "sequence" in (said := note(data)):
            numbers[time_ns] = said["sequence"]
    return numbers


def lost_frames(recording: Path, sent: Mapping[int, int] | None = None) -> int:
    """How many of the world's frames a recording skips between its first and its last."""
    numbers = sorted(set(world_frames(recording, sent).values()))
    return numbers[-1] - numbers[0] + 1 - len(numbers) if numbers else 0


def messages(recording: Path) -> Iterator[tuple[str, int, bytes]]:
    """Topic, time in ns and data of each message, in the order of the file."""
    from mcap.reader import make_reader

    with recording.open("rb") as file:
        for _, channel, message in make_reader(file).iter_messages(log_time_order=False):
            yield channel.topic, message.publish_time, message.data


def note(data: bytes) -> dict[str, Any]:
    """A string in CDR: four bytes of encapsulation, its length, its bytes and a zero."""
    found: dict[str, Any] = json.loads(data[8:].rstrip(b"\0"))
    return found


@dataclass(frozen=True)
class Delay:
    """By how much a computer was late, and how long the camera's frames took."""

    late_s: float
    period_s: float = PERIOD_S


def assert_trigger(
    outcome: Outcome, recorded: list[Frame], stage: str, px: float, mover: str, delay: Delay
) -> int:
    """Return how many frames were exposed before a ``gripper`` or ``robot`` was stopped.

    At most one is allowed, and those that fit into the computer's `delay`.

    A gripper without a command to stop is sent to where it is.
    """
    first = next(frame for frame in recorded if frame["stage"] == stage and frame["motion_px"] >= px)
    moves = {"gripper": "fingers_move", "robot": "robot_moves"}[mover]
    later = [event for event in outcome.events if event["frame"] >= first["world_frame"]]
    acted = next(
        event for event in later if event["event"] in (f"{mover}_stop", f"{mover}_move") or not event[moves]
    )
    exposed: int = acted["frame"] - first["world_frame"]
    late = f"{mover} stopped {exposed} frames after the one with {first['motion_px']:.1f} px"
    max_exposed = 1 + round(delay.late_s / delay.period_s)
    assert exposed <= max_exposed, f"{late}; the computer was late by {delay.late_s:.3f} s"
    return exposed


def assert_triggers(outcome: Outcome, recorded: list[Frame], delay: Delay) -> dict[str, int]:
    """Both triggers acted within one frame of the one that shows them; frames exposed before they did."""
    if outcome.kind == "not_grasped":
        assert all(frame["motion_px"] < 10.0 for frame in recorded if frame["stage"] == "close")
        return {}
    exposed = {"grasp": assert_trigger(outcome, recorded, "close", 10.0, "gripper", delay)}
    if outcome.kind in {"inserted", "jammed"}:
        exposed["insertion"] = assert_trigger(outcome, recorded, "insert", 5.0, "robot", delay)
    return exposed


def assert_at_rest(opened: Cell, since_ns: int, within_s: float = MAX_MOTION_S) -> None:
    """Nothing moves in the world any more after so long, unless fingers finish their last move as grippers
    do.
    """
    rest_ns = since_ns + int(within_s * 1e9)

    def late() -> list[Frame]:
        return [event for event in opened.events() if event["time_ns"] > rest_ns]

    # The world's clock is this computer's; some frames must follow, since a world that has stopped moves
    # nothing.
    wait_until(lambda: len(late()) >= 4, "the world to go on", within_s + 10.0)
    events = late()
    places = {tuple(event["position_mm"]) for event in events}
    assert len(places) == 1, f"the robot moves: {places}"
    # A stop may come late, when the host has given a silent gripper up; it moves nothing.
    commands = [
        event for event in events if event["event"] != "exposed" and not event["event"].endswith("_stop")
    ]
    assert not commands, commands
    # Fingers that finish a move go one way.
    ways_mm = [after["width_mm"] - before["width_mm"] for before, after in itertools.pairwise(events)]
    assert min(ways_mm) >= 0.0 or max(ways_mm) <= 0.0, ways_mm
