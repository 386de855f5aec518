"""Places of labels beside their points, without overlap."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import numpy.typing as npt

__all__ = ["label_corners"]

Array = npt.NDArray[np.float64]

#: Directions tried at every distance, right and left first.
_DIRECTIONS = 24
#: Distance of the nearest place, and steps to farther ones, px.
_FIRST_PX, _STEP_PX = 13.0, 7.0


def label_corners(
    anchors_px: Array, sizes_px: Array, bounds_px: tuple[float, float, float, float], obstacles_px: Array
) -> Array:
    """Lower left corners of labels, each as near to its point as free space allows.

    Labels are placed in order. A label may cover neither a label placed before it nor an obstacle, and must
    lie within the bounds. If nothing is free, the nearest place within the bounds is taken.

    Parameters
    ----------
    anchors_px
        (N, 2) points that are labelled.
    sizes_px
        (N, 2) widths and heights.
    bounds_px
        Left, bottom, right and top.
    obstacles_px
        (M, 4) boxes: left, bottom, right and top.

    Returns
    -------
    (N, 2) array
    """
    taken = [np.asarray(box, np.float64) for box in obstacles_px]
    found = np.empty((len(anchors_px), 2))
    for index, (anchor, size) in enumerate(zip(anchors_px, sizes_px, strict=True)):
        found[index] = _place(anchor, size, bounds_px, taken)
        taken.append(np.append(found[index], found[index] + size))
    return found


def _place(anchor: Array, size: Array, bounds_px: Sequence[float], taken: Sequence[Array]) -> Array:
    """The nearest free place; the nearest of all if none is free."""
    low, high = np.array(bounds_px[:2]), np.array(bounds_px[2:]) - size
    nearest = np.clip(anchor, low, np.maximum(low, high))
    for corner in _candidates(anchor, size, bounds_px):
        if not _overlaps(np.append(corner, corner + size), taken):
            return corner
    return np.asarray(nearest)


def _candidates(anchor: Array, size: Array, bounds_px: Sequence[float]) -> Iterator[Array]:
    """Places within the bounds on growing rings around a point, the nearest first."""
    low, high = np.array(bounds_px[:2]), np.array(bounds_px[2:]) - size
    reach_px = float(np.hypot(*(np.array(bounds_px[2:]) - bounds_px[:2])))
    turns = 2.0 * np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS
    turns = turns[np.argsort(np.abs(np.sin(turns)), kind="stable")]
    for distance in np.arange(_FIRST_PX, reach_px, _STEP_PX):
        for turn in turns:
            way = np.array([np.cos(turn), np.sin(turn)])
            # The label's near side or corner is at the distance.
            corner = anchor + distance * way + 0.5 * size * (way / np.abs(way).max() - 1.0)
            if np.all(corner >= low) and np.all(corner <= high):
                yield corner


def _overlaps(box: Array, taken: Sequence[Array]) -> bool:
    return any(
        box[0] < other[2] and other[0] < box[2] and box[1] < other[3] and other[1] < box[3] for other in taken
    )
