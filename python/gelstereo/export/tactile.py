"""Forces at the markers, as LeRobot's tactile features have them."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

_Floats = npt.NDArray[np.float64]

_N_PER_KPA_MM2 = 1e-3


def force_features(
    displacement_mm: _Floats,
    traction_kpa: _Floats,
    pitch_mm: float | list[float],
    force_n: _Floats,
    torque_nmm: _Floats,
) -> dict[str, _Floats]:
    """The features ``force`` (N, 3), ``full`` (N, 6) and ``wrench`` (6,).

    Parameters
    ----------
    displacement_mm, traction_kpa
        (N, 3) motion of the markers since rest, and tractions that are uniform over the cell of a pitch
        around each of them.
    pitch_mm
        Of the lattice; two numbers of a rectangular one.
    force_n, torque_nmm
        (3,) wrench about the origin of the left camera's frame.
    """
    cell_n = traction_kpa * (np.prod(np.broadcast_to(pitch_mm, 2)) * _N_PER_KPA_MM2)
    return {
        "force": cell_n,
        "full": np.hstack([displacement_mm, cell_n]),
        "wrench": np.concatenate([force_n, torque_nmm]),
    }
