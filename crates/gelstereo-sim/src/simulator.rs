//! From a scene to marker positions and images.

use crate::scene::{Scene, SceneError};
use alloc::vec::Vec;
use gelstereo_core::math::{DVec2, DVec3, Pose};
use gelstereo_core::surface::TriangleMesh;

/// How the indenter touches the gel at one moment.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(deny_unknown_fields))]
pub struct ContactState {
    /// Object frame to sensor frame.
    pub t_sensor_object: Pose,
    /// How far the contact has dragged the surface along, sensor x and y, since it touched.
    pub shear_mm: [f64; 2],
    /// How far it has turned the surface about the contact's centre, radians.
    pub twist_rad: f64,
}

/// Ground truth of one moment; marker `row * cols + col` stands at that index.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Truth {
    /// Marker centres, sensor frame, millimetres.
    pub points_mm: Vec<DVec3>,
    /// Height above the rest surface, towards the camera.
    pub indentation_mm: Vec<f64>,
    /// Whether the indenter touches the gel at this marker.
    pub in_contact: Vec<bool>,
    /// Centres in the left image.
    pub left_px: Vec<DVec2>,
    /// Centres in the right image.
    pub right_px: Vec<DVec2>,
}

/// A scene made ready to run.
#[derive(Clone, Debug)]
pub struct Simulator {}

impl Simulator {
    /// Makes a scene ready; `mesh` is the indenter's surface when its shape is a mesh file.
    ///
    /// # Errors
    /// [`SceneError`].
    pub fn new(scene: &Scene, mesh: Option<&TriangleMesh>) -> Result<Self, SceneError> {
        let _ = (scene, mesh);
        unimplemented!()
    }

    /// Frames of the trajectory (1 when nothing moves).
    #[must_use]
    pub fn frames(&self) -> usize {
        unimplemented!()
    }

    /// The trajectory's contact at a frame; `None` without an indenter.
    #[must_use]
    pub fn contact(&self, frame: usize) -> Option<ContactState> {
        let _ = frame;
        unimplemented!()
    }

    /// Marker positions for a contact (`None`: nothing touches).
    pub fn truth(&mut self, contact: Option<&ContactState>, out: &mut Truth) {
        let _ = (contact, out);
        unimplemented!()
    }

    /// Renders both views of a moment, `height * width` bytes each; `frame` keys the noise.
    pub fn render(&mut self, truth: &Truth, frame: u64, left: &mut Vec<u8>, right: &mut Vec<u8>) {
        let _ = (truth, frame, left, right);
        unimplemented!()
    }
}
