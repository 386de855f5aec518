//! Grippers.

use std::fmt;

/// What a gripper says of itself.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct GripperStatus {
    /// Opening between the pads.
    pub width_mm: f64,
    /// Whether the fingers move.
    pub moving: bool,
    /// Whether the fingers were stopped by something between them.
    pub object_detected: bool,
}

/// Why a gripper does not do what it was asked.
#[derive(Clone, Debug, PartialEq)]
pub enum GripperError {
    /// The width is out of range.
    Width {
        /// Width asked for.
        width_mm: f64,
        /// Smallest valid.
        min_mm: f64,
        /// Largest valid.
        max_mm: f64,
    },
    /// A move was asked for before the gripper was activated.
    NotActivated,
    /// The gripper does not answer, or reports a fault.
    Device {
        /// What it said.
        message: String,
    },
}

impl fmt::Display for GripperError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Width { width_mm, min_mm, max_mm } => write!(
                f,
                "the gripper was asked for {width_mm:.3} mm; it can have {min_mm:.3} to {max_mm:.3} mm"
            ),
            Self::NotActivated => {
                write!(f, "the gripper is not activated; activate it before the first move")
            }
            Self::Device { message } => write!(f, "gripper: {message}"),
        }
    }
}

impl std::error::Error for GripperError {}

/// A two-finger gripper. Moves return at once; [`Gripper::status`] says when they are over.
pub trait Gripper {
    /// Makes the gripper ready. Some sweep their fingers, and drop what they hold.
    ///
    /// # Errors
    /// [`GripperError::Device`].
    fn activate(&mut self) -> Result<(), GripperError>;

    /// Starts to move to a width. `force` is a share of the gripper's range, 0 to 1.
    ///
    /// # Errors
    /// [`GripperError`].
    fn move_to(&mut self, width_mm: f64, speed_mm_s: f64, force: f64) -> Result<(), GripperError>;

    /// Stops where the fingers are.
    ///
    /// # Errors
    /// [`GripperError::Device`].
    fn stop(&mut self) -> Result<(), GripperError>;

    /// Asks for the present state.
    ///
    /// # Errors
    /// [`GripperError::Device`].
    fn status(&mut self) -> Result<GripperStatus, GripperError>;
}
