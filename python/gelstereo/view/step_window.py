"""Stepping through a recording in an OpenCV window."""

from __future__ import annotations

from collections.abc import Sequence

from gelstereo.view.canvas import Image
from gelstereo.view.picture import draw
from gelstereo.view.steps import Step, Steps

_NAME = "gelstereo view"
#: Interval of checks whether the window was closed, milliseconds.
_EVENTS_MS = 50
#: Codes of `cv2.waitKeyEx` with GTK and Qt, on Windows and on macOS, and letters.
_NEXT = {65363, 2555904, 63235, ord("d"), ord("n"), ord(" ")}
_BEFORE = {65361, 2424832, 63234, ord("a"), ord("p")}
_FIRST = {65360, 2359296, 63273}
_LAST = {65367, 2293760, 63275}
_CLOSE = {27, ord("q")}


def step_after(key: int, number: int, count: int) -> int | None:
    """The step selected by a key in step `number` of `count`; None closes the window.

    Examples
    --------
    >>> step_after(65363, 0, 3), step_after(65361, 0, 3), step_after(27, 0, 3)
    (1, 0, None)
    """
    if key in _CLOSE:
        return None
    if key in _NEXT:
        number += 1
    elif key in _BEFORE:
        number -= 1
    elif key in _FIRST:
        number = 0
    elif key in _LAST:
        number = count - 1
    return min(max(number, 0), count - 1)


def step_through(steps: Steps) -> None:
    """Show one step at a time. Arrow keys, Home and End change it; Escape, q or closing the window ends.

    Raises
    ------
    RecordingError
        If the recording has no steps.
    """
    import cv2

    listed = list(steps)
    cv2.namedWindow(_NAME, cv2.WINDOW_NORMAL | cv2.WINDOW_KEEPRATIO | cv2.WINDOW_GUI_NORMAL)
    try:
        picture = _numbered(steps, listed, 0)
        cv2.resizeWindow(_NAME, picture.shape[1], picture.shape[0])
        number: int | None = 0
        while number is not None:
            cv2.imshow(_NAME, picture)
            number = _next_step(number, len(listed))
            picture = picture if number is None else _numbered(steps, listed, number)
    finally:
        cv2.destroyAllWindows()


def _next_step(shown: int, count: int) -> int | None:
    """Wait for a key that changes the step, or for the end."""
    import cv2

    while True:
        key = cv2.waitKeyEx(_EVENTS_MS)
        if key != -1 and (number := step_after(key, shown, count)) != shown:
            return number
        if cv2.getWindowProperty(_NAME, cv2.WND_PROP_VISIBLE) < 1:
            return None


def _numbered(steps: Steps, listed: Sequence[Step], number: int) -> Image:
    moment = steps.moment(listed[number])
    return draw(moment.titled(f"{moment.title} ({number + 1} of {len(listed)})"))
