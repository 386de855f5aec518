"""Recordings as tables, and recordings of other stereo-marker sensors as clouds with a rest frame.

`load_recording` reads what `gelstereo-host` and `gelstereo live` write, as tables for polars and pandas.

`load_pytac3d` reads the arrays that PyTac3D writes (the sensors of Zhang et al., "Tac3D", a mirror stereo
camera over a domed gel); `pytac3d_example` finds those that come with its wheel. `contacts` finds the
contacts of a frame, `fit_radius` the radius of a part, and `undo_smoothing` reverses the recorder's smoothing
over time.
"""

from __future__ import annotations

from gelstereo.recordings.clouds import CloudRecording, RecordingError
from gelstereo.recordings.fits import CylinderFit, PlaneFit, SphereFit, fit_cylinder, fit_plane, fit_sphere
from gelstereo.recordings.pytac3d import load_pytac3d, pytac3d_example
from gelstereo.recordings.radii import RadiusFit, cap_radius_sigma_mm, fit_radius
from gelstereo.recordings.regions import Contact, contacts, episodes
from gelstereo.recordings.runs import Recording, load_recording
from gelstereo.recordings.smoothing import (
    detrended_covariance,
    intact,
    noise_gain,
    noise_mm,
    smoothing_frames,
    undo_smoothing,
)

__all__ = [
    "CloudRecording",
    "Contact",
    "CylinderFit",
    "PlaneFit",
    "RadiusFit",
    "Recording",
    "RecordingError",
    "SphereFit",
    "cap_radius_sigma_mm",
    "contacts",
    "detrended_covariance",
    "episodes",
    "fit_cylinder",
    "fit_plane",
    "fit_radius",
    "fit_sphere",
    "intact",
    "load_pytac3d",
    "load_recording",
    "noise_gain",
    "noise_mm",
    "pytac3d_example",
    "smoothing_frames",
    "undo_smoothing",
]
