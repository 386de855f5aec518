"""Live sensing: frames of a camera, a scene or a folder, their results, and viewers that do not
slow it down.
"""

from gelstereo.live.sensing import LiveResult, LiveSensor
from gelstereo.live.source import CameraSource, FolderSource, LiveFrame, LiveSource, SceneSource

__all__ = [
    "CameraSource",
    "FolderSource",
    "LiveFrame",
    "LiveResult",
    "LiveSensor",
    "LiveSource",
    "SceneSource",
]
