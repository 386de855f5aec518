//! The sensing stages in order, over scratch that is allocated once.

use crate::image::GrayView;
use crate::math::{DVec2, DVec3};
use crate::params::{Params, ParamsError};
use crate::rig::Rig;
use crate::track::MarkerState;
use crate::{
    contact::ContactError, contact::RestSurface, detect::DetectError, label::LabelError,
    triangulate::TriangulateError,
};
use alloc::vec::Vec;

/// Where the rows and columns of a frame come from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum LabelSource {
    /// The rest frame's lattice.
    #[default]
    Rest,
    /// Foresight sort of this frame.
    Foresight,
    /// The tracks since the rest frame.
    Tracks,
}

/// What one view contributed to a frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ViewEvidence {
    /// Markers detected.
    pub detected: usize,
    /// Where the labels come from; `Tracks` under `label.method = foresight` means that the sort refused.
    pub labels: LabelSource,
    /// Markers whose label by the sort differs from that by their track.
    pub relabelled: usize,
}

/// Everything that one stereo frame gave; marker `row * cols + col` stands at that index in every list.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Frame {
    /// Frames since the last reset, from 0 (the rest frame).
    pub index: u64,
    /// Positions in the left image, pixels.
    pub left_px: Vec<DVec2>,
    /// Positions in the right image, pixels.
    pub right_px: Vec<DVec2>,
    /// Seen only when both views saw it.
    pub state: Vec<MarkerState>,
    /// Positions in the sensor frame, millimetres.
    pub points_mm: Vec<DVec3>,
    /// Height above the rest surface, towards the camera, millimetres.
    pub indentation_mm: Vec<f64>,
    /// In contact (Eq. 4).
    pub salient: Vec<bool>,
    /// Mean motion of the seen markers of the left view since the reference, pixels.
    pub motion_px: f64,
    /// The left view's evidence.
    pub left: ViewEvidence,
    /// The right view's evidence.
    pub right: ViewEvidence,
}

/// Why a frame gave no result. The pipeline's tracks are then as after the last good frame.
#[derive(Clone, Debug, PartialEq)]
pub enum PipelineError {
    /// Settings.
    Params(ParamsError),
    /// Image size differs from the rig's.
    Size { view: &'static str, found: (usize, usize), expected: (usize, usize) },
    /// Detection failed in one view.
    Detect { view: &'static str, error: DetectError },
    /// Labelling failed in one view.
    Label { view: &'static str, error: LabelError },
    /// Triangulation failed.
    Triangulate(TriangulateError),
    /// The rest surface failed.
    Contact(ContactError),
}

impl core::fmt::Display for PipelineError {
    fn fmt(&self, _f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        unimplemented!()
    }
}

impl core::error::Error for PipelineError {}

/// Sensing: stereo frames in, tactile point clouds out.
#[derive(Clone, Debug)]
pub struct Pipeline {}

impl Pipeline {
    /// For this rig, with these settings. The first frame processed is the rest frame.
    ///
    /// # Errors
    /// [`PipelineError::Params`] or [`PipelineError::Triangulate`] for an invalid rig.
    pub fn new(rig: &Rig, params: &Params) -> Result<Self, PipelineError> {
        let _ = (rig, params);
        unimplemented!()
    }

    /// Forgets tracks, rest surface and reference: the next frame is the rest frame.
    pub fn reset(&mut self) {
        unimplemented!()
    }

    /// Measures motion from the present frame on (the paper's "moment before grasping / insertion").
    pub fn mark_reference(&mut self) {
        unimplemented!()
    }

    /// The rest surface, once a rest frame was processed.
    #[must_use]
    pub fn rest(&self) -> Option<&RestSurface> {
        unimplemented!()
    }

    /// Runs all sensing stages on one stereo frame.
    ///
    /// # Errors
    /// [`PipelineError`] naming stage and view; the state is then as before the call.
    pub fn process(
        &mut self,
        left: GrayView<'_>,
        right: GrayView<'_>,
        out: &mut Frame,
    ) -> Result<(), PipelineError> {
        let _ = (left, right, out);
        unimplemented!()
    }
}

impl Frame {
    /// Digest of all results.
    #[must_use]
    pub fn digest(&self) -> u64 {
        unimplemented!()
    }

    /// The salient points, in the order of the markers; `out` is cleared first.
    pub fn salient_points_mm(&self, out: &mut Vec<DVec3>) {
        out.clear();
        out.extend(
            self.points_mm
                .iter()
                .zip(&self.salient)
                .filter(|&(_, &salient)| salient)
                .map(|(&point, _)| point),
        );
    }
}
