//! Grippers: the trait used by the robot task, and a driver for each kind.
//!
//! A driver is one file here and a codec in [`crate::codec`]. It does not open ports; [`mod@line`]
//! provides the line.

mod config;
mod dh;
mod dynamixel;
mod feetech;
pub mod line;
mod modbus;
mod onrobot;
mod robotiq;
mod robotiq_urcap;
mod servo;
mod width;

pub use config::{GripperConfig, OnRobotModel, RobotiqModel};
pub use dh::DhRobotics;
pub use dynamixel::DynamixelGripper;
pub use feetech::FeetechGripper;
pub use modbus::{Framing, Master};
pub use onrobot::OnRobot;
pub use robotiq::Robotiq;
pub use robotiq_urcap::RobotiqUrcap;
pub use width::{WidthTable, WidthTableError};

use std::fmt;
use std::time::{Duration, Instant};

/// Status of a gripper.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct GripperStatus {
    /// Opening between the pads.
    pub width_mm: f64,
    /// Whether the fingers move.
    pub moving: bool,
    /// Whether an object between the fingers stopped them.
    pub object_detected: bool,
}

/// Reason why a gripper request failed.
#[derive(Clone, Debug, PartialEq)]
pub enum GripperError {
    /// The width is out of range.
    Width {
        /// Requested width.
        width_mm: f64,
        /// Smallest valid width.
        min_mm: f64,
        /// Largest valid width.
        max_mm: f64,
    },
    /// The speed is out of range.
    Speed {
        /// Requested speed.
        speed_mm_s: f64,
        /// Smallest valid speed.
        min_mm_s: f64,
        /// Largest valid speed.
        max_mm_s: f64,
    },
    /// The force is not a fraction of the range.
    Force {
        /// Requested fraction; valid is 0 to 1.
        force: f64,
    },
    /// A move was requested before the gripper was activated.
    NotActivated,
    /// Activation would move the fingers while they hold something.
    Holds,
    /// No reply came.
    Silent {
        /// Port that was read.
        port: String,
        /// Total time waited.
        waited_ms: u64,
    },
    /// The port failed.
    Port {
        /// Name of the port.
        port: String,
        /// Error message of the system.
        message: String,
    },
    /// The gripper reports a fault.
    Fault {
        /// The fault in words.
        message: String,
    },
    /// The gripper refuses the request or sends an invalid reply.
    Device {
        /// Reason.
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
            Self::Speed { speed_mm_s, min_mm_s, max_mm_s } => write!(
                f,
                "the gripper was asked for {speed_mm_s} mm/s; it can move at {min_mm_s} to {max_mm_s} mm/s"
            ),
            Self::Force { force } => {
                write!(f, "force is {force}; valid is a fraction from 0 to 1")
            }
            Self::NotActivated => {
                write!(
                    f,
                    "the gripper is not activated; activate it, and wait until its fingers stand, before the \
                    first move"
                )
            }
            Self::Holds => write!(
                f,
                "the gripper holds something and must be activated again, which drops it; take the part out, \
                 open the gripper, then start again"
            ),
            Self::Silent { port, waited_ms } => write!(
                f,
                "the gripper on {port} has not answered for {waited_ms} ms; is it powered, and are port, \
                 baud rate and unit right?"
            ),
            Self::Port { port, message } => write!(f, "gripper port {port}: {message}"),
            Self::Fault { message } => write!(f, "gripper fault: {message}"),
            Self::Device { message } => write!(f, "gripper: {message}"),
        }
    }
}

impl std::error::Error for GripperError {}

/// Activation opens and closes the fingers once; the makers' own drivers allow ten seconds.
const MAX_ACTIVATION: Duration = Duration::from_secs(15);

/// An activation in progress.
#[derive(Clone, Copy, Debug)]
struct Activating {
    deadline: Instant,
}

impl Activating {
    fn begun() -> Self {
        Self { deadline: Instant::now() + MAX_ACTIVATION }
    }

    /// Status while the fingers sweep, at `width_mm`. `fault` is the gripper's report.
    fn status(self, width_mm: f64, fault: &dyn fmt::Display) -> Result<GripperStatus, GripperError> {
        if Instant::now() > self.deadline {
            let message = format!("activation did not end within {} s: {fault}", MAX_ACTIVATION.as_secs());
            return Err(GripperError::Fault { message });
        }
        Ok(GripperStatus { width_mm, moving: true, object_detected: false })
    }
}

/// Checks that a speed is within a range; NaN is not.
fn check_speed(speed_mm_s: f64, (min_mm_s, max_mm_s): (f64, f64)) -> Result<f64, GripperError> {
    if speed_mm_s >= min_mm_s && speed_mm_s <= max_mm_s {
        return Ok(speed_mm_s);
    }
    Err(GripperError::Speed { speed_mm_s, min_mm_s, max_mm_s })
}

/// Converts a fraction of a range to steps of the device.
fn share(force: f64, steps: f64) -> Result<f64, GripperError> {
    if (0.0..=1.0).contains(&force) {
        Ok((force * steps).round())
    } else {
        Err(GripperError::Force { force })
    }
}

/// Two-finger gripper. Activation and moves return at once; [`Gripper::status`] reports when they are
/// complete.
pub trait Gripper {
    /// Starts to make the gripper ready. Some grippers sweep their fingers and drop what they hold;
    /// their status is moving until they are ready.
    ///
    /// # Errors
    /// [`GripperError`].
    fn activate(&mut self) -> Result<(), GripperError>;

    /// Starts a move to a width. `force` is a fraction of the gripper's range, 0 to 1.
    ///
    /// # Errors
    /// [`GripperError`].
    fn move_to(&mut self, width_mm: f64, speed_mm_s: f64, force: f64) -> Result<(), GripperError>;

    /// Begins to stop without waiting for the gripper, if the driver supports it; [`Self::stop`] follows
    /// in any case.
    fn begin_stop(&mut self) {}

    /// Stops the fingers at their position. A gripper whose activation is interrupted is not ready
    /// afterwards.
    ///
    /// # Errors
    /// [`GripperError::Device`].
    fn stop(&mut self) -> Result<(), GripperError>;

    /// Reads the present status.
    ///
    /// # Errors
    /// [`GripperError::Device`].
    fn status(&mut self) -> Result<GripperStatus, GripperError>;

    /// Time at which the last bytes to the gripper were sent, nanoseconds of `CLOCK_MONOTONIC`. `None`
    /// for a simulated gripper.
    fn sent_ns(&self) -> Option<u64> {
        None
    }
}
