"""Visuotactile sensing with stereo markers: from a stereo frame to the pose of the part in the hand.

A stereo camera looks through a clear gel at a lattice of printed markers. `Pipeline` turns its frames into tactile
point clouds, `localize` registers the part of the cloud that is in contact to the held part's `Template`, and
`SensorMount` takes the pose on to the gripper.

Units and frames are in the names. Lengths are millimetres, angles radians; ``_px`` is pixels with the centre of the
first pixel at (0, 0). ``t_a_b`` is a (4, 4) matrix that maps coordinates of frame b to frame a. The sensor frame is the
left camera's: x right, y down, z away from the camera. Indentation is positive towards the camera. Marker
``row * cols + col`` stands at that index in every array.

Every array that gelstereo returns is read-only; ``.copy()`` gives one that can be written to. Every error derives from
`Error`, which is a ``ValueError``.
"""

from gelstereo import geometry, templates
from gelstereo._native import (
    ContactError,
    DenseSurface,
    DetectError,
    Detector,
    Error,
    FingerKinematics,
    Frame,
    FrameError,
    FreeDirection,
    ImageError,
    LabelError,
    Localization,
    Markers,
    MeshError,
    Params,
    ParamsError,
    Pipeline,
    PoseError,
    Rectification,
    RegisterError,
    RestLattice,
    RestRecord,
    RestSurface,
    Rig,
    RigError,
    Scene,
    SceneError,
    SensorMount,
    ShapeError,
    SimulatedDots,
    SimulatedFrame,
    Simulator,
    Template,
    TemplateError,
    TriangulateError,
    ViewEvidence,
    __version__,
    adjusted_gripper,
    disc_bias,
    foresight_sort,
    localize,
    pressure_saliency,
    rest_lattice,
    triangulate,
    triangulate_covariance,
)
from gelstereo.simulation import simulate
from gelstereo.states import MarkerState, Sight

__all__ = [
    "ContactError",
    "DenseSurface",
    "DetectError",
    "Detector",
    "Error",
    "FingerKinematics",
    "Frame",
    "FrameError",
    "FreeDirection",
    "ImageError",
    "LabelError",
    "Localization",
    "MarkerState",
    "Markers",
    "MeshError",
    "Params",
    "ParamsError",
    "Pipeline",
    "PoseError",
    "Rectification",
    "RegisterError",
    "RestLattice",
    "RestRecord",
    "RestSurface",
    "Rig",
    "RigError",
    "Scene",
    "SceneError",
    "SensorMount",
    "ShapeError",
    "Sight",
    "SimulatedDots",
    "SimulatedFrame",
    "Simulator",
    "Template",
    "TemplateError",
    "TriangulateError",
    "ViewEvidence",
    "__version__",
    "adjusted_gripper",
    "disc_bias",
    "foresight_sort",
    "geometry",
    "localize",
    "pressure_saliency",
    "rest_lattice",
    "simulate",
    "templates",
    "triangulate",
    "triangulate_covariance",
]
