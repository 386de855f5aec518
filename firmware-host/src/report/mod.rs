//! The report of a job, and the page that shows it.

mod broken_off;
mod file;
mod page;
mod trace;

pub use broken_off::{ErrorOutcome, ErrorReport};
pub use file::page_path;
pub use page::page;
pub use trace::Trace;

use crate::recording::RecordingReport;
use crate::task::LatencyReport;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// A stage of the job (Fig. 11 of the paper).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Stage {
    /// Gripper activated and opened, robot at the part.
    Open,
    /// Rest frame of the gel without contact.
    Rest,
    /// Closing until the grasp trigger.
    Close,
    /// Localizing the part in the hand.
    Localize,
    /// Touching a face of the cell with the held part, to measure its position.
    Touch,
    /// Moving the part above the hole.
    Align,
    /// Lowering until the insertion trigger.
    Insert,
    /// Leaving the hole, with or without the part.
    Retreat,
    /// The job is finished.
    Done,
    /// No job: continuous sensing without a robot.
    Sense,
}

impl Stage {
    /// Name of the stage.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Open => "open",
            Self::Rest => "rest",
            Self::Close => "close",
            Self::Localize => "localize",
            Self::Touch => "touch",
            Self::Align => "align",
            Self::Insert => "insert",
            Self::Retreat => "retreat",
            Self::Done => "done",
            Self::Sense => "sense",
        }
    }
}

/// A figure with its unit in the name.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Figure {
    /// For example `motion_px`.
    pub name: &'static str,
    /// Its value.
    pub value: f64,
}

/// Duration and results of a stage.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct StageReport {
    /// The stage.
    pub stage: Stage,
    /// Time on this computer's clock.
    pub wall_s: f64,
    /// Time on the frame source's clock.
    pub source_s: f64,
    /// Stereo pairs recorded.
    pub frames: u64,
    /// Number of pairs that could not be processed; the recording has the reasons.
    pub bad_frames: u64,
    /// Results.
    pub figures: Vec<Figure>,
    /// What does not stop the task but makes its results less reliable, with the likely causes.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub warnings: Vec<String>,
}

/// How a job ended, as far as the robot itself can determine.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case", tag = "kind")]
pub enum Outcome {
    /// The insertion trigger stopped the robot at the depth of the hole, within the uncertainty of the
    /// part's position.
    Inserted {
        /// Depth below the rim at the stop, from the estimated position of the part along the axis.
        depth_mm: f64,
        /// Three standard deviations of that depth.
        within_mm: f64,
    },
    /// The insertion trigger stopped the robot before the depth of the hole.
    Jammed {
        /// Depth below the rim at the stop, from the estimated position of the part along the axis.
        depth_mm: f64,
        /// Three standard deviations of that depth.
        within_mm: f64,
    },
    /// The goal was taught.
    Taught {
        /// Origin of the part at its goal as localized, base frame.
        position_mm: [f64; 3],
    },
    /// Nothing stopped the part over the whole travel.
    NothingFelt {
        /// Depth below the rim at the end of the travel.
        depth_mm: f64,
    },
    /// Nothing stopped the part on its way to a face of `task.edges`.
    EdgeNotFelt {
        /// Index of the face, from 0.
        edge: usize,
        /// Travel of the hand.
        travel_mm: f64,
    },
    /// The fingers stopped before the grasp trigger.
    NotGrasped {
        /// Mean marker motion at the stop.
        motion_px: f64,
        /// Opening width at the stop.
        width_mm: f64,
    },
    /// The part's pose could not be determined.
    NotLocalized {
        /// The reason.
        reason: String,
    },
    /// After all looks, the probability that the part fits into the hole is below `task.min_chance`.
    Declined {
        /// Probability that it would fit.
        chance: f64,
        /// Number of looks at the part.
        looks: u32,
        /// The least certain motion over the hole, and its standard deviation.
        weakest: String,
    },
    /// The source has no more stereo pairs.
    SourceEnded {
        /// The stage at that time.
        stage: Stage,
    },
    /// A stop was requested.
    Interrupted {
        /// The stage at that time.
        stage: Stage,
    },
}

impl Outcome {
    /// Outcome for a part that is localized, but not accurately enough for the hole.
    #[must_use]
    pub fn declined(localized: &Localized, forecast: Forecast) -> Self {
        Self::Declined { chance: forecast.chance, looks: localized.looks, weakest: forecast.weakest }
    }
}

impl std::fmt::Display for Outcome {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Inserted { depth_mm, within_mm } => {
                write!(
                    f,
                    "inserted: felt the bottom at a depth of {depth_mm:.2} mm, within {within_mm:.2} mm"
                )
            }
            Self::Jammed { depth_mm, within_mm } => write!(
                f,
                "jammed: stopped by the insertion trigger at a depth of {depth_mm:.2} mm, within \
                {within_mm:.2} mm"
            ),
            Self::Taught { position_mm: [x, y, z] } => {
                write!(f, "taught: the part was localized in its goal at ({x:.2}, {y:.2}, {z:.2}) mm")
            }
            Self::NothingFelt { depth_mm } => {
                write!(
                    f,
                    "no contact down to a depth of {depth_mm:.2} mm: there is no part, or the hole has no \
                    bottom"
                )
            }
            Self::EdgeNotFelt { edge, travel_mm } => write!(
                f,
                "edge not felt: nothing stopped the part on a way of {travel_mm:.2} mm to face {edge} of \
                 task.edges; is it where the configuration says?"
            ),
            Self::NotGrasped { motion_px, width_mm } => write!(
                f,
                "not grasped: the fingers rest at {width_mm:.2} mm with a marker motion of {motion_px:.2} px"
            ),
            Self::NotLocalized { reason } => write!(f, "not localized: {reason}"),
            Self::Declined { chance, looks, weakest } => write!(
                f,
                "declined: the chance of insertion is {chance:.3} after {looks} looks; least known is \
                {weakest}"
            ),
            Self::SourceEnded { stage } => write!(f, "no more stereo pairs during {}", stage.name()),
            Self::Interrupted { stage } => write!(f, "interrupted during {}", stage.name()),
        }
    }
}

/// Forecast of an insertion.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Forecast {
    /// Probability that the part fits, 0 to 1.
    pub chance: f64,
    /// The motion over the hole whose uncertainty costs the most room, and its standard deviation.
    pub weakest: String,
    /// Standard deviation of the tip across the hole, along the least certain direction.
    pub lateral_sigma_mm: f64,
}

/// The part's pose in the hand, with figures on its quality.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Localized {
    /// Rows of the 4x4 matrix that maps part coordinates to sensor coordinates, millimetres.
    pub t_sensor_object: [[f64; 4]; 4],
    /// Rows of the 4x4 matrix that maps part coordinates to gripper coordinates, millimetres.
    pub t_gripper_object: [[f64; 4]; 4],
    /// Whether the iterations converged.
    pub converged: bool,
    /// Number of iterations.
    pub iterations: u32,
    /// Number of inlier points.
    pub inliers: usize,
    /// Number of points in contact.
    pub points: usize,
    /// RMS residual of the inliers.
    pub rmse_mm: f64,
    /// Standard deviations of x y z, millimetres, then rotations, radians (sensor frame).
    pub sigma: [f64; 6],
    /// Standard deviation of the part's position along the insertion axis.
    pub axial_sigma_mm: f64,
    /// Directions that the contact leaves free, in words.
    pub free: Vec<String>,
    /// Looks at the part, including touches. The pose in the gripper is fused from all of them; the other
    /// figures are of the last grasp.
    pub looks: u32,
    /// Number of touches of a face of the cell among them.
    pub touches: u32,
    /// Forecast of the insertion; present if `task.clearance_mm` is given.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub forecast: Option<Forecast>,
}

/// Ground truth of a simulated job. The errors are those of the part's localized pose in the hand, or of
/// the expected pose if it was not localized.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TruthReport {
    /// Error of the part's origin across the insertion axis.
    pub lateral_error_mm: f64,
    /// Error of the tip across the insertion axis.
    pub tip_error_mm: f64,
    /// Error of the direction of the insertion axis.
    pub tilt_error_rad: f64,
    /// Error along the axis.
    pub axial_error_mm: f64,
    /// Depth that the part reached; negative if it never reached the rim.
    pub inserted_mm: f64,
    /// Depth that it could have reached in the posture in which it was aligned.
    pub limit_mm: f64,
    /// Distance of the tip from the hole's axis at the deepest position of the hand.
    pub hole_offset_mm: f64,
    /// Angle between the axes of part and hole at the same moment.
    pub hole_tilt_rad: f64,
    /// Whether the reported outcome is correct.
    pub outcome_is_true: bool,
}

/// Result of writing the page of a run.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct PageReport {
    /// Path of the page.
    pub path: PathBuf,
    /// Why it could not be written, if it could not.
    pub fault: Option<String>,
}

/// Report of a job.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct JobReport {
    /// How it ended.
    pub outcome: Outcome,
    /// Why it stopped, in one sentence.
    pub why: String,
    /// The stages that were started.
    pub stages: Vec<StageReport>,
    /// Latencies from images to results and to stop commands.
    pub latency: LatencyReport,
    /// The localized part in the hand, if it was found.
    pub localized: Option<Localized>,
    /// Ground truth; in simulation only.
    pub truth: Option<TruthReport>,
    /// Digest of all frames' digests, in order.
    pub digest: String,
    /// The recording, and whether it ended early.
    pub recording: Option<RecordingReport>,
    /// Why the light could not be switched off at the end, if it could not.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub light_fault: Option<String>,
    /// The page of the run, if requested.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub page: Option<PageReport>,
}
