"""Whether OpenCV can open windows here."""

from __future__ import annotations

import os
import sys


def window_problem(instead: str) -> str | None:
    """Why no window can be opened here, or None. `instead` says what else shows pictures.

    The wheel that gelstereo depends on is the headless one. It has no windows even on a desktop, since the other one
    brings Qt along and does not install beside it.
    """
    import cv2

    if not cv2.currentUIFramework():
        return (
            f"this OpenCV has no windows; {instead}, or replace opencv-contrib-python-headless by "
            "opencv-contrib-python"
        )
    if sys.platform == "linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        return f"there is no display (neither DISPLAY nor WAYLAND_DISPLAY is set); {instead}"
    return None
