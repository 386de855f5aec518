"""Data for viewers: a result, the figures at that time, and the recording."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from gelstereo.live.meter import Reading
from gelstereo.live.sensing import LiveResult, contact_of, markers_of


@dataclass(frozen=True)
class Shown:
    """One moment of a live run.

    Attributes
    ----------
    result : LiveResult
    reading : Reading
    recording : str or None
        Name and size of the file being written, as text.
    """

    result: LiveResult
    reading: Reading
    recording: str | None = None

    def as_json(self) -> dict[str, Any]:
        """Everything except the images, for JSON; lengths in millimetres, times in milliseconds."""
        frame, sensed, located = self.result.frame, self.result.sensed, self.result.located
        pose = None
        if located is not None:
            pose = {
                "t_sensor_object": located.t_sensor_object.tolist(),
                "tracking": located.tracking,
                "free": [str(direction) for direction in located.free],
            }
        return {
            "sequence": frame.sequence,
            "time_ns": frame.time_ns,
            "stale": frame.stale,
            "skew_ns": frame.skew_ns,
            "latency_ms": self.result.latency_ms,
            "problem": self.result.problem,
            "markers": None if sensed is None else markers_of(sensed),
            "contact": None if sensed is None else contact_of(sensed),
            "pose": pose,
            "recording": self.recording,
            **{"source": asdict(self.reading)},
        }
