"""Settings of a GelStereo camera."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from lerobot.cameras import CameraConfig

SOURCES = ("camera", "scene", "folder")
PICTURES = ("left", "pair", "motion")


@CameraConfig.register_subclass("gelstereo")
@dataclass(kw_only=True)
class GelStereoCameraConfig(CameraConfig):
    """Settings of a GelStereo camera.

    Attributes
    ----------
    fps, width, height : int, optional
        Frames a second and size of the picture. LeRobot's robots need all three. A size that differs from
        what the source gives is an error, except for ``motion``, which is made in any size.
    source : str
        ``camera``, ``scene`` (a simulated sensor) or ``folder`` (images ``left/NAME.png`` and
        ``right/NAME.png``).
    device, right_device : str, optional
        The camera: its path, or ``serial:`` and its USB serial number; the second one if each view has a
        device of its own.
    settings : dict
        Anything else that `gelstereo.cameras.open` takes, for example ``{layout: interleaved, exposure_us:
        8000}``.
    path : Path, optional
        The scene's file or the folder.
    picture : str
        ``left``: the left image. ``pair``: left and right image side by side. ``motion``: how markers moved
        since the first frame, one cell each: x, y and z displacement as red, green and blue around 128.
    rig : Path, optional
        Rig file, for ``motion``. A scene has its own; of a folder it is ``rig.toml`` in it if left out.
    preset : str
        Settings of the pipeline, for ``motion``.
    motion_full_scale_mm : float
        Displacement that reaches black or full colour. Two millimetres are as deep as a 5 mm gel is usually
        pressed.
    max_stale_ms : float
        After so long without a new frame, reading is an error. Frames at 30 Hz are 33 ms apart.
    connect_timeout_s : float
        Time for the first frame.
    """

    source: str = "camera"
    device: str | None = None
    right_device: str | None = None
    settings: dict[str, Any] = field(default_factory=dict)
    path: Path | None = None
    picture: str = "left"
    rig: Path | None = None
    preset: str = "balanced"
    motion_full_scale_mm: float = 2.0
    max_stale_ms: float = 500.0
    connect_timeout_s: float = 10.0

    def __post_init__(self) -> None:
        _check(self.source in SOURCES, "source", self.source, f"one of {SOURCES}")
        _check(self.picture in PICTURES, "picture", self.picture, f"one of {PICTURES}")
        if self.source == "camera":
            _check(
                self.device is not None, "device", self.device, "the camera's path, or serial: and its number"
            )
            needs_rig = self.picture == "motion" and self.rig is None
            _check(not needs_rig, "rig", self.rig, "the camera's rig file, for picture: motion")
        else:
            _check(self.path is not None, "path", self.path, f"the {self.source}'s path")
        for name in ("motion_full_scale_mm", "max_stale_ms", "connect_timeout_s"):
            _check(getattr(self, name) > 0.0, name, getattr(self, name), "more than 0")
        for name in ("fps", "width", "height"):
            value = getattr(self, name)
            _check(value is None or value > 0, name, value, "more than 0")


def _check(good: bool, name: str, found: object, valid: str) -> None:
    if not good:
        raise ValueError(f"{name} is {found!r}; valid is {valid}")
