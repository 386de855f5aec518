"""States of markers."""

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
    """Not measured; its position is the previous one, or interpolated from its neighbours if it was never
    printed.
    """
    LOST = 2
    """Not measured for longer than ``track.max_held_frames``; its position is the last known one."""


class Sight(IntEnum):
    """Visibility of a simulated marker in one image; if several apply, the last in this list.

    Examples
    --------
    >>> Sight(1).name
    'CUT'
    """

    WHOLE = 0
    """Fully visible."""
    CUT = 1
    """Cut by the image border."""
    MERGED = 2
    """Joined to another marker by ink."""
    COVERED = 3
    """Touched by a smear."""
    OUTSIDE = 4
    """Outside the image, or behind the camera."""
    NOT_PRINTED = 5
    """Not printed."""


class Stick(IntEnum):
    """Whether the gel around a marker moves with the part, as in `Frame.stick` and `SimulatedLoads.stick`.

    Examples
    --------
    >>> Stick(2).name
    'SLIPS'
    """

    FREE = 0
    """The part does not press here."""
    STUCK = 1
    """It moves with the part."""
    SLIPS = 2
    """It slips along the part."""
    UNKNOWN = 3
    """In contact, but not known: it has just touched, it is not seen, or too few markers stick. Never of a
    simulated gel.
    """


class SlipStatus(IntEnum):
    """Slip of a contact as a whole, as in `Slip.status`.

    Examples
    --------
    >>> SlipStatus(2).name
    'INCIPIENT'
    """

    UNKNOWN = 0
    """Fewer than three markers have been in contact for two frames."""
    STUCK = 1
    """No marker slips."""
    INCIPIENT = 2
    """Some markers slip; the part is still held."""
    GROSS = 3
    """Too few markers stick to hold the part. It lasts until the part leaves the gel."""
