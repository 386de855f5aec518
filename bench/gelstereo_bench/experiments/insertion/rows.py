"""How many markers along an edge of a part lie alike to it, and so err together."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

__all__ = ["markers_alike"]

Array = npt.NDArray[np.float64]

#: Rows, diagonals, and the ways of a knight: steps of the lattice, in pitches.
_STEPS = np.array([[1, 0], [0, 1], [1, 1], [1, -1], [2, 1], [2, -1], [1, 2], [1, -2]], np.float64)
#: Markers whose distances from an edge differ by less lie alike to it, in pitches. Set on hexagonal pegs of seeds 2 and
#: 11, whose wrong poses had chances near 1 within 0.04 rad of a row, a diagonal or a knight's way, and nowhere else.
_ALIKE = 0.06


def markers_alike(axis: Array, points_mm: Array, pitch_mm: float) -> float:
    """Count the markers beside an edge along `axis`, (3,) in the sensor's frame, that lie alike to it; at least 1.

    The lattice's rows are along the sensor's x and y. Where the edge turns by an angle from a way of the lattice, the
    distance of its markers from the edge changes from each to the next by the step times the sine.

    Parameters
    ----------
    axis
        Direction of the edges.
    points_mm
        Salient markers, (N, 3): the edges are as long as they reach.
    pitch_mm
        Of the lattice.
    """
    along = axis[:2] / np.linalg.norm(axis[:2])
    reach = np.ptp(points_mm[:, :2] @ along) / pitch_mm
    steps = np.linalg.norm(_STEPS, axis=1)
    apart = np.abs(_STEPS @ np.array([-along[1], along[0]]))
    counts = np.minimum(reach / steps, _ALIKE / np.maximum(apart, 1e-9))
    return max(float(counts.max()), 1.0)
