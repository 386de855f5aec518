"""What is known of a marker."""

from enum import IntEnum


class MarkerState(IntEnum):
    """State of a marker in one frame, as in `Frame.state`.

    Examples
    --------
    >>> MarkerState(1).name
    'HELD'
    """

    SEEN = 0
    """Measured in this frame."""
    HELD = 1
    """Not measured; its position is carried over, or filled in from its neighbours if it was never printed."""
    LOST = 2
    """Not measured for longer than ``track.max_held_frames``; its position is the last one known."""


class Sight(IntEnum):
    """What there is to see of a simulated marker in one image; where several hold, the last in this list.

    Examples
    --------
    >>> Sight(1).name
    'CUT'
    """

    WHOLE = 0
    """All of it."""
    CUT = 1
    """The image's border cuts it."""
    MERGED = 2
    """Ink joins it to another one."""
    COVERED = 3
    """A smear reaches it."""
    OUTSIDE = 4
    """It lies outside the image, or behind the camera."""
    NOT_PRINTED = 5
    """It was not printed."""
