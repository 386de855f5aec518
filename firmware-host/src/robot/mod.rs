//! Robots that carry the gripper: the trait used by the robot task, and the bridge to any controller.

mod bridge;

pub use bridge::BridgeRobot;

use gelstereo_core::math::Pose;
use std::fmt;

/// Status of a robot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RobotStatus {
    /// Maps gripper coordinates to base coordinates.
    pub t_base_gripper: Pose,
    /// Whether it is moving.
    pub moving: bool,
}

/// Reason why a robot does not carry out a request.
#[derive(Clone, Debug, PartialEq)]
pub enum RobotError {
    /// A speed is not positive and finite.
    Speed {
        /// Requested speed.
        speed_mm_s: f64,
    },
    /// No response arrived.
    Silent {
        /// Address of the bridge.
        address: String,
        /// Waiting time.
        waited_ms: u64,
    },
    /// The connection failed.
    Connection {
        /// Address of the bridge.
        address: String,
        /// The system's error.
        message: String,
    },
    /// The robot reports a fault, or its response is invalid.
    Device {
        /// The robot's message.
        message: String,
    },
}

impl fmt::Display for RobotError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Speed { speed_mm_s } => {
                write!(f, "speed_mm_s is {speed_mm_s}; valid is above 0 and finite")
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

/// A robot arm with the gripper at its flange. Moves return at once; [`Robot::status`] shows when they
/// are over.
pub trait Robot {
    /// Starts a straight-line motion of the gripper to a pose in the base frame, turning at a constant rate.
    ///
    /// # Errors
    /// [`RobotError`].
    fn move_to(&mut self, t_base_gripper: &Pose, speed_mm_s: f64) -> Result<(), RobotError>;

    /// Starts a stop without waiting for the robot, if the driver can; [`Self::stop`] always follows.
    fn begin_stop(&mut self) {}

    /// Stops at the present position.
    ///
    /// # Errors
    /// [`RobotError::Device`].
    fn stop(&mut self) -> Result<(), RobotError>;

    /// Reads the present state.
    ///
    /// # Errors
    /// [`RobotError::Device`].
    fn status(&mut self) -> Result<RobotStatus, RobotError>;

    /// Time when the last bytes to the robot were on the wire, nanoseconds of `CLOCK_MONOTONIC`; `None`
    /// for a simulated robot.
    fn sent_ns(&self) -> Option<u64> {
        None
    }
}
