"""Calibration of forces: from known loads to the gel's modulus; and compliance matrices of finite gels.

`calibrate` fits Young's modulus, and if asked Poisson's ratio, to the markers' motion under known loads.
`calibrate_resultant` fits the stiffnesses of the method `resultant`, which has no model of the gel.
`compute_compliance` computes how a narrow gel with free sides moves, by finite elements.
`PressedSkin` gives the skin over a print below it, with the pressure that the markers' motion shows.
"""

from gelstereo.force.compliance import compute_compliance
from gelstereo.force.fit import ForceCalibration, LoadResult, calibrate
from gelstereo.force.loads import Load, LoadsError, read_loads
from gelstereo.force.pressed import Pressed, pressed_frames
from gelstereo.force.resultant import ResultantCalibration, calibrate_resultant
from gelstereo.force.skin import PressedSkin, pressed_skin

__all__ = [
    "ForceCalibration",
    "Load",
    "LoadResult",
    "LoadsError",
    "Pressed",
    "PressedSkin",
    "ResultantCalibration",
    "calibrate",
    "calibrate_resultant",
    "compute_compliance",
    "pressed_frames",
    "pressed_skin",
    "read_loads",
]
