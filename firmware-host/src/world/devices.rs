//! Devices of the simulated world: a camera, a gripper and a robot.

use super::World;
use crate::gripper::{Gripper, GripperError, GripperStatus};
use crate::robot::{Robot, RobotError, RobotStatus};
use crate::source::{FrameSource, Next, SourceError, StereoPair};
use gelstereo_core::math::Pose;
use std::cell::RefCell;
use std::rc::Rc;
use std::time::Duration;

/// The simulated sensor; it never waits or ends.
#[derive(Clone, Debug)]
pub struct SimulatedCamera(pub Rc<RefCell<World>>);

impl FrameSource for SimulatedCamera {
    fn next_pair(&mut self, _timeout: Duration, pair: &mut StereoPair) -> Result<Next, SourceError> {
        let exposed = self.0.borrow_mut().expose(pair);
        let exposed = exposed.map_err(|error| SourceError::Device { message: error.to_string() })?;
        Ok(if exposed { Next::Pair } else { Next::End })
    }
}

/// Real images in a simulated world; each frame advances its time.
pub struct PacedSource {
    /// Source of the images.
    pub source: Box<dyn FrameSource>,
    /// The world that is advanced.
    pub world: Rc<RefCell<World>>,
}

impl FrameSource for PacedSource {
    fn next_pair(&mut self, timeout: Duration, pair: &mut StereoPair) -> Result<Next, SourceError> {
        let next = self.source.next_pair(timeout, pair)?;
        if next == Next::Pair {
            self.world.borrow_mut().tick();
        }
        Ok(next)
    }

    fn len_hint(&self) -> Option<usize> {
        self.source.len_hint()
    }
}

/// Longest step of the simulated world between two pairs: after a camera interruption, gripper and robot
/// continue from where they were.
const MAX_STEP_NS: u64 = 1_000_000_000;

/// Images of a real camera in a simulated world; their timestamps advance its time.
pub struct TimedSource {
    source: Box<dyn FrameSource>,
    world: Rc<RefCell<World>>,
    last_ns: Option<u64>,
    /// Remainder of time below one period of the world.
    rest_ns: u64,
}

impl TimedSource {
    /// Pairs of `source`, whose timestamps advance `world`.
    #[must_use]
    pub fn new(source: Box<dyn FrameSource>, world: Rc<RefCell<World>>) -> Self {
        Self { source, world, last_ns: None, rest_ns: 0 }
    }
}

impl FrameSource for TimedSource {
    fn next_pair(&mut self, timeout: Duration, pair: &mut StereoPair) -> Result<Next, SourceError> {
        let next = self.source.next_pair(timeout, pair)?;
        if next == Next::Pair {
            let last_ns = self.last_ns.replace(pair.time_ns).unwrap_or(pair.time_ns);
            let mut world = self.world.borrow_mut();
            let passed_ns = self.rest_ns + pair.time_ns.saturating_sub(last_ns).min(MAX_STEP_NS);
            (0..passed_ns / world.period_ns).for_each(|_| world.tick());
            self.rest_ns = passed_ns % world.period_ns;
        }
        Ok(next)
    }

    fn len_hint(&self) -> Option<usize> {
        self.source.len_hint()
    }
}

/// The simulated gripper.
#[derive(Clone, Debug)]
pub struct SimulatedGripper(pub Rc<RefCell<World>>);

impl Gripper for SimulatedGripper {
    fn activate(&mut self) -> Result<(), GripperError> {
        self.0.borrow_mut().activated = true;
        Ok(())
    }

    fn move_to(&mut self, width_mm: f64, speed_mm_s: f64, _force: f64) -> Result<(), GripperError> {
        let mut world = self.0.borrow_mut();
        if !world.activated {
            return Err(GripperError::NotActivated);
        }
        let (min_mm, max_mm) = world.mount.kinematics.width_range_mm();
        if !(width_mm >= min_mm && width_mm <= max_mm) {
            return Err(GripperError::Width { width_mm, min_mm, max_mm });
        }
        if !(speed_mm_s > 0.0 && speed_mm_s.is_finite()) {
            let message = format!("speed_mm_s is {speed_mm_s}; valid is above 0 and finite");
            return Err(GripperError::Device { message });
        }
        world.width_mm.target = width_mm;
        world.width_mm.speed = speed_mm_s;
        world.stalled = false;
        Ok(())
    }

    fn stop(&mut self) -> Result<(), GripperError> {
        let mut world = self.0.borrow_mut();
        world.width_mm.target = world.width_mm.now;
        Ok(())
    }

    fn status(&mut self) -> Result<GripperStatus, GripperError> {
        let world = self.0.borrow();
        Ok(GripperStatus {
            width_mm: world.width_mm.now,
            moving: world.width_mm.now != world.width_mm.target,
            object_detected: world.stalled,
        })
    }
}

/// The simulated robot.
#[derive(Clone, Debug)]
pub struct SimulatedRobot(pub Rc<RefCell<World>>);

impl Robot for SimulatedRobot {
    fn move_to(&mut self, t_base_gripper: &Pose, speed_mm_s: f64) -> Result<(), RobotError> {
        if !(speed_mm_s > 0.0 && speed_mm_s.is_finite()) {
            return Err(RobotError::Speed { speed_mm_s });
        }
        let mut world = self.0.borrow_mut();
        let from = world.t_base_gripper.now;
        if let Some(bench) = &mut world.bench {
            bench.depart(&from);
        }
        world.t_base_gripper.target = *t_base_gripper;
        world.t_base_gripper.speed = speed_mm_s;
        Ok(())
    }

    fn stop(&mut self) -> Result<(), RobotError> {
        let mut world = self.0.borrow_mut();
        world.t_base_gripper.target = world.t_base_gripper.now;
        Ok(())
    }

    fn status(&mut self) -> Result<RobotStatus, RobotError> {
        let world = self.0.borrow();
        let robot = &world.t_base_gripper;
        Ok(RobotStatus { t_base_gripper: robot.now, moving: robot.now != robot.target })
    }
}
