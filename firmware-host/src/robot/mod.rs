//! Robots that carry the gripper: the trait that the robot task uses, and the bridge to any controller.

mod bridge;

pub use bridge::BridgeRobot;

use gelstereo_core::math::Pose;
use std::fmt;

/// What a robot says of itself.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RobotStatus {
    /// Maps gripper coordinates to base coordinates.
    pub t_base_gripper: Pose,
    /// Whether it moves.
    pub moving: bool,
}

/// Why a robot does not do what it was asked.
#[derive(Clone, Debug, PartialEq)]
pub enum RobotError {
    /// A speed is not above 0 and finite.
    Speed {
        /// Speed asked for.
        speed_mm_s: f64,
    },
    /// Nothing came back.
    Silent {
        /// Where it was waited.
        address: String,
        /// For how long.
        waited_ms: u64,
    },
    /// The connection fails.
    Connection {
        /// Which.
        address: String,
        /// The system's answer.
        message: String,
    },
    /// The robot reports a fault, or answers with what is no answer.
    Device {
        /// What it said.
        message: String,
    },
}

impl fmt::Display for RobotError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Speed { speed_mm_s } => {
                write!(f, "the robot was asked for a speed of {speed_mm_s} mm/s; valid is above 0 and finite")
            }
            Self::Silent { address, waited_ms } => {
                write!(
                    f,
                    "the robot at {address} has not answered for {waited_ms} ms; the motion was not confirmed"
                )
            }
            Self::Connection { address, message } => write!(f, "robot at {address}: {message}"),
            Self::Device { message } => write!(f, "robot: {message}"),
        }
    }
}

impl std::error::Error for RobotError {}

/// A robot arm with the gripper at its flange. Moves return at once; [`Robot::status`] says when they are over.
pub trait Robot {
    /// Starts to move the gripper on a straight line to a pose in the base frame, turning evenly on the way.
    ///
    /// # Errors
    /// [`RobotError`].
    fn move_to(&mut self, t_base_gripper: &Pose, speed_mm_s: f64) -> Result<(), RobotError>;

    /// Begins to stop without waiting for the robot, where the driver can; [`Self::stop`] follows in any case.
    fn begin_stop(&mut self) {}

    /// Stops where it is.
    ///
    /// # Errors
    /// [`RobotError::Device`].
    fn stop(&mut self) -> Result<(), RobotError>;

    /// Asks for the present state.
    ///
    /// # Errors
    /// [`RobotError::Device`].
    fn status(&mut self) -> Result<RobotStatus, RobotError>;

    /// When the last bytes to the robot were on the wire, nanoseconds of `CLOCK_MONOTONIC`. A simulated robot has no
    /// wire.
    fn sent_ns(&self) -> Option<u64> {
        None
    }
}
