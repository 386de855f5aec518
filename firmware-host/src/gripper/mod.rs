//! Grippers: the trait that the robot task uses, and a driver for each kind.
//!
//! A driver is one file here beside its codec in [`crate::codec`]. It opens nothing by itself: [`mod@line`] brings the bytes.

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
    /// The speed is out of range.
    Speed {
        /// Speed asked for.
        speed_mm_s: f64,
        /// Smallest valid.
        min_mm_s: f64,
        /// Largest valid.
        max_mm_s: f64,
    },
    /// The force is no share of the range.
    Force {
        /// Share asked for; valid is 0 to 1.
        force: f64,
    },
    /// A move was asked for before the gripper was activated.
    NotActivated,
    /// Activation would move the fingers, and they hold something.
    Holds,
    /// Nothing came back.
    Silent {
        /// Where it was waited.
        port: String,
        /// For how long in all.
        waited_ms: u64,
    },
    /// The port fails.
    Port {
        /// Which.
        port: String,
        /// The system's answer.
        message: String,
    },
    /// The gripper reports a fault.
    Fault {
        /// The fault in words.
        message: String,
    },
    /// The gripper refuses the request, or answers with what is no answer.
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
            Self::Speed { speed_mm_s, min_mm_s, max_mm_s } => write!(
                f,
                "the gripper was asked for {speed_mm_s} mm/s; it can move at {min_mm_s} to {max_mm_s} mm/s"
            ),
            Self::Force { force } => {
                write!(f, "the gripper was asked for a force of {force}; valid is a share from 0 to 1")
            }
            Self::NotActivated => {
                write!(
                    f,
                    "the gripper is not activated; activate it, and wait until its fingers stand, before the first move"
                )
            }
            Self::Holds => write!(
                f,
                "the gripper holds something and must be activated again, which drops it; take the part out, open the \
                 gripper, then start again"
            ),
            Self::Silent { port, waited_ms } => write!(
                f,
                "the gripper on {port} has not answered for {waited_ms} ms; is it powered, and are port, baud rate and \
                 unit right?"
            ),
            Self::Port { port, message } => write!(f, "gripper port {port}: {message}"),
            Self::Fault { message } => write!(f, "gripper fault: {message}"),
            Self::Device { message } => write!(f, "gripper: {message}"),
        }
    }
}

impl std::error::Error for GripperError {}

/// Activation sweeps the fingers once open and closed; the makers' own drivers allow ten seconds.
const MAX_ACTIVATION: Duration = Duration::from_secs(15);

/// An activation that is under way.
#[derive(Clone, Copy, Debug)]
struct Activating {
    deadline: Instant,
}

impl Activating {
    fn begun() -> Self {
        Self { deadline: Instant::now() + MAX_ACTIVATION }
    }

    /// The status of fingers that sweep at `width_mm`. `fault` is what the gripper reports.
    fn status(self, width_mm: f64, fault: &dyn fmt::Display) -> Result<GripperStatus, GripperError> {
        if Instant::now() > self.deadline {
            let message = format!("activation did not end within {} s: {fault}", MAX_ACTIVATION.as_secs());
            return Err(GripperError::Fault { message });
        }
        Ok(GripperStatus { width_mm, moving: true, object_detected: false })
    }
}

/// A speed within a range; a NaN is out of it.
fn check_speed(speed_mm_s: f64, (min_mm_s, max_mm_s): (f64, f64)) -> Result<f64, GripperError> {
    if speed_mm_s >= min_mm_s && speed_mm_s <= max_mm_s {
        return Ok(speed_mm_s);
    }
    Err(GripperError::Speed { speed_mm_s, min_mm_s, max_mm_s })
}

/// A share of a range, in steps of the device.
fn share(force: f64, steps: f64) -> Result<f64, GripperError> {
    if (0.0..=1.0).contains(&force) {
        Ok((force * steps).round())
    } else {
        Err(GripperError::Force { force })
    }
}

/// A two-finger gripper. Activation and moves return at once; [`Gripper::status`] says when they are over.
pub trait Gripper {
    /// Begins to make the gripper ready. Some sweep their fingers, and drop what they hold; they move until they are
    /// ready.
    ///
    /// # Errors
    /// [`GripperError`].
    fn activate(&mut self) -> Result<(), GripperError>;

    /// Starts to move to a width. `force` is a share of the gripper's range, 0 to 1.
    ///
    /// # Errors
    /// [`GripperError`].
    fn move_to(&mut self, width_mm: f64, speed_mm_s: f64, force: f64) -> Result<(), GripperError>;

    /// Begins to stop without waiting for the gripper, where the driver can; [`Self::stop`] follows in any case.
    fn begin_stop(&mut self) {}

    /// Stops where the fingers are. A gripper that is being activated is not ready afterwards.
    ///
    /// # Errors
    /// [`GripperError::Device`].
    fn stop(&mut self) -> Result<(), GripperError>;

    /// Asks for the present state.
    ///
    /// # Errors
    /// [`GripperError::Device`].
    fn status(&mut self) -> Result<GripperStatus, GripperError>;

    /// When the last bytes to the gripper were on the wire, nanoseconds of `CLOCK_MONOTONIC`. A simulated gripper has no
    /// wire.
    fn sent_ns(&self) -> Option<u64> {
        None
    }
}
