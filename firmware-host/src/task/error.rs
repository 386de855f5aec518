//! Errors that end a task before its last stage.

use super::noise::MIN_SIGMAS;
use crate::gripper::GripperError;
use crate::report::{Outcome, Stage};
use crate::robot::RobotError;
use crate::sensing::SensingError;
use crate::source::SourceError;
use gelstereo_core::frames::WidthError;
use std::time::Duration;

/// Reason why a task broke off. Gripper and robot were stopped, and the recording was closed.
#[derive(Debug)]
pub enum TaskError {
    /// The source of stereo pairs failed.
    Source(SourceError),
    /// The gripper failed.
    Gripper(GripperError),
    /// The robot failed.
    Robot(RobotError),
    /// The gripper reports a width outside the range of the mount.
    Width(WidthError),
    /// Frames could not be processed, or a pipeline action failed.
    Sensing {
        /// The stage.
        stage: Stage,
        /// Frames that failed in a row; 0 for an action.
        bad_frames: u32,
        /// The last error.
        error: SensingError,
    },
    /// The camera delivered no image while something moved.
    CameraSilent {
        /// The stage.
        stage: Stage,
        /// Duration of the silence.
        silent: Duration,
    },
    /// A result came too late while something moved.
    Late {
        /// The stage.
        stage: Stage,
        /// From the image to the result.
        took: Duration,
        /// `task.max_late_periods`, as a time.
        limit: Duration,
    },
    /// A trigger in sigmas is so low that noise alone would reach it.
    TriggerInNoise {
        /// `grasp` or `insertion`.
        name: &'static str,
        /// The trigger.
        found_px: f64,
        /// Lowest trigger without false alarms.
        bound_px: f64,
        /// Median of the mean marker motion at rest.
        level_px: f64,
        /// Robust standard deviation of the same.
        sigma_px: f64,
        /// Number of frames measured.
        frames: usize,
    },
    /// A stage exceeded its time limit.
    StageTimeout {
        /// The stage.
        stage: Stage,
        /// `task.stage_timeout_s`.
        limit_s: f64,
    },
}

impl TaskError {
    /// Kind of error, as used in the JSON summary.
    pub(crate) const fn cause(&self) -> &'static str {
        match self {
            Self::Source(_) => "source",
            Self::Gripper(_) => "gripper",
            Self::Robot(_) => "robot",
            Self::Width(_) => "width",
            Self::Sensing { .. } => "sensing",
            Self::CameraSilent { .. } => "camera_silent",
            Self::Late { .. } => "late",
            Self::TriggerInNoise { .. } => "trigger_in_noise",
            Self::StageTimeout { .. } => "stage_timeout",
        }
    }
}

impl std::fmt::Display for TaskError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Source(error) => error.fmt(f),
            Self::Gripper(error) => error.fmt(f),
            Self::Robot(error) => error.fmt(f),
            Self::Width(error) => error.fmt(f),
            Self::Sensing { stage, bad_frames: 0, error } => write!(f, "{}: {error}", stage.name()),
            Self::Sensing { stage, bad_frames, error } => {
                write!(f, "{}: {bad_frames} bad frames in a row, at last: {error}", stage.name())
            }
            Self::CameraSilent { stage, silent } => write!(
                f,
                "{}: the camera was silent for {:.0} ms while something moved; everything was stopped \
                 (task.max_blind_travel_mm)",
                stage.name(),
                silent.as_secs_f64() * 1e3
            ),
            Self::Late { stage, took, limit } => write!(
                f,
                "{}: a result came {:.0} ms after its image while something moved, later than {:.0} ms; \
                 everything was stopped (task.max_late_periods)",
                stage.name(),
                took.as_secs_f64() * 1e3,
                limit.as_secs_f64() * 1e3
            ),
            Self::TriggerInNoise { name, found_px, bound_px, level_px, sigma_px, frames } => write!(
                f,
                "the {name} trigger of {found_px:.4} px lies in this sensor's noise, which over {frames} \
                 frames at rest was {level_px:.4} px with a standard deviation of {sigma_px:.4} px; valid is \
                 {bound_px:.4} px, {MIN_SIGMAS} sigmas, or more, and a noise above zero; raise \
                 task.{name}_trigger_sigmas or params.contact.{name}_trigger_px"
            ),
            Self::StageTimeout { stage, limit_s } => write!(
                f,
                "{} did not end within {limit_s} s (task.stage_timeout_s); do gripper and robot move?",
                stage.name()
            ),
        }
    }
}

impl std::error::Error for TaskError {}

/// Reason why a stage ends early.
pub(super) enum Halt {
    Outcome(Outcome),
    Error(TaskError),
}

impl From<TaskError> for Halt {
    fn from(error: TaskError) -> Self {
        Self::Error(error)
    }
}

macro_rules! halt_from {
    ($($error:ty => $variant:ident),*) => {
        $(impl From<$error> for Halt {
            fn from(error: $error) -> Self {
                Self::Error(TaskError::$variant(error))
            }
        })*
    };
}
halt_from!(SourceError => Source, GripperError => Gripper, RobotError => Robot, WidthError => Width);
