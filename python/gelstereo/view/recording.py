"""The last located moment of a recording that ``gelstereo-host`` wrote (MCAP with ROS 2 messages).

Reading needs the extra ``recording``: ``pip install gelstereo[recording]``.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

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

__all__ = ["RecordingError", "moment_of_recording"]

Floats = npt.NDArray[np.float64]


@dataclass
class _Located:
    """The first cloud, and the last of each message type up to the last pose (or to the end if there is no pose)."""

    header: Header = field(default_factory=Header)
    rest: Cloud | None = None
    cloud: Cloud | None = None
    left: npt.NDArray[np.uint8] | None = None
    layout: str = "side_by_side"
    frame: dict[str, Any] = field(default_factory=dict)
    pose: Floats | None = None
    at_pose: tuple[Cloud, npt.NDArray[np.uint8], dict[str, Any]] | None = None
    notes: dict[str, Any] = field(default_factory=dict)


def moment_of_recording(path: str | Path) -> Moment:
    """The moment of the last pose in a recording, or its last frame if the part was never located.

    Parameters
    ----------
    path
        An MCAP file; a truncated one is read up to its end.

    Raises
    ------
    RecordingError
        If the file is not a recording of a sensor.
    FileNotFoundError
        If there is no such file.
    """
    recorded = _read(Path(path))
    if recorded.rest is None or recorded.cloud is None or recorded.left is None:
        raise RecordingError(
            f"{path} has no stereo frame with markers; valid is a recording by gelstereo-host"
        )
    cloud, left, frame = recorded.at_pose or (recorded.cloud, recorded.left, recorded.frame)
    rig = rig_of(recorded.header)
    part = None if recorded.pose is None else _part(recorded.header, recorded.pose)
    notes = [] if recorded.pose is None else [pose_in_words(recorded.pose)]
    free = recorded.notes.get("free")
    if recorded.pose is not None:
        notes.append("free: " + "; ".join(free) if free else "all six directions determined")
    place = f"frame {frame['index']}" if "index" in frame else "last frame"
    return Moment(
        left=left,
        rows=cloud.rows,
        cols=cloud.cols,
        left_px=rig.project(cloud.points_mm)[0],
        reference_px=rig.project(recorded.rest.points_mm)[0],
        points_mm=cloud.points_mm,
        indentation_mm=cloud.indentation_mm,
        state=cloud.state,
        salient=cloud.salient,
        part=part,
        title=f"{Path(path).name}: {'part located' if part else 'no part located'}, {place}",
        notes=notes,
    )


def _read(path: Path) -> _Located:
    located = _Located()
    try:
        for message in read_messages(path):
            _take(located, message)
    except Exception as error:
        end_at_damage(path, error, located.cloud is not None)
    located.header = read_header(path)
    return located


def _take(located: _Located, message: Recorded) -> None:
    topic, data = message.topic, message.data
    if topic in IMAGE_TOPICS:
        located.left = LeftImage(topic, data, located.layout).pixels()
    elif topic == "/gelstereo/capture":
        located.layout = json.loads(text_of(data)).get("layout", located.layout)
    elif topic == "/gelstereo/points":
        located.cloud = cloud_of(data)
        located.rest = located.rest or located.cloud
    elif topic == "/gelstereo/frame":
        located.frame = json.loads(text_of(data))
    elif topic == "/gelstereo/stage":
        note = json.loads(text_of(data))
        if "free" in note:
            located.notes = note
    elif topic == "/gelstereo/pose" and located.cloud is not None and located.left is not None:
        located.pose = pose_of(data)
        located.at_pose = (located.cloud, located.left, located.frame)


def _part(header: Header, t_sensor_object: Floats) -> Part | None:
    mesh = mesh_of(header)
    return None if mesh is None else Part.located(*mesh, t_sensor_object)
