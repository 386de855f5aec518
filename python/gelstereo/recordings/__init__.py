"""Recordings of real stereo-marker sensors, as clouds with a rest frame.

`load_pytac3d` reads the arrays that PyTac3D writes (the sensors of Zhang et al., "Tac3D", a mirror stereo camera over
a domed gel); `pytac3d_example` finds those that come with its wheel. `contacts` finds who touches where.
"""

from __future__ import annotations

from gelstereo.recordings.clouds import CloudRecording, RecordingError
from gelstereo.recordings.contacts import Contact, contacts, episodes
from gelstereo.recordings.fits import CylinderFit, PlaneFit, SphereFit, fit_cylinder, fit_plane, fit_sphere
from gelstereo.recordings.pytac3d import load_pytac3d, pytac3d_example

__all__ = [
    "CloudRecording",
    "Contact",
    "CylinderFit",
    "PlaneFit",
    "RecordingError",
    "SphereFit",
    "contacts",
    "episodes",
    "fit_cylinder",
    "fit_plane",
    "fit_sphere",
    "load_pytac3d",
    "pytac3d_example",
]
