//! Repeated grasps in the simulated world, as input for sensing without a robot.

use crate::config::Config;
use crate::gripper::{Gripper, GripperError};
use crate::source::{FrameSource, Next, SourceError, StereoPair};
use std::time::Duration;

/// Frames with open fingers before each grasp: enough for the rest state.
const OPEN_FRAMES: u32 = 30;
/// Number of frames with the part held.
const HELD_FRAMES: u32 = 60;
/// The fingers close this far below `sense.grasp_width_mm`; the default part then presses the gel 0.75 mm
/// deep.
const SQUEEZE_MM: f64 = 1.5;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    Open { frames: u32 },
    Closing,
    Held { frames: u32 },
    Opening,
}

/// The simulated sensor in a gripper that opens and closes.
pub struct Rehearsal {
    source: Box<dyn FrameSource>,
    gripper: Box<dyn Gripper>,
    open_mm: f64,
    closed_mm: f64,
    opening_speed_mm_s: f64,
    closing_speed_mm_s: f64,
    force: f64,
    phase: Option<Phase>,
}

impl Rehearsal {
    /// Uses the speeds of the task.
    #[must_use]
    pub fn new(source: Box<dyn FrameSource>, gripper: Box<dyn Gripper>, config: &Config) -> Self {
        let task = &config.task;
        let (min_mm, _) = config.mount.kinematics.width_range_mm();
        Self {
            source,
            gripper,
            open_mm: task.open_width_mm,
            closed_mm: (config.sense.grasp_width_mm - SQUEEZE_MM).max(min_mm),
            opening_speed_mm_s: task.opening_speed_mm_s,
            closing_speed_mm_s: task.closing_speed_mm_s,
            force: task.closing_force,
            phase: None,
        }
    }

    fn drive(&mut self) -> Result<(), GripperError> {
        let moving = self.phase.is_some() && self.gripper.status()?.moving;
        let next = match self.phase {
            None => {
                self.gripper.activate()?;
                self.gripper.move_to(self.open_mm, self.opening_speed_mm_s, self.force)?;
                Phase::Opening
            }
            Some(Phase::Opening) if !moving => Phase::Open { frames: OPEN_FRAMES },
            Some(Phase::Open { frames: 0 }) => {
                self.gripper.move_to(self.closed_mm, self.closing_speed_mm_s, self.force)?;
                Phase::Closing
            }
            Some(Phase::Closing) if !moving => Phase::Held { frames: HELD_FRAMES },
            Some(Phase::Held { frames: 0 }) => {
                self.gripper.move_to(self.open_mm, self.opening_speed_mm_s, self.force)?;
                Phase::Opening
            }
            Some(Phase::Open { frames }) => Phase::Open { frames: frames - 1 },
            Some(Phase::Held { frames }) => Phase::Held { frames: frames - 1 },
            Some(phase) => phase,
        };
        self.phase = Some(next);
        Ok(())
    }
}

impl FrameSource for Rehearsal {
    fn next_pair(&mut self, timeout: Duration, pair: &mut StereoPair) -> Result<Next, SourceError> {
        self.drive().map_err(|error| SourceError::Device { message: error.to_string() })?;
        self.source.next_pair(timeout, pair)
    }
}
