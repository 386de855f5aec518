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


class MarginSource(IntEnum):
    """What a margin to the friction limit follows from, as in `SlipMargin.source`.

    Examples
    --------
    >>> MarginSource(1).name
    'LIMIT'
    """

    STICK = 0
    """The stick ratio, by the law of ``slip.shape``."""
    LIMIT = 1
    """The wrench and ``force.friction``."""


class MotionStatus(IntEnum):
    """How well a motion is known, as in `PartMotion.status`.

    Examples
    --------
    >>> MotionStatus(1).name
    'TRACKED'
    """

    STARTED = 0
    """First frame of a contact: the motion is the identity by definition."""
    TRACKED = 1
    """All directions are determined."""
    PARTIAL = 2
    """Some directions are not determined. Their variance grows from frame to frame, as set by
    ``motion.free_turn_rad`` and ``motion.free_shift_mm``.
    """
    PREDICTED = 3
    """Neither markers nor surface determine a direction."""


class MotionSource(IntEnum):
    """What a motion is found from, as in `PartMotion.source`.

    Examples
    --------
    >>> MotionSource(1).name
    'MARKERS'
    """

    NOTHING = 0
    """Nothing: the part is where it was, with a larger variance."""
    MARKERS = 1
    """Markers that stick."""
    SURFACE = 2
    """The surface of the contact."""
    BOTH = 3
    """Both."""


class MotionKind(IntEnum):
    """How a part moves along the gel, as in `PartMotion.kind`.

    Examples
    --------
    >>> MotionKind(2).name
    'ROLLS'
    """

    UNKNOWN = 0
    """The contact is new, or it is not known whether the gel holds the part."""
    RESTS = 1
    """The part is held, and the contact stays on the same part of its surface."""
    ROLLS = 2
    """The contact moves over the part and over the gel in the same direction."""
    SLIDES = 3
    """The gel does not hold the part, which moves along it."""
    ROLLS_AND_SLIDES = 4
    """Both."""
