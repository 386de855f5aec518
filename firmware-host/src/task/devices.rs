//! Camera, gripper and robot of a task.

use super::TaskError;
use crate::gripper::Gripper;
use crate::robot::Robot;
use crate::source::FrameSource;

/// What the task works with.
pub struct Devices {
    /// Stereo pairs.
    pub source: Box<dyn FrameSource>,
    /// The gripper.
    pub gripper: Box<dyn Gripper>,
    /// The robot.
    pub robot: Box<dyn Robot>,
}

impl Devices {
    /// Stops gripper and robot; the one is stopped even if the other fails.
    ///
    /// # Errors
    /// The first error of both.
    pub(super) fn stop(&mut self) -> Result<(), TaskError> {
        let (gripper, robot) = (self.gripper.stop(), self.robot.stop());
        gripper.map_err(TaskError::Gripper)?;
        robot.map_err(TaskError::Robot)
    }
}
