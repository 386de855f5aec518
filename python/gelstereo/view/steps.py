"""A recording, step by step: one moment per stage, or per given number of frames."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from gelstereo._native import Rig
from gelstereo.view.edges import feature_edges_mm
from gelstereo.view.mcap_file import Header, Recorded, end_at_damage, read_header, read_messages
from gelstereo.view.messages import (
    IMAGE_TOPICS,
    Cloud,
    LeftImage,
    RecordingError,
    cloud_of,
    pose_of,
    text_of,
)
from gelstereo.view.moment import Moment, Part, pose_in_words
from gelstereo.view.recorded_part import mesh_of, rig_of

__all__ = ["Step", "Steps", "outcome_in_words"]

Floats = npt.NDArray[np.float64]
Triangles = npt.NDArray[np.int64]

#: Stages without the part in the hand: an earlier pose is no longer valid.
_WITHOUT_PART = ("open", "rest", "close", "retreat")
#: Outcome, motion, a trigger, the pose, and what is free.
_NOTE_LINES = 5
#: The stage of sensing without a task, in which a pose is valid only for its own frame.
_SENSE = "sense"


@dataclass(frozen=True)
class Step:
    """One moment of a run.

    Attributes
    ----------
    number : int
        Number from 0, in the order of the recording.
    stage : str
        Name of the stage; empty where the recording names none.
    time_ns : int
        Time on the recording's clock.
    index : int, optional
        Index of the frame since the last rest frame.
    motion_px : float, optional
        Mean motion of the markers in the left image since the reference.
    cloud, reference : Cloud
        Present markers, and the reference of the motion.
    image : LeftImage
    t_sensor_object : (4, 4) float64, optional
        Pose of the part, millimetres.
    free : tuple of str
        Directions that the contact does not determine.
    events : tuple of str
        Triggers, and frames that could not be sensed, since the previous step.
    outcome : str
        Outcome of the run, in the last step.
    """

    number: int
    stage: str
    time_ns: int
    index: int | None
    motion_px: float | None
    cloud: Cloud
    reference: Cloud
    image: LeftImage
    t_sensor_object: Floats | None = None
    free: tuple[str, ...] = ()
    events: tuple[str, ...] = ()
    outcome: str = ""

    @property
    def place(self) -> str:
        """Stage and frame, as text."""
        frame = "a frame" if self.index is None else f"frame {self.index}"
        return f"{self.stage}, {frame}" if self.stage else frame


class Steps:
    """Iterates over the steps of a recording, and converts them to moments.

    Parameters
    ----------
    path
        An MCAP file; a truncated one is read up to its end.
    every
        Number of frames with an image per step. Default: one step per stage, of its last frame.
    """

    def __init__(self, path: str | Path, every: int | None = None) -> None:
        self.path = Path(path)
        self._every = every
        self._rig: Rig | None = None
        self._mesh: tuple[Floats, Triangles] | None = None

    def __iter__(self) -> Iterator[Step]:
        """Read the recording from its start.

        Raises
        ------
        RecordingError
            If the file is not a recording of a sensor, or has no frame with markers and an image.
        FileNotFoundError
            If there is no such file.
        """
        walk = _Walk(self._every)
        for _ in self._walked(walk):
            yield from walk.finished()
        walk.close()
        yield from walk.finished()

    def located(self) -> Step:
        """The frame of the last pose, or the last frame without one. Its motion counts from the first frame.

        Raises
        ------
        RecordingError, FileNotFoundError
            As in iteration.
        """
        walk = _Walk(self._every)
        for _ in self._walked(walk):
            walk.finished()
        step = walk.located or walk.newest
        assert step is not None and walk.first is not None, "checked by _walked"
        return replace(step, reference=walk.first)

    def _walked(self, walk: _Walk) -> Iterator[None]:
        """Pass all messages to the walk; yields after each."""
        try:
            for message in read_messages(self.path):
                walk.take(message)
                yield
        except Exception as error:
            end_at_damage(self.path, error, walk.newest is not None)
        if walk.newest is None:
            raise RecordingError(
                f"{self.path} has no stereo frame with markers; valid is a recording by gelstereo-host"
            )

    def moment(self, step: Step) -> Moment:
        """The moment of a step, for a picture."""
        rig, mesh = self._model()
        part, edges_px = None, None
        if mesh is not None and step.t_sensor_object is not None:
            part = Part.located(*mesh, step.t_sensor_object)
            edges_px = _seen_by(rig, feature_edges_mm(part))
        return Moment(
            left=step.image.pixels(),
            rows=step.cloud.rows,
            cols=step.cloud.cols,
            left_px=rig.project(step.cloud.points_mm)[0],
            reference_px=rig.project(step.reference.points_mm)[0],
            points_mm=step.cloud.points_mm,
            indentation_mm=step.cloud.indentation_mm,
            state=step.cloud.state,
            salient=step.cloud.salient,
            part=part,
            title=f"{self.path.name}: {step.place}",
            notes=_padded(notes_of(step)),
            part_edges_px=edges_px,
        )

    def _model(self) -> tuple[Rig, tuple[Floats, Triangles] | None]:
        if self._rig is None:
            header: Header = read_header(self.path)
            self._rig, self._mesh = rig_of(header), mesh_of(header)
        return self._rig, self._mesh


def _seen_by(rig: Rig, edges_mm: Floats) -> Floats:
    """Visible edges in the left image, (E, 2, 2)."""
    edges_px: Floats = rig.project(edges_mm.reshape(-1, 3))[0].reshape(-1, 2, 2)
    return edges_px


def _padded(notes: list[str]) -> list[str]:
    """Notes padded to the usual number of lines, so that all pictures have the same size."""
    return notes + [""] * (_NOTE_LINES - len(notes))


def notes_of(step: Step) -> list[str]:
    """Lines about a step, the outcome first."""
    notes = [f"ended: {step.outcome}"] if step.outcome else []
    if step.motion_px is not None:
        notes.append(f"mean marker motion {step.motion_px:.2f} px")
    return [*notes, *step.events, *pose_notes(step)]


def pose_notes(step: Step) -> list[str]:
    """Lines about a step's pose; none without one."""
    if step.t_sensor_object is None:
        return []
    free = "free, object frame: " + "; ".join(step.free) if step.free else "all six directions determined"
    return [pose_in_words(step.t_sensor_object), free]


def outcome_in_words(outcome: dict[str, Any]) -> str:
    """A recorded outcome as a phrase.

    Examples
    --------
    >>> outcome_in_words({"kind": "nothing_felt", "depth_mm": 11.0})
    'nothing felt: depth 11.00 mm'
    """
    details = [_detail(name, value) for name, value in outcome.items() if name != "kind"]
    kind = str(outcome.get("kind", "unknown")).replace("_", " ")
    return f"{kind}: {', '.join(details)}" if details else kind


def _detail(name: str, value: Any) -> str:
    words = name.replace("_", " ")
    if not isinstance(value, float):
        return f"{words} {value}"
    stem, _, unit = words.rpartition(" ")
    return f"{stem} {value:.2f} {unit}" if stem else f"{words} {value:.2f}"


@dataclass
class _Walk:
    """State while reading the recording."""

    every: int | None
    stage: str = ""
    layout: str = "side_by_side"
    frames: int = 0
    steps: int = 0
    image: LeftImage | None = None
    note: dict[str, Any] = field(default_factory=dict)
    time_ns: int = 0
    first: Cloud | None = None
    reference: Cloud | None = None
    awaits_reference: bool = True
    pose: Floats | None = None
    free: tuple[str, ...] = ()
    events: list[str] = field(default_factory=list)
    #: The newest frame with markers and an image, and later messages about it.
    newest: Step | None = None
    #: The frame of the last pose.
    located: Step | None = None
    #: Whether the newest frame already is a step of this stage.
    is_step: bool = False
    _ready: list[Step] = field(default_factory=list)

    def finished(self) -> list[Step]:
        """Completed steps; each is returned once."""
        ready, self._ready = self._ready, []
        return ready

    def take(self, message: Recorded) -> None:
        topic, data = message.topic, message.data
        if topic in IMAGE_TOPICS:
            self.image = LeftImage(topic, bytes(data), self.layout)
        elif topic == "/gelstereo/capture":
            self._take_capture(json.loads(text_of(data)))
        elif topic == "/gelstereo/frame":
            self.note, self.time_ns = json.loads(text_of(data)), message.log_ns
            if "error" in self.note:
                self.events.append(f"a frame could not be sensed: {self.note['error']}")
        elif topic == "/gelstereo/points":
            self._take_cloud(cloud_of(data))
        elif topic == "/gelstereo/pose":
            self.pose, self.located = pose_of(data), self.newest
            self._locate()
        elif topic == "/gelstereo/stage":
            self._take_stage(json.loads(text_of(data)))

    def close(self) -> None:
        """End a stage or the recording: its newest frame becomes a step."""
        if self.newest is not None and not self.is_step:
            self._emit(self.newest if self.every is not None else replace(self.newest, stage=self.stage))

    def _take_capture(self, capture: dict[str, Any]) -> None:
        if "event" not in capture:
            # An image belongs to the capture before it; some captures have no recorded image.
            self.layout, self.image = capture.get("layout", self.layout), None
        elif capture["event"] == "trigger" and capture.get("cause") != "end":
            self.events.append(f"trigger: {capture.get('cause')}")

    def _take_cloud(self, cloud: Cloud) -> None:
        if self.every is not None and (self.frames - 1) % self.every == 0:
            # No more messages about the previous frame will follow.
            self.close()
        self.first = self.first or cloud
        if self.awaits_reference or self.reference is None:
            self.reference, self.awaits_reference = cloud, False
        if self.stage in (_SENSE, ""):
            self.pose, self.free = None, ()
        if self.image is None:
            return
        self.newest = Step(
            number=self.steps,
            stage=self.stage,
            time_ns=self.time_ns,
            index=self.note.get("index"),
            motion_px=self.note.get("motion_px"),
            cloud=cloud,
            reference=self.reference,
            image=self.image,
            t_sensor_object=self.pose,
            free=self.free,
        )
        self.is_step = False
        self.frames += 1

    def _take_stage(self, note: dict[str, Any]) -> None:
        if "free" in note:
            self.free = tuple(note["free"])
            self._locate()
        request = note.get("request")
        if request is not None:
            self._take_request(request)
        elif "outcome" in note or "error" in note:
            if self.newest is not None:
                self.newest = replace(self.newest, outcome=_ending(note))
            self.close()
        elif "free" not in note:
            self._begin(str(note.get("stage", "")))

    def _begin(self, stage: str) -> None:
        if self.every is None:
            self.close()
            self.is_step = False
        self.stage = stage
        if stage in _WITHOUT_PART:
            self.pose, self.free = None, ()
            self._locate()

    def _take_request(self, request: dict[str, Any]) -> None:
        if request.get("action") == "reset":
            self.awaits_reference = True
        elif request.get("action") == "mark_reference" and self.newest is not None:
            self.reference = self.newest.cloud

    def _locate(self) -> None:
        """Pose and free directions belong to the newest frame; they follow it in either order."""
        if self.newest is None:
            return
        newest = replace(self.newest, t_sensor_object=self.pose, free=self.free)
        if self.located is self.newest and self.pose is not None:
            self.located = newest
        self.newest = newest

    def _emit(self, step: Step) -> None:
        self._ready.append(replace(step, number=self.steps, events=tuple(self.events)))
        self.events.clear()
        self.steps += 1
        self.is_step = True


def _ending(note: dict[str, Any]) -> str:
    if "outcome" in note:
        return outcome_in_words(note["outcome"])
    return f"broke off: {note['error']}"
