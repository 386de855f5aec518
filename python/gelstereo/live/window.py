"""The live picture in an OpenCV window; needs OpenCV with window support and a display."""

from __future__ import annotations

from collections.abc import Callable

from gelstereo.live.latest import Latest
from gelstereo.live.shown import Shown
from gelstereo.view.canvas import Image

_NAME = "gelstereo live"
_ESCAPE = 27
#: Time for window events per picture, milliseconds; also the polling interval for a new picture.
_EVENTS_MS = 15


def show_window(newest: Latest[Shown], draw: Callable[[Shown], Image]) -> None:
    """Show the newest moment until the run ends, the window is closed, or Escape or q is pressed."""
    import cv2

    number = 0
    cv2.namedWindow(_NAME, cv2.WINDOW_NORMAL | cv2.WINDOW_KEEPRATIO | cv2.WINDOW_GUI_NORMAL)
    try:
        while not newest.closed:
            found = newest.newer_than(number, 0.2)
            if found is not None:
                picture = draw(found[1])
                if number == 0:
                    cv2.resizeWindow(_NAME, picture.shape[1], picture.shape[0])
                number = found[0]
                cv2.imshow(_NAME, picture)
            if cv2.waitKey(_EVENTS_MS) & 0xFF in (_ESCAPE, ord("q")):
                return
            if number and cv2.getWindowProperty(_NAME, cv2.WND_PROP_VISIBLE) < 1:
                return
    finally:
        cv2.destroyAllWindows()
