//! Results as JSON, one line per frame.

use super::contact::Contact;
use crate::notes::tracking_name;
use crate::source::Capture;
use gelstereo_core::force::Wrench;
use gelstereo_core::math::sqrt;
use gelstereo_core::pipeline::Frame;
use gelstereo_core::register::{Registration, TrackingStatus};
use gelstereo_core::slip::{Margin, Slip, SlipStatus};
use serde::{Deserialize, Serialize};

/// All results of one stereo pair.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct FrameLine {
    /// Time on the frame source's clock.
    pub time_ns: u64,
    /// How the pair was captured.
    pub capture: Capture,
    /// Frames since the rest frame; absent for a frame that could not be processed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub index: Option<u64>,
    /// Contact; absent until the rest state is learned.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub contact: Option<Contact>,
    /// Force and torque of the part on the gel; absent without contact, or without `force.method`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub wrench: Option<WrenchLine>,
    /// Slip of the part along the gel; absent without contact, or without `slip.method`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub slip: Option<SlipLine>,
    /// The part's pose; absent when it is not localized.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pose: Option<PoseLine>,
    /// Positions of all markers in the sensor frame, millimetres; absent unless requested.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub points_mm: Option<Vec<[f64; 3]>>,
    /// Digest of all results of the frame.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub digest: Option<String>,
    /// Why the frame could not be processed or the part could not be localized.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub error: Option<String>,
}

/// Force and torque of the part on the gel, in the sensor frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct WrenchLine {
    /// Force, newtons.
    pub force_n: [f64; 3],
    /// Torque about `about_mm`, newton millimetres.
    pub torque_nmm: [f64; 3],
    /// Centroid of the rest markers.
    pub about_mm: [f64; 3],
    /// Standard deviations of force and torque.
    pub sigma: [f64; 6],
    /// Unexplained motion over its variance; 1 is none.
    pub misfit: f64,
    /// Whether the contact reaches the lattice's border, so that forces beyond it are missing.
    pub is_cut: bool,
}

impl From<&Wrench> for WrenchLine {
    fn from(wrench: &Wrench) -> Self {
        Self {
            force_n: wrench.force_n.to_array(),
            torque_nmm: wrench.torque_nmm.to_array(),
            about_mm: wrench.about_mm.to_array(),
            sigma: core::array::from_fn(|i| sqrt(wrench.covariance[i][i])),
            misfit: wrench.misfit,
            is_cut: wrench.is_cut,
        }
    }
}

/// Slip of the part along the gel.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SlipLine {
    /// `unknown`, `stuck`, `incipient` or `gross`.
    pub status: SlipStatus,
    /// Markers that stick over those known to stick or slip; absent while none is known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stick_ratio: Option<f64>,
    /// Range of the ratio of areas.
    pub stick_range: [f64; 2],
    /// Motion of the part since it touched the gel, sensor frame; absent if too few markers stick.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub motion: Option<[[f64; 4]; 4]>,
    /// Share of the friction limit that is not used; absent if it is not known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub margin: Option<Margin>,
}

impl From<&Slip> for SlipLine {
    fn from(slip: &Slip) -> Self {
        Self {
            status: slip.status,
            stick_ratio: slip.stick_ratio,
            stick_range: slip.stick_range,
            motion: slip.motion.map(|motion| motion.pose.to_rows()),
            margin: slip.margin,
        }
    }
}

/// Pose of the held part.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PoseLine {
    /// `found`, `followed` or `lost`. The pose of a lost part is the best search result and is not reliable.
    pub tracking: String,
    /// Rows of the 4x4 matrix that maps part coordinates to sensor coordinates, millimetres.
    pub t_sensor_object: [[f64; 4]; 4],
    /// Standard deviations of x y z, millimetres, then of rotations about x y z, radians (sensor frame).
    pub sigma: [f64; 6],
    /// RMS residual of the inliers.
    pub rmse_mm: f64,
    /// Number of inlier points.
    pub inliers: usize,
    /// Directions that the contact leaves free, in words.
    pub free: Vec<String>,
}

impl PoseLine {
    /// From a registration and its covariance (millimetres, radians).
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
    /// Adds the results of a good frame.
    pub fn add_frame(&mut self, frame: &Frame, with_points: bool) {
        self.index = Some(frame.index);
        self.digest = Some(format!("{:016x}", frame.digest()));
        self.wrench = frame.wrench.as_ref().map(WrenchLine::from);
        self.slip = frame.slip.as_ref().map(SlipLine::from);
        self.points_mm = with_points.then(|| frame.points_mm.iter().map(|point| point.to_array()).collect());
    }
}
