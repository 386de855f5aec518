"""Calibration of forces: from known loads to the gel's modulus.

`calibrate` fits Young's modulus, and if asked Poisson's ratio, to the markers' motion under known loads.
"""

from gelstereo.force.fit import ForceCalibration, LoadResult, calibrate
from gelstereo.force.loads import Load, LoadsError, read_loads
from gelstereo.force.pressed import Pressed, pressed_frames

__all__ = [
    "ForceCalibration",
    "Load",
    "LoadResult",
    "LoadsError",
    "Pressed",
    "calibrate",
    "pressed_frames",
    "read_loads",
]
