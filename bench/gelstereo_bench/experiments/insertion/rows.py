"""Number of markers along an edge that have the same distance from it, and therefore correlated errors."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

__all__ = ["markers_alike"]

Array = npt.NDArray[np.float64]

#: Lattice directions, in pitches: rows, diagonals, and knight's moves.
_STEPS = np.array([[1, 0], [0, 1], [1, 1], [1, -1], [2, 1], [2, -1], [1, 2], [1, -2]], np.float64)
#: Markers whose distances from an edge differ by less than this count as one, in pitches. Set on hexagonal
#: pegs of seeds 2 and 11, whose wrong poses had chances near 1 within 0.04 rad of a row, a diagonal or a
#: knight's move, and nowhere else.
_ALIKE = 0.06


def markers_alike(axis: Array, points_mm: Array, pitch_mm: float) -> float:
    """Count the markers beside an edge along `axis`, (3,) in the sensor's frame, at the same distance from
    it; at least 1.

    The lattice's rows are along the sensor's x and y. If the edge is rotated by an angle from a lattice
    direction, the distance from the edge changes from marker to marker by the step times the sine.

    Parameters
    ----------
    axis
        Direction of the edges.
    points_mm
        Salient markers, (N, 3); their extent is the edges' length.
    pitch_mm
        Pitch of the lattice.
    """
    along = axis[:2] / np.linalg.norm(axis[:2])
    reach = np.ptp(points_mm[:, :2] @ along) / pitch_mm
    steps = np.linalg.norm(_STEPS, axis=1)
    apart = np.abs(_STEPS @ np.array([-along[1], along[0]]))
    counts = np.minimum(reach / steps, _ALIKE / np.maximum(apart, 1e-9))
    return max(float(counts.max()), 1.0)
