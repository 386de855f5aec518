//! Results as JSON, one line a frame.

use super::contact::Contact;
use crate::notes::tracking_name;
use crate::source::Capture;
use gelstereo_core::math::sqrt;
use gelstereo_core::pipeline::Frame;
use gelstereo_core::register::{Registration, TrackingStatus};
use serde::{Deserialize, Serialize};

/// Everything that one stereo pair gave.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct FrameLine {
    /// The frame source's time.
    pub time_ns: u64,
    /// How the pair was captured.
    pub capture: Capture,
    /// Frames since the rest frame; absent for a frame that could not be sensed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub index: Option<u64>,
    /// Contact; absent while the rest state is not known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub contact: Option<Contact>,
    /// The part's pose, while it is localized.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pose: Option<PoseLine>,
    /// Positions of all markers in the sensor frame, millimetres, where they were asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub points_mm: Option<Vec<[f64; 3]>>,
    /// Digest of all results of the frame.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub digest: Option<String>,
    /// Why the frame could not be sensed, or the part not localized.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub error: Option<String>,
}

/// The part in the hand.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PoseLine {
    /// `found`, `followed` or `lost`; a lost part's pose is the best one that a search gave, and not to be
    /// relied on.
    pub tracking: String,
    /// Rows of the 4x4 matrix that maps part coordinates to sensor coordinates, millimetres.
    pub t_sensor_object: [[f64; 4]; 4],
    /// Standard deviations of x y z, millimetres, then of rotations about x y z, radians (sensor frame).
    pub sigma: [f64; 6],
    /// Residual of the inliers.
    pub rmse_mm: f64,
    /// Points that the part explains.
    pub inliers: usize,
    /// What the contact leaves free, in words.
    pub free: Vec<String>,
}

impl PoseLine {
    /// Of a registration and its covariance (millimetres, radians).
    #[must_use]
    pub fn new(found: &Registration, tracking: TrackingStatus, covariance: &[[f64; 6]; 6]) -> Self {
        Self {
            tracking: tracking_name(tracking).to_owned(),
            t_sensor_object: found.t_sensor_object.to_rows(),
            sigma: core::array::from_fn(|i| sqrt(covariance[i][i])),
            rmse_mm: found.rmse_mm,
            inliers: found.inliers,
            free: found.free.iter().map(ToString::to_string).collect(),
        }
    }
}

impl FrameLine {
    /// Adds what a good frame gave.
    pub fn add_frame(&mut self, frame: &Frame, with_points: bool) {
        self.index = Some(frame.index);
        self.digest = Some(format!("{:016x}", frame.digest()));
        self.points_mm = with_points.then(|| frame.points_mm.iter().map(|point| point.to_array()).collect());
    }
}
