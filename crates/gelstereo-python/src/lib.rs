//! Python bindings: thin conversions, no logic. One file per topic of the public surface.
#![forbid(unsafe_code)]
#![cfg_attr(not(test), deny(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout))]
// The exported items are documented in Python's docstrings; `pub` here is for sibling files.
#![allow(clippy::needless_pass_by_value)]

mod arrays;
mod camera;
mod camera_info;
mod closest;
mod codec;
mod compliance;
mod contact;
mod detect;
mod errors;
mod force;
mod frame;
mod frames;
mod geometry;
mod given;
mod gripper;
mod interrupt;
mod lattice;
mod layer;
mod localizer;
mod marker_tracker;
mod motion;
mod moved;
mod names;
mod notebook;
mod params;
mod pickle;
mod pipeline;
mod pitch_check;
mod random;
mod register;
mod rest_record;
mod rig;
mod sim;
mod slip;
mod surface;
mod template;
mod tree;
mod triangulate;

use pyo3::prelude::*;

/// The compiled part of gelstereo; import names from `gelstereo` instead.
#[pymodule]
mod _native {
    #[pymodule_export]
    use crate::camera::{Camera, CameraFrame, decode_camera_frame, list_cameras};
    #[pymodule_export]
    use crate::camera_info::{CameraControl, CameraInfo};
    #[pymodule_export]
    use crate::closest::{Closest, Surface, Symmetry, turned_outward};
    #[pymodule_export]
    use crate::codec::{Blink1Command, TaraAssembly, TaraRequest, hid_udev_rule};
    #[pymodule_export]
    use crate::compliance::Compliance;
    #[pymodule_export]
    use crate::contact::{RestSurface, adaptive_saliency, pressure_saliency, skin_over};
    #[pymodule_export]
    use crate::detect::{Detector, Markers};
    #[pymodule_export]
    use crate::errors::{
        CameraError, ContactError, DetectError, Error, FrameError, GripperError, HidError, ImageError,
        LabelError, LayerError, MeshError, ParamsError, PitchWarning, PoseError, RegisterError, RigError,
        SceneError, ShapeError, TemplateError, TriangulateError,
    };
    #[pymodule_export]
    use crate::force::{ForceEstimator, Wrench};
    #[pymodule_export]
    use crate::frame::{Frame, ViewEvidence};
    #[pymodule_export]
    use crate::frames::{FingerKinematics, SensorMount, adjusted_gripper};
    #[pymodule_export]
    use crate::geometry::{
        fuse_plane, fuse_poses, nearest, rigid_fit, se3_exp, se3_log, so3_exp, so3_from_matrix,
        so3_left_jacobian, so3_left_jacobian_inverse, so3_log,
    };
    #[pymodule_export]
    use crate::gripper::{GripperDriver, GripperStatus};
    #[pymodule_export]
    use crate::lattice::{PrintDescription, RestLattice, describe_print, foresight_sort, rest_lattice};
    #[pymodule_export]
    use crate::layer::{LayerContact, LayerSolution};
    #[pymodule_export]
    use crate::localizer::Localizer;
    #[pymodule_export]
    use crate::marker_tracker::{MarkerTracker, TrackedMarkers, pair_views};
    #[pymodule_export]
    use crate::motion::{
        MotionTracker, PartMotion, Recognition, motion_kinds, motion_sources, motion_statuses,
        recognition_statuses, recognize_surface,
    };
    #[pymodule_export]
    use crate::params::Params;
    #[pymodule_export]
    use crate::pipeline::{Pipeline, marker_states};
    #[pymodule_export]
    use crate::pitch_check::PitchCheck;
    #[pymodule_export]
    use crate::random::RandomStream;
    #[pymodule_export]
    use crate::register::{FreeDirection, Localization, localize};
    #[pymodule_export]
    use crate::rest_record::RestRecord;
    #[pymodule_export]
    use crate::rig::{Rectification, Rig};
    #[pymodule_export]
    use crate::sim::{
        Plan, PlannedEffect, Scene, SimulatedDots, SimulatedFrame, SimulatedLoads, Simulator, shape_mesh,
        sights,
    };
    #[pymodule_export]
    use crate::slip::{
        Slip, SlipMargin, SlipTracker, friction_margin, margin_sources, slip_statuses, sticks,
    };
    #[pymodule_export]
    use crate::surface::DenseSurface;
    #[pymodule_export]
    use crate::template::Template;
    #[pymodule_export]
    use crate::tree::parse_toml;
    #[pymodule_export]
    use crate::triangulate::{disc_bias, triangulate, triangulate_covariance};

    #[pymodule_init]
    fn init(module: &pyo3::Bound<'_, pyo3::types::PyModule>) -> pyo3::PyResult<()> {
        use pyo3::types::PyModuleMethods;
        module.add("__version__", env!("CARGO_PKG_VERSION"))
    }
}
