"""Check whether OpenCV can open windows."""

from __future__ import annotations

import os
import sys

from gelstereo.extras import needs


def window_problem(instead: str) -> str | None:
    """Reason why no window can be opened, or None. `instead` names an alternative for the message.

    gelstereo depends on OpenCV's headless wheel, which has no windows even on a desktop. The full wheel
    brings Qt, and cannot be installed beside it.
    """
    with needs(__name__):
        import cv2

    if not cv2.currentUIFramework():
        return (
            f"this OpenCV has no windows; {instead}, or replace opencv-contrib-python-headless by "
            "opencv-contrib-python"
        )
    if sys.platform == "linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        return f"there is no display (neither DISPLAY nor WAYLAND_DISPLAY is set); {instead}"
    return None
