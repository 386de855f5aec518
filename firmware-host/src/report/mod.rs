//! What came of a job, and the page that shows it.

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
    /// Gripper made ready and opened, robot at the part.
    Open,
    /// The gel without contact.
    Rest,
    /// Closing until the grasp trigger.
    Close,
    /// The part's pose in the hand.
    Localize,
    /// The part in the hand brought to a face of the cell, to know its place better.
    Touch,
    /// The part brought above the hole.
    Align,
    /// Lowering until the insertion trigger.
    Insert,
    /// Leaving the hole, with or without the part.
    Retreat,
    /// The end.
    Done,
    /// No job: sensing alone.
    Sense,
}

impl Stage {
    /// Its name.
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

/// What a stage took and gave.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct StageReport {
    /// Which.
    pub stage: Stage,
    /// Time on this computer's clock.
    pub wall_s: f64,
    /// Time on the frame source's clock.
    pub source_s: f64,
    /// Stereo pairs recorded.
    pub frames: u64,
    /// How many of them could not be sensed; the recording says why.
    pub bad_frames: u64,
    /// What it gave.
    pub figures: Vec<Figure>,
}

/// How a job ended, as far as the robot itself can tell.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case", tag = "kind")]
pub enum Outcome {
    /// The insertion trigger stopped the robot at the depth of the hole, within what is known of the part's
    /// place.
    Inserted {
        /// Depth below the rim at the stop, by what is known of the part's place along the axis.
        depth_mm: f64,
        /// Three standard deviations of that depth.
        within_mm: f64,
    },
    /// The insertion trigger stopped the robot before the depth of the hole.
    Jammed {
        /// Depth below the rim at the stop, by what is known of the part's place along the axis.
        depth_mm: f64,
        /// Three standard deviations of that depth.
        within_mm: f64,
    },
    /// The goal was taught.
    Taught {
        /// Origin of the part in its goal, base frame, as it was localized.
        position_mm: [f64; 3],
    },
    /// Nothing stopped the part as far as the robot went.
    NothingFelt {
        /// Depth below the rim where the robot gave up.
        depth_mm: f64,
    },
    /// Nothing stopped the part on its way to a face of `task.edges`.
    EdgeNotFelt {
        /// Which of them, from 0.
        edge: usize,
        /// How far the hand went.
        travel_mm: f64,
    },
    /// The fingers came to rest before the grasp trigger.
    NotGrasped {
        /// Mean marker motion then.
        motion_px: f64,
        /// Opening width then.
        width_mm: f64,
    },
    /// The part's pose could not be determined.
    NotLocalized {
        /// Why.
        reason: String,
    },
    /// The chance that the part goes into the hole is below `task.min_chance`, after all looks at it.
    Declined {
        /// Probability that it would go in.
        chance: f64,
        /// Looks at the part.
        looks: u32,
        /// The motion over the hole that is known least, and its standard deviation.
        weakest: String,
    },
    /// There were no more stereo pairs.
    SourceEnded {
        /// During this stage.
        stage: Stage,
    },
    /// Somebody asked to stop.
    Interrupted {
        /// During this stage.
        stage: Stage,
    },
}

impl Outcome {
    /// The end of a part that is localized, but not well enough for the hole.
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
                "jammed: stopped by the insertion trigger at a depth of {depth_mm:.2} mm, within {within_mm:.2} mm"
            ),
            Self::Taught { position_mm: [x, y, z] } => {
                write!(f, "taught: the part was localized in its goal at ({x:.2}, {y:.2}, {z:.2}) mm")
            }
            Self::NothingFelt { depth_mm } => {
                write!(f, "nothing felt down to a depth of {depth_mm:.2} mm: no part, or no hole's bottom")
            }
            Self::EdgeNotFelt { edge, travel_mm } => write!(
                f,
                "edge not felt: nothing stopped the part on a way of {travel_mm:.2} mm to face {edge} of task.edges; is it \
                 where the configuration says?"
            ),
            Self::NotGrasped { motion_px, width_mm } => write!(
                f,
                "not grasped: the fingers rest at {width_mm:.2} mm with a marker motion of {motion_px:.2} px"
            ),
            Self::NotLocalized { reason } => write!(f, "not localized: {reason}"),
            Self::Declined { chance, looks, weakest } => write!(
                f,
                "declined: the chance of insertion is {chance:.3} after {looks} looks; least known is {weakest}"
            ),
            Self::SourceEnded { stage } => write!(f, "no more stereo pairs during {}", stage.name()),
            Self::Interrupted { stage } => write!(f, "interrupted during {}", stage.name()),
        }
    }
}

/// What a robot expects of an insertion.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Forecast {
    /// Probability that the part goes in, 0 to 1.
    pub chance: f64,
    /// The motion over the hole that is known least of those that matter, and its standard deviation.
    pub weakest: String,
    /// Standard deviation of the tip across the hole, along the direction that is known least.
    pub lateral_sigma_mm: f64,
}

/// The part's pose in the hand, with its evidence.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Localized {
    /// Rows of the 4x4 matrix that maps part coordinates to sensor coordinates, millimetres.
    pub t_sensor_object: [[f64; 4]; 4],
    /// Rows of the 4x4 matrix that maps part coordinates to gripper coordinates, millimetres.
    pub t_gripper_object: [[f64; 4]; 4],
    /// Whether the iterations came to rest.
    pub converged: bool,
    /// Iterations.
    pub iterations: u32,
    /// Points that the template explains.
    pub inliers: usize,
    /// Points in contact.
    pub points: usize,
    /// Residual of the inliers.
    pub rmse_mm: f64,
    /// Standard deviations of x y z, millimetres, then rotations, radians (sensor frame).
    pub sigma: [f64; 6],
    /// Standard deviation of the part's place along the axis of insertion.
    pub axial_sigma_mm: f64,
    /// What the contact leaves free, in words.
    pub free: Vec<String>,
    /// Looks at the part, touches included; the pose in the gripper is fused from all of them, the rest is
    /// of the last grasp.
    pub looks: u32,
    /// How many of them were touches of a face of the cell.
    pub touches: u32,
    /// What is expected of the insertion, where `task.clearance_mm` says how wide the hole is.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub forecast: Option<Forecast>,
}

/// What a simulated job really did. The errors are those of the part's pose in the hand as it was
/// localized, or as it was expected if it was not localized.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TruthReport {
    /// Error of the part's origin across the axis of insertion, as it was localized.
    pub lateral_error_mm: f64,
    /// Error of the tip across the axis of insertion.
    pub tip_error_mm: f64,
    /// Error of the direction of that axis.
    pub tilt_error_rad: f64,
    /// Error along the axis.
    pub axial_error_mm: f64,
    /// How deep the part got; negative when it never reached the rim.
    pub inserted_mm: f64,
    /// How deep it could have gone in the posture in which it was aligned.
    pub limit_mm: f64,
    /// Distance of the tip from the hole's axis when the hand was farthest into the hole.
    pub hole_offset_mm: f64,
    /// Angle between the axes of part and hole then.
    pub hole_tilt_rad: f64,
    /// Whether the outcome says what happened.
    pub outcome_is_true: bool,
}

/// What became of the page of a run.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct PageReport {
    /// Where it stands.
    pub path: PathBuf,
    /// Why it could not be written, if it could not.
    pub fault: Option<String>,
}

/// What came of a job.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct JobReport {
    /// How it ended.
    pub outcome: Outcome,
    /// Why it stopped, in one sentence.
    pub why: String,
    /// The stages that were begun.
    pub stages: Vec<StageReport>,
    /// From images to results and to stop commands.
    pub latency: LatencyReport,
    /// The part in the hand, once it was found.
    pub localized: Option<Localized>,
    /// What really happened, where that is known: in simulation only.
    pub truth: Option<TruthReport>,
    /// Digest of all frames' digests, in order.
    pub digest: String,
    /// The recording, and whether it ended early.
    pub recording: Option<RecordingReport>,
    /// Why the light could not be switched off at the end, if it could not.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub light_fault: Option<String>,
    /// The page of the run, where one was asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub page: Option<PageReport>,
}
