//! Camera, gripper and robot of a task.

use super::TaskError;
use crate::gripper::Gripper;
use crate::robot::Robot;
use crate::source::{FrameSource, monotonic_ns};

/// Device that a trigger stops.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Stops {
    Gripper,
    Robot,
}

/// Devices of a task.
pub struct Devices {
    /// Source of stereo pairs.
    pub source: Box<dyn FrameSource>,
    /// The gripper.
    pub gripper: Box<dyn Gripper>,
    /// The robot.
    pub robot: Box<dyn Robot>,
}

impl Devices {
    /// Stops one device; returns when the last byte was on the wire, nanoseconds of `CLOCK_MONOTONIC`.
    /// For a simulated device this is the moment when it has stopped.
    ///
    /// # Errors
    /// The device's error.
    pub(super) fn stop_one(&mut self, which: Stops) -> Result<u64, TaskError> {
        let sent_ns = match which {
            Stops::Gripper => {
                self.gripper.stop().map(|()| self.gripper.sent_ns()).map_err(TaskError::Gripper)?
            }
            Stops::Robot => self.robot.stop().map(|()| self.robot.sent_ns()).map_err(TaskError::Robot)?,
        };
        Ok(sent_ns.unwrap_or_else(monotonic_ns))
    }

    /// Stops gripper and robot at the same time; each is stopped even if the other fails.
    ///
    /// # Errors
    /// The first error of the two.
    pub(super) fn stop(&mut self) -> Result<(), TaskError> {
        self.gripper.begin_stop();
        self.robot.begin_stop();
        let (gripper, robot) = (self.gripper.stop(), self.robot.stop());
        gripper.map_err(TaskError::Gripper)?;
        robot.map_err(TaskError::Robot)
    }
}
