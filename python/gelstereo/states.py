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
