"""The last located moment of a recording that ``gelstereo-host`` or ``gelstereo live`` wrote.

Reading needs the extra ``recording``: ``pip install gelstereo[recording]``.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from gelstereo.view.messages import RecordingError
from gelstereo.view.moment import Moment
from gelstereo.view.steps import Steps, pose_notes

__all__ = ["RecordingError", "moment_of_recording"]


def moment_of_recording(path: str | Path) -> Moment:
    """The moment of the last pose in a recording, or its last frame if the part was never located.

    Parameters
    ----------
    path
        An MCAP file; a truncated one is read up to its end.

    Raises
    ------
    RecordingError
        If the file is not a recording of a sensor, or has no frame with markers and an image.
    FileNotFoundError
        If there is no such file.
    """
    steps = Steps(path)
    step = steps.located()
    moment = steps.moment(step)
    place = "last frame" if step.index is None else f"frame {step.index}"
    return replace(
        moment,
        title=f"{steps.path.name}: {'part located' if moment.part else 'no part located'}, {place}",
        notes=pose_notes(step),
    )
